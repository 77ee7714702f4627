"""The commands of this command line as steps of scenarios: what they take, whether words are right, and to run them."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from functools import cached_property
from typing import TYPE_CHECKING

import click

from slidectl.cli.commands import Variadic, common_options
from slidectl.cli.context import Context
from slidectl.cli.main import COMMANDS, described, invoke, load, root
from slidectl.errors import EXIT_DONE, EXIT_INTERRUPTED, BadFile, UnknownName, UsageError
from slidectl.scenarios.step_commands import StepArgument, StepCommand, StepOption, StepOutcome

if TYPE_CHECKING:
    from slidectl.client import Client

_NO_STEPS = ("daemon", "shell", "test", "ros-commands", "completion", "version", "doctor", "launch")
"""Commands about other things than the world of a scenario, which is there already."""
_PLACE = re.compile(r"\[?([A-Z]+)\]?(\.\.\.)?\Z")
_KEPT_OUTPUT = 20_000


class StepRunner:
    """`scenarios.step_commands.Commands` by click."""

    @cached_property
    def known(self) -> dict[str, StepCommand]:
        """All commands that can be steps, by name."""
        found: dict[str, StepCommand] = {}
        for name, entry in COMMANDS.items():
            if name not in _NO_STEPS:
                found |= {shape.name: shape for shape in _shapes(name, load(name, entry))}
        return found

    def check(self, words: Sequence[str]) -> None:
        """Raises SlidectlError for words that click would not take, and for files of controllers that are wrong."""
        context = Context()
        try:
            with redirect_stdout(io.StringIO()):
                leaf, values = _parsed(words, context)
        except click.exceptions.Exit:
            raise UsageError(f"{words[-1]!r} prints something and does nothing", "leave it out") from None
        except click.ClickException as error:
            message, hint, _ = described(error)
            raise UsageError(message, hint) from None
        if context.instance or context.socket:
            raise UsageError("a step acts in the world of its scenario", "leave out --instance and --socket")
        if leaf == "spawn":
            _check_spawn(values)

    def run(self, words: Sequence[str], client: Client) -> StepOutcome:
        """Run a command line with the connection; results are records as JSON, unless the words say otherwise."""
        shell = Context()
        shell._client = client
        shell.format = "json"
        own = Context(shell)
        timeout = client.timeout
        begin = _written()
        error: Exception | None = None
        code = EXIT_DONE
        try:
            invoke(list(words), own)
        except click.exceptions.Exit as leaving:
            code = leaving.exit_code
        except (KeyboardInterrupt, click.Abort):
            code = EXIT_INTERRUPTED
        except Exception as raised:
            error = raised
        finally:
            client.timeout = timeout
            sys.stdout.flush()
            sys.stderr.flush()
        output = _output_since(begin)
        if error is not None:
            message, hint, code = described(error)
            return StepOutcome(code, message, hint or "", output)
        return StepOutcome(code, f"exit code {code}: {output.strip()}" if code else "", "", output)


def _written() -> int:
    """How much has been printed, where that goes into a file, as it does in a worker of scenarios."""
    try:
        return os.lseek(1, 0, os.SEEK_CUR)
    except OSError:
        return 0


def _output_since(begin: int) -> str:
    try:
        return os.pread(1, _KEPT_OUTPUT, max(begin, _written() - _KEPT_OUTPUT)).decode("utf-8", "replace")
    except OSError:  # it cannot be read again
        return ""


def _parsed(words: Sequence[str], context: Context) -> tuple[str, dict[str, object]]:
    """The name of the command that the words mean, and its parameters. Raises what click raises."""
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
    return names, command.make_context(names.split()[-1], rest, parent=above).params


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
    """The arguments by the names that the help has: `TOPIC [TYPE] [VALUE]...` are topic, type and values."""
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


def _check_spawn(values: dict[str, object]) -> None:
    """The model and the controllers, as far as they can be judged without a world. Raises SlidectlError."""
    from slidectl.check import controllers
    from slidectl.check.findings import Findings
    from slidectl.client import spawning

    file = values.get("controllers")
    if not isinstance(file, str):
        return
    findings = Findings()
    path = spawning.find(file)
    controllers.check(path, None, findings)
    for broken in findings.broken:
        raise broken
    for notice in findings.sorted(("wrong",)):
        raise BadFile(f"{notice.subject}: {notice.text}", notice.file, notice.line)
    from slidectl.description import controllers_file

    tree = controllers_file.read(path)
    known = {name for inner in [tree, *tree.values()] if isinstance(inner, dict) for name in inner}
    wanted = values.get("start")
    for name in wanted if isinstance(wanted, tuple) else ():
        if name.rpartition("/")[2] not in known and name not in known:
            raise UnknownName("controller", name, sorted(known), f"in {file}")
