"""Setup of the MuJoCo library, once per process: remove its clock and collect its warnings.

Without a handler, MuJoCo writes warnings to the console and to MUJOCO_LOG.TXT. This module uses no world and no
robot.
"""

from __future__ import annotations

import ctypes
import sys
import warnings
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import mujoco

EngineError = mujoco.FatalError
"""Raised by a step that MuJoCo cannot compute, for example with too many contacts."""

VERSION: str = mujoco.__version__
MOST_WARNINGS = 100

_warnings: deque[str] = deque(maxlen=MOST_WARNINGS)


def pop_warnings() -> list[str]:
    """Take the warnings of MuJoCo since the last call, oldest first; at most `MOST_WARNINGS` are kept."""
    taken = list(_warnings)
    _warnings.clear()
    return taken


@contextmanager
def warnings_kept() -> Iterator[None]:
    """Context that also collects warnings of MuJoCo's Python layer, such as those of its compiler."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        _keep_warning(str(warning.message))


def _keep_warning(text: str) -> None:
    _warnings.append(" ".join(text.split()))


@cache
def _library() -> ctypes.CDLL | None:
    files = sorted(Path(mujoco.__file__).parent.glob("libmujoco*"))
    return ctypes.CDLL(str(files[0])) if files else None


def prepare() -> None:
    """Collect the warnings and remove the clock. Calling it twice has no further effect."""
    mujoco.set_mju_user_warning(_keep_warning)
    library = _library()
    if library is not None:
        # MuJoCo's Python package sets a clock that each step reads about twenty times; `set_mjcb_time(None)` keeps it.
        ctypes.c_void_p.in_dll(library, "mjcb_time").value = None


def struct_address(struct: mujoco.MjModel | mujoco.MjData) -> int:
    """The address of a model or its state in memory. Only `_address` of MuJoCo's Python layer has it."""
    return int(struct._address)


def address_of(function: str) -> int:
    """The address of a MuJoCo function, for compiled code; 0 when the library is not found."""
    library = _library()
    return ctypes.cast(getattr(library, function), ctypes.c_void_p).value or 0 if library is not None else 0


_PAGE, _MOST_OF_DATA = 4096, 1 << 20
"""Bytes: size of a memory page, which is mapped as a whole or not at all, and largest part of MjData to search."""


@cache
def constraint_variables() -> tuple[int, int]:
    """The offsets in MjData of the variables `efc_aref` and `efc_force`, in bytes; 0: not found.

    MuJoCo's Python layer does not give them. This searches two MjData, whose arrays have different addresses, for these
    addresses. It searches page by page, so it stops before memory that is not mapped.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), explicitinertial=True)
    body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, frictionloss=1.0)
    model = spec.compile()
    found = []
    for _ in range(2):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        found.append([_find(array.ctypes.data, struct_address(data)) for array in (data.efc_aref, data.efc_force)])
    references, forces = found[0]
    return (references, forces) if found[0] == found[1] else (0, 0)


def _find(address: int, begin: int) -> int:
    """The offset from `begin` at which memory holds `address`; 0: not found within `_MOST_OF_DATA`."""
    place, wanted = begin, address.to_bytes(8, sys.byteorder)
    while place < begin + _MOST_OF_DATA:
        end = (place // _PAGE + 1) * _PAGE
        found = ctypes.string_at(place, end - place).find(wanted)
        if found >= 0:
            return place + found - begin
        place = end
    return 0


def error_hook_address() -> int:
    """The address of MuJoCo's variable `mju_user_error`, the pointer to its handler of fatal errors; 0: no library."""
    library = _library()
    return ctypes.addressof(ctypes.c_void_p.in_dll(library, "mju_user_error")) if library is not None else 0
