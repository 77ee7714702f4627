"""Finds and reads launch files: `FILE`, `PACKAGE FILE`, the name of a shipped one, or `-` for standard input.

Nothing is parsed here.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from slidectl import input_files, paths
from slidectl.description.models import read_file
from slidectl.description.packages import Packages, is_file, shown
from slidectl.description.xml_tree import MOST_BYTES
from slidectl.errors import BadFile, UnknownName, UsageError, listing

SUFFIX = ".launch"


@dataclass(frozen=True)
class LaunchFile:
    """The raw text of a launch file; `shown` is its name in messages."""

    path: Path
    text: bytes
    shown: str


def find(words: Sequence[str], packages: Packages) -> list[LaunchFile]:
    """Find the launch files that the words of a command line mean.

    Raises UsageError, UnknownName, UnknownPackage: no such file. BadFile: a file that cannot be read.
    """
    if not words:
        raise UsageError("which launch file?", "slidectl launch FILE, or PACKAGE FILE, or the name of a shipped one")
    if list(words).count("-") > 1:
        raise UsageError("standard input ('-') can be read only once")
    first, *more = words
    _check_joined(words, packages)
    path = _in_package(first, more[0], packages) if more and "-" not in (first, more[0]) else None
    if path is not None:
        return [_source(path), *(_given(word, packages) for word in more[1:])]
    if len(words) == 2 and not is_file(Path(first)) and first != "-":
        return [_source(find_in_package(first, more[0], packages, "launch file"))]
    return [_given(word, packages) for word in words]


def _check_joined(words: Sequence[str], packages: Packages) -> None:
    """Raise UsageError when the first words are the name of a package whose underscores became blanks."""
    if len(words) < 3 or packages.candidates(words[0]) or is_file(Path(words[0])) or words[0] in shipped():
        return
    for count in range(len(words) - 1, 1, -1):
        name = "_".join(words[:count])
        if packages.candidates(name):
            rest = " ".join(words[count:])
            raise UsageError(f"no package {words[0]!r}", f"did you mean the package {name}? type: {name} {rest}")


def find_in_package(package: str, file: str, packages: Packages, kind: str = "file") -> Path:
    """Find a file by its name anywhere in a package; `kind` is the word for it in messages.

    Raises UnknownPackage, UnknownName: no such package or file. UsageError: the package has several of that name.
    """
    path = _in_package(package, file, packages)
    if path is not None:
        return path
    folder = packages.find(package)
    alike = [found.name for found in below(folder) if found.suffix == Path(file).suffix]
    raise UnknownName(kind, file, sorted(set(alike)), f"in the package {package} ({shown(folder)})")


def _given(word: str, packages: Packages) -> LaunchFile:
    if word == "-":
        return LaunchFile(Path.cwd() / "<stdin>", input_files.read_stdin(MOST_BYTES), "<stdin>")
    return _source(_single(word, packages))


def _source(path: Path) -> LaunchFile:
    absolute = Path(os.path.abspath(path))
    return LaunchFile(absolute, read_file(absolute, pipes=True), shown(absolute))


def _in_package(package: str, file: str, packages: Packages) -> Path | None:
    """The file anywhere in the package; None when there is no such package or file."""
    for folder in packages.candidates(package) if "/" not in package else ():
        directs = (folder / file, folder / "launch" / file) if "/" in file else ()
        found = [path for path in directs if is_file(path)][:1] or [p for p in below(folder) if p.name == file]
        if len(found) > 1:
            places = ", ".join(str(path.relative_to(folder)) for path in found)
            raise UsageError(f"package {package} has several {file}: {places}", "give the path inside the package")
        if found:
            packages.note_own(package, folder)
            return found[0]
    return None


def _single(word: str, packages: Packages) -> Path:
    """The path for one word: a file, else a shipped launch file, else the only launch file of a shipped package."""
    path = Path(os.path.expanduser(word))
    if os.path.exists(path) and not os.path.isdir(path):
        return path
    known = shipped()
    if word in known:
        return known[word]
    if packages.candidates(word):
        inside = sorted(path.name for path in below(packages.find(word)) if path.suffix == SUFFIX)
        hint = f"launch files: {listing(inside)}\nslidectl launch {word} {inside[0] if inside else 'FILE'}"
        raise UsageError(f"{word!r} is a package: which launch file of it?", hint)
    if os.path.isdir(path):
        inside = sorted(file.name for file in path.glob(f"*{SUFFIX}"))
        raise BadFile("a folder, not a launch file", word, hint=f"launch files in it: {listing(inside) or 'none'}")
    package, _, file = word.partition("/")
    if file and (found := _in_package(package, file.rpartition("/")[2], packages)) is not None:
        raise BadFile("no such launch file", word, hint=f"a file of a package is written: {package} {found.name}")
    if (given := re.fullmatch(r"([A-Za-z]\w*)=(.*)", word)) is not None:
        raise UsageError(f"no launch file {word!r}", f"an argument is written {given[1]}:={given[2]}")
    if "/" in word or word.endswith((SUFFIX, ".xml")):
        raise BadFile("no such launch file", word, hint=f"shipped ones: {', '.join(sorted(known))}")
    raise UnknownName("shipped launch file", word, sorted(known), "(and no file of that name here)")


def shipped() -> dict[str, Path]:
    """The shipped launch files by file name, or by package name if the package has only one."""
    found: dict[str, Path] = {}
    top = paths.share("launch")
    for package in sorted(top.iterdir()) if top.is_dir() else []:
        files = sorted(package.glob(f"launch/*{SUFFIX}"))
        if len(files) == 1:
            found[package.name] = files[0]
        found.update((file.stem, file) for file in files)
    return found


def below(folder: Path) -> list[Path]:
    """All files in a folder, except in folders that begin with a dot."""
    found = []
    for here, folders, files in os.walk(folder, followlinks=True):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if len(Path(here).relative_to(folder).parts) > 8:
            folders.clear()
        found += [Path(here) / name for name in sorted(files)]
    return found
