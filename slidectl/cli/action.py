"""`slidectl action`: actions of the graph, five topics each as in actionlib: list, inspect, send, cancel, follow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.errors import Refused, UsageError

if TYPE_CHECKING:
    from slidectl.client.actions import Action, ActionResult

TOPICS = ("status", "feedback", "result", "goal", "cancel")


@group(
    examples=[
        "slidectl action list",
        "slidectl action send gripper_controller/gripper_cmd '{command: {position: 0.02}}' --wait",
    ]
)
def action() -> None:
    """Goals of actions: list, inspect, send, cancel, follow."""


@action.command("list", examples=["slidectl action list", "slidectl action list --json"])
@click.pass_obj
def list_actions(ctx: Context) -> None:
    """List the actions with their types.

    JSON keys: action, type.
    """
    from slidectl.client.actions import goal_topics

    known = goal_topics(ctx.client.topics())
    rows = [{"action": name, "type": kind} for name, kind in known.items()]
    ctx.emit_rows(rows, ["action", "type"], empty="no action is there; a trajectory or gripper controller brings one")


@action.command("info", examples=["slidectl action info arm_controller"])
@click.argument("name", metavar="ACTION", shell_complete=completion.topics)
@click.pass_obj
def info(ctx: Context, name: str) -> None:
    """Show an action's type, its server and the goals that it knows.

    JSON keys: action, type, servers, goals (id, state, text).
    """
    from slidectl.client.actions import STATES

    with _open(ctx, name) as chosen:
        servers = ctx.resolve("topic", f"{chosen.name}/result", role="publishers")["nodes"]
        goals = [
            {"id": goal["goal_id"]["id"], "state": STATES[goal["status"]], "text": goal["text"]}
            for goal in chosen.goals()
        ]
        record = {"action": chosen.name, "type": chosen.type, "servers": servers, "goals": goals}
    lines = [f"Action: {chosen.name}", f"Type: {chosen.type}", f"Servers: {' '.join(servers)}"]
    lines += [f"Goal {goal['id']}: {goal['state']}{goal['text'] and ', ' + goal['text']}" for goal in goals]
    ctx.emit(record, "\n".join(lines))


@action.command(
    "send",
    examples=["slidectl action send gripper_controller/gripper_cmd '{command: {position: 0.02}}' --wait --feedback"],
)
@click.argument("name", metavar="ACTION", shell_complete=completion.topics)
@click.argument("goal", metavar="GOAL")
@click.option("--wait", is_flag=True, help="Wait for the result; the exit code is 0 only for a goal that succeeded.")
@click.option("--feedback", is_flag=True, help="Print the feedback while waiting.")
@click.pass_obj
def send(ctx: Context, name: str, goal: str, wait: bool, feedback: bool) -> None:
    """Send a goal: the fields of the action's Goal as YAML.

    Without --wait it prints the goal's id and ends when the server has the goal. JSON keys: id, and with --wait
    state, status, text, result. Interrupted while it waits, it cancels the goal.
    """
    import yaml

    try:
        fields = yaml.safe_load(goal)
    except yaml.YAMLError as error:
        raise UsageError(f"the GOAL is no YAML: {' '.join(str(error).split())}") from None
    if not isinstance(fields, dict):
        raise UsageError(f"the GOAL {goal!r} is no mapping of fields", "write '{field: value}'; {} for the defaults")
    with _open(ctx, name) as chosen:
        run(ctx, chosen, fields, wait=wait or feedback, tell_feedback=feedback)


@action.command("cancel", examples=["slidectl action cancel arm_controller"])
@click.argument("name", metavar="ACTION", shell_complete=completion.topics)
@click.argument("goal_id", required=False, metavar="[ID]")
@click.pass_obj
def cancel(ctx: Context, name: str, goal_id: str | None) -> None:
    """Cancel one goal, or all goals of an action."""
    with _open(ctx, name) as chosen:
        chosen.cancel(goal_id or "")
    ctx.done({"action": chosen.name, "id": goal_id or ""}, f"{chosen.name}: {goal_id or 'all goals'} cancelled")


@action.command("echo", examples=["slidectl action echo arm_controller feedback -n 1"])
@click.argument("name", metavar="ACTION", shell_complete=completion.topics)
@click.argument("topic", type=click.Choice(TOPICS), default="feedback")
@click.option("-n", "--count", type=int, help="End after so many messages.")
@click.pass_obj
def echo(ctx: Context, name: str, topic: str, count: int | None) -> None:
    """Print what an action's server publishes: feedback, status or result.

    JSON is the message, one a line.
    """
    with _open(ctx, name) as chosen:
        full = f"{chosen.name}/{topic}"
    with ctx.client.subscribe(full) as messages:
        for number, message in enumerate(messages, 1):
            emit_message(ctx, message)
            if number == count:
                return


def emit_message(ctx: Context, message: dict[str, Any]) -> None:
    """A message as YAML documents, or in the chosen format."""
    from slidectl.cli import output

    ctx.emit(message, output.as_yaml(message) + "---")


def _open(ctx: Context, name: str) -> Action:
    from slidectl.client.actions import Action

    return Action(ctx.client, name)


def run(ctx: Context, chosen: Action, goal: dict[str, Any], *, wait: bool, tell_feedback: bool = False) -> None:
    """Send a goal and, if asked, follow it to its end.

    Raises:
        Refused: it did not succeed; the text is the server's. TimedOut: --timeout; the goal goes on.
    """
    from slidectl.client.actions import ActionResult

    goal_id = chosen.send(goal)
    if not wait:
        return ctx.done({"id": goal_id}, goal_id)
    try:
        for event in chosen.follow(goal_id, ctx.wait_limit(math.inf)):
            if isinstance(event, ActionResult):
                return _tell(ctx, chosen, goal_id, event)
            if tell_feedback:
                emit_message(ctx, event)
    except KeyboardInterrupt:
        chosen.cancel(goal_id)
        ctx.say(f"{chosen.name}: the goal is cancelled")
        raise
    return None


def _tell(ctx: Context, chosen: Action, goal_id: str, ended: ActionResult) -> None:
    record = {"id": goal_id, "state": ended.state, "status": ended.status, "text": ended.text, "result": ended.result}
    code = ended.result.get("error_code")
    text = ended.text or str(ended.result.get("error_string", ""))
    line = f"{chosen.name}: {ended.state}"
    if code:
        line += f", error_code {code}"
    if text:
        line += f": {text}"
    if ended.succeeded:
        return ctx.done(record, line)
    if ctx.format != "text":
        ctx.emit(record)
    raise Refused(line)
