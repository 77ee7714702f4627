"""`slidectl robots`, `slidectl delete` and `slidectl estop`: list, delete and stop robots.

Other commands use its functions to find a robot by name, and to print its report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.errors import Refused, UnknownName, closest
from slidectl.names import is_under, join

if TYPE_CHECKING:
    from slidectl.msgs.typed import RobotInfoMsg

_NONE = "no robots in the world; spawn one: slidectl spawn slider"
_JOINT_COLUMNS = (
    "name", "type", "interface", "position", "velocity", "effort", "lower", "upper", "max_velocity", "max_effort",
)  # fmt: skip


def find(robots: Sequence[RobotInfoMsg], name: str) -> RobotInfoMsg:
    """The robot of that name, or of that namespace (`/left`). Raises UnknownName."""
    for robot in robots:
        if name == robot["name"] or (name.startswith("/") and name == robot["namespace"]):
            return robot
    raise UnknownName("robot", name, [robot["name"] for robot in robots])


@command("robots", examples=["slidectl robots", "slidectl robots slider -v", "slidectl robots slider --json"])
@click.argument("name", required=False, shell_complete=completion.robots)
@click.pass_obj
def robots(ctx: Context, name: str | None) -> None:
    """List the robots, or show one with its joints.

    Lengths in m, angles in rad, forces in N or N m; a joint without a limit has none. With a name, -v also lists what
    became of each tag of the model. KIND is robot, model (without a controller manager, from SDF), or static (a model
    that does not move). JSON keys: name, namespace, kind, fixed, pose (x y z qx qy qz qw), links, joints (name, type,
    interface, position, velocity, effort, lower, upper, max_velocity, max_effort), controllers, estop (true in an
    emergency stop), frozen (it diverged), and report (verdict, subject, text, file, line) when a name is given.
    """
    found = ctx.client.robots() if name is None else [find(ctx.client.robots(), name)]
    warn_stopped(ctx, [robot["name"] for robot in found if robot["estop"]])
    if name is None:
        rows = [record(robot, with_report=False) for robot in found]
        if ctx.format in ("text", "csv"):
            rows = [{**row, "joints": moving(robot)} for row, robot in zip(rows, found, strict=True)]
        ctx.emit_rows(rows, ["name", "namespace", "kind", "fixed", "joints", "controllers"], empty=_NONE)
        return
    one = record(found[0])
    if ctx.format == "csv":
        ctx.emit_rows(one["joints"], _JOINT_COLUMNS)
    else:
        ctx.emit(one, robot_text(one, ctx.verbose > 0) if ctx.format == "text" else None)


def record(robot: RobotInfoMsg, with_report: bool = True) -> dict[str, Any]:
    """A slidectl/RobotInfo with the documented JSON keys."""
    joints = [{**joint, "interface": joint["hardware_interface"]} for joint in robot["joints"]]
    shown = {**robot, "joints": [{key: joint[key] for key in _JOINT_COLUMNS} for joint in joints]}
    keys = ("name", "namespace", "kind", "fixed", "pose", "links", "joints", "controllers", "estop", "frozen", "report")
    return {key: shown[key] for key in (keys if with_report else keys[:-1])}


def warn_stopped(ctx: Context, stopped: Sequence[str]) -> None:
    """Warn that the emergency stop of these robots holds their joints."""
    if stopped:
        ctx.warn(f"emergency stop is on: {', '.join(stopped)}; slidectl estop release ends it")


def moving(robot: RobotInfoMsg) -> list[str]:
    """The names of the robot's joints, without the fixed ones."""
    return [joint["name"] for joint in robot["joints"] if joint["type"] != "fixed"]


def robot_text(robot: Mapping[str, Any], with_report: bool) -> str:
    """The text of one robot; takes what `record` returns."""
    head = {
        "name": robot["name"],
        "namespace": robot["namespace"],
        "kind": robot["kind"],
        "root": "fixed to the world" if robot["fixed"] else "free",
        "position": robot["pose"][:3],
        "quaternion": robot["pose"][3:],
        "links": robot["links"],
        "controllers": robot["controllers"],
    }
    if robot["estop"]:
        head["estop"] = "on"
    if robot["frozen"]:
        head["frozen"] = "it diverged, and is held at rest until a reset"
    movable = [joint for joint in robot["joints"] if joint["type"] != "fixed"]
    rows = [{**joint, "interface": joint["interface"].rpartition("/")[2]} for joint in movable]
    parts = [output.as_lines(head)]
    if rows:
        parts.append(output.table(rows, _JOINT_COLUMNS).rstrip())
    if notices := robot.get("report"):
        parts.append("\n".join(map(notice_text, notices)) if with_report else summary(robot["name"], notices))
    return "\n\n".join(parts)


