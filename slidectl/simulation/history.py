"""The recent past of all joints: their state at every tenth cycle, written by the runner of the cycles.

The rows are in one block of numbers, which the compiled cycle writes too. The block is replaced when a robot is spawned
or deleted, since the indices of the joints change. Writing a row takes a third of a microsecond in the interpreter, and
some nanoseconds in machine code.
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

import numpy as np

from slidectl.simulation.clock import SECOND

if TYPE_CHECKING:
    from slidectl.physics import World

EVERY = 10
"""Cycles from one row to the next, counted from time 0."""
HEADER, ROWS, WRITTEN = 2, 0, 1
"""Length of the header; the indices in it of the capacity in rows, and of the number of rows written so far."""
_MOST_ROWS = 6000
_MOST_BYTES = 1 << 25


class History:
    """The last rows of a world: time in ns, then all of qpos, qvel, qfrc_applied and external efforts by dof."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.begin()

    def begin(self) -> None:
        """Start with an empty block: the indices of the joints have changed."""
        model = self._world.model
        self._positions, self._dofs = int(model.nq), int(model.nv)
        self._width = 1 + self._positions + 3 * self._dofs
        rows = max(1, min(_MOST_ROWS, _MOST_BYTES // (8 * self._width)))
        self._table = np.zeros(HEADER + rows * self._width)
        self._table[ROWS] = rows
        view: Any = memoryview(self._table)  # type: ignore[arg-type]
        self._view: memoryview[float] = view
        self._bytes: memoryview[int] = view.cast("B")
        self._time = array("d", [0.0])

    def forget(self) -> None:
        """Discard all rows, after joints were moved or the clock was set: they do not lead to the present state."""
        self._table[WRITTEN] = 0.0

    @property
    def address(self) -> int:
        """The address of the block; valid until `begin`."""
        return int(self._table.ctypes.data)

    def keep(self, time_ns: int) -> None:
        """Write a row: the state at the end of the cycle at this time. The kernel's `keep` does the same."""
        table, row_bytes = self._view, 8 * self._width
        written = table[WRITTEN]
        table[WRITTEN] = written + 1.0
        at = 8 * HEADER + row_bytes * int(written % table[ROWS])
        self._time[0] = time_ns
        qpos, qvel, forces, efforts, _ = self._world.views
        self._bytes[at : at + row_bytes] = b"".join((self._time, qpos, qvel, forces, efforts))

    def last_positions(self) -> Any:
        """All of qpos in the newest row (n,), or None when there is no row yet."""
        room, written = int(self._table[ROWS]), int(self._table[WRITTEN])
        if not written:
            return None
        at = HEADER + (written - 1) % room * self._width + 1
        return self._table[at : at + self._positions]

    def of_joint(self, qpos: int, dof: int, since_ns: int, before_ns: int) -> Any:
        """Time (s), position, velocity and effort of a joint in the rows with since_ns <= time < before_ns, (n, 4)."""
        room, written = int(self._table[ROWS]), int(self._table[WRITTEN])
        rows = self._table[HEADER:].reshape(room, self._width)
        rows = np.roll(rows, -(written % room), axis=0) if written > room else rows[:written]
        times, first = rows[:, 0], 1 + self._positions + dof
        is_wanted = (times >= since_ns) & (times < before_ns)
        effort = rows[:, first + self._dofs] + rows[:, first + 2 * self._dofs]
        return np.stack([times / SECOND, rows[:, 1 + qpos], rows[:, first], effort], axis=1)[is_wanted]
