"""The command and group classes of this command line, and the options that every command understands.

`@command(examples=[...])` and `@group(...)` replace click's. They add the common options, which store into the Context,
an Examples section, negative numbers as plain values, and options that take values until the next option.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from functools import cache
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import click

from slidectl import names
from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.command_steps import CommandStep

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from slidectl.entry_points import Part, PartError

Callback = Callable[[click.Context, click.Parameter, Any], Any]


# --- callbacks of options -------------------------------------------------------------------------------------------


def finite(_click: click.Context, _param: click.Parameter, value: float | None) -> float | None:
    """The value of an option. Raises a usage error for infinity, and for nan, which click's ranges accept."""
    if value is not None and not math.isfinite(value):
        raise click.BadParameter(f"{value:g} is not a finite number")
    return value


def positive_seconds(_click: click.Context, _param: click.Parameter, value: float | None) -> float | None:
    """The value of an option in seconds. Raises a usage error unless it is above 0."""
    if value is not None and not value > 0:
        raise click.BadParameter(f"{value:g} is not above 0")
    return value


def simulated_seconds(click_context: click.Context, param: click.Parameter, value: float | None) -> float | None:
    """The value of an option in simulated seconds. Raises a usage error unless it is above 0 and finite."""
    if value == math.inf:
        raise click.BadParameter("the simulated time never gets there; leave the option out for no limit")
    return positive_seconds(click_context, param, value)


def number(*names: str, **more: Any) -> Callable[..., Any]:
    """An option that takes a finite number, X in its help text. The arguments are those of `click.option`."""
    return click.option(*names, **{"type": float, "callback": finite, "metavar": "X", **more})


def seconds(*names: str, **more: Any) -> Callable[..., Any]:
    """An option that takes simulated seconds above 0, S in its help text. The arguments are those of `click.option`."""
    return click.option(*names, **{"type": float, "callback": simulated_seconds, "metavar": "S", **more})


