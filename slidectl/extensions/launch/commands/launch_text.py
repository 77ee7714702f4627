"""The output of `slidectl launch`: the steps of a run, and the listings of a plan, which start nothing."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from slidectl.cli import output
from slidectl.cli.context import Context, paint
from slidectl.description import source_note
from slidectl.description.report import bounded
from slidectl.errors import NotThere, Refused, UnknownName
from slidectl.extensions.launch.nodes.programs import Process
from slidectl.extensions.launch.plan import LaunchPlan, Location, Node
from slidectl.extensions.launch.task import Task

_LONGEST = 60


class Terminal:
    """The console of a run: prints a line for each step, and on a terminal a status line at the bottom."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.verbose = context.verbose
        both = output.is_terminal(sys.stdout) and output.is_terminal(sys.stderr)
        self.is_live = both and context.format == "text" and not context.quiet
        self._status = ""
        self._closing = False

    def step(self, event: str, text: str, **details: Any) -> None:
        self._say(lambda: self.context.done({"event": event, "text": text, **details}, text))

    def warn(self, text: str) -> None:
        self._say(lambda: self.context.warn(text))

    def output(self, node: str, stream: str, line: str) -> None:
        if self.context.format != "text":
            record = {"event": "output", "node": node, "stream": stream, "line": line}
            self._say(lambda: self.context.emit(record))
        elif stream == "stdout":
            self._say(lambda: output.write(f"[{node}] {line}"))
        else:
            self._say(lambda: print(f"[{node}] {line}", file=sys.stderr, flush=True))

    def status(self, text: str) -> None:
        cut = text[: max(10, output.terminal_width() - 1)]
        self._say(lambda: setattr(self, "_status", cut))

    def closing(self) -> None:
        self._closing = True
        self.status("")

    def _say(self, action: Callable[[], None]) -> None:
        """Print above the status line. A failed write (closed pipe or terminal, full disk) ends the launch."""
        try:
            if self._status:
                self._draw("")
            action()
            if self._status:
                self._draw(paint(self._status, "cyan"))
        except (output.ClosedPipe, Refused, OSError) as error:
            if self._closing:  # the end of a launch needs no reader
                return
            if isinstance(error, BrokenPipeError):
                raise output.ClosedPipe from None
            raise

    def _draw(self, text: str) -> None:
        sys.stderr.write("\r\x1b[K" + text)
        sys.stderr.flush()


# --- a plan ----------------------------------------------------------------------------------------------------------


def print_plan(ctx: Context, plan: LaunchPlan, given: dict[str, Any]) -> bool:
    """Print the requested listing if it needs only the files; else return False."""
    if given["nodes"]:
        ctx.emit_names([node.full_name for node in plan.nodes], "node", "no nodes")
    elif given["files"]:
        ctx.emit_names(list(dict.fromkeys(plan.files)), "file")
    elif given["find_node"]:
        file = find_node(plan, given["find_node"]).file
        ctx.emit({"file": file}, file)
    elif given["ros_args"] and ctx.format == "text":
        output.write(arguments(plan))
    elif given["ros_args"]:
        rows = [{"name": one.name, "default": one.default, "doc": one.doc} for one in plan.arguments.values()]
        ctx.emit_rows(rows, ["name", "default", "doc"])
    elif given["dump_params"]:
        if ctx.format == "text":
            output.write(as_yaml(plan))
        else:
            ctx.emit(_parameters(plan))
        _print_notices(ctx, plan)
    else:
        return False
    plan.missing.refuse()
    return True


