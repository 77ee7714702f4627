"""Parts that installed packages add to slidectl by entry points: commands, gateways, sensors, steps and others.

One rule holds for all of them. A name belongs to slidectl if slidectl has it, and to nobody if two packages claim it:
the parts of the packages are refused then. No code of a package runs before one of its parts is used, and a part that
fails names its package. The metadata of the installed packages takes milliseconds to read, so it is read only
when a name is not among those of slidectl, or when all names are to be listed.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple

from slidectl.errors import Refused, SlidectlError

_GROUP = "slidectl."


class Part(NamedTuple):
    """An entry point of an installed package."""

    group: str
    name: str
    value: str
    """`module:attribute`."""
    package: str
    version: str

    @property
    def module(self) -> str:
        """The module of the value."""
        return self.value.partition(":")[0].strip()

    @property
    def attr(self) -> str:
        """The attribute of the value, without the extras that may follow it."""
        return self.value.partition(":")[2].partition("[")[0].strip()

    @property
    def owner(self) -> str:
        """The package with its version."""
        return f"{self.package} {self.version}".strip()

    @property
    def removal(self) -> str:
        """The command line that removes the package."""
        return f"pip uninstall {self.package}"

    @property
    def summary(self) -> str:
        """The package's line about itself; empty when it has none."""
        from importlib.metadata import PackageNotFoundError, metadata

        try:
            text = metadata(self.package)
            return " ".join(text["Summary"].split()) if "Summary" in text else ""
        except (PackageNotFoundError, ValueError):
            return ""


# --- what can be wrong with a part ------------------------------------------------------------------------------------


class PartError(Refused):
    """A part of an installed package cannot be used. By default the hint says how to remove the package."""

    def __init__(self, part: Part, kind: str, trouble: str, hint: str | None = None) -> None:
        super().__init__(f"the {kind} {part.name!r} of {part.owner} {trouble}", hint or part.removal)
        self.part = part


class NameOfSlidectl(PartError):
    """A package claims a name that slidectl has."""

    def __init__(self, part: Part, kind: str) -> None:
        super().__init__(part, kind, "is not used: slidectl has one of that name")


class BadPartName(PartError):
    """A package claims a name that no part of this kind can have."""

    def __init__(self, part: Part, kind: str, why: str) -> None:
        super().__init__(part, kind, f"is not used: {why}")


class NameClaimedTwice(PartError):
    """Several packages claim a name."""

    def __init__(self, parts: Sequence[Part], kind: str) -> None:
        owners = " and ".join(other.owner for other in parts[1:])
        hint = " or ".join(dict.fromkeys(part.removal for part in parts))
        super().__init__(parts[0], kind, f"is not used: the name is also claimed by {owners}", hint)


class BrokenPart(PartError):
    """A part cannot be imported."""


class WrongPart(PartError):
    """An entry point names an object that is not a part of its kind."""

    def __init__(self, part: Part, kind: str, expected: str) -> None:
        super().__init__(part, kind, f"cannot be used: {part.value} is not a {expected}")


class PartFailed(PartError):
    """The code of a part raised an exception while it ran."""


class BadMetadata(Refused):
    """The entry points of an installed package cannot be read."""

    def __init__(self, package: str, cause: str) -> None:
        super().__init__(f"the entry points of {package} cannot be read: {cause}", f"pip uninstall {package}")


# --- the registry of one kind -----------------------------------------------------------------------------------------


