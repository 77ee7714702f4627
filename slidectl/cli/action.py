"""`slidectl action`: list, inspect, send, cancel and follow actions, which are five topics each as in actionlib."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import click

from slidectl import names, typed_values
from slidectl.cli import completion, output, robots
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.cli.echo import echo as echo_topic
from slidectl.cli.topic_streams import pause_remark
from slidectl.errors import Refused, TimedOut, UsageError

if TYPE_CHECKING:
    from slidectl.client.action_client import Action, ActionResult

Message = dict[str, Any]
Describe = Callable[[Message], str]

TOPICS = ("feedback", "result", "status", "goal", "cancel")
PAUSED_LIMIT_S = 10.0
"""How long `--wait` waits for a paused world to go on, or to be stepped, wall seconds."""


def _names(ctx: Context) -> list[str]:
    from slidectl.client.action_client import goal_topics

    return list(goal_topics(ctx.client.topics()))


_name = click.argument("name", metavar="ACTION", shell_complete=completion.completer(_names))


@group(
    examples=[
        "slidectl action list",
        "slidectl action send gripper_controller/gripper_cmd '{command: {position: 0.02, max_effort: 20}}' --wait",
    ]
)
def action() -> None:
    """Goals of actions: list, inspect, send, cancel, follow.

    ACTION is a name or its unique end, or the name of a controller with one action.
    """


@action.command("list", examples=["slidectl action list", "slidectl action list --json"])
@click.pass_obj
def list_actions(ctx: Context) -> None:
    """List the actions with their types.

    JSON keys: action, type.
    """
    from slidectl.client.action_client import goal_topics

    known = goal_topics(ctx.client.topics())
    rows = [{"action": name, "type": kind} for name, kind in known.items()]
    ctx.emit_rows(rows, ["action", "type"], empty="no actions; a trajectory or gripper controller provides one")


@action.command("info", examples=["slidectl action info arm_controller"])
@_name
@click.pass_obj
def info(ctx: Context, name: str) -> None:
    """Show an action's type, its servers and the goals that they know.

    JSON keys: action, type, servers, goals (id, state, text).
    """
    from slidectl.client.action_client import STATES

    with _open(ctx, name) as chosen:
        servers = ctx.call("/rosapi/publishers", {"topic": f"{chosen.name}/result"})["publishers"]
        goals = [
            {"id": goal["goal_id"]["id"], "state": STATES[goal["status"]], "text": goal["text"]}
            for goal in (chosen.goals() if servers else ())
        ]
    record = {"action": chosen.name, "type": chosen.type, "servers": servers, "goals": goals}
    lines = [f"Action: {chosen.name}", f"Type: {chosen.type}", f"Servers: {' '.join(servers) or 'none'}"]
    lines += [f"Goal {goal['id']}: {goal['state']}{goal['text'] and ', ' + goal['text']}" for goal in goals]
    ctx.emit(record, "\n".join(lines))


@action.command(
    "send",
    examples=[
        "slidectl action send gripper_controller/gripper_cmd '{command: {position: 0.02, max_effort: 20}}' --wait"
    ],
)
@_name
@click.argument("goal", metavar="GOAL")
@click.option("--wait", is_flag=True, help="Wait for the result; exits 0 only when the goal succeeded.")
@click.option("--feedback", is_flag=True, help="Wait, and print the feedback before the result.")
@click.pass_obj
def send(ctx: Context, name: str, goal: str, wait: bool, feedback: bool) -> None:
    """Send a goal: the fields of the action's Goal as YAML.

    Without --wait it prints the goal's id, and exits 1 when the server rejects the goal. While it waits, Ctrl-C
    cancels the goal, and --timeout (4) leaves it under way. JSON keys: id, and of a goal that has ended state, status,
    text, result.
    """
    fields = typed_values.read(goal)
    if not isinstance(fields, dict):
        raise UsageError(f"the GOAL {goal!r} is not a mapping of fields", "write '{field: value}'; {} for the defaults")
    with _open(ctx, name) as chosen:
        run(ctx, chosen, fields, wait=wait or feedback, print_feedback=feedback)


@action.command("cancel", examples=["slidectl action cancel arm_controller"])
@_name
@click.argument("goal_id", required=False, metavar="[ID]")
@click.pass_obj
def cancel(ctx: Context, name: str, goal_id: str | None) -> None:
    """Cancel one goal, or all goals of an action.

    JSON keys: action, id (empty for all).
    """
    with _open(ctx, name) as chosen:
        cancel_goals(ctx, chosen, goal_id or "")


@action.command("echo", examples=["slidectl action echo arm_controller result -n 1"])
@_name
@click.argument("topic", type=click.Choice(TOPICS), default="feedback")
@click.option("-n", "--count", type=click.IntRange(min=0), metavar="COUNT", help="End after COUNT messages.")
@click.pass_context
def echo(click_context: click.Context, name: str, topic: str, count: int | None) -> None:
    """Print the messages of one of an action's topics, the feedback by default.

    As 'slidectl echo' prints them, until -n is reached or Ctrl-C is pressed.
    """
    with _open(click_context.obj, name) as chosen:
        full = f"{chosen.name}/{topic}"
    click_context.invoke(echo_topic, target=full, count=count)


def _open(ctx: Context, name: str) -> Action:
    from slidectl.client.action_client import Action

    return Action(ctx.client, name, ctx.namespace)


# --- goals, for other groups of commands too --------------------------------------------------------------------------


def cancel_goals(ctx: Context, chosen: Action, goal_id: str = "") -> None:
    """Cancel one goal, or all when `goal_id` is empty, and print the outcome."""
    chosen.cancel(goal_id)
    ctx.done({"action": chosen.name, "id": goal_id}, f"{chosen.name}: {goal_id or 'all goals'} cancelled")


def run(
    ctx: Context,
    chosen: Action,
    goal: Message,
    *,
    wait: bool,
    print_feedback: bool = False,
    describe: Describe = lambda _feedback: "the goal is active",
) -> None:
    """Send a goal; with `wait`, follow it to its end. `describe` turns a feedback into the terminal's status line.

    Raises:
        Refused: the goal did not succeed; the text is the server's. TimedOut: --timeout passed; the goal goes on.
    """
    from slidectl.client.action_client import new_goal_id

    goal_id = new_goal_id()
    try:
        chosen.send(goal, goal_id)
        reasons, ended = list(ctx.client.reasons), chosen.ended(goal_id)
        if ended is None:
            for reason in reasons:
                ctx.warn(reason)
            if wait:
                ended = _follow(ctx, chosen, goal_id, print_feedback, describe)
    except KeyboardInterrupt:
        if wait:
            chosen.cancel(goal_id)
            ctx.say(f"{chosen.name}: the goal is cancelled")
        raise
    if ended is not None:
        _print_outcome(ctx, chosen, goal_id, ended, reasons)
    else:
        ctx.emit({"id": goal_id}, goal_id)


def _follow(ctx: Context, chosen: Action, goal_id: str, print_feedback: bool, describe: Describe) -> ActionResult:
    status = ctx.call("/slidectl/status")
    robots.warn_stopped(ctx, status["estop"])
    limit_s = ctx.wait_limit(math.inf)
    if status["paused"] and limit_s == math.inf:
        limit_s = PAUSED_LIMIT_S
        ctx.say(pause_remark(status, f"this waits {limit_s:g} s for it to go on"))
    with output.status_line(f"{chosen.name}: the goal is sent", not (print_feedback or ctx.quiet)) as show:

        def show_feedback(feedback: Message) -> None:
            if print_feedback:
                ctx.emit(feedback, output.as_yaml(feedback) + "---")
            else:
                show(f"{chosen.name}: {describe(feedback)}")

        try:
            return _ended(chosen, goal_id, limit_s, show_feedback)
        except TimedOut as error:
            now = ctx.call("/slidectl/status")
            stands = now["paused"] and now["time"] == status["time"]
            if ctx.timeout is not None or stands:
                hint = error.hint or f"it goes on; to end it: slidectl action cancel {chosen.name}"
                raise TimedOut(error.message, hint) from None
        return _ended(chosen, goal_id, math.inf, show_feedback)  # somebody steps the world, or it goes on


def _ended(chosen: Action, goal_id: str, limit_s: float, on_feedback: Callable[[Message], None]) -> ActionResult:
    """Pass feedback to `on_feedback` until the goal has ended. Raises TimedOut."""
    from slidectl.client.action_client import ActionResult

    for event in chosen.follow(goal_id, limit_s):
        if isinstance(event, ActionResult):
            return event
        on_feedback(event)
    raise AssertionError("follow ends with a result")


def _print_outcome(ctx: Context, chosen: Action, goal_id: str, ended: ActionResult, reasons: Sequence[str]) -> None:
    """Print the outcome of a goal. Raises Refused unless it succeeded."""
    result = dict(ended.result)
    code, text = result.pop("error_code", 0), result.pop("error_string", "")
    parts = [ended.state, *([f"error_code {code}"] if code else [])]
    parts += [f"{field} {output.cell(value)}" for field, value in result.items()]
    text = ended.text or text or "; ".join(reasons)
    line = f"{chosen.name}: {', '.join(parts)}" + (f": {text}" if text else "")
    record = {"id": goal_id, "state": ended.state, "status": ended.status, "text": text, "result": ended.result}
    if ended.succeeded:
        ctx.done(record, line)
        return
    if ctx.format != "text":
        ctx.emit(record)
    raise Refused(line, _motion_after(ctx, chosen, ended, code))


def _motion_after(ctx: Context, chosen: Action, ended: ActionResult, code: int) -> str | None:
    """What the joints do after a tolerance has aborted a goal; None for other ends."""
    from slidectl.client.action_client import TOLERANCE_CODES, TRAJECTORY_TYPE, is_of_ros2

    if ended.state != "aborted" or chosen.type != TRAJECTORY_TYPE or code not in TOLERANCE_CODES:
        return None
    controller = names.parent(chosen.name)
    if is_of_ros2(ctx.client, controller):
        return "the joints hold the positions at which they were"
    parameter = f"{controller}/stop_on_abort"
    if ctx.call("/rosapi/get_param", {"name": parameter, "default": "false"})["value"] == "true":
        return f"the joints stop where they are ({parameter})"
    return (
        "the controller drives on to the end of the trajectory, as ros_controllers do; stop it: "
        f"slidectl trajectory hold {controller}\nto have it stop at once: {parameter}: true before it is loaded"
    )
