"""`slidectl trajectory`: goals of joint trajectory controllers, from files or from the command line.

A file is YAML or JSON (trajectory_msgs/JointTrajectory, or control_msgs/FollowJointTrajectoryGoal with `trajectory`) or
CSV: a column `time` in s, a column a joint with its position, and columns JOINT.velocity and JOINT.acceleration.
"""

from __future__ import annotations

import csv
import io
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, output
from slidectl.cli.action import run
from slidectl.cli.commands import Variadic, group
from slidectl.cli.context import Context
from slidectl.errors import BadFile, UnknownName, UsageError

if TYPE_CHECKING:
    from slidectl.client.actions import Action

TYPE = "control_msgs/FollowJointTrajectory"
_TIMES = ("time", "time_from_start")
_QUANTITIES = {"position": "positions", "velocity": "velocities", "acceleration": "accelerations"}

_controller = click.argument("controller", metavar="CONTROLLER", shell_complete=completion.controllers)
_wait = click.option(
    "--wait", is_flag=True, help="Wait for the end; the exit code is 0 only when the goal was reached."
)


@group(
    examples=[
        "slidectl trajectory send arm_controller path.yaml --wait",
        "slidectl trajectory plan arm_controller --to joint1=1.5 joint2=-0.4 --duration 2 --wait",
    ]
)
def trajectory() -> None:
    """Goals of trajectory controllers: send, plan, hold, cancel, state."""


@trajectory.command("send", examples=["slidectl trajectory send arm_controller path.csv --wait"])
@_controller
@click.argument("file", metavar="FILE")
@_wait
@click.pass_obj
def send(ctx: Context, controller: str, file: str, wait: bool) -> None:
    """Send a trajectory from a .yaml, .json or .csv file; - is standard input.

    Interrupted while it waits, it cancels the goal. JSON keys: id, and with --wait state, status, text, result.
    """
    goal = read_goal(file)
    with _action(ctx, controller) as action:
        _run(ctx, action, goal, wait)


@trajectory.command(
    "plan", examples=["slidectl trajectory plan arm_controller --to joint1=1.5 joint2=-0.4 --duration 2 --wait"]
)
@_controller
@click.option(
    "--to", "targets", cls=Variadic, metavar="JOINT=POSITION...", required=True, help="Where to go, rad or m."
)
@click.option("--duration", type=float, required=True, metavar="SECONDS", help="Simulated time that it takes.")
@_wait
@click.pass_obj
def plan(ctx: Context, controller: str, targets: tuple[str, ...], duration: float, wait: bool) -> None:
    """Go to positions of some joints in a time; the other joints stay where they are asked to be.

    JSON keys as for send.
    """
    if not 0 < duration < math.inf:
        raise UsageError(f"--duration is a time above 0, not {duration:g}")
    wanted = dict(_target(text) for text in targets)
    with _action(ctx, controller) as action:
        now = _state(ctx, action)
        for joint in wanted:
            if joint not in now["joint_names"]:
                raise UnknownName("joint", joint, now["joint_names"], f"of {controller}")
        held = dict(zip(now["joint_names"], now["desired"]["positions"], strict=True))
        positions = [wanted.get(joint, held[joint]) for joint in now["joint_names"]]
        zeros = [0.0] * len(positions)
        point = {"positions": positions, "velocities": zeros, "time_from_start": duration_message(duration)}
        _run(ctx, action, {"trajectory": {"joint_names": now["joint_names"], "points": [point]}}, wait)


@trajectory.command("hold", examples=["slidectl trajectory hold arm_controller"])
@_controller
@click.pass_obj
def hold(ctx: Context, controller: str) -> None:
    """Give up what is under way, and hold the joints in place: an empty trajectory on the command topic."""
    with _action(ctx, controller) as action:
        topic = action.name.rpartition("/")[0] + "/command"
    ctx.client.deliver(topic, {})
    ctx.done({"topic": topic}, f"{controller}: holds its position")


@trajectory.command("cancel", examples=["slidectl trajectory cancel arm_controller"])
@_controller
@click.pass_obj
def cancel(ctx: Context, controller: str) -> None:
    """Cancel the goals of the action; the joints hold their position."""
    with _action(ctx, controller) as action:
        action.cancel()
    ctx.done({"action": action.name}, f"{action.name}: all goals cancelled")


@trajectory.command("state", examples=["slidectl trajectory state arm_controller"])
@_controller
@click.pass_obj
def state(ctx: Context, controller: str) -> None:
    """Show desired and actual positions and velocities of the joints, and the errors of position.

    JSON keys of each joint: joint, desired, actual, error, desired_velocity, actual_velocity.
    """
    with _action(ctx, controller) as action:
        now = _state(ctx, action)
    rows = [
        {
            "joint": joint,
            "desired": now["desired"]["positions"][index],
            "actual": now["actual"]["positions"][index],
            "error": now["error"]["positions"][index],
            "desired_velocity": now["desired"]["velocities"][index],
            "actual_velocity": now["actual"]["velocities"][index],
        }
        for index, joint in enumerate(now["joint_names"])
    ]
    ctx.emit_rows(rows, ["joint", "desired", "actual", "error", "desired_velocity", "actual_velocity"])