def conditions(equals: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a condition: --near, --above, --below, then `equals`, and --tol."""
    options = [
        number("--near", help="Within --tol of X, in the unit of the value: m or rad, say."),
        number("--above", help="Greater than X, in the unit of the value."),
        number("--below", help="Less than X, in the unit of the value."),
        equals,
        click.option("--tol", type=click.FloatRange(min=0), callback=finite, metavar="T",
                     help="How far --near may be off, in the unit of the value (0.01)."),
    ]  # fmt: skip

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            function = option(function)
        return function

    return add


def pixel_size(smallest: int, largest: int) -> Callback:
    """The callback of an option with a width and a height in pixels, such as 800x600. Its value is two numbers."""

    def parse(_click: click.Context, _param: click.Parameter, value: str | None) -> tuple[int, int] | None:
        if value is None:
            return None
        match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", value)
        if match is None or not all(smallest <= int(side) <= largest for side in match.groups()):
            raise click.BadParameter(f"{value!r} is not a size from {smallest}x{smallest} to {largest}x{largest}")
        return int(match[1]), int(match[2])

    return parse


def wait_for_world_s(simulated_s: float) -> float:
    """Wall-clock limit in s for something that takes `simulated_s` of simulated time, when `--timeout` is not given.

    One minute, plus the time that a world at a tenth of real time needs.
    """
    return 60.0 + 10.0 * simulated_s


def full_namespace(value: str) -> str:
    """A namespace as an absolute name. Raises BadName."""
    return names.check(names.join("/", value.rstrip("/") or "/"))


# --- the common options ---------------------------------------------------------------------------------------------


def _store(click_context: click.Context, param: click.Parameter, value: Any) -> None:
    """Store the value of a common option in the Context; one that is not given leaves it as it is."""
    context = click_context.find_object(Context)
    if value is None or value is False or context is None:
        return
    match param.name:
        case "common_ns":
            context.namespace = full_namespace(value)
        case "common_output":
            context.format = value
        case "common_json":
            context.format = "json"
        case "common_verbose":
            context.verbose += value
        case "common_timeout":
            context.timeout = positive_seconds(click_context, param, value)
        case "common_instance" | "common_socket" | "common_quiet":
            setattr(context, param.name.removeprefix("common_"), value)


@cache
def common_options() -> tuple[click.Option, ...]:
    """The shared options, in the order of the help. The daemon's options come first."""
    rows: list[tuple[list[str], str, dict[str, Any]]] = [
        (["-i", "--instance"], "Which daemon, by name.", {"metavar": "NAME"}),
        (["--socket"], "Which daemon, by its socket.", {"metavar": "PATH"}),
        (["--ns"], "Where relative names are tried first.", {"metavar": "NAMESPACE"}),
        (["-o", "--output"], "Format of the results.", {"type": click.Choice(output.FORMATS)}),
        (["--json"], "The same as -o json: one object a line.", {"is_flag": True}),
        (["-q", "--quiet"], "Only results and errors.", {"is_flag": True}),
        (["-v", "--verbose"], "Print more; twice shows tracebacks.", {"count": True}),
        (["--timeout"], "Longest wait, s of wall time.", {"type": float, "metavar": "SECONDS"}),
    ]
    # `common_` gives a parameter name that no command uses.
    options = [
        click.Option(
            [*flags, "common_" + flags[-1].lstrip("-")], help=text, callback=_store, expose_value=False, **more
        )
        for flags, text, more in rows
    ]
    return tuple(options)


# --- commands -------------------------------------------------------------------------------------------------------


def is_number(token: str) -> bool:
    """True for a number as a user writes it: `-5`, `1e-3`, `.5`, `-inf`, and YAML's `-.inf`."""
    try:
        float(token.replace(".inf", "inf").replace(".nan", "nan"))
    except ValueError:
        return False
    return True


class Variadic(click.Option):
    """An option that takes values until the next option, and may repeat: `--start A B --stop C`.

    `takes` returns True when a token behind the option is one of its values.
    """

    def __init__(
        self, param_decls: Sequence[str] | None = None, takes: Callable[[str], bool] | None = None, **attributes: Any
    ) -> None:
        super().__init__(param_decls, multiple=True, **attributes)
        self.takes = takes or (lambda token: not token.startswith("-") or token == "-")


_PLAIN_STEP = CommandStep()


class _Shared(click.Command):
    """Base class of commands and groups. `examples` are complete command lines.

    `step` says what the command is as a step of a scenario; with None it cannot be one. That of a group is that of its
    commands, unless they have one of their own.
    """

    def __init__(
        self, *args: Any, examples: Sequence[str] = (), step: CommandStep | None = _PLAIN_STEP, **attributes: Any
    ) -> None:
        super().__init__(*args, **attributes)
        self.examples = tuple(examples)
        self.step = step
        self._all_params: list[click.Parameter] | None = None

    def get_help_option_names(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return ["-h", "--help"]

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        if self._all_params is None:  # click asks several times in each run
            own = super().get_params(ctx)
            taken = {name for param in own for name in param.opts}
            self._all_params = own + [option for option in common_options() if taken.isdisjoint(option.opts)]
        return self._all_params

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        common = common_options()
        for title, is_common in (("Options", False), ("Common options", True)):
            params = [param for param in self.get_params(ctx) if (param in common) is is_common]
            options = [param for param in params if isinstance(param, click.Option)]
            records = [record for option in options if (record := option.get_help_record(ctx)) is not None]
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)
        if isinstance(self, click.Group):
            self.format_commands(ctx, formatter)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        if self.examples:
            with formatter.section("Examples"):
                for line in self.examples:
                    formatter.write(f"{'':>{formatter.current_indent}}{line}\n")
        super().format_epilog(ctx, formatter)


class Command(_Shared):
    """A command. Override `is_value` to let more tokens that begin with `-` be values (expressions, say).

    `check_words` checks a command line without running it. It takes the parameters by name, and raises SlidectlError
    for those that the command refuses in any world.
    """

    def __init__(self, *args: Any, check_words: Callable[..., object] | None = None, **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self.check_words = check_words

    def is_value(self, token: str) -> bool:
        """True when `token`, which begins with `-` and is no option of this command, is a value."""
        return is_number(token)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments with click's parser, in the unambiguous order of `_ordered`.

        click has no setting for values that begin with a dash beside options that are refused when they are unknown,
        and none for options with as many values as are there.
        """
        return super().parse_args(ctx, self._ordered(list(args), ctx) if ctx.allow_interspersed_args else args)

    def _ordered(self, rest: list[str], ctx: click.Context) -> list[str]:
        """The options with their values, then `--`, then the other arguments. This lets a value begin with `-`.

        A `Variadic` option is repeated before each of its values.
        """
        every = [param for param in self.get_params(ctx) if isinstance(param, click.Option)]
        named = {name: param for param in every for name in (*param.opts, *param.secondary_opts)}
        takes = {name: 0 if param.is_flag or param.count else param.nargs for name, param in named.items()}
        options: list[str] = []
        values: list[str] = []
        while rest:
            token = rest.pop(0)
            param = named.get(token)
            if token == "--":
                values += rest
                break
            if isinstance(param, Variadic):
                taken = list(takewhile(param.takes, rest))
                if not taken and not ctx.resilient_parsing:
                    raise click.BadOptionUsage(token, f"Option {token!r} requires an argument.")
                options += [part for value in taken for part in (token, value)]
                del rest[: len(taken)]
            elif param is None and (not token.startswith("-") or token == "-" or self.is_value(token)):
                values.append(token)
            elif param is None and token[2:3] == "=" and token[:2] in named:  # -n=5
                options += [token[:2], token[3:]]
            else:
                count = takes.get(token, 0)
                # click's options that may stand without their value have the value for that case; the others have none.
                is_optional = param is not None and isinstance(param.flag_value, int | str)
                if is_optional and rest and rest[0].startswith("-") and not is_number(rest[0]):
                    count = 0  # the next word is an option, not this one's value
                flags, last = token[1:-1], token[-1]
                if param is None and all(takes.get(f"-{flag}") == 0 for flag in flags):  # several in one word: -vn 5
                    count = takes.get(f"-{last}", 0)
                options += [token, *rest[:count]]
                del rest[:count]
        return [*options, "--", *values] if values else options


class Group(_Shared, click.Group):
    """A group of commands. Without a command, it prints its help on stderr and exits with 2."""

    command_class = Command

    def __init__(self, *args: Any, **attributes: Any) -> None:
        super().__init__(*args, no_args_is_help=False, **attributes)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            click.echo(self.get_help(ctx), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        if isinstance(cmd, _Shared) and cmd.step is _PLAIN_STEP:
            cmd.step = self.step
        super().add_command(cmd, name)

    # --- commands of installed packages: `list_commands` does not have them, since to look for them takes time ---

    def entry_point(self, name: str) -> str:
        """The name of the entry point of a command of this group."""
        return f"{self.name}.{name}"

    def installed(self) -> dict[str, Part]:
        """The commands of this group that installed packages add, by name."""
        from slidectl.cli.installed_commands import INSTALLED

        begin = self.entry_point("")
        parts = {name.removeprefix(begin): part for name, part in INSTALLED.parts().items() if name.startswith(begin)}
        return {name: part for name, part in parts.items() if "." not in name}

    def refused(self) -> list[PartError]:
        """The commands of installed packages that are not used because of their names, with the reasons."""
        from slidectl.cli.installed_commands import INSTALLED

        begin = self.entry_point("").rstrip(".")
        return [error for error in INSTALLED.refused() if error.part.name.rpartition(".")[0] == begin]

    def find_installed(self, name: str) -> click.Command | None:
        """The command that an installed package adds; None: there is none. Raises PartError: it cannot be used."""
        from slidectl.cli import installed_commands

        return installed_commands.find(self.entry_point(name))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return super().get_command(ctx, cmd_name) or self.find_installed(cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_commands(ctx, formatter)
        self.format_installed(formatter, 0)

    def format_installed(self, formatter: click.HelpFormatter, width: int) -> None:
        """The section of the commands that installed packages add, with names at least so wide; nothing if none is."""
        parts, notes = self.installed(), self.refused()
        if parts or notes:
            with formatter.section("Installed packages"):
                # What the package says of itself: none of its code runs for a help.
                texts = {name: ": ".join(filter(None, [part.owner, part.summary])) for name, part in parts.items()}
                if texts:
                    formatter.write_dl([(name.ljust(width), text) for name, text in texts.items()])
                for note in notes:
                    formatter.write_text(note.message)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        from click.shell_completion import CompletionItem

        found = [CompletionItem(name, help=part.owner) for name, part in self.installed().items()]
        return super().shell_complete(ctx, incomplete) + [item for item in found if item.value.startswith(incomplete)]

    # --- names that are not there ---

    def elsewhere(self, ctx: click.Context, name: str) -> list[str]:  # noqa: ARG002
        """Full commands outside this group that a name may mean."""
        return []

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name, known = args[0], self.list_commands(ctx)
        if ctx.resilient_parsing or name.startswith("-") or name in known or self.find_installed(name) is not None:
            return super().resolve_command(ctx, args)
        known += self.installed()
        if meant := self.elsewhere(ctx, name):
            raise click.UsageError(f"no command {name!r}; there is: {', '.join(meant)}", ctx)
        from slidectl.errors import closest

        near = closest(name, known)
        suggestion = f" Did you mean {ctx.command_path + ' ' + near!r}?" if near else ""
        raise click.UsageError(f"no command {name!r}.{suggestion}\ncommands: {', '.join(known)}", ctx)


def command(name: str | None = None, *, examples: Sequence[str], **attributes: Any) -> Callable[..., Command]:
    """Decorator of a top-level command. The first sentence of its help is the short help in the command table."""
    attributes.setdefault("cls", Command)
    return click.command(name, examples=examples, **attributes)


def group(name: str | None = None, **attributes: Any) -> Callable[..., Group]:
    """Decorator of a group; add to it with `@thegroup.command("verb", examples=[...])`."""
    attributes.setdefault("cls", Group)
    return click.group(name, **attributes)
