"""The command and group classes of this command line.

`@command(examples=[...])` and `@group(...)` replace click's. They add the common options, an Examples section,
negative numbers as plain values, and options that take values until the next option.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import click

from slidectl.cli.options import common_options, help_option


def looks_like_number(token: str) -> bool:
    """True for what a person writes as a number: `-5`, `1e-3`, `.5`, `-inf`, and YAML's `-.inf`."""
    try:
        float(token.replace(".inf", "inf").replace(".nan", "nan"))
    except ValueError:
        return False
    return True


class Variadic(click.Option):
    """An option that takes values until the next option, and may repeat: `--start A B --stop C`."""

    def __init__(
        self, param_decls: Sequence[str] | None = None, takes: Callable[[str], bool] | None = None, **attributes: Any
    ) -> None:
        attributes["multiple"] = True
        super().__init__(param_decls, **attributes)
        self._takes = takes

    def takes(self, token: str) -> bool:
        """True when `token`, which follows the option, is one of its values."""
        if self._takes is not None:
            return self._takes(token)
        return not token.startswith("-") or token == "-"


class _Shared(click.Command):
    """What commands and groups have in common. `examples` are complete command lines."""

    def __init__(self, *args: Any, examples: Sequence[str] = (), **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self.examples = tuple(examples)
        self._all_params: list[click.Parameter] = []

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        # click asks several times for every command that runs.
        if not self._all_params:
            own = super().get_params(ctx)
            taken = {name for param in own for name in param.opts}
            self._all_params = own + [option for option in common_options() if taken.isdisjoint(option.opts)]
        return self._all_params

    def get_help_option(self, ctx: click.Context) -> click.Option:  # noqa: ARG002
        return help_option()

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        common = common_options()
        own = [param for param in self.get_params(ctx) if param not in common]
        shared = [param for param in self.get_params(ctx) if param in common]
        self._write_options(ctx, formatter, "Options", own)
        self._write_options(ctx, formatter, "Common options", shared)
        if isinstance(self, click.Group):
            self.format_commands(ctx, formatter)

    def _write_options(
        self, ctx: click.Context, formatter: click.HelpFormatter, title: str, params: Sequence[click.Parameter]
    ) -> None:
        options = [param for param in params if isinstance(param, click.Option)]
        records = [record for option in options if (record := option.get_help_record(ctx)) is not None]
        if records:
            with formatter.section(title):
                formatter.write_dl(records)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        if self.examples:
            with formatter.section("Examples"):
                for line in self.examples:
                    formatter.write(f"{'':>{formatter.current_indent}}{line}\n")
        super().format_epilog(ctx, formatter)


class Command(_Shared):
    """A command. Override `is_value` to let more tokens that begin with `-` be values (expressions, say)."""

    def is_value(self, token: str, before: Sequence[str]) -> bool:  # noqa: ARG002
        """True when `token`, which begins with `-` and is no option of this command, is a value.

        `before` holds the arguments to its left as the user typed them.
        """
        return looks_like_number(token)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """click's own parser, on the arguments in an order that leaves it nothing to guess: see `_ordered`."""
        ordered = self._ordered(list(args), ctx) if ctx.allow_interspersed_args else args
        return super().parse_args(ctx, ordered)

    def _ordered(self, args: list[str], ctx: click.Context) -> list[str]:
        """The options with their values, then `--`, then the rest: so a value may begin with `-`.

        An option that takes values until the next one is repeated before each of its values.
        """
        named = {
            name: param for param in self.get_params(ctx) if isinstance(param, click.Option) for name in param.opts
        }
        named |= {name: param for param in set(named.values()) for name in param.secondary_opts}
        options: list[str] = []
        values: list[str] = []
        index = 0
        while index < len(args):
            token = args[index]
            index += 1
            param = named.get(token)
            if token == "--":
                values += args[index:]
                break
            if isinstance(param, Variadic):
                end = _end_of_values(param, args, index)
                if end == index and not ctx.resilient_parsing:
                    raise click.BadOptionUsage(token, f"Option {token!r} requires an argument.")
                options += [part for value in args[index:end] for part in (token, value)]
                index = end
            elif param is None and (
                not token.startswith("-") or token == "-" or self.is_value(token, args[: index - 1])
            ):
                values.append(token)
            elif param is None and token[2:3] == "=" and token[:2] in named:  # -n=5
                options += [token[:2], token[3:]]
            else:
                taken = _values_of(param, token, named)
                # click looks a short name up as a long one first, and imports what compares names when it fails.
                long = [name for name in param.opts if name.startswith("--")] if param and len(token) == 2 else []
                options += [*(long[:1] or [token]), *args[index : index + taken]]
                index += taken
        return [*options, "--", *values] if values else options


def _values_of(param: click.Option | None, token: str, named: Mapping[str, click.Option]) -> int:
    """How many of the arguments behind a token are values of its option: none of a flag, or of `-n5` and `--name=5`."""
    if param is None and not token.startswith("--"):  # flags in one word, perhaps with an option behind them: -vn 5
        for place, letter in enumerate(token[1:], 2):
            param = named.get(f"-{letter}")
            if param is None or not param.is_flag:
                param = param if place == len(token) else None
                break
    return 0 if param is None or param.is_flag or param.count else param.nargs


def _end_of_values(option: Variadic, args: Sequence[str], start: int) -> int:
    end = start
    while end < len(args) and option.takes(args[end]):
        end += 1
    return end


class Group(_Shared, click.Group):
    """A group of commands; without one it shows its help on stderr and exits 2."""

    command_class = Command

    def __init__(self, *args: Any, **attributes: Any) -> None:
        super().__init__(*args, no_args_is_help=False, **attributes)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            click.echo(self.get_help(ctx), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def elsewhere(self, ctx: click.Context, name: str) -> list[str]:  # noqa: ARG002
        """The full commands that a name may mean which this group has not."""
        return []

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if not ctx.resilient_parsing and not name.startswith("-") and name not in self.list_commands(ctx):
            raise UnknownCommand(name, self.list_commands(ctx), ctx, self.elsewhere(ctx, name))
        return super().resolve_command(ctx, args)


class UnknownCommand(click.UsageError):
    """No such command: says which full commands may be meant, else suggests the closest and lists all."""

    def __init__(self, name: str, known: Sequence[str], ctx: click.Context, meant: Sequence[str] = ()) -> None:
        from slidectl.errors import closest

        if meant:
            super().__init__(f"no command {name!r}; there is: {', '.join(meant)}", ctx)
            return
        near = closest(name, known)
        suggestion = f" Did you mean {ctx.command_path + ' ' + near!r}?" if near else ""
        super().__init__(f"no command {name!r}.{suggestion}\ncommands: {', '.join(known)}", ctx)


def command(name: str | None = None, *, examples: Sequence[str], **attributes: Any) -> Callable[..., Command]:
    """Decorator of a command that stands on its own. Its first sentence is the short help of the command table."""
    attributes.setdefault("cls", Command)
    return click.command(name, examples=examples, **attributes)


def group(name: str | None = None, **attributes: Any) -> Callable[..., Group]:
    """Decorator of a group; add to it with `@thegroup.command("verb", examples=[...])`."""
    attributes.setdefault("cls", Group)
    return click.group(name, **attributes)
