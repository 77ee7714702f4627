"""The plan that launch files describe: parameters to set, namespaces to clear, nodes to start; with file and line.

Values that take time (running xacro, reading files) are computed on first use, once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from slidectl import names
from slidectl.description.missing import Missing
from slidectl.description.robot import Notice, Verdict
from slidectl.errors import BadFile, NotThere

Leaf = tuple[Any, "Location"]


@dataclass(frozen=True)
class Location:
    """File and line of something in a launch file."""

    file: str
    line: int | None

    def __str__(self) -> str:
        return self.file if self.line is None else f"{self.file}:{self.line}"

    def error(self, message: str, hint: str | None = None) -> BadFile:
        """An error at this place, to be raised."""
        return BadFile(message, self.file, self.line, hint)

    def absence(self, message: str, hint: str | None = None, thing: str = "") -> NotThere:
        """The error for a missing thing that is named at this place."""
        return NotThere(message, self.file, self.line, hint, thing)


@dataclass
class Setting:
    """A parameter, or a tree of parameters. `compute` returns the value; `origin` is its kind of source."""

    name: str
    place: Location
    origin: str
    compute: Callable[[], Any]
    runs_command: bool = False
    """True when `compute` runs a program of the user."""
    source: str = ""
    """The file that the value is read from, or empty."""
    is_whole: bool = False
    """True when a mapping is the value of one parameter, and not a tree of parameters."""
    _value: Any = None
    _known: bool = False

    @property
    def loss(self) -> str:
        """What is left out when the value cannot be computed, for a message."""
        what = f"the parameter {self.name}" if self.is_whole else f"the file's parameters in {self.name}"
        return f"{what} {'is' if self.is_whole else 'are'} left out"

    def value(self) -> Any:
        """Compute the value, once. Raises NotThere when a file is missing, BadFile for other errors."""
        if not self._known:
            self._value, self._known = self.compute(), True
        return self._value

    def parameters(self) -> Iterator[tuple[str, Any]]:
        """Full names and values of the parameters. Raises BadFile."""
        if self.is_whole:
            return iter([(self.name, self.value())])
        return leaves(self.name, self.value(), self.place)


@dataclass(frozen=True)
class Remap:
    """The name `source` is replaced by `target`. Both are as written, possibly relative."""

    source: str
    target: str
    place: Location


@dataclass(frozen=True)
class RosparamCommand:
    """`<rosparam command="delete">` or `"dump"`; done before the parameters are set."""

    verb: str
    name: str
    file: str
    place: Location


@dataclass
class Node:
    """One `<node>`, with everything that applies to it. `namespace` has no trailing slash, except for the root."""

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
    """`screen` or `log`; None when it is not set."""
    respawn: bool = False
    respawn_delay_s: float = 0.0
    required: bool = False
    cwd: str | None = None
    """`node` or `ROS_HOME`; None when it is not set."""
    launch_prefix: list[str] = field(default_factory=list)
    file: str = ""
    """The launch file that defines it."""
    absent: tuple[NotThere, ...] = ()
    """The missing packages in `args`. Words that need them are not in `words`."""

    @property
    def full_name(self) -> str:
        """The full name, `/ns/name`."""
        return names.join(self.namespace, self.name)

    @property
    def kind(self) -> str:
        """The kind of node, `package/type`."""
        return f"{self.package}/{self.type}"

    def resolve(self, name: str) -> str:
        """The absolute name after remaps: a relative name is in the node's namespace, a `~` name below the node."""
        remap = self.remap_of(name)
        return self.absolute(name if remap is None else remap.target)

    def remap_of(self, name: str) -> Remap | None:
        """The last remap for the name, or None."""
        full = self.absolute(name)
        return next((remap for remap in reversed(self.remaps) if self.absolute(remap.source) == full), None)

    def absolute(self, name: str) -> str:
        """The absolute name, without remaps."""
        if name.startswith("~"):
            return names.join(self.full_name, name[1:].lstrip("/"))
        return names.join(self.namespace, name)


@dataclass
class Argument:
    """An `<arg>` of a file on the command line. Without a default it is required."""

    name: str
    default: str | None
    doc: str | None


@dataclass
class LaunchPlan:
    """The content of all launch files, in their order."""

    files: list[str] = field(default_factory=list)
    """Absolute paths of all files, including included ones."""
    arguments: dict[str, Argument] = field(default_factory=dict)
    clear: list[tuple[str, Location]] = field(default_factory=list)
    """Namespaces whose parameters are deleted first."""
    commands: list[RosparamCommand] = field(default_factory=list)
    settings: list[Setting] = field(default_factory=list)
    nodes: list[Node] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    missing: Missing = field(default_factory=Missing)
    """The missing things that the files name."""

    def notice(self, verdict: Verdict, place: Location, subject: str, text: str) -> None:
        """Add a notice about the files."""
        self.notices.append(Notice(verdict, subject, text, place.file, place.line))

    def parameters(self, gather: bool = False, run_commands: bool = True) -> dict[str, Leaf]:
        """All parameters by full name, with value and place; a later setting of a name overrides an earlier one.

        A name with a value cannot have names below it: the later setting (by the first mention of each) replaces the
        earlier one, with a notice. Settings that need a missing file are left out and noted; with `gather` the caller
        raises the error, after looking for more. Without `run_commands` settings that run a program are left out.

        Raises BadFile: a value cannot be computed.
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
                self.missing.refuse()  # something missing is the most frequent reason
                raise
        if not gather:
            self.missing.refuse()
        for name, over in _conflicts(found):
            gone, last = found.pop(name, None), found[over]
            if gone is not None:
                self.notice("wrong", gone[1], name, f"conflicts with {over}, which is set at {last[1]} and replaces it")
        return found


def leaves(name: str, value: Any, place: Location) -> Iterator[tuple[str, Any]]:
    """Full names and values below a name; a key with a leading slash is a full name. Lists are values.

    Raises BadFile: a key that cannot be a name.
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
    """Names that are overridden, each with the later name that replaces it. A mapping may have names below it."""
    order = {name: index for index, name in enumerate(found)}
    pairs = []
    for name in found:
        above = names.parent(name)
        while above != "/":
            if above in found and not (isinstance(found[above][0], dict) and order[above] < order[name]):
                pairs.append((above, name) if order[above] < order[name] else (name, above))
            above = names.parent(above)
    return pairs