class Registry:
    """The parts of one kind that installed packages add, by name."""

    def __init__(
        self,
        group: str,
        kind: str,
        ours: Callable[[], Container[str]],
        expected: Callable[[Any], str] = lambda _: "",
        bad_name: Callable[[str], str] = lambda name: "" if name.split() == [name] else "a name is one word",
    ) -> None:
        """`group` is that of the entry points, `kind` what a part is called.

        `ours` returns the names that slidectl has. `expected` returns an empty text for an object that is such a part,
        else what it should have been. `bad_name` returns why no part can have a name, or an empty text.
        """
        self.group = group
        self.kind = kind
        self._ours = ours
        self._expected = expected
        self._bad_name = bad_name

    def parts(self) -> dict[str, Part]:
        """The parts that can be used, by name, in alphabetical order."""
        return {name: parts[0] for name, parts in self._claimed().items() if self._refusal(parts) is None}

    def refused(self) -> list[PartError]:
        """The parts that are not used because of their names, with the reasons."""
        return [refusal for parts in self._claimed().values() if (refusal := self._refusal(parts)) is not None]

    def find(self, name: str) -> Part | None:
        """The part of that name, or None. Do not ask for a name of slidectl's own. Raises PartError: it is refused."""
        parts = self._claimed().get(name)
        if parts is None:
            return None
        if (refusal := self._refusal(parts)) is not None:
            raise refusal
        return parts[0]

    def load(self, part: Part) -> Any:
        """Import a part.

        Raises:
            BrokenPart: its module fails or has no such attribute. WrongPart: it is not of this kind.
        """
        try:
            found: Any = importlib.import_module(part.module)
            if part.attr:
                found = attrgetter(part.attr)(found)
        except (Exception, SystemExit) as failure:
            raise BrokenPart(part, self.kind, f"cannot be loaded: {cause_of(failure)}") from failure
        if expected := self._expected(found):
            raise WrongPart(part, self.kind, expected)
        return found

    @contextmanager
    def running(self, part: Part, *passed: type[BaseException]) -> Iterator[None]:
        """Context for code of a part. Exceptions become PartFailed, except errors for users and those of `passed`."""
        try:
            yield
        except (Exception, SystemExit) as failure:
            if isinstance(failure, (SlidectlError, *passed)):
                raise
            hint = f"this is a bug in {part.package}; -vv shows the traceback"
            raise PartFailed(part, self.kind, f"failed: {cause_of(failure)}", hint) from failure

    def _claimed(self) -> dict[str, list[Part]]:
        return _installed()[0].get(self.group, {})

    def _refusal(self, parts: Sequence[Part]) -> PartError | None:
        part = parts[0]
        if part.name in self._ours():
            return NameOfSlidectl(part, self.kind)
        if why := self._bad_name(part.name):
            return BadPartName(part, self.kind, why)
        return NameClaimedTwice(parts, self.kind) if len(parts) > 1 else None


def unread() -> list[BadMetadata]:
    """The installed packages whose entry points cannot be read."""
    return _installed()[1]


def unknown_groups(known: Container[str]) -> list[Part]:
    """The parts whose group begins with `slidectl.` and is none of `known`: nobody uses them."""
    return [
        part
        for group, names in _installed()[0].items()
        if group not in known
        for parts in names.values()
        for part in parts
    ]


@cache
def _installed() -> tuple[dict[str, dict[str, list[Part]]], list[BadMetadata]]:
    """The parts by group and name, and the packages that cannot be read.

    Each file of entry points is read by itself: `importlib.metadata.entry_points` fails for all packages where one
    has a broken file, and to import and call it takes 30 ms, though few machines have such a package.
    """
    parts: dict[str, list[Part]] = {}
    unreadable: dict[str, BadMetadata] = {}
    seen: set[str] = set()
    for folder in _metadata_folders():
        # Of two versions the first on the path counts, as for an import, also where only the second has parts.
        name = os.path.basename(folder).partition("-")[0].lower().replace("_", "-")
        if name in seen:
            continue
        seen.add(name)
        points_file = os.path.join(folder, "entry_points.txt")
        if not os.path.isfile(points_file):  # most packages have none; to open a pipe would wait
            continue
        with suppress(OSError), open(points_file, "rb") as file:
            if f"[{_GROUP}".encode() not in file.read():
                continue
            from importlib.metadata import Distribution
            from pathlib import Path

            package = folder
            try:
                found = Distribution.at(Path(folder))
                package = found.name or folder
                points = [point for point in found.entry_points if point.group.startswith(_GROUP)]
                parts[package] = [Part(one.group, one.name, one.value, package, found.version or "") for one in points]
            except Exception as error:  # the files of a package may be broken in any way
                unreadable[package] = BadMetadata(package, f"{type(error).__name__}: {error}")
    by_name: dict[str, dict[str, list[Part]]] = {}
    for part in sorted(part for some in parts.values() for part in some):
        by_name.setdefault(part.group, {}).setdefault(part.name, []).append(part)
    return by_name, list(unreadable.values())


def _metadata_folders() -> Iterator[str]:
    """The folders with the metadata of installed packages, in the order of `sys.path`."""
    for place in sys.path:
        with suppress(OSError):
            names = sorted(os.listdir(place or "."))
            yield from (os.path.join(place, name) for name in names if name.endswith((".dist-info", ".egg-info")))


# --- code of packages -------------------------------------------------------------------------------------------------


def cause_of(failure: BaseException) -> str:
    """An exception as one line: its class, text, and the file and line of the code that raised it."""
    text = " ".join(f"{type(failure).__name__}: {failure}".split()).removesuffix(":")
    if isinstance(failure, SyntaxError):  # its text has the place
        return text
    trace, where = failure.__traceback__, ""
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if not file.startswith("<") and file not in (__file__, importlib.__file__):
            where = f" ({file}:{trace.tb_lineno})"
        trace = trace.tb_next
    return text + where