# --- goals ------------------------------------------------------------------------------------------------------------


def read_goal(file: str) -> dict[str, Any]:
    """The FollowJointTrajectoryGoal of a file. Raises BadFile."""
    shown = "<stdin>" if file == "-" else file
    try:
        text = sys.stdin.read() if file == "-" else Path(file).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadFile(str(getattr(error, "strerror", None) or error), shown) from None
    return _from_csv(text, shown) if file.lower().endswith(".csv") else _from_yaml(text, shown)


def _from_yaml(text: str, file: str) -> dict[str, Any]:
    import yaml

    try:
        read = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark is not None else None
        raise BadFile(f"no YAML: {getattr(error, 'problem', None) or error}", file, line) from None
    if not isinstance(read, dict):
        raise BadFile("holds no mapping; expected joint_names and points, or a goal with trajectory", file)
    goal = dict(read) if "trajectory" in read else {"trajectory": read}
    body = goal["trajectory"]
    if not isinstance(body, dict) or not isinstance(body.get("points"), list) or "joint_names" not in body:
        raise BadFile("lacks joint_names or a list of points", file)
    points = []
    for number, point in enumerate(body["points"], 1):
        if not isinstance(point, dict) or "time_from_start" not in point:
            raise BadFile(f"point {number} lacks time_from_start", file)
        points.append({**point, "time_from_start": duration_message(point["time_from_start"], file, number)})
    goal["trajectory"] = {**body, "points": points}
    return goal


def duration_message(value: Any, file: str = "", number: int = 0) -> dict[str, int]:
    """A duration as secs and nsecs: from seconds, or from what is written in that form already. Raises BadFile."""
    if isinstance(value, Mapping):
        return {"secs": value.get("secs", 0), "nsecs": value.get("nsecs", 0)}
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadFile(f"point {number}: time_from_start is {value!r}, expected seconds", file)
    nanoseconds = round(value * 1e9)
    return {"secs": nanoseconds // 10**9, "nsecs": nanoseconds % 10**9}


def _from_csv(text: str, file: str) -> dict[str, Any]:
    reader = csv.reader(io.StringIO(text), skipinitialspace=True)
    header = [name.strip().lstrip("#").strip() for name in next(reader, [])]
    if not header or header[0] not in _TIMES:
        raise BadFile("the first column of a CSV trajectory is time, in s", file, 1, "time,joint1,joint2")
    columns = [_column(name, file) for name in header[1:]]
    joints = list(dict.fromkeys(joint for joint, _ in columns))
    points = []
    for row in reader:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise BadFile(f"has {len(row)} values, expected {len(header)}", file, reader.line_num)
        numbers = [_cell(cell, file, reader.line_num) for cell in row]
        point: dict[str, Any] = {"time_from_start": duration_message(numbers[0])}
        for quantity in dict.fromkeys(quantity for _, quantity in columns):
            values = {
                joint: value for (joint, kind), value in zip(columns, numbers[1:], strict=True) if kind == quantity
            }
            if len(values) != len(joints):
                lacking = ", ".join(joint for joint in joints if joint not in values)
                raise BadFile(f"has no {quantity} of {lacking}", file, 1)
            point[_QUANTITIES[quantity]] = [values[joint] for joint in joints]
        points.append(point)
    return {"trajectory": {"joint_names": joints, "points": points}}


def _column(name: str, file: str) -> tuple[str, str]:
    joint, dot, quantity = name.rpartition(".")
    if not dot:
        return name, "position"
    if quantity not in _QUANTITIES:
        raise BadFile(f"column {name!r}: {quantity!r} is none of {', '.join(_QUANTITIES)}", file, 1)
    return joint, quantity


def _cell(text: str, file: str, line: int) -> float:
    try:
        return float(text)
    except ValueError:
        raise BadFile(f"{text!r} is no number", file, line) from None


def _target(text: str) -> tuple[str, float]:
    joint, equals, value = text.partition("=")
    try:
        position = float(value)
    except ValueError:
        position = math.nan
    if not equals or not math.isfinite(position):
        raise UsageError(f"--to {text!r}: write JOINT=POSITION, as joint1=1.5")
    return joint, position


# --- the controller ---------------------------------------------------------------------------------------------------


def _action(ctx: Context, controller: str) -> Action:
    """The controller's follow_joint_trajectory action. Raises UnknownName, AmbiguousName."""
    from slidectl.client.actions import Action

    return Action(ctx.client, f"{controller.rstrip('/')}/follow_joint_trajectory")


def _state(ctx: Context, action: Action) -> dict[str, Any]:
    with ctx.client.subscribe(action.name.rpartition("/")[0] + "/state") as states:
        return states.get()


def _run(ctx: Context, action: Action, goal: dict[str, Any], wait: bool) -> None:
    points: Sequence[Mapping[str, Any]] = goal["trajectory"]["points"]
    if points and wait and output.is_terminal(sys.stderr) and not ctx.quiet:
        last = points[-1]["time_from_start"]
        ctx.say(f"{action.name}: {len(points)} points, {last['secs'] + last['nsecs'] * 1e-9:g} s")
    run(ctx, action, goal, wait=wait)
