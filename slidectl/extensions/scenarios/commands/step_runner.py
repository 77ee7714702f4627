"""The commands of this command line as steps of scenarios: their parameters, the check of words, and the execution."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from functools import cached_property
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli.command_table import COMMANDS
from slidectl.cli.commands import Command, Variadic, common_options
from slidectl.cli.context import Context
from slidectl.cli.main import described, invoke, load, root
from slidectl.errors import EXIT_DONE, EXIT_INTERRUPTED, SlidectlError, UsageError
from slidectl.extensions.scenarios.step_commands import CheckedWords, StepArgument, StepCommand, StepOption, StepOutcome

if TYPE_CHECKING:
    from slidectl.client import Client

_NO_STEPS = (
    "daemon",
    "shell",
    "test",
    "ros-commands",
    "completion",
    "version",
    "doctor",
    "gui",
    "teleop",
    "top",
    "view",
)
"""Commands that do not act in the world of a scenario, which exists already, or that need a terminal."""
_MAY_ADD_CONTROLLERS = ("param", "controller config", "service call", "launch", "ros", "sim load")
"""Commands, and groups, that may add controllers, or parameters of controllers, that no file of a spawn has."""
_NO_ROS_STEPS = ("roscore", "roslaunch", "rosrun")
_PLACE = re.compile(r"\[?([A-Z]+)\]?(\.\.\.)?\Z")
_KEPT_OUTPUT = 20_000


class StepRunner:
    """Implements `scenarios.step_commands.Commands` with click. `live`: the world has a daemon, for other programs."""

    def __init__(self, live: bool = False) -> None:
        self._live = live

    @cached_property
    def known(self) -> dict[str, StepCommand]:
        """All commands that can be steps, by name."""
        found: dict[str, StepCommand] = {}
        for name, entry in COMMANDS.items():
            if name not in _NO_STEPS:
                found |= {shape.name: shape for shape in _shapes(name, load(name, entry))}
        return found

    def check(self, words: Sequence[str]) -> CheckedWords:
        """Check the words of a step. Raises SlidectlError for words that click refuses, or that no step may have."""
        context = Context()
        try:
            with redirect_stdout(io.StringIO()):
                leaf, command, values = _parsed(words, context)
        except click.exceptions.Exit:
            raise UsageError(f"{words[-1]!r} prints something and does nothing", "leave it out") from None
        except click.ClickException as error:
            message, hint, _ = described(error)
            raise UsageError(message, hint) from None
        if context.instance or context.socket:
            raise UsageError("a step acts in the world of its scenario", "leave out --instance and --socket")
        if values.get("detach"):
            raise UsageError("--detach leaves a process behind", "to go on meanwhile: background: true")
        if leaf == "sim fork" or values.get("keep"):
            what = "--keep" if values.get("keep") else leaf
            raise UsageError(f"{what} leaves a daemon behind", "a scenario has a world of its own")
        if leaf == "ros" and (tool := values["words"][0]) in _NO_ROS_STEPS:
            raise UsageError(f"{tool} brings up a world, and a scenario has its own", "spawn what is needed")
        if leaf == "launch":
            return _check_launch(values, self._live)
        refusal = None
        if isinstance(command, Command) and command.check_words is not None:
            try:
                command.check_words(**values)
            except SlidectlError as error:
                refusal = error
        others = self._live or leaf.startswith(_MAY_ADD_CONTROLLERS)  # a world with a daemon may have them already
        if leaf == "spawn":
            return CheckedWords(
                controllers=values["controllers"] or "", named=tuple(values["start"]), model=values["model"],
                may_add_controllers=others or values["keep_going"], refusal=refusal,
            )  # fmt: skip
        others = others or (leaf == "controller load" and values["source"] is not None)
        return CheckedWords(named=_named(leaf, values), may_add_controllers=others, refusal=refusal)

    def stays(self, words: Sequence[str]) -> bool:
        """True for a launch, the only command that goes on once it is up."""
        return words[0] == "launch"

    def run(self, words: Sequence[str], client: Client, up: Callable[[], None] = lambda: None) -> StepOutcome:
        """Run a command line with the connection; results are JSON records, unless the words give a format."""
        shell = Context()
        shell.up = up
        shell._client = client
        shell.format = "json"
        own = Context(shell)
        timeout = client.timeout
        begin = _written()
        code, message, hint = EXIT_DONE, "", None
        try:
            invoke(list(words), own)
        except click.exceptions.Exit as leaving:
            code = leaving.exit_code
        except (KeyboardInterrupt, click.Abort):
            code = EXIT_INTERRUPTED
        except Exception as error:
            message, hint, code = described(error)
        finally:
            client.timeout = timeout
            sys.stdout.flush()
            sys.stderr.flush()
        output = _output_since(begin)
        if code and not message:
            message = f"exit code {code}: {output.strip()}"
        return StepOutcome(code, message, hint or "", output)


def _named(leaf: str, values: Mapping[str, Any]) -> tuple[str, ...]:
    """The controllers that a manager must know, without their namespaces."""
    if not leaf.startswith("controller ") or values.get("wait") or not values.get("strict", True):
        return ()
    full = [name for key in ("names", "to_start", "to_stop") for name in values.get(key) or ()]
    return tuple(name.rpartition("/")[2] for name in full)


def _written() -> int:
    """The bytes printed so far, when stdout is a file, as in a worker of scenarios; else 0."""
    try:
        return os.lseek(1, 0, os.SEEK_CUR)
    except OSError:
        return 0


def _output_since(begin: int) -> str:
    try:
        return os.pread(1, _KEPT_OUTPUT, max(begin, _written() - _KEPT_OUTPUT)).decode("utf-8", "replace")
    except OSError:  # stdout cannot be read back
        return ""


def _parsed(words: Sequence[str], context: Context) -> tuple[str, click.Command, dict[str, Any]]:
    """The full name of the command that the words mean, the command, and its parameters. Raises click's exceptions."""
    command: click.Command = root
    above, rest, names = click.Context(root, info_name="slidectl", obj=context), list(words), ""
    while isinstance(command, click.Group):
        if not rest:
            raise click.UsageError(f"{names!r} needs one of: {', '.join(command.list_commands(above))}", above)
        name, found, rest = command.resolve_command(above, rest)
        assert found is not None
        command, names = found, f"{names} {name}".strip()
        if isinstance(command, click.Group):
            above = click.Context(command, info_name=name, parent=above)
    return names, command, command.make_context(names.split()[-1], rest, parent=above).params


