"""What surrounds a tag: namespace, arguments, remaps, environment and private parameters, and the launch as a whole.

A scope is copied for a group and an include, so that nothing leaks out of it. No tags here.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from slidectl.description import xml_tree
from slidectl.description.packages import Packages, UnknownPackage, is_file
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile, closest
from slidectl.launch.plan import Place, Plan, Remap, Setting
from slidectl.launch.substitution import Substitution

if TYPE_CHECKING:
    from slidectl.launch.tag import Tag

Parse = Callable[[bytes, str], Element]
"""Elements of the text of a file, given its name in messages. Raises BadFile."""

# Around the name of a package that is not there, in the place of its folder: an argument takes it along to whoever
# needs the folder, and only that is left out. On the last private plane of Unicode, as in protected.py.
ABSENT = "\U0010f6ff"
_ABSENT = re.compile(f"{ABSENT}([^{ABSENT}]*){ABSENT}")

MOST_TAGS = 20_000
MOST_FILES = 1000
MOST_TEXT = 64 * 2**20
"""Letters that all substitutions of a launch may come to."""
MOST_SECONDS = 60.0
"""Of the processor's time, for reading the files without what commands take."""
DEEPEST_INCLUDE = 60


def absent_packages(text: str) -> list[str]:
    """The packages that are not there and that a text with everything substituted needs."""
    return _ABSENT.findall(text)


@dataclass
class Launch:
    """One loading: what all its files share."""

    packages: Packages
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    run_commands: bool = True
    parse: Parse = xml_tree.read
    plan: Plan = field(default_factory=Plan)
    machines: set[str] = field(default_factory=set)
    """Names that launch files give to this machine."""
    absent: dict[str, UnknownPackage] = field(default_factory=dict)
    """The packages that are not there, and why."""
    knows_angles: bool = False
    """Whether `deg(90)` is a number in `<param type="yaml">`: in roslaunch it is, after the first `<rosparam>`."""
    _tags: int = 0
    _text: int = 0
    _began_s: float = field(default_factory=time.process_time)

    def count(self, tag: Tag) -> None:
        """One more tag is read. Raises BadFile when there are more than any launch has."""
        self._tags += 1
        if self._tags > MOST_TAGS:
            raise tag.error(f"unfolds to more than {MOST_TAGS} tags", "does a file include itself?")

        if time.process_time() - self._began_s > MOST_SECONDS:
            raise tag.error(f"the launch takes more than {MOST_SECONDS:g} s to read", "does a file include itself?")

    def count_text(self, tag: Tag, text: str) -> None:
        """So much more text was put in. Raises BadFile when it is more than any launch has."""
        self._text += len(text)
        if self._text > MOST_TEXT:
            hint = "do arguments repeat each other many times over?"
            raise tag.error(f"the launch comes to more than {MOST_TEXT >> 10} KiB of text", hint)

    def count_file(self, tag: Tag) -> None:
        """One more file is included. Raises BadFile when there are more than any launch has."""
        if len(self.plan.files) > MOST_FILES:
            raise tag.error(f"unfolds to more than {MOST_FILES} files", "does a file include itself?")


@dataclass(frozen=True)
class Surroundings:
    """What `$(...)` finds outside of its scope; packages are looked for from the file's folder upwards too."""

    launch: Launch
    packages: Packages
    anonymous_names: dict[str, str]

    @property
    def environment(self) -> Mapping[str, str]:
        return self.launch.environment

    def find(self, package: str) -> str:
        """The package's folder; of one that is not there a name that `absent_packages` knows again."""
        try:
            return str(self.packages.find(package))
        except UnknownPackage as error:
            self.launch.absent[package] = error
            return f"{ABSENT}{package}{ABSENT}"

    def executable(self, package: str, path: str) -> str | None:
        """Where a build has put an executable of the package: `PREFIX/lib/PACKAGE` beside `PREFIX/share/PACKAGE`."""
        if package in self.launch.absent:
            return None
        share = self.packages.find(package)
        built = share.parent.parent / "lib" / package / path
        is_there = "/" not in path and share.parent.name == "share" and is_file(built) and os.access(built, os.X_OK)
        return str(built) if is_there else None

    def anonymous(self, identifier: str) -> str:
        """`identifier` with host, process and a random number behind it; the same again for the same identifier."""
        if identifier not in self.anonymous_names:
            host = "".join(letter if letter.isalnum() and letter.isascii() else "_" for letter in os.uname().nodename)
            number = int.from_bytes(os.urandom(6), "big")
            self.anonymous_names[identifier] = f"{identifier}_{host}_{os.getpid()}_{number}"
        return self.anonymous_names[identifier]