def notice_text(notice: Mapping[str, Any]) -> str:
    """`file:line: verdict: subject: text`."""
    where = f"{notice['file']}:{notice['line']}" if notice["line"] else notice["file"]
    return f"{where}: {notice['verdict']}: {notice['subject']}: {notice['text']}"


def summary(name: str, notices: Sequence[Mapping[str, Any]]) -> str:
    """One line with the counts of the notices and the command that lists them."""
    titles = {"wrong": "wrong", "ignored": "without effect", "converted": "converted"}
    counts = {verdict: sum(notice["verdict"] == verdict for notice in notices) for verdict in titles}
    parts = [f"{count} {titles[verdict]}" for verdict, count in counts.items() if count]
    return f"tags and values of the model: {', '.join(parts)} (slidectl robots {name} -v lists them)" if parts else ""


@command("delete", examples=["slidectl delete slider"])
@click.argument("names", nargs=-1, required=True, metavar="NAME...", shell_complete=completion.robots)
@click.pass_obj
def delete(ctx: Context, names: tuple[str, ...]) -> None:
    """Take robots out of the world.

    All names are looked up before the first robot goes. JSON keys: name, namespace.
    """
    present = ctx.client.robots()
    for robot in [find(present, name) for name in dict.fromkeys(names)]:
        answer = ctx.call("/gazebo/delete_model", {"model_name": robot["name"]})
        if not answer["success"]:
            raise Refused(f"cannot delete {robot['name']}: {answer['status_message']}")
        ctx.done({"name": robot["name"], "namespace": robot["namespace"]}, f"{robot['name']}: deleted")


@command("estop", examples=["slidectl estop", "slidectl estop slider", "slidectl estop release"])
@click.argument("words", nargs=-1, metavar="[release] [NAME]...", shell_complete=completion.robots)
@click.option("--cm", "namespaces", multiple=True, metavar="NAMESPACE", shell_complete=completion.managers,
              help="The robot with this controller manager, as /rrbot; may repeat.")  # fmt: skip
@click.pass_obj
def estop(ctx: Context, words: tuple[str, ...], namespaces: tuple[str, ...]) -> None:
    """Stop robots at once, or release them.

    Without a name it stops all robots. From the next cycle on, efforts (N or N m) and velocities (m/s or rad/s) are 0
    and positions (m or rad) stay as they were read, whatever controllers command; the controllers keep running.
    'slidectl estop release' ends the stop: it stops and starts the running controllers, so that they begin where the
    joints are. A reset does not end the stop. The command calls the service /slidectl/estop; the topic in <eStopTopic>
    of a robot's plugin does the same. JSON keys: name, namespace, estop, before.
    """
    stop = words[:1] != ("release",)
    present = [robot for robot in ctx.client.robots() if robot["kind"] == "robot"]
    asked = [*(words if stop else words[1:]), *(join("/", namespace) for namespace in namespaces)]
    try:
        meant = [find(present, name) for name in asked] or _below(present, ctx.namespace)
    except UnknownName as unknown:
        if stop and closest(unknown.name, ["release", *unknown.known]) == "release":
            others = [word for word in words if word != unknown.name]
            unknown.hint = f"to end an emergency stop: {' '.join(['slidectl estop release', *others])}"
        raise
    if not meant:
        raise Refused("no robots in the world", "spawn one: slidectl spawn slider")
    answer = ctx.call("/slidectl/estop", {"names": [robot["name"] for robot in meant], "stop": stop})
    if not answer["success"]:
        raise Refused(answer["message"])
    for robot in {robot["name"]: robot for robot in meant}.values():
        record = {"name": robot["name"], "namespace": robot["namespace"], "estop": stop, "before": robot["estop"]}
        already = " already" if robot["estop"] == stop else ""
        ctx.done(record, f"{robot['name']}: {'emergency stop' if stop else 'released'}{already}")


def _below(present: Sequence[RobotInfoMsg], namespace: str) -> list[RobotInfoMsg]:
    """The robots in a namespace. Raises UnknownName when all robots are outside it."""
    found = [robot for robot in present if is_under(robot["namespace"], namespace)]
    if present and not found:
        raise UnknownName("robot's namespace", namespace, [robot["namespace"] for robot in present])
    return found
