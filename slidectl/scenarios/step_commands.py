"""What a step may be: the commands of the command line, as names with options and arguments, and how to run one.

The words of a step are what a shell would have: from a text they are split as a shell does, from a mapping they are
made by the names of the command's options and arguments.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from slidectl.errors import SlidectlError, UnknownName, UsageError

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


class CheckedWords(NamedTuple):
    """What a check of a command line has found out."""

    starts_programs: bool = False
    controllers: str = ""
    """The file from which a spawn loads the parameters of controllers."""
    named: tuple[str, ...] = ()
    """The controllers that must have parameters."""
    brings_others: bool = False
    """Whether there may then be controllers, or parameters of some, that no file of a spawn has."""
    model: str = ""
    """What a spawn puts into the world."""
    refusal: SlidectlError | None = None
    """What the command would say of its words."""


class Commands(Protocol):
    """The commands of the command line."""

    @property
    def known(self) -> Mapping[str, StepCommand]:
        """All that can be steps, by name."""

    def check(self, words: Sequence[str]) -> CheckedWords:
        """Raises SlidectlError for what is no command line of a step, before anything runs."""

    def stays(self, words: Sequence[str]) -> bool:
        """Whether the command goes on in the background once it is up, and ends with the case."""

    def run(self, words: Sequence[str], client: Client, up: Callable[[], None] = lambda: None) -> StepOutcome:
        """Run a command line with the connection. One that stays calls `up`."""


def as_word(value: Any) -> str:
    """A value as one word: texts as they are, all else as YAML reads it again."""
    return value if isinstance(value, str) else json.dumps(value)


def split(text: str) -> list[str]:
    """The words of a text, as a shell parts them. Raises UsageError."""
    try:
        return shlex.split(text)
    except ValueError as error:
        raise UsageError(f"cannot part the words of {text!r}: {error}", "a quote needs its end") from None


def words_of(command: StepCommand, given: Mapping[str, Any], tell: Callable[[SlidectlError], None]) -> list[str]:
    """The words behind the command's name, from values by names; those with slips, which are told, are left out.

    Raises UsageError: an argument is missing.
    """
    options = {option.name: option for option in command.options}
    arguments = {argument.name: argument for argument in command.arguments}
    words: list[str] = []
    for name, value in given.items():
        try:
            if name in options:
                words += _option_words(command, options[name], value)
            elif name not in arguments:
                raise UnknownName("option", name, [*arguments, *options], f"of {command.name}")
        except SlidectlError as slip:
            tell(slip)
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
    """Raises UsageError."""
    if value is None:
        what = f"{option.name!r} of {command.name} has no value"
        raise UsageError(what, f'"{option.name}: null" is text when it is quoted')
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
