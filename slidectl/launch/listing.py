"""What can be told of a plan without starting anything: nodes, files, parameters, arguments, steps, command lines."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from typing import Any

from slidectl.description import source_note
from slidectl.errors import NotThere, UnknownName
from slidectl.launch.nodes.process import Process
from slidectl.launch.plan import Node, Plan
from slidectl.launch.task import Task

_LONGEST = 60


def nodes(plan: Plan) -> list[str]:
    """Full names, in order."""
    return [node.full_name for node in plan.nodes]


def files(plan: Plan) -> list[str]:
    """Paths, each once."""
    return list(dict.fromkeys(plan.files))


def node(plan: Plan, name: str) -> Node:
    """The node of that name; a leading slash may be missing. Raises UnknownName."""
    wanted = "/" + name.strip("/")
    for one in plan.nodes:
        if one.full_name == wanted:
            return one
    raise UnknownName("node", name, nodes(plan), f"in {', '.join(files(plan)[:1])}")


def parameters(plan: Plan) -> str:
    """All of them as YAML, sorted by name, letter for letter as `roslaunch --dump-params`. Raises BadFile."""
    import yaml

    return str(yaml.safe_dump(parameter_values(plan), default_flow_style=False))


def parameter_values(plan: Plan) -> dict[str, Any]:
    """All of them by name, descriptions of robots as any reader takes them. Raises BadFile."""
    shown = ((name, value) for name, (value, _) in sorted(plan.parameters().items()))
    return {name: source_note.split(value)[0] if isinstance(value, str) else value for name, value in shown}


def arguments(plan: Plan) -> str:
    """As `roslaunch --ros-args` prints them."""
    required = [argument for argument in plan.arguments.values() if argument.default is None]
    optional = [argument for argument in plan.arguments.values() if argument.default is not None]
    lines = []
    if required:
        lines += ["Required Arguments:", *(f"  {one.name}: {one.doc or 'undocumented'}" for one in _sorted(required))]
    if optional:
        lines.append("Optional Arguments:")
        lines += [f'  {one.name} (default "{one.default}"): {one.doc or "undocumented"}' for one in _sorted(optional)]
    return "\n".join(lines or ["No arguments."])


def _sorted(arguments: Sequence[Any]) -> list[Any]:
    return sorted(arguments, key=lambda argument: argument.name)


def command_line(task: Task) -> str:
    """The exact command line of a node with its environment; of a counterpart, what it does."""
    namespace = {"ROS_NAMESPACE": task.node.namespace} if task.node.namespace != "/" else {}
    own = {**namespace, **dict(task.node.environment)}
    environment = "".join(f'{name}="{value}" ' for name, value in own.items())
    if isinstance(task, Process):
        return f"{environment}{shlex.join(task.command)}"
    return f"{environment}{task.node.kind} {shlex.join(task.node.words)}".rstrip() + f"  # here: {task.text}"


def steps(plan: Plan, tasks: Sequence[Task]) -> Iterator[dict[str, Any]]:
    """What a launch would do, in order: records with `step`, `text`, `file`, `line`. Programs are not run for it.

    Raises:
        BadFile: the value of a parameter cannot be had.
    """
    for command in plan.commands:
        into = f" into {command.file}" if command.file else ""
        yield _step(command.verb, f"{command.verb} the parameters of {command.name}{into}", command.place)
    for namespace, place in plan.clear:
        yield _step("clear", f"delete the parameters in {namespace}", place)
    for setting in plan.settings:
        if setting.runs_command:
            yield _step("parameter", f"{setting.name} = what the command prints", setting.place)
            continue
        try:
            values = list(setting.parameters())
        except NotThere:  # which is told with all that is not there
            continue
        for name, value in values:
            yield _step("parameter", f"{name} = {_short(value)}", setting.place)
    for task in [*(t for t in tasks if not t.comes_last), *(t for t in tasks if t.comes_last)]:
        yield _step(task.family, f"{task.node.full_name}: {task.text}", task.node.place)


def _step(kind: str, text: str, place: Any) -> dict[str, Any]:
    return {"step": kind, "text": text, "file": place.file, "line": place.line}


def _short(value: Any) -> str:
    text = " ".join(str(value).split()) if isinstance(value, str) else repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}... ({len(text)} characters)"
