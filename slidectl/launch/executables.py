"""The program that a node's `pkg` and `type` name, where rosrun would find it.

First where a build puts executables (`PREFIX/lib/PACKAGE`), then anywhere in the package. Nothing is run here.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from slidectl.description.packages import Packages, UnknownPackage, is_file
from slidectl.errors import NotThere, closest, listing
from slidectl.launch.plan import Node

_DEEPEST = 8
_ROSPY, _ROSCPP = "rospy", "roscpp"
_FILES = {_ROSPY: ("rospy/__init__.py", "rospy.py"), _ROSCPP: ("libroscpp.so",)}
_MOST_BYTES = 1 << 26
_SKIP = "--skip-unknown leaves such nodes out"
_LIKELY = ("scripts", "nodes", "bin", "src")


class NeedsRos(NotThere):
    """A program that is there, and needs ROS 1, which is not."""


def find(node: Node, packages: Packages) -> Path:
    """The executable of a node.

    Raises:
        NotThere: no such package, no such program in it, or one that may not be executed. NeedsRos.
    """
    try:
        folders = list(packages.candidates(node.package)) or [packages.find(node.package)]
    except UnknownPackage as error:
        hint = f"{_similar(node)}; {_SKIP}\n{error.hint}"
        message = f"node {node.full_name} ({node.kind}): {error.message}"
        raise node.place.absence(message, hint, f"package {node.package}") from None
    found = [path for folder in folders for path in _named(node, folder)]
    for path in found:
        if os.access(path, os.X_OK):
            _check_ros(node, path)
            return path
    raise node.place.absence(*_why_not(node, folders, found), f"program {node.kind}")


def _check_ros(node: Node, program: Path) -> None:
    """Raise NotThere when the program needs a library of ROS 1 that is not on this machine."""
    if not (library := _ros_library(program)):
        return
    environment = {**os.environ, **dict(node.environment)}
    if any(is_file(folder / file) for folder in _library_folders(program, environment) for file in _FILES[library]):
        return
    what = "is linked with roscpp" if library == _ROSCPP else "imports rospy"
    message = f"node {node.full_name} ({node.kind}): {program.name} {what}, which needs ROS 1 and its master"
    hint = f"neither is here; a script may use slidectl.client instead of rospy\n{_SKIP}"
    raise NeedsRos(message, node.place.file, node.place.line, hint, f"{library} for {node.kind}")


def _ros_library(program: Path) -> str:
    """`rospy` for a script that cannot do without it, `roscpp` for what was compiled with it; else nothing."""
    try:
        with program.open("rb") as file:
            content = file.read(_MOST_BYTES)
    except OSError:  # which is said when it is run
        return ""
    if content.startswith(b"\x7fELF"):
        return _ROSCPP if b"libroscpp.so" in content else ""
    if b"rospy" not in content or (program.suffix != ".py" and b"python" not in content.partition(b"\n")[0]):
        return ""
    return _ROSPY if _imports(content, _ROSPY) else ""


def _imports(script: bytes, module: str) -> bool:
    """Whether a script imports the module as it starts. What it imports in a `try` it can do without."""
    import ast

    try:
        statements = ast.parse(script).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # of Python 2, most often
        return re.search(rb"^(import|from)\s+" + module.encode() + rb"\b", script, re.MULTILINE) is not None
    for statement in statements:
        names = [alias.name for alias in statement.names] if isinstance(statement, ast.Import) else []
        names += [statement.module or ""] if isinstance(statement, ast.ImportFrom) and not statement.level else []
        if any(name.partition(".")[0] == module for name in names):
            return True
    return False


def _library_folders(program: Path, environment: Mapping[str, str]) -> Iterator[Path]:
    """Where a program finds its libraries: what the environment says, beside a script, and where ROS 1 is installed."""
    for variable in ("PYTHONPATH", "LD_LIBRARY_PATH"):
        yield from (Path(entry) for entry in environment.get(variable, "").split(os.pathsep) if entry)
    yield program.parent
    yield from Path("/opt/ros").glob("*/lib/python*/dist-packages")
    yield from Path("/opt/ros").glob("*/lib")
    yield from (Path(entry) for entry in sys.path if entry)


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
        f"programs in {folders[0]}: {listing(known)}\n{_compiled(node, folders)}{_SKIP}",
    )


def _compiled(node: Node, folders: list[Path]) -> str:
    """A line about a program that a build of the package would make."""
    built = re.compile(rf"add_executable\(\s*{re.escape(node.type)}\s")
    for folder in folders:
        with suppress(OSError):
            if built.search((folder / "CMakeLists.txt").read_text("utf-8", "replace")):
                return "it is compiled from C++ (CMakeLists.txt), and with roscpp it needs ROS 1 and its master\n"
    return ""