def print_tasks(ctx: Context, plan: LaunchPlan, tasks: Sequence[Task], node_name: str | None) -> None:
    """Print the steps of a launch, or the command line of one node."""
    if node_name:
        node = find_node(plan, node_name)
        task = next((task for task in tasks if task.node is node), None)
        if task is None:
            raise Refused(f"{node.place}: node {node.full_name} is missing and left out")
        ctx.emit({"node": node.full_name, "command": command_line(task)}, command_line(task))
        return
    for kind, text, place in _steps(plan, tasks):
        ctx.emit({"step": kind, "text": text, "file": place.file, "line": place.line}, f"{place}: {text}")
    _print_notices(ctx, plan)
    if lines := plan.missing.lines():
        ctx.warn("\n".join(["left out:", *lines]))


def _print_notices(ctx: Context, plan: LaunchPlan) -> None:
    for notice in bounded(plan.notices):
        if notice.verdict == "wrong" or ctx.verbose:
            ctx.warn(str(notice))


def find_node(plan: LaunchPlan, name: str) -> Node:
    """The node of that name; a leading slash may be missing. Raises UnknownName."""
    nodes = {node.full_name: node for node in plan.nodes}
    if (node := nodes.get("/" + name.strip("/"))) is None:
        raise UnknownName("node", name, list(nodes), f"in {', '.join(plan.files[:1])}")
    return node


def _parameters(plan: LaunchPlan) -> dict[str, Any]:
    """All parameters by name, robot descriptions without their source notes. Raises BadFile."""
    shown = ((name, value) for name, (value, _) in sorted(plan.parameters().items()))
    return {name: source_note.split(value)[0] if isinstance(value, str) else value for name, value in shown}


def as_yaml(plan: LaunchPlan) -> str:
    """The parameters exactly as `roslaunch --dump-params` prints them. Raises BadFile."""
    import yaml

    return str(yaml.safe_dump(_parameters(plan), default_flow_style=False))


def arguments(plan: LaunchPlan) -> str:
    """The arguments as `roslaunch --ros-args` prints them."""
    lines: dict[str, list[str]] = {"Required Arguments:": [], "Optional Arguments:": []}
    for one in sorted(plan.arguments.values(), key=lambda argument: argument.name):
        title, default = "Required Arguments:", ""
        if one.default is not None:
            title, default = "Optional Arguments:", f' (default "{one.default}")'
        lines[title].append(f"  {one.name}{default}: {one.doc or 'undocumented'}")
    return "\n".join(line for title, some in lines.items() if some for line in (title, *some)) or "No arguments."


def command_line(task: Task) -> str:
    """The exact command line of a node with its environment; of a counterpart, a description."""
    namespace = {"ROS_NAMESPACE": task.node.namespace} if task.node.namespace != "/" else {}
    own = {**namespace, **dict(task.node.environment)}
    environment = "".join(f'{name}="{value}" ' for name, value in own.items())
    if isinstance(task, Process):
        return f"{environment}{shlex.join(task.command)}"
    return f"{environment}{task.node.kind} {shlex.join(task.node.words)}".rstrip() + f"  # here: {task.text}"


def _steps(plan: LaunchPlan, tasks: Sequence[Task]) -> Iterator[tuple[str, str, Location]]:
    """Yield the steps of a launch in order: kind, text and place. It runs no programs.

    Raises BadFile: the value of a parameter cannot be determined.
    """
    for command in plan.commands:
        into = f" into {command.file}" if command.file else ""
        yield command.verb, f"{command.verb} the parameters of {command.name}{into}", command.place
    for namespace, place in plan.clear:
        yield "clear", f"delete the parameters in {namespace}", place
    for setting in plan.settings:
        if setting.runs_command:
            yield "parameter", f"{setting.name} = what the command prints", setting.place
            continue
        try:
            values = list(setting.parameters())
        except NotThere:  # it is printed with everything that is missing
            continue
        for name, value in values:
            yield "parameter", f"{name} = {_short(value)}", setting.place
    for task in sorted(tasks, key=lambda task: task.comes_last):
        yield task.family, f"{task.node.full_name}: {task.text}", task.node.place


def _short(value: Any) -> str:
    text = " ".join(str(value).split()) if isinstance(value, str) else repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}... ({len(text)} characters)"
