"""Options as the ROS tools read them, which is Python's optparse (argparse for two verbs), and their usage errors.

Options before and behind positionals, abbreviated long options, `-n1`, `--`; unlike there a negative number is a
value. The standard library's modules would cost more time than a whole command may take.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import click

from slidectl.cli import output
from slidectl.cli.commands import looks_like_number
from slidectl.cli.ros.failure import Failure
from slidectl.errors import EXIT_USAGE


class Option(NamedTuple):
    """One option. `value` is the metavar of what it takes, empty for a flag."""

    names: tuple[str, ...]
    dest: str
    help: str
    value: str = ""


class Arguments:
    """What was given: options as attributes (None or False when absent), `words` for the rest."""

    def __init__(self, options: Iterable[Option]) -> None:
        self.words: list[str] = []
        for option in options:
            setattr(self, option.dest, None if option.value else False)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)


IsValue = Callable[[str, Sequence[str]], bool]
"""Whether a word that begins with `-` is a value; the second argument holds the positionals before it."""


def begins_as_number(token: str) -> bool:
    """True for `-5`, `-.5`, and for `-0x10` and `-1:30`, which YAML knows."""
    return looks_like_number(token) or (token[:1] == "-" and token[1:2].isdigit())


class Parser:
    """Reads the words of one verb. `tool` is the program's name in errors, `usage` what follows `Usage: `.

    `modern` writes usage errors as argparse does, for the verbs that use that.
    """

    def __init__(
        self,
        tool: str,
        usage: str,
        options: Sequence[Option] = (),
        about: str = "",
        *,
        modern: bool = False,
        is_value: IsValue | None = None,
    ) -> None:
        self.tool = tool
        self.usage = usage
        self.options = [*options, Option(("-h", "--help"), "help", "show this and exit")]
        self.about = about
        self.modern = modern
        self._is_value = is_value or self._is_number

    def parse(self, argv: Sequence[str]) -> Arguments:
        """The options and words. `-h` prints the help and ends; Failure (2) for wrong usage."""
        arguments = Arguments(self.options)
        rest = list(argv)
        while rest:
            token = rest.pop(0)
            if token == "--":
                arguments.words += rest
                break
            if not self._is_option(token, arguments.words):
                arguments.words.append(token)
            elif token.startswith("--"):
                self._long(token, rest, arguments)
            else:
                self._short(token, rest, arguments)
        return arguments

    def _is_option(self, token: str, before: Sequence[str]) -> bool:
        return token.startswith("-") and token != "-" and not self._is_value(token, before)

    def _is_number(self, token: str, _before: Sequence[str]) -> bool:
        return begins_as_number(token) and not any(token in option.names for option in self.options)

    def _long(self, token: str, rest: list[str], arguments: Arguments) -> None:
        name, equals, value = token.partition("=")
        option = self._find_long(name)
        if not option.value:
            if equals:
                self.error(f"{option.names[-1]} option does not take a value")
            self._store(option, True, arguments)
        else:
            self._store(option, value if equals else self._next(option.names[-1], rest), arguments)

    def _find_long(self, name: str) -> Option:
        long = {each: option for option in self.options for each in option.names if each.startswith("--")}
        if name in long:
            return long[name]
        near = sorted(each for each in long if each.startswith(name))
        if len(near) > 1:
            self.error(f"ambiguous option: {name} ({', '.join(near)}?)")
        return long[near[0]] if near else self.error(f"no such option: {name}")

    def _short(self, token: str, rest: list[str], arguments: Arguments) -> None:
        """A cluster such as `-lv`, or an option with its value behind it such as `-n1`."""
        for index, letter in enumerate(token[1:], start=2):
            name = "-" + letter
            option = next((option for option in self.options if name in option.names), None)
            if option is None:
                self.error(f"no such option: {name}")
            elif option.value:
                self._store(option, token[index:] or self._next(name, rest), arguments)
                return
            else:
                self._store(option, True, arguments)

    def _next(self, name: str, rest: list[str]) -> str:
        return rest.pop(0) if rest else self.error(f"{name} option requires 1 argument")

    def _store(self, option: Option, value: Any, arguments: Arguments) -> None:
        if option.dest == "help":
            output.write(self.help())
            raise click.exceptions.Exit(0)
        setattr(arguments, option.dest, value)

    def error(self, text: str) -> Any:
        """Raise the usage error that the tool would print."""
        if self.modern:
            raise Failure(f"usage: {self.usage}\n{text}", EXIT_USAGE)
        raise Failure(f"Usage: {self.usage}\n\n{self.tool}: error: {text}", EXIT_USAGE)

    def integer(self, text: str | None, default: int, complaint: str) -> int:
        """The whole number that an option was given. A usage error with `complaint` when it is none."""
        try:
            return default if text is None else int(text)
        except ValueError:
            return int(self.error(complaint))

    def at_most(self, arguments: Arguments, count: int, complaint: str) -> list[str | None]:
        """The words, filled up with None to `count`. A usage error with `complaint` when there are more."""
        if len(arguments.words) > count:
            self.error(complaint)
        return [*arguments.words, *[None] * (count - len(arguments.words))]

    def only_word(self, argv: Sequence[str], missing: str, extra: str) -> str:
        """The one word of a verb that takes one and has no options; the texts complain when it is not so."""
        words = self.parse(argv).words
        if not words:
            self.error(missing)
        if len(words) > 1:
            self.error(extra.format(" ".join(words[1:])))
        return words[0]

    def help(self) -> str:
        """Usage, what it does, and the options in two columns."""
        rows = [(f"  {_spelled(option)}", option.help) for option in self.options]
        width = max(len(left) for left, _ in rows) + 2
        lines = [f"{left:<{width}}{text}" for left, text in rows]
        about = [self.about, ""] if self.about else []
        return "\n".join([f"Usage: {self.usage}", "", *about, "Options:", *lines])


def _spelled(option: Option) -> str:
    """`-r RATE, --rate=RATE`."""
    if not option.value:
        return ", ".join(option.names)
    value = option.value
    return ", ".join(f"{name}={value}" if name.startswith("--") else f"{name} {value}" for name in option.names)
