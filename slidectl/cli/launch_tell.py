"""What `slidectl launch` prints without starting anything: nodes, files, parameters, arguments, steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.errors import Refused
from slidectl.launch import listing
from slidectl.launch.plan import Plan
from slidectl.launch.task import Task


def plan_only(ctx: Context, plan: Plan, given: dict[str, Any]) -> bool:
    """Print what needs the files alone; False when nothing of that was asked for."""
    if given["nodes"]:
        ctx.emit_names(listing.nodes(plan), "node", "no nodes")
    elif given["files"]:
        ctx.emit_names(listing.files(plan), "file")
    elif given["find_node"]:
        ctx.emit({"file": listing.node(plan, given["find_node"]).file}, listing.node(plan, given["find_node"]).file)
    elif given["ros_args"]:
        rows = [{"name": one.name, "default": one.default, "doc": one.doc} for one in plan.arguments.values()]
        if ctx.format == "text":
            output.write(listing.arguments(plan))
        else:
            ctx.emit_rows(rows, ["name", "default", "doc"])
    elif given["dump_params"]:
        _parameters(ctx, plan)
    else:
        return False
    plan.missing.refuse()
    return True


def _parameters(ctx: Context, plan: Plan) -> None:
    if ctx.format == "text":
        output.write(listing.parameters(plan))
    else:
        ctx.emit(listing.parameter_values(plan))
    _notices(ctx, plan)


def _tell_missing(ctx: Context, plan: Plan) -> None:
    """The list of what a launch would leave out, on stderr."""
    if lines := plan.missing.lines():
        ctx.warn("\n".join(["left out:", *lines]))


def _notices(ctx: Context, plan: Plan) -> None:
    for notice in plan.notices:
        if notice.verdict == "wrong" or ctx.verbose:
            ctx.warn(str(notice))


def tasks(ctx: Context, plan: Plan, made: Sequence[Task], given: dict[str, Any]) -> None:
    """The steps of a launch, or the command line of one node."""
    if given["args_of"]:
        node = listing.node(plan, given["args_of"])
        task = next((task for task in made if task.node is node), None)
        if task is None:
            raise Refused(f"{node.place}: node {node.full_name} is left out: it is not there")
        ctx.emit({"node": node.full_name, "command": listing.command_line(task)}, listing.command_line(task))
        return
    for step in listing.steps(plan, made):
        ctx.emit(step, f"{step['file']}:{step['line']}: {step['text']}")
    _notices(ctx, plan)
    _tell_missing(ctx, plan)
