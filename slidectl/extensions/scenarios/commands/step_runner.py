"""The commands of this command line as steps of scenarios: their parameters, the check of words, and the execution."""

from __future__ import annotations

import io
import json
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, redirect_stdout, suppress
from functools import cache
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import installed_commands
from slidectl.cli.command_table import COMMANDS, load
from slidectl.cli.commands import Command, Variadic, common_options
from slidectl.cli.context import Context
from slidectl.cli.installed_commands import INSTALLED
from slidectl.cli.main import described, invoke, root
from slidectl.command_steps import CommandStep, StepEffects
from slidectl.entry_points import Part, PartError, Registry
from slidectl.errors import EXIT_DONE, EXIT_INTERRUPTED, SlidectlError, UsageError
from slidectl.extensions.scenarios.scenario_file import STEP_KEYS
from slidectl.extensions.scenarios.step_commands import StepArgument, StepCommand, StepKind, StepOption, StepOutcome

if TYPE_CHECKING:
    from slidectl.client import Client

_PLACE = re.compile(r"\[?([A-Z]+)\]?(\.\.\.)?\Z")
_KEPT_OUTPUT = 20_000
_OWN_KEYS = frozenset((*COMMANDS, *STEP_KEYS))
"""The keys of steps that slidectl has."""


def _expected(found: Any) -> str:
    return "" if isinstance(found, type) and issubclass(found, StepKind) else "class derived from StepKind"


def _bad_name(name: str) -> str:
    if not name.replace("_", "").replace("-", "").isalnum():
        return "a name is of letters, digits, '-' and '_'"
    return "a command of an installed package has this name" if name in INSTALLED.parts() else ""


STEP_KINDS = Registry("slidectl.steps", "step", lambda: _OWN_KEYS, _expected, _bad_name)


class StepRunner:
    """Implements `scenarios.step_commands.Commands` with click. `live`: the world has a daemon, for other programs."""

    def __init__(self, live: bool = False) -> None:
        self._live = live
        self.known: Mapping[str, StepCommand] = _KnownCommands()
        self.kinds: Mapping[str, StepKind] = _KnownKinds()

    def tops(self) -> list[str]:
        """The first words of all steps, sorted."""
        ours = (name for name in COMMANDS if self.has(name))
        return sorted({*ours, *root.installed(), *STEP_KINDS.parts()})

    def has(self, top: str) -> bool:
        """True when steps begin with this word. Raises PartError: several packages claim it."""
        if top in COMMANDS:
            return bool(_shapes_of(top))
        return top not in STEP_KEYS and (INSTALLED.find(top) or STEP_KINDS.find(top)) is not None

    def check(self, words: Sequence[str]) -> StepEffects:
        """Check the words of a step. Raises SlidectlError for words that click refuses, or that no step may have."""
        if words[0] in self.kinds:
            kind = self.kinds[words[0]]
            with _running(words[0]):
                kind.check(json.loads(words[1]))
            return StepEffects(may_add_controllers=self._live or kind.may_add_controllers)
        context = Context()
        try:
            with redirect_stdout(io.StringIO()):
                leaf, command, values = _parsed(words, context)
        except click.exceptions.Exit:
            raise UsageError(f"{words[-1]!r} only prints text", "leave it out") from None
        except click.ClickException as error:
            message, hint, _ = described(error)
            raise UsageError(message, hint) from None
        if context.instance or context.socket:
            raise UsageError("a step acts in the world of its scenario", "leave out --instance and --socket")
        step = _declared(command)
        if step is None:
            raise UsageError(f"{leaf} cannot be a step: it does not act in the world of a scenario")
        effects = StepEffects() if step.effects is None else step.effects(values, self._live)
        if isinstance(command, Command) and command.check_words is not None:
            try:
                command.check_words(**values)
            except SlidectlError as error:
                effects = effects._replace(refusal=error)
        # A world with a daemon may have controllers already.
        may_add = self._live or step.may_add_controllers or effects.may_add_controllers
        return effects._replace(may_add_controllers=may_add)

    def stays(self, words: Sequence[str]) -> bool:
        """True when the command, once it is up, continues in the background until the case ends."""
        command: click.Command | None = root
        context = click.Context(root)
        for word in words:
            if not isinstance(command, click.Group):
                break
            command = command.get_command(context, word)
        step = None if command is None else _declared(command)
        return step is not None and step.stays

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
            if words[0] in self.kinds:
                with _running(words[0]):
                    record = self.kinds[words[0]].run(json.loads(words[1]), client)
                own.emit(record or {}, "")
            else:
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


def _declared(command: click.Command) -> CommandStep | None:
    """How a command acts as a step; a plain click command has the default."""
    step: CommandStep | None = getattr(command, "step", CommandStep())
    return step


def _running(kind: str) -> AbstractContextManager[None]:
    """The context for the code of an installed kind of steps."""
    part = STEP_KINDS.find(kind)
    assert part is not None
    return STEP_KINDS.running(part)


class _KnownCommands(Mapping[str, StepCommand]):
    """The commands that can be steps. Only a command that is asked for is imported; all are when they are listed, save
    those of installed packages that cannot be loaded."""

    def __getitem__(self, name: str) -> StepCommand:
        top, _, verb = name.partition(" ")
        shapes = _shapes_of(top)
        if name not in shapes and verb and top in COMMANDS:
            shapes = _installed_shapes(f"{top}.{verb}", name)
        return shapes[name]

    def __iter__(self) -> Iterator[str]:
        for top in (*COMMANDS, *INSTALLED.parts()):
            with suppress(PartError):
                yield from _shapes_of(top) if "." not in top else _installed_shapes(top, top.replace(".", " "))

    def __len__(self) -> int:
        return sum(1 for _ in self)


@cache
def _shapes_of(top: str) -> dict[str, StepCommand]:
    """The steps of a top-level command, without the verbs that packages add. Raises PartError."""
    if top not in COMMANDS:
        return _installed_shapes(top, top)
    return {shape.name: shape for shape in _shapes(top, load(top))}


def _installed_shapes(entry_point: str, name: str) -> dict[str, StepCommand]:
    command = installed_commands.find(entry_point)
    return {} if command is None else {shape.name: shape for shape in _shapes(name, command)}


class _KnownKinds(Mapping[str, StepKind]):
    """The kinds of steps that installed packages add, as `_KnownCommands`."""

    def __getitem__(self, name: str) -> StepKind:
        part = STEP_KINDS.find(name) if name in self else None
        if part is None:
            raise KeyError(name)
        return _made(part)

    def __contains__(self, name: object) -> bool:
        return name not in _OWN_KEYS and STEP_KINDS.find(str(name)) is not None

    def __iter__(self) -> Iterator[str]:
        for name, part in STEP_KINDS.parts().items():
            with suppress(PartError):
                _made(part)
                yield name

    def __len__(self) -> int:
        return sum(1 for _ in self)


@cache
def _made(part: Part) -> StepKind:
    kind_class = STEP_KINDS.load(part)
    with STEP_KINDS.running(part):
        kind: StepKind = kind_class()
    return kind


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
    if _declared(command) is None:
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
