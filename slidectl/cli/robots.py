"""`slidectl robots` and `slidectl delete`: what is in the world, and taking it out.

Also what other commands need to know of robots: finding one by name, and telling its report.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click

from slidectl.cli import live, output
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.errors import Refused, UnknownName

Robot = dict[str, Any]

_NONE = "no robots in the world; spawn one: slidectl spawn slider"
_JOINT_COLUMNS = (
    "name", "type", "interface", "position", "velocity", "effort", "lower", "upper", "max_velocity", "max_effort",
)  # fmt: skip


def all_robots(ctx: Context) -> list[Robot]:
    """Every robot (slidectl/RobotInfo), by name."""
    return sorted(ctx.call("/slidectl/list_robots", {"name": ""})["robots"], key=lambda robot: str(robot["name"]))


def find(robots: Sequence[Robot], name: str) -> Robot:
    """The robot of that name, or of that namespace (`/left`). Raises UnknownName."""
    for robot in robots:
        if name == robot["name"] or (name.startswith("/") and name == robot["namespace"]):
            return robot
    raise UnknownName("robot", name, [robot["name"] for robot in robots])


@command("robots", examples=["slidectl robots", "slidectl robots slider -v", "slidectl robots slider --json"])
@click.argument("name", required=False, shell_complete=live.robots)
@click.pass_obj
def robots(ctx: Context, name: str | None) -> None:
    """List the robots, or show one with its joints.

    Lengths in m, angles in rad, forces in N or N m; a joint without a limit has none. With a name and -v also what
    became of each tag of the model. JSON keys: name, namespace, fixed, pose (x y z qx qy qz qw), links, joints (name,
    type, interface, position, velocity, effort, lower, upper, max_velocity, max_effort), controllers, and report
    (verdict, subject, text, file, line) when a name is given.
    """
    found = all_robots(ctx)
    if name is None:
        rows = [record(robot, with_report=False) for robot in found]
        if ctx.format in ("text", "csv"):
            rows = [{**row, "joints": moving(row)} for row in rows]
        ctx.emit_rows(rows, ["name", "namespace", "fixed", "joints", "controllers"], empty=_NONE)
        return
    one = record(find(found, name))
    if ctx.format == "csv":
        ctx.emit_rows(one["joints"], _JOINT_COLUMNS)
    else:
        ctx.emit(one, robot_text(one, ctx.verbose > 0) if ctx.format == "text" else None)


def record(robot: Robot, with_report: bool = True) -> Robot:
    """A slidectl/RobotInfo with the keys that this command line promises."""
    joints = [_joint(joint) for joint in robot["joints"]]
    keys = ("name", "namespace", "fixed", "pose", "links")
    result = {key: robot[key] for key in keys} | {"joints": joints, "controllers": robot["controllers"]}
    return result | ({"report": robot["report"]} if with_report else {})


def moving(robot: Robot) -> list[str]:
    """The names of its joints, without the fixed ones."""
    return [joint["name"] for joint in robot["joints"] if joint["type"] != "fixed"]


def _joint(joint: dict[str, Any]) -> dict[str, Any]:
    return {key: joint["hardware_interface" if key == "interface" else key] for key in _JOINT_COLUMNS}


def robot_text(robot: Robot, with_report: bool) -> str:
    """One robot for people."""
    head = {
        "name": robot["name"],
        "namespace": robot["namespace"],
        "root": "fixed to the world" if robot["fixed"] else "free",
        "position": robot["pose"][:3],
        "quaternion": robot["pose"][3:],
        "links": robot["links"],
        "controllers": robot["controllers"],
    }
    shown = (joint for joint in robot["joints"] if joint["type"] != "fixed")
    rows = [{**joint, "interface": joint["interface"].rpartition("/")[2]} for joint in shown]
    parts = [output.as_lines(head)]
    if rows:
        parts.append(output.table(rows, _JOINT_COLUMNS).rstrip())
    notices = robot["report"]
    if notices:
        parts.append("\n".join(map(notice_text, notices)) if with_report else summary(robot["name"], notices))
    return "\n\n".join(parts)


def notice_text(notice: dict[str, Any]) -> str:
    """`file:line: verdict: subject: text`."""
    where = f"{notice['file']}:{notice['line']}" if notice["line"] else notice["file"]
    return f"{where}: {notice['verdict']}: {notice['subject']}: {notice['text']}"


def summary(name: str, notices: Sequence[dict[str, Any]]) -> str:
    """One line that counts the notices and says where they are listed."""
    names = {"wrong": "wrong", "ignored": "without effect", "converted": "converted"}
    counts = {verdict: sum(notice["verdict"] == verdict for notice in notices) for verdict in names}
    parts = [f"{count} {names[verdict]}" for verdict, count in counts.items() if count]
    return f"tags and values of the model: {', '.join(parts)} (slidectl robots {name} -v lists them)" if parts else ""


@command("delete", examples=["slidectl delete slider"])
@click.argument("names", nargs=-1, required=True, metavar="NAME...", shell_complete=live.robots)
@click.pass_obj
def delete(ctx: Context, names: tuple[str, ...]) -> None:
    """Take robots out of the world.

    All names are looked up before the first robot goes. JSON keys: name, namespace.
    """
    present = all_robots(ctx)
    for robot in [find(present, name) for name in dict.fromkeys(names)]:
        answer = ctx.call("/gazebo/delete_model", {"model_name": robot["name"]})
        if not answer["success"]:
            raise Refused(f"cannot delete {robot['name']}: {answer['status_message']}")
        ctx.done({"name": robot["name"], "namespace": robot["namespace"]}, f"{robot['name']}: deleted")
