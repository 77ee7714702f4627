"""Lines that leave click nothing to decide, run without its parser: for a shell, which reads many.

A plan is made of a command's own parameters and of the defaults that click finds for them. Whatever is not plain
(help, an error, an unknown option, `--name=value`, a value that does not convert) is left to click, and so are all
messages: `parse` gives None for it, before anything has happened.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import click
from click.globals import pop_context, push_context

from slidectl.cli.commands import Command, Group, Variadic
from slidectl.cli.context import Context
from slidectl.errors import SlidectlError

_TAKES_CLICK = click.pass_context(lambda _: None).__code__
"""The code of a callback that is given click's own context: what it wants to know there is not all in a plan."""
_WORD = r"""(?:[^\s'"\\#]|'[^']*'|"[^"\\]*")++"""
_PLAIN_LINE = re.compile(rf"[ \t\r\n]*(?:{_WORD}(?:[ \t\r\n]++|\Z))*+\Z")
_SPECIAL = frozenset("'\"\\#")
_WORDS = re.compile(_WORD)
_QUOTED = re.compile(r"""'[^']*'|"[^"]*\"""")


def split(line: str) -> list[str] | None:
    """The words of a line as a POSIX shell parts them; None where there is a comment, an escape or an open quote."""
    if line.isascii() and _SPECIAL.isdisjoint(line) and line.rstrip("\n").isprintable():
        return line.split()
    if not line.isascii() or _PLAIN_LINE.match(line) is None:
        return None
    return [_QUOTED.sub(lambda quoted: quoted[0][1:-1], word) for word in _WORDS.findall(line)]


class _Option:
    """What an option on a line means: true, or the word behind it."""

    __slots__ = ("param", "takes_word")

    def __init__(self, param: click.Option) -> None:
        self.param = param
        self.takes_word = not param.is_flag


def _is_plain_option(param: click.Option) -> bool:
    plain = not (param.multiple or param.count or param.is_eager or param.secondary_opts or isinstance(param, Variadic))
    return plain and param.nargs == 1 and (not param.is_flag or (param.is_bool_flag and param.flag_value is not False))


class Plan:
    """One command whose arguments are single words, the last perhaps as many as there are."""

    def __init__(self, command: Command, click_context: click.Context) -> None:
        params = command.get_params(click_context)
        self._command = command
        self._click = click_context
        self._defaults = dict(click_context.params)
        self._callback = command.callback
        self._options = {
            name: _Option(param)
            for param in params
            if isinstance(param, click.Option) and _is_plain_option(param)
            for name in param.opts
        }
        self._all_options = {name for param in params if isinstance(param, click.Option) for name in param.opts}
        arguments = [param for param in params if isinstance(param, click.Argument)]
        self._rest = arguments.pop() if arguments and arguments[-1].nargs == -1 else None
        self._arguments = arguments
        self._fewest = max((place for place, param in enumerate(arguments, 1) if param.required), default=0)

    def parse(self, words: Sequence[str], context: Context) -> dict[str, Any] | None:
        """The parameters for the callback; None for words that click must read. Stores common options in `context`."""
        given: list[str] = []
        options: dict[str, tuple[_Option, str]] = {}
        index = 0
        while index < len(words):
            word = words[index]
            index += 1
            if word[:1] != "-" or word == "-":
                given.append(word)
                continue
            option = self._options.get(word)
            if option is None:
                if word in self._all_options or word == "--" or not self._command.is_value(word, words[: index - 1]):
                    return None
                given.append(word)
                continue
            value = ""
            if option.takes_word:
                if index == len(words) or not self._is_value(words, index):
                    return None
                value = words[index]
                index += 1
            if options.setdefault(str(option.param.name), (option, value)) != (option, value):
                return None
        return self._converted(given, options, context)

    def _is_value(self, words: Sequence[str], index: int) -> bool:
        word = words[index]
        return word[:1] != "-" or (word not in self._all_options and self._command.is_value(word, words[:index]))

    def _converted(
        self, given: list[str], options: dict[str, tuple[_Option, str]], context: Context
    ) -> dict[str, Any] | None:
        singles = len(self._arguments)
        if len(given) < self._fewest or (len(given) > singles and self._rest is None):
            return None
        self._click.obj = context
        params = self._defaults.copy()
        try:
            for param, word in zip(self._arguments, given, strict=False):
                self._put(params, param, word)
            if self._rest is not None:
                if self._rest.required and len(given) <= singles:
                    return None
                self._put_rest(params, self._rest, given[singles:])
            for option, word in options.values():
                self._put(params, option.param, word if option.takes_word else True)
        except (click.ClickException, SlidectlError):
            return None
        return params

    def _put(self, params: dict[str, Any], param: click.Parameter, value: Any) -> None:
        if isinstance(value, str) and param.type is not click.STRING:
            value = param.type(value, param, self._click)
        if param.callback is not None:
            value = param.callback(self._click, param, value)
        if param.expose_value:
            params[str(param.name)] = value

    def _put_rest(self, params: dict[str, Any], param: click.Argument, words: list[str]) -> None:
        if words:
            convert = param.type
            values = words if convert is click.STRING else [convert(word, param, self._click) for word in words]
            params[str(param.name)] = tuple(values)

    def run(self, params: dict[str, Any], context: Context) -> None:
        """Call the command as click would. Raises what it raises."""
        click_context = self._click
        click_context.obj = context
        click_context.params = params
        push_context(click_context)
        try:
            self._callback(**params)  # type: ignore[misc]
        except click.UsageError as error:
            error.ctx = error.ctx or click_context
            raise
        finally:
            pop_context()


