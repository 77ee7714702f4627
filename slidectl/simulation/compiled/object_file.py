"""The stored machine code of the cycle, and its loading into this process: by LLVM, without numba.

A file is valid for one version of all its sources; a digest of them is in its name. It is machine code, so it is only
loaded when it is complete and only the user could have written it. Against: a second user of the machine, and a file
damaged by a crash, which would end the process without a message.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
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
"""The number of stored files of cycles and of users' laws: the last used ones. Each version of any source has its own
file."""
_CHECKSUM_BYTES = 32
_SOURCES = ("control", "physics", "simulation/cycle.py", "simulation/compiled")


class UnsafeFile(PermissionError):
    """A file or folder that another user could have written."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} belongs to another user, or others may write to it; remove it or chmod go-w it")


@functools.cache
def is_possible() -> bool:
    """True when numba is installed."""
    return bool(_compilers())


@functools.cache
def _compilers() -> tuple[str, ...]:
    """The versions of numba and llvmlite; empty when one of them is not installed."""
    try:
        return metadata.version("numba"), metadata.version("llvmlite")
    except metadata.PackageNotFoundError:
        return ()


def folder() -> Path:
    """The folder of the code, below XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return Path(base if os.path.isabs(base) else os.path.expanduser("~/.cache")) / "slidectl"


@functools.cache
def place() -> Path:
    """The path of the code for this program on this machine; it may not exist."""
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
    """The path of the code of a user's law with this description; it may not exist."""
    return folder() / f"law-{hashlib.sha256(place().name.encode() + content).hexdigest()[:24]}.o"


def report() -> Path:
    """The file with the error of a failed compilation; a running compiler has it locked."""
    return folder() / "compiling.log"


def prepare() -> None:
    """Create the folder. Raises OSError: it cannot be created; UnsafeFile."""
    if not folder().is_absolute():
        raise FileNotFoundError("there is no home folder, and XDG_CACHE_HOME is not set")
    folder().mkdir(mode=0o700, parents=True, exist_ok=True)
    _check_ours(folder(), folder().stat())


def start_compiler(*law: str, source: int | IO[bytes], report: IO[Any]) -> subprocess.Popen[bytes]:
    """Start the compiler as a process that outlives this one: for the cycle, or for the law with this file name.

    `source` is its standard input; its errors go to `report`. The folder must exist: see `prepare`.
    """
    return subprocess.Popen(
        # -P: a user's file with the name of a library must not be imported instead of it.
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
    """Write code to its file, whole or not at all. Raises OSError, also when the folder was removed meanwhile."""
    replace(path, hashlib.sha256(content).digest() + content, 0o600)


def tidy() -> None:
    """Delete the files that were not used for longest, and unfinished files of compilers that ended early.

    The caller must hold the lock of the report. Others may read meanwhile, and find a file missing.
    """
    for draft in folder().glob(".*.o"):
        draft.unlink(missing_ok=True)
    for pattern, kept in (("cycle-*.o", KEPT), ("law-*.o", KEPT_LAWS)):
        by_use = sorted(folder().glob(pattern), key=lambda path: path.stat().st_mtime, reverse=True)
        for old in by_use[kept:]:
            old.unlink(missing_ok=True)


def _read(path: Path) -> bytes:
    """The code; its time of use is updated. Raises OSError: missing, or damaged and then removed; UnsafeFile."""
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC), "rb") as file:
        _check_ours(path, os.fstat(file.fileno()))
        _check_ours(path.parent, path.parent.stat())
        with suppress(OSError):  # a read-only file system
            os.utime(path)
        checksum, content = file.read(_CHECKSUM_BYTES), file.read()
    if checksum != hashlib.sha256(content).digest():
        path.unlink(missing_ok=True)
        raise FileNotFoundError(path)
    return content


def _check_ours(path: Path, found: os.stat_result) -> None:
    if found.st_uid != os.geteuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise UnsafeFile(path)


def machine() -> Any:
    """LLVM's generic processor of this architecture: without the fused operations of newer ones."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(cpu="", features="", opt=3, reloc="pic", codemodel="small")


class Cycle(NamedTuple):
    """The loaded code: the cycle as a function of the address of addresses, and the text of MuJoCo's last error."""

    run: Callable[[int], int]
    error_text: Callable[[], bytes]
    laws: list[int]
    """The addresses of the code of our forms, in their order."""
    engine: Any
    """Owns the memory of the code."""


@functools.cache
def load() -> Cycle:
    """Load the code of the cycle into this process, once. Raises as `loaded`."""
    names = [guard.ENTRY, guard.ERROR_TEXT, *map(guard.law, range(len(compiled_forms())))]
    engine, addresses = loaded(place(), names)
    # PYFUNCTYPE keeps the interpreter's lock: there is one thread, and MuJoCo's warnings call Python.
    run = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(addresses[0])
    text = ctypes.PYFUNCTYPE(ctypes.c_char_p)(addresses[1])
    return Cycle(run, text, addresses[2:], engine)


def loaded(path: Path, names: list[str]) -> tuple[Any, list[int]]:
    """Load code into this process. Returns the owner of its memory, and the addresses of these functions.

    Raises OSError (missing, or unsafe), RuntimeError (a function is missing).
    """
    import llvmlite.binding as llvm

    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(_read(path)))
    engine.finalize_object()
    addresses = [engine.get_function_address(name) for name in names]
    if not all(addresses):
        raise RuntimeError(f"{path} lacks its functions; delete it")
    return engine, addresses
