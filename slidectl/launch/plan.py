"""What launch files come to: parameters to set, namespaces to clear, nodes to start; plain data with file and line.

Values that take time (running xacro, reading files) are computed when they are asked for, and once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from slidectl import names
from slidectl.description.missing import Missing
from slidectl.description.robot import Notice
from slidectl.errors import BadFile, NotThere

Leaf = tuple[Any, "Location"]


@dataclass(frozen=True)
class Location:
    """Where something was written."""

    file: str
    line: int | None

    def __str__(self) -> str:
        return self.file if self.line is None else f"{self.file}:{self.line}"

    def error(self, message: str, hint: str | None = None) -> BadFile:
        """An error at this place, to be raised."""
        return BadFile(message, self.file, self.line, hint)

    def absence(self, message: str, hint: str | None = None, thing: str = "") -> NotThere:
        """The error when what is named at this place is not there."""
        return NotThere(message, self.file, self.line, hint, thing)


@dataclass
class Setting:
    """A parameter, or a whole tree of them: `compute` gives its value. `origin` says where that comes from."""

    name: str
    place: Location
    origin: str
    compute: Callable[[], Any]
    runs_command: bool = False
    """True when computing it runs a program of the user's."""
    source: str = ""
    """The file that the value is read from, if it is."""
    is_whole: bool = False
    """True when a mapping is one value, and not one for each of the names in it."""
    _value: Any = None
    _known: bool = False

    @property
    def loss(self) -> str:
        """What is not set when its value cannot be had."""
        what = f"the parameter {self.name}" if self.is_whole else f"the file's parameters in {self.name}"
        return f"{what} {'is' if self.is_whole else 'are'} left out"

    def value(self) -> Any:
        """Raises BadFile when it cannot be had; of a file that is not there NotThere."""
        if not self._known:
            self._value, self._known = self.compute(), True
        return self._value

    def parameters(self) -> Iterator[tuple[str, Any]]:
        """Full names and values. Raises BadFile."""
        if self.is_whole:
            return iter([(self.name, self.value())])
        return leaves(self.name, self.value(), self.place)


@dataclass(frozen=True)
class Remap:
    """Names to be taken for others, absolute where they were written so."""

    source: str
    target: str
    place: Location


@dataclass(frozen=True)
class RosparamCommand:
    """`<rosparam command="delete">` or `"dump"`: done before the parameters are set."""

    verb: str
    name: str
    file: str
    place: Location


@dataclass
class Node:
    """One `<node>`, with all that applies to it. `namespace` has no slash at its end, but for the root."""

    package: str
    type: str
    name: str
    namespace: str
    place: Location
    words: list[str] = field(default_factory=list)
    """The words of `args`."""
    remaps: tuple[Remap, ...] = ()
    environment: tuple[tuple[str, str], ...] = ()
    output: str | None = None
    """`screen` or `log`; None when it was not said."""
    respawn: bool = False
    respawn_delay_s: float = 0.0
    required: bool = False
    cwd: str | None = None
    """`node` or `ROS_HOME`; None when it was not said."""
    launch_prefix: list[str] = field(default_factory=list)
    file: str = ""
    """The launch file that defines it."""
    absent: tuple[NotThere, ...] = ()
    """The packages that `args` looks for and that are not there; the words that need them are not among `words`."""

    @property
    def full_name(self) -> str:
        """`/ns/name`."""
        return names.join(self.namespace, self.name)

    @property
    def kind(self) -> str:
        """`package/type`."""
        return f"{self.package}/{self.type}"

    def resolve(self, name: str) -> str:
        """The absolute name that the node means: relative ones in its namespace, `~` ones below it, then remaps."""
        remap = self.remap_of(name)
        return self.absolute(name if remap is None else remap.target)

    def remap_of(self, name: str) -> Remap | None:
        """The remap that counts for the name: of several the last."""
        full = self.absolute(name)
        return next((remap for remap in reversed(self.remaps) if self.absolute(remap.source) == full), None)

    def absolute(self, name: str) -> str:
        """The same without remaps."""
        if name.startswith("~"):
            return names.join(self.full_name, name[1:].lstrip("/"))
        return names.join(self.namespace, name)


@dataclass
class Argument:
    """An `<arg>` of a file that was named on the command line. Without a default it is required."""

    name: str
    default: str | None
    doc: str | None


@dataclass
class LaunchPlan:
    """Everything, in the order of the files."""

    files: list[str] = field(default_factory=list)
    """Absolute paths of all files used, includes as well."""
    arguments: dict[str, Argument] = field(default_factory=dict)
    clear: list[tuple[str, Location]] = field(default_factory=list)
    """Namespaces whose parameters are deleted first."""
    commands: list[RosparamCommand] = field(default_factory=list)
    settings: list[Setting] = field(default_factory=list)
    nodes: list[Node] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    missing: Missing = field(default_factory=Missing)
    """What the files name and is not there."""

    def notice(self, verdict: str, place: Location, subject: str, text: str) -> None:
        """Say something about the files that is no error; `verdict` is `ignored`, `converted` or `wrong`."""
        self.notices.append(Notice(verdict, subject, text, place.file, place.line))  # type: ignore[arg-type]

    def parameters(self, gather: bool = False, run_commands: bool = True) -> dict[str, Leaf]:
        """Every parameter by its full name, with its value and its place; of those set twice the last counts.

        A name that is set to a value cannot hold others: the first mention of either counts for the order, the later
        one goes over the earlier one, and a notice says so. What cannot be had because a file is not there is left out,
        and noted as missing; with `gather` the caller refuses it, after looking for more. Without `run_commands` those
        are left out for which a program of the user's would have to run.

        Raises:
            BadFile: a value cannot be had.
        """
        found: dict[str, Leaf] = {}
        for setting in self.settings:
            if setting.runs_command and not run_commands:
                continue
            try:
                found.update((name, (value, setting.place)) for name, value in setting.parameters())
            except NotThere as error:
                self.missing.note(error, setting.loss)
            except BadFile:
                self.missing.refuse()  # the reason, more often than not
                raise
        if not gather:
            self.missing.refuse()
        for name, over in _conflicts(found):
            gone, last = found.pop(name, None), found[over]
            if gone is not None:
                self.notice(
                    "wrong", gone[1], name, f"cannot be set beside {over}, which is set at {last[1]} and counts"
                )
        return found


def leaves(name: str, value: Any, place: Location) -> Iterator[tuple[str, Any]]:
    """Full names and values below a name; a key with a slash before it is a full name. Lists are values.

    Raises:
        BadFile: a key that cannot be a name.
    """
    if not isinstance(value, dict):
        if value is not None:
            yield name, value
        return
    for key, below in value.items():
        full = names.join(name, str(key).rstrip("/"))
        if not names.is_legal(full):
            raise place.error(f"{key!r} cannot be the name of a parameter", "names are letters, digits, '_' and '/'")
        yield from leaves(full, below, place)


def _conflicts(found: Mapping[str, Leaf]) -> list[tuple[str, str]]:
    """Names whose values do not count, each with the later name that replaces it. A mapping may hold other names."""
    order = {name: index for index, name in enumerate(found)}
    pairs = []
    for name in found:
        above = names.parent(name)
        while above != "/":
            if above in found and not (isinstance(found[above][0], dict) and order[above] < order[name]):
                pairs.append((above, name) if order[above] < order[name] else (name, above))
            above = names.parent(above)
    return pairs