class Branch:
    """The plans of the commands in a group, each made when the first line needs it."""

    def __init__(self, group: Group, click_context: click.Context) -> None:
        self._group = group
        self._click = click_context
        self._names = frozenset(group.list_commands(click_context))
        self._made: dict[str, Branch | Plan | None] = {}

    def find(self, words: Sequence[str]) -> tuple[Plan | None, Sequence[str]]:
        """The plan for a line and the words behind the command's name; None where click must read it."""
        if not words or words[0] not in self._names:
            return None, words
        name = words[0]
        if name not in self._made:
            self._made[name] = self._make(name)
        made = self._made[name]
        return made.find(words[1:]) if isinstance(made, Branch) else (made, words[1:])

    def _make(self, name: str) -> Branch | Plan | None:
        command = self._group.get_command(self._click, name)
        if command is None or not (_is_plain_group(command) or _is_plain_command(command)):
            return None
        # That finds the defaults, and complains of nothing.
        click_context = command.make_context(name, [], parent=self._click, resilient_parsing=True)
        click_context.resilient_parsing = False
        if isinstance(command, Group):
            return Branch(command, click_context)
        return Plan(command, click_context) if isinstance(command, Command) else None


def plans(root: Group) -> Branch:
    """The plans of a whole command line."""
    click_context = root.make_context(root.name, [], resilient_parsing=True)
    click_context.resilient_parsing = False
    return Branch(root, click_context)


def _is_plain_group(command: click.Command) -> bool:
    """One that only has commands: nothing happens on the way to them."""
    return type(command) is Group and not command.params and not command.invoke_without_command


def _is_plain_command(command: click.Command) -> bool:
    kind = type(command)
    if not isinstance(command, Command) or command.callback is None or command.context_settings or command.deprecated:
        return False
    as_usual = kind.invoke is click.Command.invoke and kind.make_context is click.Command.make_context
    as_usual = as_usual and kind.parse_args is click.Command.parse_args and kind.make_parser is Command.make_parser
    counts = [param.nargs for param in command.params if isinstance(param, click.Argument)]
    one_by_one = all(count == 1 for count in counts[:-1]) and set(counts[-1:]) <= {1, -1}
    looks_at_click = getattr(command.callback, "__code__", None) is _TAKES_CLICK
    return as_usual and one_by_one and not looks_at_click and not any(_decides(param) for param in command.params)


def _decides(param: click.Parameter) -> bool:
    """True for a parameter whose absence is not settled by a default."""
    if isinstance(param, click.Option) and (param.required or param.prompt):
        return True
    return bool(param.envvar) or callable(param.default)
