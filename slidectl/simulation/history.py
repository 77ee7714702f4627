"""The recent past of all joints: their state at every tenth cycle, kept by whoever runs the cycles.

The rows lie in one block of numbers, which the compiled cycle fills as well. It begins anew when a robot comes or goes,
since others have the places then. To keep a row costs half a microsecond in the interpreter and some nanoseconds in
machine code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slidectl.simulation.clock import SECOND

if TYPE_CHECKING:
    from slidectl.physics import World

EVERY = 10
"""Cycles from one row to the next, counted from time 0."""
HEADER, ROWS, TAKEN = 2, 0, 1
"""Length of the header; the places in it of how many rows there is room for, and how many were written so far."""
_MOST_ROWS = 6000
_MOST_BYTES = 1 << 25


class History:
    """The last rows of a world: time in ns, then all of qpos, qvel, and the forces and the outside efforts by dof."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.begin()

    def begin(self) -> None:
        """Forget everything: the world has other places for its joints."""
        model = self._world.model
        self._positions, self._dofs = int(model.nq), int(model.nv)
        self._width = 1 + self._positions + 3 * self._dofs
        rows = max(1, min(_MOST_ROWS, _MOST_BYTES // (8 * self._width)))
        self._table = np.zeros(HEADER + rows * self._width)
        self._table[ROWS] = rows
        view: Any = memoryview(self._table)  # type: ignore[arg-type]
        self._view: memoryview[float] = view

    def forget(self) -> None:
        """The world is at another moment: what was before does not lead to it."""
        self._table[TAKEN] = 0.0

    @property
    def address(self) -> int:
        """Where the block lies, until `begin`."""
        return int(self._table.ctypes.data)

    def keep(self, time_ns: int) -> None:
        """A row: the state at the end of the cycle at this time. The kernel's `keep` does the same."""
        table, views, positions, dofs = self._view, self._world.views, self._positions, self._dofs
        taken = table[TAKEN]
        at = HEADER + int(taken % table[ROWS]) * self._width
        table[TAKEN] = taken + 1.0
        table[at] = float(time_ns)
        at += 1
        table[at : at + positions] = views.qpos
        at += positions
        for numbers in (views.qvel, views.forces, views.efforts):
            table[at : at + dofs] = numbers
            at += dofs

    def of_joint(self, qpos: int, dof: int, since_ns: int) -> Any:
        """Time (s), position, velocity and effort of a joint in the rows since then, (n, 4). A clock that was put back
        begins anew."""
        room, taken = int(self._table[ROWS]), int(self._table[TAKEN])
        rows = self._table[HEADER:].reshape(room, self._width)
        rows = np.roll(rows, -(taken % room), axis=0) if taken > room else rows[:taken]
        times, first = rows[:, 0], 1 + self._positions + dof
        back = np.flatnonzero(np.diff(times) <= 0)
        is_wanted = times >= since_ns
        is_wanted[: back[-1] + 1 if len(back) else 0] = False
        effort = rows[:, first + self._dofs] + rows[:, first + 2 * self._dofs]
        return np.stack([times / SECOND, rows[:, 1 + qpos], rows[:, first], effort], axis=1)[is_wanted]
