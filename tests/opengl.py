"""Machines with another OpenGL than this one, for processes that are started with the variables."""

from __future__ import annotations

import _ctypes
import shutil
from pathlib import Path

from slidectl.physics import rendering

FILES = [file for files in rendering._LIBRARIES.values() for file in files]


def missing(folder: Path) -> dict[str, str]:
    """The variables for a machine without OpenGL: the files that are found first are empty."""
    for file in FILES:
        (folder / file).write_bytes(b"")
    return {"LD_LIBRARY_PATH": str(folder)}


def broken(folder: Path) -> dict[str, str]:
    """The variables for a machine on which a library of that name is there, and is none of OpenGL."""
    for file in FILES:
        for name in (file, file.rpartition(".")[0]):  # PyOpenGL looks for the second one first
            shutil.copy(_ctypes.__file__, folder / name)
    return {"LD_LIBRARY_PATH": str(folder)}
