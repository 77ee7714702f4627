"""Modules that users' code imports from users' files. Their source is recorded for a journal and reused in a replay.

Modules of Python, slidectl and installed packages do not count, except those of a package that a user has named.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Callable, Iterable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import NamedTuple

from slidectl.errors import BadFile
from slidectl.input_files import MOST_TEXT, read_bytes


class UserModule(NamedTuple):
    """A module as it was when it was imported."""

    name: str
    path: str
    source: str
    """Bytes that are not UTF-8 are decoded as surrogates."""
    is_package: bool


_FOLDERS = [*(sysconfig.get_path(name) for name in ("stdlib", "platstdlib")), str(Path(__file__).parent.parent)]
_OF_PYTHON = tuple(folder + os.sep for folder in _FOLDERS)
_INSTALLED = ("/site-packages/", "/dist-packages/")

imported: dict[str, UserModule] = {}
"""The users' modules that this process has imported, by name."""
listeners: list[Callable[[UserModule], None]] = []
"""Functions that are called with each imported module."""
given: dict[str, UserModule] = {}
"""Modules, by name, that are imported instead of the present content of their files."""
_files: set[str] = set()
"""Names of the modules of users' files."""
_packages: set[str] = set()


def watch(name: str, is_file: bool) -> None:
    """Treat a module, or with `is_file` false its whole package, as a user's. Call this before the module runs."""
    if is_file:
        _files.add(name)
    elif _top(name) != _top(__name__):
        _packages.add(_top(name))
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)


def give(modules: Iterable[UserModule]) -> None:
    """Replace `given`, and discard the users' modules imported so far.

    An installed module stays, whatever a journal calls its modules: this process runs on it.
    """
    given.clear()
    given.update((module.name, module) for module in modules)
    for name in (*imported, *(name for name in given if not _is_installed(sys.modules.get(name)))):
        sys.modules.pop(name, None)
    imported.clear()


def _is_installed(module: ModuleType | None) -> bool:
    """True for a module of Python, slidectl or an installed package."""
    folders = getattr(module, "__path__", None) or ()
    path = str(getattr(module, "__file__", None) or next(iter(folders), ""))
    return not path or _is_place_of_installed(path)


def _is_place_of_installed(path: str) -> bool:
    return path.startswith(_OF_PYTHON) or any(place in path for place in _INSTALLED)


def _top(name: str) -> str:
    return name.partition(".")[0]


def _is_of_a_user(name: str) -> bool:
    return name in _files or name in imported or _top(name) in _packages


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not _is_of_a_user(fullname) and not _is_of_a_user(_importer()):
            return None
        module, found = given.get(fullname), None
        if module is None:
            others = (finder for finder in sys.meta_path if finder is not self)
            found = next((spec for one in others if (spec := one.find_spec(fullname, path, target)) is not None), None)
            module = None if found is None else _read(found)
        if module is None:
            return found
        imported[fullname] = module
        for tell in listeners:
            tell(module)
        if found is not None and not found.has_location:  # a package without a file
            return found
        folder = [str(Path(module.path).parent)] if module.is_package else None
        return spec_from_file_location(fullname, module.path, loader=_Loader(module), submodule_search_locations=folder)


_FINDER = _Finder()


def _importer() -> str:
    """The name of the module whose code is importing now."""
    frame: FrameType | None = sys._getframe(2)
    while frame is not None and _top(name := str(frame.f_globals.get("__name__"))) == "importlib":
        frame = frame.f_back
    return name


def _read(spec: ModuleSpec) -> UserModule | None:
    """The module with its source; None if it is not a user's, or not Python. A package without a file has no source."""
    folders = spec.submodule_search_locations
    path = str(spec.origin) if spec.has_location else f"{next(iter(folders or ()), '')}/__init__.py"
    if not path.endswith(".py") or (_is_place_of_installed(path) and _top(spec.name) not in _packages):
        return None
    if not spec.has_location:
        return None if folders is None else UserModule(spec.name, path, "", True)
    try:
        source = read_bytes(path, MOST_TEXT).decode("utf-8", "surrogateescape")
    except BadFile as error:
        raise ImportError(str(error), name=spec.name, path=path) from None
    return UserModule(spec.name, path, source, folders is not None)


class _Loader(SourceFileLoader):
    """Loads from the recorded source, not from Python's cache, which compares only size and whole seconds."""

    def __init__(self, module: UserModule) -> None:
        super().__init__(module.name, module.path)
        self._module = module

    def get_source(self, fullname: str) -> str:  # noqa: ARG002
        return self._module.source

    def is_package(self, fullname: str) -> bool:  # noqa: ARG002
        return self._module.is_package

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002
        source = self._module.source.encode("utf-8", "surrogateescape")
        code: CodeType = compile(source, self._module.path, "exec", dont_inherit=True)
        return code
