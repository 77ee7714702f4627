"""Common parts of the ROS tools: verbs, options, names and failures.

Options are read by optparse, as the tools themselves do.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from optparse import Option, OptionParser, Values
from typing import Any, NamedTuple, NoReturn, TypeVar

import click

from slidectl import names
from slidectl.cli import commands, output
from slidectl.cli.context import Context
from slidectl.errors import EXIT_REFUSED, EXIT_USAGE, BadFile, Refused, SlidectlError, UsageError

N = TypeVar("N", int, float)
D = TypeVar("D")

HOST = "localhost"
"""The machine of every node and service."""
NO_SUCH_VERB = 64
"""EX_USAGE of sysexits.h, as in most of the tools."""

_YAML_NUMBER = re.compile(r"-(0[xX][0-9a-fA-F_]+|[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9]*)?)\Z")
# A word of a command line cannot contain NUL.
_MARK = "\0"
_REMAPPING = re.compile(r"[A-Za-z0-9_~/]+:=")
_NODE_ARGUMENT = re.compile(r"__(name|ns|log|ip|hostname|master):=")


class Failure(SlidectlError):
    """A failure with an exit code. Its text is complete: no prefix is printed before it."""

    def __init__(self, text: str, exit_code: int = EXIT_REFUSED) -> None:
        super().__init__(text)
        self.exit_code = exit_code


@contextmanager
def refusals() -> Iterator[None]:
    """Turn refusals of files, values and controllers into Failure: exit code 1, also where slidectl exits with 2."""
    try:
        yield
    except (BadFile, UsageError, Refused) as error:
        raise Failure(f"ERROR: {error}") from None


# --- options ----------------------------------------------------------------------------------------------------------


def option(names: str, text: str, value: str = "", dest: str | None = None) -> Option:
    """One option: its names with blanks between, its help, and the metavar of its value (empty for a flag)."""
    kind: dict[str, Any] = {"metavar": value} if value else {"action": "store_true"}
    return Option(*names.split(), help=text, dest=dest, **kind)


class Parser(OptionParser):
    """The options of one verb.

    Args:
        tool: the program's name in errors.
        usage: what follows `Usage: `.
        modern: usage errors are written as argparse writes them, for the verbs that use that.
    """

    def __init__(self, tool: str, usage: str, *options: Option, modern: bool = False) -> None:
        super().__init__(usage, options, prog=tool)
        self.modern = modern

    def parse(
        self, argv: Sequence[str], least: int = 0, most: float = float("inf"), missing: str = "", extra: str = ""
    ) -> Values:
        """The options as attributes (None when absent), and the other words as `words`. `-h` prints the help and exits.

        Raises Failure (2) for wrong usage: `missing` for fewer words than `least`, `extra` for more than `most`.
        """
        # optparse reads each word with a leading dash as an option. The mark hides negative numbers from it.
        hidden = [_MARK + word if is_number(word) and not self.has_option(word) else word for word in argv]
        given, words = self.parse_args(hidden)
        for dest, value in vars(given).items():
            if isinstance(value, str):
                setattr(given, dest, value.removeprefix(_MARK))
        given.words = [word.removeprefix(_MARK) for word in words]
        if len(words) < least:
            self.error(missing)
        if len(words) > most:
            self.error(extra.format(" ".join(given.words[least:])))
        return given

    def number(self, kind: Callable[[str], N], text: str | None, default: D, complaint: str) -> N | D:
        """The value of an option as `kind`, int or float. Raises a usage error with `complaint` when it is not one."""
        try:
            return default if text is None else kind(text)
        except ValueError:
            self.error(complaint)

    def error(self, msg: str) -> NoReturn:
        """Raise the usage error that the tool would print."""
        usage, gap = ("usage", "\n") if self.modern else ("Usage", "\n\n")
        raise Failure(f"{usage}: {self.usage}{gap}{self.prog}: error: {msg}", EXIT_USAGE)

    def print_help(self, file: object = None) -> None:  # noqa: ARG002
        output.write(self.format_help().rstrip("\n"))

    def exit(self, status: int = 0, msg: str | None = None) -> NoReturn:  # noqa: ARG002
        raise click.exceptions.Exit(status)


def is_number(word: str) -> bool:
    """True for `-5` and `-.5`, and for the YAML numbers `-0x10` and `-1:30`."""
    return word[:1] == "-" and (commands.is_number(word) or bool(_YAML_NUMBER.match(word)))


# --- verbs ------------------------------------------------------------------------------------------------------------


class Tool(NamedTuple):
    """A tool with verbs. Without a verb, or with an unknown one, it prints the list of verbs on stdout.

    `verbs` has a function and a help for each; one without help is not listed. `without` and `unknown` are the exit
    codes for no verb and for an unknown one; `help_options` print the list.
    """

    name: str
    about: str
    verbs: Mapping[str, tuple[Callable[[Context, list[str]], None], str]]
    without: int = NO_SUCH_VERB
    unknown: int = NO_SUCH_VERB
    help_options: Sequence[str] = ()

    def __call__(self, ctx: Context, argv: Sequence[str]) -> None:
        """Run the verb with the words behind it. Raises its exceptions, and click's Exit."""
        if argv and argv[0] in self.verbs:
            function, _ = self.verbs[argv[0]]
            return function(ctx, list(argv[1:]))
        width = max(map(len, self.verbs))
        listed = [f"\t{self.name} {name:<{width}}  {text}" for name, (_, text) in self.verbs.items() if text]
        last = f"'{self.name} <command> -h' prints its usage.\n"
        output.write("\n".join([self.about, "", "Commands:", *listed, "", last]))
        raise click.exceptions.Exit(self.without if not argv else 0 if argv[0] in self.help_options else self.unknown)


