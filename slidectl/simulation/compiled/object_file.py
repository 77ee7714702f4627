"""Where the machine code of the cycle is kept, and how it is brought into this process: LLVM alone, without numba.

A file is good for one version of everything that it was made from; that is in its name.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.util
import platform
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import slidectl
from slidectl.simulation.compiled import cache, guard

_SOURCES = (
    "control",
    "physics",
    "simulation/cycle.py",
    "simulation/runner.py",
    "simulation/compiled",
)


@functools.cache
def compilers() -> tuple[str, ...]:
    """The versions of numba and llvmlite; empty when one of them is not installed, or only in part."""
    try:
        return tuple(_version(name) for name in ("numba", "llvmlite"))
    except ImportError:
        return ()


def _version(name: str) -> str:
    """Raises ImportError. A mere folder of that name on the path is no library."""
    found = importlib.util.find_spec(name)
    if found is None or found.origin is None:
        raise ImportError(name)
    version: str | None = metadata.version(name)  # None for what is left of one that was half removed
    if version is None:
        raise ImportError(name)
    return version


def is_possible() -> bool:
    """True when numba is installed."""
    return bool(compilers())


@functools.cache
def place() -> Path:
    """The file of the code for this program on this machine, whether it is there or not."""
    made_from = hashlib.sha256()
    for text in (sys.version, platform.machine(), *compilers()):
        made_from.update(text.encode())
    root = Path(slidectl.__file__).parent
    for source in _SOURCES:
        whole = root / source
        for file in [whole] if whole.is_file() else sorted(whole.rglob("*.py")):
            made_from.update(file.read_bytes())
    return cache.folder() / f"cycle-{made_from.hexdigest()[:24]}.o"


def is_there() -> bool:
    """True when the code is compiled, and by nobody else."""
    return cache.holds(place())


def report() -> Path:
    """The file in which a failed compilation says why; whoever compiles has it locked."""
    return cache.folder() / "compiling.log"


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
    engine: Any
    """Owns the memory that the code is in."""


@functools.cache
def load() -> Cycle:
    """Bring the code into this process, once. Raises OSError (not there, or not ours), RuntimeError (no good)."""
    import llvmlite.binding as llvm

    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(cache.read(place())))
    engine.finalize_object()
    addresses = [engine.get_function_address(name) for name in (guard.DOOR, guard.ERROR_TEXT)]
    if not all(addresses):
        raise RuntimeError(f"{place()} is not what it should be; delete it")
    # The interpreter's lock is kept: there is one thread, and MuJoCo's warnings come back through Python.
    run = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(addresses[0])
    text = ctypes.PYFUNCTYPE(ctypes.c_char_p)(addresses[1])
    return Cycle(run, text, engine)
