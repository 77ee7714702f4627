"""Modules that users' code imports from users' files, in one world. A host may record and replace their source.

Modules of Python, slidectl and installed packages do not count, except those of a package that a user has named. Each
world imports users' files for itself: see UserCode.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any, NamedTuple

from slidectl.errors import BadFile
from slidectl.input_files import MOST_TEXT, read_bytes


class UserModule(NamedTuple):
    """A module as it was when it was imported."""

    name: str
    path: str
    source: str
    """Bytes that are not UTF-8 are decoded as surrogates."""
    is_package: bool


class CodeLimit(AbstractContextManager[None]):
    """Context in which users' code runs. This one sets no limit; another may raise user_classes.CodeTimeout in it."""

    def __init__(self) -> None:
        self.on_end: list[Callable[[], None]] = []
        """Called after code was ended by the limit."""

    def __exit__(self, *_: Any) -> None:
        """Leave users' code."""

    def close(self) -> None:
        """End what watches the code; entering the context again begins anew."""


class CodeHost:
    """What users' code needs from outside of the process. This one reads the disk and sets no limit."""

    def __init__(self, limit: CodeLimit | None = None) -> None:
        self.limit = limit or CodeLimit()
        """The context in which users' code runs. It does not change."""
        self.given: Mapping[str, UserModule] = {}
        """Modules, by name, that are imported instead of the present content of their files."""

    def read(self, what: str, look: Callable[[], Any]) -> Any:  # noqa: ARG002 - for those that record and answer
        """Read from the disk: call `look` and return its result, JSON values. `look` never raises.

        `what` describes what is read. Lists and tuples are the same to the caller.
        """
        return look()

    def imported(self, module: UserModule) -> None:
        """Take note of a user's module that the world has imported."""


_FOLDERS = [*(sysconfig.get_path(name) for name in ("stdlib", "platstdlib")), str(Path(__file__).parent.parent)]
_OF_PYTHON = tuple(folder + os.sep for folder in _FOLDERS)
_INSTALLED = ("/site-packages/", "/dist-packages/")


class UserCode:
    """The code of users in one world: its modules, the limit on it, and the classes that the limit has ended.

    Python has one table of modules for the process. While code of one world runs, those of its users' modules are in
    it; the others are kept by their worlds, so that no world gets a module of another. Modules of installed packages,
    and those that a script imports by itself, are the same for all worlds.
    """

    def __init__(self, host: CodeHost | None = None) -> None:
        self.host = host or CodeHost()
        self.limit = self.host.limit
        self.modules: dict[str, UserModule] = {}
        """The users' modules that the world has imported, by name."""
        self.cut_off: dict[type, str] = {}
        """Users' classes whose code the limit has ended, with the error text. Their hooks are not called any more: each
        call could hold the world as long again. A reload makes another class."""
        self._files: set[str] = set()
        """Names of the modules of users' files."""
        self._packages: set[str] = set()
        self._own: set[str] = set()
        """Names of the modules that this world does not share."""
        self._kept: dict[str, ModuleType] = {}
        """The world's own modules while code of another world runs."""
        self._replaced: dict[str, ModuleType] = {}
        """The script's modules that `host.given` replaces while code of this world runs."""

    def activate(self) -> None:
        """Put the world's modules into Python's table. Call this before code of the world runs."""
        global active
        if active is self:
            return
        active._leave()
        active = self
        # An installed module stays, whatever a journal calls its modules: this process runs on it.
        replaced = [name for name in self.host.given if not _is_installed(sys.modules.get(name))]
        self._replaced = {name: sys.modules.pop(name) for name in replaced}
        sys.modules.update(self._kept)

    def _leave(self) -> None:
        self._kept = {name: sys.modules.pop(name) for name in self._own if name in sys.modules}
        sys.modules.update(self._replaced)
        self._replaced = {}

    def watch(self, name: str, is_file: bool) -> None:
        """Treat a module, or with `is_file` false its whole package, as a user's. Call this before the module runs."""
        if is_file:
            self._files.add(name)
            self._own.add(name)
        elif _top(name) != _top(__name__):
            self._packages.add(_top(name))
            for module in _installed.values():  # another world may have imported it
                if _top(module.name) == _top(name) and module.name not in self.modules:
                    self._note(module)
        if _FINDER not in sys.meta_path:
            sys.meta_path.insert(0, _FINDER)

    def is_of_a_user(self, name: str) -> bool:
        """True for a module of that name that is a user's in this world."""
        return name in self._files or name in self.modules or _top(name) in self._packages

    def find(self, name: str, found: Callable[[], ModuleSpec | None]) -> ModuleSpec | None:
        """The spec of a user's module; `found` gives the one that Python finds."""
        module, spec = self.host.given.get(name), None
        if module is not None:
            self._own.add(name)
        else:
            spec = found()
            module = None if spec is None else self._read(spec)
            if module is None:
                return spec
            if _is_place_of_installed(module.path):
                _installed[name] = module
            else:
                self._own.add(name)
        self._note(module)
        if spec is not None and not spec.has_location:  # a package without a file
            return spec
        folder = [str(Path(module.path).parent)] if module.is_package else None
        return spec_from_file_location(name, module.path, loader=_Loader(module), submodule_search_locations=folder)

    def _note(self, module: UserModule) -> None:
        self.modules[module.name] = module
        self.host.imported(module)

    def _read(self, spec: ModuleSpec) -> UserModule | None:
        """The module with its source; None if it is not a user's, or not Python. A package without a file has none."""
        folders = spec.submodule_search_locations
        path = str(spec.origin) if spec.has_location else f"{next(iter(folders or ()), '')}/__init__.py"
        if not path.endswith(".py") or (_is_place_of_installed(path) and _top(spec.name) not in self._packages):
            return None
        if not spec.has_location:
            return None if folders is None else UserModule(spec.name, path, "", True)
        try:
            source = read_bytes(path, MOST_TEXT).decode("utf-8", "surrogateescape")
        except BadFile as error:
            raise ImportError(str(error), name=spec.name, path=path) from None
        return UserModule(spec.name, path, source, folders is not None)


active = UserCode()
"""The world whose code runs, or ran last. At first it is the process itself, which imports for `slidectl check`."""
_installed: dict[str, UserModule] = {}
"""Modules of installed packages that a user has named: their state is the process's, as that of any library."""


def _is_installed(module: ModuleType | None) -> bool:
    """True for a module of Python, slidectl or an installed package, and for none."""
    folders = getattr(module, "__path__", None) or ()
    path = str(getattr(module, "__file__", None) or next(iter(folders), ""))
    return not path or _is_place_of_installed(path)


def _is_place_of_installed(path: str) -> bool:
    return path.startswith(_OF_PYTHON) or any(place in path for place in _INSTALLED)


def _top(name: str) -> str:
    return name.partition(".")[0]


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not active.is_of_a_user(fullname) and not active.is_of_a_user(_importer()):
            return None

        def found() -> ModuleSpec | None:
            others = (finder for finder in sys.meta_path if finder is not self)
            return next((spec for one in others if (spec := one.find_spec(fullname, path, target)) is not None), None)

        return active.find(fullname, found)


_FINDER = _Finder()


def _importer() -> str:
    """The name of the module whose code is importing now."""
    frame: FrameType | None = sys._getframe(2)
    while frame is not None and _top(name := str(frame.f_globals.get("__name__"))) == "importlib":
        frame = frame.f_back
    return name


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