# --- names ------------------------------------------------------------------------------------------------------------


def resolve(ctx: Context, name: str, tool: str) -> str:
    """The absolute name: below ROS_NAMESPACE (or `--ns`), for `~private` below the tool's name in it.

    The name is exact, as in ROS: the unique end of a name is not resolved.
    """
    namespace = os.environ.get("ROS_NAMESPACE") or ctx.namespace
    if name.startswith("~"):
        return names.join(names.join(namespace, tool), name[1:])
    return names.join(namespace, name)


def below(ctx: Context, known: Iterable[str], namespace: str | None, tool: str) -> list[str]:
    """The names that are in a namespace; all for None."""
    inside = resolve(ctx, namespace, tool).rstrip("/") or "/" if namespace else "/"
    return [name for name in known if names.is_under(name, inside)]


def without_remappings(words: Sequence[str], payload_from: int | None = None) -> list[str]:
    """The words without `from:=to`, `_parameter:=value` and `__name:=name`.

    From the positional number `payload_from` on, only words such as `__name:=` are removed: `a:=b` may be a value.
    """
    return _parted(words, payload_from)[0]


def resolve_remapped(ctx: Context, name: str, tool: str, words: Sequence[str], payload_from: int | None = None) -> str:
    """`resolve`, and then the last `from:=to` for the name. For a tool that publishes, as a node does."""
    full = resolve(ctx, name, tool)
    pairs = [word.split(":=", 1) for word in _parted(words, payload_from)[1] if not word.startswith("_")]
    renamed = {resolve(ctx, source, tool): resolve(ctx, target, tool) for source, target in pairs if target}
    return renamed.get(full, full)


def _parted(words: Sequence[str], payload_from: int | None) -> tuple[list[str], list[str]]:
    """The words for the tool, and the remapping words."""
    kept: list[str] = []
    remappings: list[str] = []
    positionals = 0
    for word in words:
        is_payload = payload_from is not None and positionals >= payload_from
        if (_NODE_ARGUMENT if is_payload else _REMAPPING).match(word):
            remappings.append(word)
            continue
        positionals += not word.startswith("-")
        kept.append(word)
    return kept, remappings
