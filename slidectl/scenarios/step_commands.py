"""What a step may be: the commands of the command line, as names with options and arguments, and how to run one.

The words of a step are what a shell would have: from a text they are split as a shell does, from a mapping they are
made by the names of the command's options and arguments.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from slidectl.errors import UnknownName, UsageError

if TYPE_CHECKING:
    from slidectl.client import Client


class StepOption(NamedTuple):
    """An option by its long name. `off` is the word for false, empty where there is none."""

    name: str
    word: str
    off: str
    kind: str
    """`flag`, `integer`, `number` or `text`."""
    choices: tuple[str, ...]
    takes_several: bool
    repeats_word: bool
    """Whether each of several values has the option's word before it."""
    help: str


class StepArgument(NamedTuple):
    """A positional argument."""

    name: str
    takes_several: bool
    required: bool


class StepCommand(NamedTuple):
    """A command with its words, as `controller switch`."""

    name: str
    help: str
    arguments: tuple[StepArgument, ...]
    options: tuple[StepOption, ...]


class StepOutcome(NamedTuple):
    """How a step ended: its exit code, and of a failure what was said. `output` is what it printed."""

    exit_code: int
    message: str = ""
    hint: str = ""
    output: str = ""


class Commands(Protocol):
    """The commands of the command line."""

    @property
    def known(self) -> Mapping[str, StepCommand]:
        """All that can be steps, by name."""

    def check(self, words: Sequence[str]) -> None:
        """Raises SlidectlError for what is wrong with a command line, before anything runs."""

    def run(self, words: Sequence[str], client: Client) -> StepOutcome:
        """Run a command line with the connection."""


def as_word(value: Any) -> str:
    """A value as one word: texts as they are, all else as YAML reads it again."""
    return value if isinstance(value, str) else json.dumps(value)


def split(text: str) -> list[str]:
    """The words of a text, as a shell parts them. Raises UsageError."""
    try:
        return shlex.split(text)
    except ValueError as error:
        raise UsageError(f"cannot part the words of {text!r}: {error}", "a quote needs its end") from None


def words_of(command: StepCommand, given: Mapping[str, Any]) -> list[str]:
    """The words behind the command's name, from values by names. Raises UnknownName, UsageError."""
    options = {option.name: option for option in command.options}
    arguments = {argument.name: argument for argument in command.arguments}
    for name in given:
        if name not in options and name not in arguments:
            raise UnknownName("option", name, [*arguments, *options], f"of {command.name}")
    words: list[str] = []
    for name, value in given.items():
        if name in options:
            words += _option_words(command, options[name], value)
    places: list[str] = []
    for argument in command.arguments:
        if argument.name in given:
            value = given[argument.name]
            places += [as_word(item) for item in value] if _is_several(value, argument.takes_several) else [
                as_word(value)
            ]  # fmt: skip
        elif argument.required:
            raise UsageError(f"{command.name} needs {argument.name!r}")
    return [*words, *(["--", *places] if places else [])]


def _is_several(value: Any, takes_several: bool) -> bool:
    return takes_several and isinstance(value, Sequence) and not isinstance(value, str)


def _option_words(command: StepCommand, option: StepOption, value: Any) -> list[str]:
    if option.kind == "flag":
        if not isinstance(value, bool):
            raise UsageError(f"{option.name!r} of {command.name} is true or false, not {as_word(value)}")
        return [option.word] if value else [option.off] if option.off else []
    if not _is_several(value, option.takes_several):
        if isinstance(value, list):
            raise UsageError(f"{option.name!r} of {command.name} takes one value, not {len(value)}")
        return [option.word, as_word(value)]
    if option.repeats_word:
        return [part for item in value for part in (option.word, as_word(item))]
    return [option.word, *map(as_word, value)]
