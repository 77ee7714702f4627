"""Where the machine code of the cycle is kept between runs, and how it is brought into this process: by LLVM, without
numba.

A file is good for one version of everything that it was made from; that is in its name. It is machine code, so only a
whole file that nobody but the user could have written is taken: what a crash of the machine left of one would end the
process without a word.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.util
import os
import platform
import stat
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import IO, Any, NamedTuple

import slidectl
from slidectl.control.registry import compiled_forms
from slidectl.paths import with_package
from slidectl.simulation.compiled import guard
from slidectl.writing import replace

KEPT, KEPT_LAWS = 8, 64
"""Files of cycles and of users' laws that stay: those that were used last. Each version of anything that the code is
made from has its own."""
_SEAL_BYTES = 32
_SOURCES = (
    "control",
    "physics",
    "simulation/cycle.py",
    "simulation/compiled",
)


class UnsafeFile(PermissionError):
    """A file or folder that somebody else could have written."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} belongs to somebody else, or others may write to it; move it away or chmod go-w it")


@functools.cache
def is_possible() -> bool:
    """True when numba is installed."""
    return bool(_compilers())


@functools.cache
def _compilers() -> tuple[str, ...]:
    """The versions of numba and llvmlite; empty when one of them is not installed, or only in part."""
    versions = []
    for name in ("numba", "llvmlite"):
        found = importlib.util.find_spec(name)
        if found is None or found.origin is None:  # a mere folder of that name on the path is no library
            return ()
        try:
            versions.append(metadata.version(name))
        except metadata.PackageNotFoundError:
            return ()
    return tuple(versions) if all(versions) else ()  # no version: what is left of one that was half removed


def folder() -> Path:
    """Where the code is kept, below XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return Path(base if os.path.isabs(base) else os.path.expanduser("~/.cache")) / "slidectl"


@functools.cache
def place() -> Path:
    """The file of the code for this program on this machine, whether it is there or not."""
    made_from = hashlib.sha256()
    for text in (sys.version, platform.machine(), *_compilers()):
        made_from.update(text.encode())
    root = Path(slidectl.__file__).parent
    for source in _SOURCES:
        whole = root / source
        for file in [whole] if whole.is_file() else sorted(whole.rglob("*.py")):
            made_from.update(file.read_bytes())
    return folder() / f"cycle-{made_from.hexdigest()[:24]}.o"


def law_place(content: bytes) -> Path:
    """The file of the code of a user's law that is described so, whether it is there or not."""
    return folder() / f"law-{hashlib.sha256(place().name.encode() + content).hexdigest()[:24]}.o"


def report() -> Path:
    """The file in which a failed compilation says why; whoever compiles has it locked."""
    return folder() / "compiling.log"


def prepare() -> None:
    """See to it that the folder is there. Raises OSError: it cannot be made; UnsafeFile."""
    if not folder().is_absolute():
        raise FileNotFoundError("there is no home folder, and XDG_CACHE_HOME names none")
    folder().mkdir(mode=0o700, parents=True, exist_ok=True)
    _check_ours(folder(), folder().stat())


def start_compiler(*law: str, source: int | IO[bytes], report: IO[Any]) -> subprocess.Popen[bytes]:
    """The compiler, as a process of its own that outlives this one: of the cycle, or of the law whose file is named so.

    `source` is its standard input; what it says goes into the report. The folder is there: see `prepare`.
    """
    return subprocess.Popen(
        # -P: a file of the user's that is called like a library must not be taken for it.
        [sys.executable, "-P", "-m", "slidectl.simulation.compiled.compiler", *law],
        stdin=source,
        stdout=subprocess.DEVNULL,
        stderr=report,
        env=with_package(os.environ),
        start_new_session=True,
    )


def is_there() -> bool:
    """True when the code is compiled."""
    return place().exists()


def write(path: Path, content: bytes) -> None:
    """Put code in its place, at once or not at all. Raises OSError, also when the folder has gone meanwhile."""
    replace(path, hashlib.sha256(content).digest() + content, 0o600)


def tidy() -> None:
    """Throw away what was not used for longest, and drafts of those who ended before they were done.

    For whoever has the report locked; others may read meanwhile, and find a file gone.
    """
    for draft in folder().glob("*.o.*"):
        draft.unlink(missing_ok=True)
    for pattern, kept in (("cycle-*.o", KEPT), ("law-*.o", KEPT_LAWS)):
        by_use = sorted(folder().glob(pattern), key=lambda path: path.stat().st_mtime, reverse=True)
        for old in by_use[kept:]:
            old.unlink(missing_ok=True)


def _read(path: Path) -> bytes:
    """The code; it counts as used now. Raises OSError: not there, or damaged, which removes it; UnsafeFile."""
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC), "rb") as file:
        _check_ours(path, os.fstat(file.fileno()))
        _check_ours(path.parent, path.parent.stat())
        with suppress(OSError):  # a file system that can only be read
            os.utime(path)
        seal, content = file.read(_SEAL_BYTES), file.read()
    if seal != hashlib.sha256(content).digest():
        path.unlink(missing_ok=True)
        raise FileNotFoundError(path)
    return content


def _check_ours(path: Path, found: os.stat_result) -> None:
    if found.st_uid != os.geteuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise UnsafeFile(path)


def machine() -> Any:
    """LLVM's idea of any processor of this kind: without the fused operations that newer ones have."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(cpu="", features="", opt=3, reloc="pic", codemodel="small")


class Cycle(NamedTuple):
    """The loaded code: the cycle as a function of the address of addresses, and the text of the error that ended it."""

    run: Callable[[int], int]
    error_text: Callable[[], bytes]
    laws: list[int]
    """The addresses of the code of our forms, in their order."""
    engine: Any
    """Owns the memory that the code is in."""


@functools.cache
def load() -> Cycle:
    """Bring the code of the cycle into this process, once. Raises as `loaded`."""
    names = [guard.ENTRY, guard.ERROR_TEXT, *map(guard.law, range(len(compiled_forms())))]
    engine, addresses = loaded(place(), names)
    # The interpreter's lock is kept: there is one thread, and MuJoCo's warnings come back through Python.
    run = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(addresses[0])
    text = ctypes.PYFUNCTYPE(ctypes.c_char_p)(addresses[1])
    return Cycle(run, text, addresses[2:], engine)


def loaded(path: Path, names: list[str]) -> tuple[Any, list[int]]:
    """Bring code into this process: what owns its memory, and the addresses of these functions.

    Raises OSError (not there, or not ours), RuntimeError (no good).
    """
    import llvmlite.binding as llvm

    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(_read(path)))
    engine.finalize_object()
    addresses = [engine.get_function_address(name) for name in names]
    if not all(addresses):
        raise RuntimeError(f"{path} is not what it should be; delete it")
    return engine, addresses
