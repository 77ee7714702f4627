"""Finds the folders of ROS packages, for `$(find NAME)` and `package://NAME/...`.

The order: given names; folders of SLIDECTL_PACKAGE_PATH and ROS_PACKAGE_PATH; upwards from the file that asks and from
the working folder, including the `src` of a workspace; installations of ROS 2 (AMENT_PREFIX_PATH, COLCON_PREFIX_PATH);
last the shipped packages (samples, and counterparts of some packages of ROS). No ROS installation is used beyond that.

What is in source goes before what is installed: it is what its author edits, and nothing is built here.
install_rules.py finds the files of such a package that are installed under other names.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from slidectl import paths
from slidectl.errors import BadFile, UnknownName
from slidectl.input_files import MOST_TEXT, read_bytes

_NAME = re.compile(r"<name\b[^>]*>\s*([^<\s]+)\s*</name>")
_DEEPEST = 8
"""The deepest folder that is searched. Links may lead in a circle."""
_VARIABLES = ("SLIDECTL_PACKAGE_PATH", "ROS_PACKAGE_PATH")
_PREFIXES = ("AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH")
"""Folders of installations; those of colcon may hold a folder for each package."""
_INDEX = "ament_index/resource_index/packages"
"""In the `share` of an installation; it has a file for each package."""
_MOST_LISTED = 1000
"""The most entries of a folder that are looked at, beside a file, above it, or of that index."""
_LEAVE_OUT = ("CATKIN_IGNORE", "AMENT_IGNORE", "COLCON_IGNORE", "rospack_nosubdirs")
_MARKS = ("package.xml", "manifest.xml")
"""Files that make a folder a package; packages from before catkin have the second one."""


class UnknownPackage(UnknownName):
    """No package has that name; the hint lists where it was looked for."""

    def __init__(self, name: str, known: list[str], looked: list[str]) -> None:
        super().__init__("package", name, known)
        self.hint = f"looked in: {'; '.join(looked)}\ngive --package {name}=PATH, or set SLIDECTL_PACKAGE_PATH"


class Packages:
    """A lookup of packages. `named` maps names to folders; `start` is the folder from which to walk upwards."""

    def __init__(self, named: Mapping[str, str | Path] | None = None, start: str | Path | None = None) -> None:
        self.named = {name: _folder(path) for name, path in (named or {}).items()}
        self.starts = (Path(start).absolute(),) if start is not None else ()
        self._found: dict[str, dict[str, str]] = {}
        """Name and folder of the packages below each folder that was searched."""
        self.own: dict[str, Path] = {}
        """The user's packages that are used instead of shipped ones; shared with the copies of `starting_at`."""

    def starting_at(self, folder: str | Path) -> Packages:
        """The same lookup, which walks upwards from `folder` first, and then from the present folders."""
        other = Packages(self.named)
        other.starts = tuple(dict.fromkeys((Path(folder).absolute(), *self.starts)))
        other._found, other.own = self._found, self.own
        return other

    def find(self, name: str) -> Path:
        """The folder of the package, absolute.

        Raises UnknownPackage: not found; the hint lists where it was looked for.
        """
        found = self.candidates(name)
        if found:
            self.note_own(name, found[0])
            return found[0]
        raise UnknownPackage(name, [*self.names(), *self._shipped()], self._searched_places())

    def learned(self) -> list[dict[str, Any]]:
        """What was found, as JSON values, for `learn` in another process."""
        return [self._found, {name: str(path) for name, path in self.own.items()}]

    def learn(self, learned: list[dict[str, Any]]) -> None:
        """Add what another process has found."""
        found, own = learned
        self._found.update(found)
        self.own.update({name: Path(path) for name, path in own.items()})

    def note_own(self, name: str, folder: Path) -> None:
        """Record that a folder is used as the package if a shipped package has the same name."""
        if str(folder) != self._shipped().get(name, str(folder)):
            self.own[name] = folder

    def candidates(self, name: str) -> list[Path]:
        """All folders that may be the package, in order; `find` takes the first.

        It returns a list, because an interrupt is lost in a generator that is closed before its end.
        """
        places: list[Mapping[str, str | Path]] = [self.named, *map(self._packages_below, _entries(_VARIABLES))]
        found = [Path(packages[name]) for packages in places if name in packages]
        found += [folder for start in self.starts for folder in self._above(name, start)]
        if not found:
            above = (folder for start in self.starts for folder in (start, *start.parents))
            beside = map(self._packages_in, dict.fromkeys(above))
            found = [Path(packages[name]) for packages in beside if name in packages][:1]
        found += self._installed(name)
        shipped = self._shipped().get(name)
        return found if shipped is None else [*found, Path(shipped)]

    def names(self) -> list[str]:
        """The names of all packages that are found without walking upwards."""
        below = (name for folder in _entries(_VARIABLES) for name in self._packages_below(folder))
        installed = (entry.name for prefix in _entries(_PREFIXES) for entry in _listed(prefix / "share" / _INDEX))
        return sorted({*self.named, *below, *installed})

    def _packages_below(self, folder: Path) -> dict[str, str]:
        """Name and folder of the packages below `folder`. The first one of a name counts."""
        if str(folder) not in self._found:
            found = self._found[str(folder)] = {}
            for package in _crawl(folder):
                found.setdefault(package_name(package), str(package))
        return self._found[str(folder)]

    def _packages_in(self, folder: Path) -> dict[str, str]:
        """Name and folder of the packages right in `folder`: the folder may have another name than its package."""
        key = str(folder / "*")
        if key not in self._found:
            found = self._found[key] = {}
            for inside in _listed(folder):
                if _is_package(inside):  # a file has none
                    found.setdefault(package_name(inside), str(inside))
        return self._found[key]

    def _installed(self, name: str) -> list[Path]:
        """The share folders of the package in installations of ROS 2."""
        if not name or "/" in name:
            return []
        shares = [share for prefix in _entries(_PREFIXES) for share in (prefix / "share", prefix / name / "share")]
        return [share / name for share in shares if is_file(share / _INDEX / name) or _is_package(share / name)]

    def _shipped(self) -> dict[str, str]:
        return self._packages_below(paths.share("launch"))

    def _above(self, name: str, start: Path) -> Iterator[Path]:
        """Folders at or above `start` that are the package, and packages beside these folders."""
        for folder in (start, *start.parents):
            if folder.name == name or (_is_package(folder) and package_name(folder) == name):
                yield folder
            for beside in (folder / name, folder / "src" / name):
                if _is_package(beside):
                    yield beside

    def _searched_places(self) -> list[str]:
        named = (f"--package {name}" for name in self.named)
        variables, prefixes = (
            [f"{variable}={value}" for variable in group if (value := os.environ.get(variable))]
            for group in (_VARIABLES, _PREFIXES)
        )
        above = (f"{start} and the folders above it" for start in self.starts)
        return [*named, *variables, *above, *prefixes, "the packages shipped with slidectl"]


