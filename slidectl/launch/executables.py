"""The program that a node's `pkg` and `type` name, where rosrun would find it.

First where a build puts executables (`PREFIX/lib/PACKAGE`), then anywhere in the package. Nothing is run here.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from slidectl.description.packages import Packages, UnknownPackage, is_file
from slidectl.errors import closest, listing
from slidectl.launch.plan import Node

_DEEPEST = 8
_LIKELY = ("scripts", "nodes", "bin", "src")


def find(node: Node, packages: Packages) -> Path:
    """The executable of a node.

    Raises:
        NotThere: no such package, no such program in it, or one that may not be executed.
    """
    try:
        folders = list(packages.candidates(node.package)) or [packages.find(node.package)]
    except UnknownPackage as error:
        hint = f"{_similar(node)}; --skip-unknown leaves such nodes out\n{error.hint}"
        message = f"node {node.full_name} ({node.kind}): {error.message}"
        raise node.place.absence(message, hint, f"package {node.package}") from None
    found = [path for folder in folders for path in _named(node, folder)]
    for path in found:
        if os.access(path, os.X_OK):
            return path
    raise node.place.absence(*_why_not(node, folders, found), f"program {node.kind}")


def _similar(node: Node) -> str:
    """The counterpart that may have been meant, where the package is none of the user's."""
    from slidectl.launch.kinds import counterparts

    known = [f"{package}/{kind}" for package, kind in counterparts()]
    near = closest(node.kind, known)
    return f"did you mean {near!r}, which has a counterpart here?" if near else "it has no counterpart here either"


def _named(node: Node, folder: Path) -> Iterator[Path]:
    """The files that may be meant, the likeliest first."""
    prefixes = [folder.parent.parent] if folder.parent.name == "share" else []
    prefixes += [Path(prefix) for prefix in os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep) if prefix]
    built = [prefix / "lib" / node.package / node.type for prefix in prefixes]
    likely = [folder / below / node.type for below in (*_LIKELY, "")]
    yield from (path for path in [*built, *likely] if is_file(path))
    if "/" not in node.type:
        yield from (path for path in _all_files(folder) if path.name == node.type)


def _all_files(folder: Path) -> Iterator[Path]:
    for here, folders, files in os.walk(folder, followlinks=True):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if len(Path(here).relative_to(folder).parts) >= _DEEPEST:
            folders.clear()
        yield from (Path(here) / name for name in sorted(files))


def _why_not(node: Node, folders: list[Path], found: list[Path]) -> tuple[str, str]:
    what = f"node {node.full_name} ({node.kind})"
    if found:
        return f"{what}: {found[0]} is not executable", f"chmod +x '{found[0]}'"
    known = sorted({path.name for folder in folders for path in _all_files(folder) if os.access(path, os.X_OK)})
    near = closest(node.type, known)
    suggestion = f" Did you mean {near!r}?" if near else ""
    return (
        f"{what}: no program {node.type!r} in the package, and no counterpart here.{suggestion}",
        f"programs in {folders[0]}: {listing(known)}\n--skip-unknown leaves such nodes out",
    )
