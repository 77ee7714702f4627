"""Steps: commands with their options and arguments, the base class of further kinds, and how to run one.

The words of a step are those of a command line: a text is split like a shell does it; a mapping gives values for the
names of the command's options and arguments.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from slidectl.command_steps import StepEffects
from slidectl.errors import SlidectlError, UnknownName, UsageError

if TYPE_CHECKING:
    from slidectl.client import Client


class StepKind:
    """A kind of steps of an installed package: the key of such a step is its name, the value any form of YAML.

    One instance serves all steps of a process, in several cases one after the other: it keeps nothing between them.
    """

    help: ClassVar[str] = ""
    """One sentence, for editors."""
    schema: ClassVar[Mapping[str, Any]] = {}
    """The JSON schema of the value, for editors; `check` is what counts."""
    may_add_controllers: ClassVar[bool] = False
    """True when controllers, or their parameters, may come from such a step."""

    def check(self, value: Any) -> None:
        """Raise UsageError for a value that is wrong in any world, before anything runs. Variables are replaced."""

    def run(self, value: Any, client: Client) -> Mapping[str, Any] | None:
        """Do the step by a client of the world. Waits of the client let the world run, up to the limit of the step.

        Returns a record for the output, or None. Raises SlidectlError where the step fails: Refused, for example.
        """
        raise NotImplementedError


class StepOption(NamedTuple):
    """An option with its long name. `off` is the word for false, or empty."""

    name: str
    word: str
    off: str
    kind: str
    """`flag`, `integer`, `number` or `text`."""
    choices: tuple[str, ...]
    takes_several: bool
    repeats_word: bool
    """True when the option's word is repeated before each of several values."""
    help: str


class StepArgument(NamedTuple):
    """A positional argument."""

    name: str
    takes_several: bool
    required: bool


class StepCommand(NamedTuple):
    """A command and its words, such as `controller switch`."""

    name: str
    help: str
    arguments: tuple[StepArgument, ...]
    options: tuple[StepOption, ...]


class StepOutcome(NamedTuple):
    """The outcome of a step: its exit code, the message of a failure, and in `output` what it printed."""

    exit_code: int
    message: str = ""
    hint: str = ""
    output: str = ""


class Commands(Protocol):
    """The commands of the command line, and further kinds of steps. The words of such a step are its kind and the JSON
    text of its value."""

    @property
    def known(self) -> Mapping[str, StepCommand]:
        """All commands that can be steps, by name. A command is imported when it is asked for."""

    @property
    def kinds(self) -> Mapping[str, StepKind]:
        """The kinds of steps that are no commands, by name. As with `known`."""

    def tops(self) -> list[str]:
        """The first words of all steps, sorted."""

    def has(self, top: str) -> bool:
        """True when steps begin with this word."""

    def check(self, words: Sequence[str]) -> StepEffects:
        """Check a command line before anything runs. Raises SlidectlError when it cannot be a step."""

    def stays(self, words: Sequence[str]) -> bool:
        """True when the command, once it is up, continues in the background until the case ends."""

    def run(self, words: Sequence[str], client: Client, up: Callable[[], None] = lambda: None) -> StepOutcome:
        """Run a command line with the client. A command that stays calls `up` when it is up."""


def as_word(value: Any) -> str:
    """A value as one word: texts unchanged, other values in a form that YAML reads back."""
    return value if isinstance(value, str) else json.dumps(value)


def split(text: str) -> list[str]:
    """Split a text into words like a shell. Raises UsageError."""
    try:
        return shlex.split(text)
    except ValueError as error:
        raise UsageError(f"cannot split {text!r} into words: {error}", "close the quote") from None


def words_of(command: StepCommand, given: Mapping[str, Any], report: Callable[[SlidectlError], None]) -> list[str]:
    """The words after the command's name, from values by name. `report` is called for a wrong value, which is left out.

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
        except SlidectlError as mistake:
            report(mistake)
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
    """The words for an option. Raises UsageError."""
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