def package_name(folder: Path) -> str:
    """The `<name>` of a folder's package.xml, else the folder's own name."""
    try:
        match = _NAME.search(read_bytes(folder / "package.xml", MOST_TEXT).decode("utf-8", "replace"))
    except BadFile:
        match = None
    return match.group(1) if match else folder.name


def package_of(file: Path) -> Path | None:
    """The folder of the package that a file is in, by its path as written; None when it is in none."""
    return next((folder for folder in file.absolute().parents if _is_package(folder)), None)


def _entries(variables: Iterable[str]) -> list[Path]:
    """The folders that environment variables list."""
    entries = [entry for variable in variables for entry in os.environ.get(variable, "").split(os.pathsep)]
    return list(dict.fromkeys(_folder(entry) for entry in entries if entry))


def _listed(folder: Path) -> list[Path]:
    """What is in the folder, by name; nothing when it cannot be read."""
    try:
        with os.scandir(folder) as there:
            return sorted(Path(entry.path) for entry in islice(there, _MOST_LISTED))
    except OSError:
        return []


def _folder(path: str | Path) -> Path:
    return Path(os.path.expanduser(path)).absolute()


def is_file(path: Path) -> bool:
    """True when a file exists and is accessible. No path raises an error."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # a folder without access, a path that is too long, or a null character
        return False


def shown(path: str | Path) -> str:
    """The name of a file in messages: relative when it is below the working folder."""
    absolute = Path(os.path.abspath(path))
    try:
        return str(absolute.relative_to(Path.cwd()))
    except (ValueError, OSError):
        return str(absolute)


def _is_package(folder: Path) -> bool:
    return any(is_file(folder / mark) for mark in _MARKS)


def _crawl(top: Path) -> Iterator[Path]:
    """The package folders below `top`; as in rospack, folders inside a package are not searched."""
    for folder, names, files in os.walk(top, followlinks=True):
        depth = len(Path(folder).relative_to(top).parts)
        if any(mark in files for mark in _MARKS):
            yield Path(folder)
            names.clear()
        elif depth >= _DEEPEST or any(mark in files for mark in _LEAVE_OUT):
            names.clear()
        names[:] = sorted(name for name in names if not name.startswith("."))