@dataclass
class Scope:
    """The surroundings of a tag. `file` is that which holds it."""

    launch: Launch
    file: Path
    namespace: str = "/"
    arguments: dict[str, str] = field(default_factory=dict)
    """The args that can be used here, protected: what the file was given, declared or not, and what is declared so far.

    An include that gives all args passes on those that its file has no use for: a file that is included there may."""
    given: Mapping[str, str] = field(default_factory=dict)
    """The args that the file was given, protected."""
    lenient: bool = False
    """True when all of the includer's args were passed on: one that is constant here, or unknown, is no error."""
    declared: set[str] = field(default_factory=set)
    """The args that are declared so far, here or around here. Groups beside each other may have args of one name."""
    everywhere: set[str] = field(default_factory=set)
    """All args of the file, those inside groups too."""
    remaps: tuple[Remap, ...] = ()
    environment: tuple[tuple[str, str], ...] = ()
    private: tuple[Setting, ...] = ()
    """Parameters that every later node gets as its own; names without `~`."""
    anonymous_names: dict[str, str] = field(default_factory=dict)
    """What `anon` has given in this file; each include begins anew."""
    trail: tuple[Place, ...] = ()
    """The includes that led here, outermost first."""
    nesting: tuple[tuple[Path, tuple[tuple[str, str], ...]], ...] = ()
    """The files that are being read, with what each was given."""

    @property
    def packages(self) -> Packages:
        """The lookup of packages, from the file upwards too."""
        return self.launch.packages.starting_at(self.file.parent)

    @property
    def substitution(self) -> Substitution:
        """What `$(...)` means here and now: args that are declared later are not in it."""
        surroundings = Surroundings(self.launch, self.packages, self.anonymous_names)
        return Substitution(surroundings, dict(self.arguments), str(self.file.parent))

    def group(self, namespace: str) -> Scope:
        """A scope inside this one, of the same file."""
        return replace(self, namespace=namespace, arguments=dict(self.arguments), declared=set(self.declared))

    def including(self, file: Path, tag: Tag, given: Mapping[str, str], lenient: bool) -> Scope:
        """The scope of an included file. Raises BadFile for an include without an end."""
        self.launch.count_file(tag)
        here = (file, tuple(sorted(given.items())))
        if here in self.nesting:
            raise tag.error(f"{file} includes itself", "does it need another argument each time, and an `if`?")
        if len(self.nesting) >= DEEPEST_INCLUDE:
            raise tag.error(f"includes are nested deeper than {DEEPEST_INCLUDE}", "does a file include itself?")
        return replace(
            self,
            file=file,
            namespace=tag.namespace(),
            arguments=dict(given),
            given=given,
            lenient=lenient,
            declared=set(),
            everywhere=set(),
            anonymous_names={},
            trail=(*self.trail, tag.place),
            nesting=(*self.nesting, here),
        )

    def environment_with(self, own: tuple[tuple[str, str], ...]) -> tuple[tuple[str, str], ...]:
        """The environment of the scope, and then one's own."""
        return (*self.environment, *own)


def missing_argument(scope: Scope, name: str, tag: Tag) -> BadFile:
    """The error of a required argument that nobody gave."""
    if scope.trail:
        hint = f'give it at the include: <arg name="{name}" value="..."/>'
        error = tag.error(f"the included file requires the argument {name!r}", hint)
    else:
        near = closest(name, [given for given in scope.given if given not in scope.declared])
        slip = f"; was {near}:={scope.given[near]} meant to be that?" if near else ""
        error = tag.error(f"the argument {name!r} is required", f"give {name}:=VALUE{slip}")
    return error
