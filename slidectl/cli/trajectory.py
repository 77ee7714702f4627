"""`slidectl trajectory`: goals of joint trajectory controllers, from files or from the command line.

The form of a file is checked here. The controller checks whether a trajectory fits it, and its text is printed.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from slidectl import names, typed_values
from slidectl.cli import completion
from slidectl.cli.action import cancel_goals, run
from slidectl.cli.commands import Variadic, group, seconds
from slidectl.cli.context import Context
from slidectl.errors import BadFile, UnknownName, UsageError

if TYPE_CHECKING:
    from slidectl.client.action_client import Action

Message = dict[str, Any]

_FARTHEST = 1e6
"""The largest position, rad or m. Polynomials to much larger positions overflow."""
_LONGEST_S = 2.0**31 - 1
"""The longest duration of ROS, s."""
_TIMES = ("time", "time_from_start")
_QUANTITIES = {"position": "positions", "velocity": "velocities", "acceleration": "accelerations"}
_DURATIONS = (("secs", "nsecs"), ("sec", "nanosec"))
"""The fields of a duration as ROS 1 and ROS 2 write them."""


def _controllers(ctx: Context) -> dict[str, str]:
    from slidectl.client.action_client import trajectory_controllers

    return trajectory_controllers(ctx.client.topics())


_controller = click.argument("controller", metavar="CONTROLLER", shell_complete=completion.completer(_controllers))
_wait = click.option("--wait", is_flag=True, help="Wait for the end; exits 0 only when the goal was reached.")


@group(
    examples=[
        "slidectl trajectory send arm_controller path.yaml --wait",
        "slidectl trajectory plan arm_controller --to joint1=1.5 joint2=-0.4 --duration 2 --wait",
    ]
)
def trajectory() -> None:
    """Trajectory controllers: send, plan, hold, cancel, state."""


@trajectory.command("send", examples=["slidectl trajectory send arm_controller path.csv --wait"])
@_controller
@click.argument("file", metavar="FILE", shell_complete=completion.files)
@_wait
@click.pass_obj
def send(ctx: Context, controller: str, file: str, wait: bool) -> None:
    """Send a trajectory from a .yaml, .json or .csv file; - is YAML or JSON on standard input.

    YAML and JSON hold a trajectory_msgs/JointTrajectory, or the goal that has one as trajectory; times may be seconds.
    CSV has columns time, JOINT, JOINT.velocity and JOINT.acceleration. Without --wait it prints the goal's id, and
    exits 1 when the controller rejects the goal. While it waits, Ctrl-C cancels the goal, and --timeout (4) leaves it
    under way. JSON keys: id, and of a goal that has ended state, status, text, result.
    """
    goal = read_goal(file)
    with _action(ctx, controller) as action:
        _run(ctx, action, goal, wait)


@trajectory.command(
    "plan", examples=["slidectl trajectory plan arm_controller --to joint1=1.5 joint2=-0.4 --duration 2 --wait"]
)
@_controller
@click.option("--to", "targets", cls=Variadic, metavar="JOINT=POSITION...", required=True,
              help="Target positions, rad or m.")  # fmt: skip
@seconds("--duration", required=True, help="Duration of the motion, simulated s.")
@_wait
@click.pass_obj
def plan(ctx: Context, controller: str, targets: tuple[str, ...], duration: float, wait: bool) -> None:
    """Move joints to positions in a given time.

    The other joints go to their present desired positions. All joints are at rest at the end; velocity and acceleration
    do not jump. JSON keys as for send.
    """
    from slidectl.client.action_client import desired_positions, goal_to

    wanted = dict(_target(text) for text in targets)
    cycle_s = ctx.call("/slidectl/status")["timestep"]
    if duration < cycle_s:
        raise UsageError(f"--duration {duration:g}: it takes at least one control cycle, {cycle_s:g} s")
    with _action(ctx, controller) as action:
        now = desired_positions(ctx.client, names.parent(action.name))
        for joint in wanted:
            if joint not in now:
                raise UnknownName("joint", joint, list(now), f"of {names.parent(action.name)}")
        _run(ctx, action, goal_to(now | wanted, duration), wait)


@trajectory.command("hold", examples=["slidectl trajectory hold arm_controller"])
@_controller
@click.pass_obj
def hold(ctx: Context, controller: str) -> None:
    """Cancel all goals, and hold the joints in place.

    It is an empty trajectory on the command topic; to a controller of ROS 2, the present desired positions.

    JSON key: controller.
    """
    from slidectl.client.action_client import hold as hold_joints

    with _action(ctx, controller) as action:
        full = names.parent(action.name)
        hold_joints(ctx.client, full)
    ctx.done({"controller": full}, f"{full}: the joints hold their positions")


@trajectory.command("cancel", examples=["slidectl trajectory cancel arm_controller"])
@_controller
@click.pass_obj
def cancel(ctx: Context, controller: str) -> None:
    """Cancel the goals of the action; the joints hold their positions.

    JSON keys: action, id (empty, for all).
    """
    with _action(ctx, controller) as action:
        cancel_goals(ctx, action)


@trajectory.command("state", examples=["slidectl trajectory state arm_controller"])
@_controller
@click.pass_obj
def state(ctx: Context, controller: str) -> None:
    """Show desired and actual positions and velocities of the joints, and the errors of position.

    JSON keys of each joint: joint, desired, actual, error, desired_velocity, actual_velocity.
    """
    from slidectl.client.action_client import state_of

    with _action(ctx, controller) as action:
        joints, desired, actual, error = state_of(ctx.client, names.parent(action.name))
    columns = {
        "joint": joints,
        "desired": desired["positions"],
        "actual": actual["positions"],
        "error": error["positions"],
        "desired_velocity": desired["velocities"],
        "actual_velocity": actual["velocities"] or [None] * len(joints),
    }
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    ctx.emit_rows(rows, list(columns))


# --- files ------------------------------------------------------------------------------------------------------------


def read_goal(file: str) -> Message:
    """The FollowJointTrajectoryGoal of a file; `-` is standard input. Raises BadFile, UsageError."""
    text, shown = typed_values.text_of(file).removeprefix("\ufeff"), "stdin" if file == "-" else file
    ending = file.lower().rpartition(".")[2]
    if ending == "csv":
        goal = _from_csv(text, shown)
    elif ending == "json":
        goal = _from_document(_from_json(text, shown), shown)
    else:
        documents = list(typed_values.read_documents(text, "file", shown)) or [None]
        if len(documents) > 1:
            raise BadFile(f"holds {len(documents)} YAML documents where one was expected", shown)
        goal = _from_document(documents[0], shown)
    if not goal["trajectory"]["points"]:
        raise BadFile("has no points", shown, hint="to hold the joints in place: slidectl trajectory hold CONTROLLER")
    return goal


def _from_json(text: str, file: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise BadFile(f"not valid JSON: {error.msg}", file, error.lineno) from None
    except (ValueError, RecursionError) as error:
        raise BadFile(f"not valid JSON: {error}", file) from None


def _from_document(document: Any, file: str) -> Message:
    if not isinstance(document, dict):
        raise BadFile("is not a mapping; expected joint_names and points, or a goal with trajectory", file)
    goal = dict(document) if "trajectory" in document else {"trajectory": document}
    body = goal["trajectory"]
    if not isinstance(body, dict) or not isinstance(body.get("points"), list) or "joint_names" not in body:
        raise BadFile("lacks joint_names or a list of points", file)
    points = []
    for number, point in enumerate(body["points"], 1):
        where = f"point {number}: time_from_start"
        if not isinstance(point, dict) or "time_from_start" not in point:
            raise BadFile(f"{where} is missing", file)
        points.append({**point, "time_from_start": _duration(point["time_from_start"], where, file)})
    goal["trajectory"] = {**body, "points": points}
    if "goal_time_tolerance" in goal:
        goal["goal_time_tolerance"] = _duration(goal["goal_time_tolerance"], "goal_time_tolerance", file)
    return goal


def _duration(value: Any, what: str, file: str, line: int | None = None) -> dict[str, Any]:
    """A duration as secs and nsecs: from seconds, or from either of the forms of ROS. Raises BadFile."""
    for secs, nsecs in _DURATIONS:
        if isinstance(value, Mapping) and {secs, nsecs}.issuperset(value):
            parts = value.get(secs, 0), value.get(nsecs, 0)
            if all(type(part) is int for part in parts):
                return {"secs": parts[0], "nsecs": parts[1]}
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) <= _LONGEST_S:
        raise BadFile(f"{what} is {value!r}, expected seconds up to 2147483647, or secs and nsecs", file, line)
    total_ns = round(value * 1e9)
    return {"secs": total_ns // 10**9, "nsecs": total_ns % 10**9}


def _from_csv(text: str, file: str) -> Message:
    reader = csv.reader(io.StringIO(text), skipinitialspace=True)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise BadFile(f"not valid CSV: {error}", file, reader.line_num) from None
    line, header = rows[0] if rows else (1, [])
    header = [name.strip().removeprefix("#").strip() for name in header]
    if not header or header[0] not in _TIMES or len(header) == 1:
        raise BadFile("the first line of a CSV trajectory names its columns", file, line, "as: time,joint1,joint2")
    columns = [_column(name, file, line) for name in header[1:]]
    if len(set(columns)) < len(columns):
        raise BadFile("duplicate column", file, line)
    joints = list(dict.fromkeys(joint for joint, _ in columns))
    quantities = list(dict.fromkeys(quantity for _, quantity in columns))
    for quantity in quantities:
        if lacking := [joint for joint in joints if (joint, quantity) not in columns]:
            raise BadFile(f"has no {quantity} of {', '.join(lacking)}", file, line)
    points = []
    for line, row in rows[1:]:
        if len(row) != len(header):
            raise BadFile(f"has {len(row)} values, expected {len(header)}", file, line)
        time_s, *numbers = (_number(cell, file, line) for cell in row)
        by_column = dict(zip(columns, numbers, strict=True))
        point: Message = {"time_from_start": _duration(time_s, header[0], file, line)}
        for quantity in quantities:
            point[_QUANTITIES[quantity]] = [by_column[joint, quantity] for joint in joints]
        points.append(point)
    return {"trajectory": {"joint_names": joints, "points": points}}


def _column(name: str, file: str, line: int) -> tuple[str, str]:
    joint, dot, quantity = name.rpartition(".")
    if not dot:
        return name, "position"
    if quantity not in _QUANTITIES:
        raise BadFile(f"column {name!r}: {quantity!r} is not one of {', '.join(_QUANTITIES)}", file, line)
    return joint, quantity


def _number(text: str, file: str, line: int) -> float:
    try:
        return float(text)
    except ValueError:
        raise BadFile(f"{text!r} is not a number", file, line) from None


def _target(text: str) -> tuple[str, float]:
    joint, _, value = text.partition("=")
    try:
        position = float(value)
    except ValueError:
        raise UsageError(f"--to {text!r}: write JOINT=POSITION, as joint1=1.5") from None
    if not abs(position) <= _FARTHEST:
        what = "must be a finite number" if not math.isfinite(position) else f"is within ±{_FARTHEST:g} rad or m"
        raise UsageError(f"--to {text!r}: the position {what}")
    return joint, position


# --- the controller ---------------------------------------------------------------------------------------------------


def _action(ctx: Context, controller: str) -> Action:
    """The action of a trajectory controller. Raises UnknownName, AmbiguousName."""
    from slidectl.client.action_client import Action

    known = _controllers(ctx)
    full = names.resolve(controller, known, kind="trajectory controller", namespace=ctx.namespace)
    return Action(ctx.client, known[full])


def _run(ctx: Context, action: Action, goal: Message, wait: bool) -> None:
    last = goal["trajectory"]["points"][-1]["time_from_start"]
    total_s = _seconds(last)

    def describe(feedback: Message) -> str:
        errors = dict(zip(feedback["joint_names"], feedback["error"]["positions"], strict=True))
        worst = max(errors, key=lambda joint: abs(errors[joint] or 0.0))
        passed_s = min(_seconds(feedback["actual"]["time_from_start"]), total_s)
        return f"{passed_s:.1f} of {total_s:g} s, largest error {errors[worst] or 0.0:.3g} ({worst})"

    run(ctx, action, goal, wait=wait, describe=describe)


def _seconds(duration: Message) -> float:
    return float(duration["secs"] + duration["nsecs"] * 1e-9)