def _shapes(name: str, command: click.Command) -> Iterator[StepCommand]:
    if isinstance(command, click.Group):
        context = click.Context(command, info_name=name)
        for verb in command.list_commands(context):
            found = command.get_command(context, verb)
            if found is not None:
                yield from _shapes(f"{name} {verb}", found)
        return
    own = [param for param in command.params if param not in common_options()]
    arguments = [place for param in own if isinstance(param, click.Argument) for place in _places(param)]
    options = [_option(param) for param in own if isinstance(param, click.Option) and not param.hidden]
    yield StepCommand(name, command.get_short_help_str(200), tuple(arguments), tuple(options))


def _places(param: click.Argument) -> Iterator[StepArgument]:
    """The arguments, named as in the help: `TOPIC [TYPE] [VALUE]...` are topic, type and values."""
    tokens = [_PLACE.match(token) for token in (param.metavar or "").split()]
    if tokens and all(tokens):
        for token in tokens:
            assert token is not None
            name = token[1].lower()
            yield StepArgument(f"{name}s" if token[2] else name, bool(token[2]), not token[0].startswith("["))
    else:
        yield StepArgument(str(param.name), param.nargs == -1, param.required)


def _option(param: click.Option) -> StepOption:
    word = max(param.opts, key=len)
    off = max(param.secondary_opts, key=len, default="")
    is_flag = bool(param.is_flag and not isinstance(param.flag_value, str))
    kinds = ((click.types.IntParamType, "integer"), (click.types.FloatParamType, "number"))
    kind = (
        "flag" if is_flag or param.count else next((name for cls, name in kinds if isinstance(param.type, cls)), "text")
    )
    choices = tuple(map(str, param.type.choices)) if isinstance(param.type, click.Choice) else ()
    return StepOption(
        word.lstrip("-"), word, off, kind, choices, param.multiple or param.nargs > 1, not isinstance(param, Variadic),
        param.help or "",
    )  # fmt: skip


def _check_launch(values: Mapping[str, Any], live: bool) -> CheckedWords:
    """Check the files of a launch. Raises SlidectlError when nodes are programs, which need a daemon, and none runs."""
    from slidectl.extensions.launch import execution, node_kinds
    from slidectl.extensions.launch.commands.launch import load_plan
    from slidectl.extensions.launch.nodes.programs import Process

    try:
        plan, lookup, _ = load_plan(values["words"], values["packages"], values)
        tasks = node_kinds.tasks(plan, lookup, gather=True)
        execution.look_ahead(plan, tasks, lookup, run_commands=False)
    except SlidectlError as refusal:
        return CheckedWords(may_add_controllers=True, refusal=refusal)
    programs = [task for task in tasks if isinstance(task, Process)]
    if programs and not live:
        text = f"{programs[0].node.kind} is a program of its own, which needs a daemon"
        raise programs[0].error(text, "slidectl test --daemon runs the scenario in a daemon")
    return CheckedWords(starts_programs=bool(programs), may_add_controllers=True)
