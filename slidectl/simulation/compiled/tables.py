"""The memory of the rows, and who is seated where in it.

It grows behind what is there: a robot that comes, or whose controllers changed, costs its own rows only.
Nothing runs here.
"""

from __future__ import annotations

import ctypes

from slidectl.simulation.assembly import SpawnedRobot
from slidectl.simulation.compiled import rows
from slidectl.simulation.compiled.seat import Seat

_FEW = 1000
"""Rows that nobody uses and nobody minds."""


class Tables:
    """Rows of all robots. `seats` are in the order of the robots."""

    def __init__(self) -> None:
        self.content = {name: bytearray(columns.size) for name, columns in rows.TABLES.items()}
        self._counts = dict.fromkeys(rows.TABLES, 0)
        self.seats: list[Seat] = []
        self._abandoned = 0

    def seat(self, robot: SpawnedRobot) -> Seat:
        """A place behind the others."""
        seat = Seat(robot, self.add("robots"))
        self.seats.append(seat)
        seat.settle(self)
        return seat

    def seat_anew(self, old: Seat) -> Seat:
        """Other rows for a robot that is not what it was; those that it had are left over."""
        self._abandoned += old.rows
        seat = self.seats[old.number] = Seat(old.robot, old.number)
        seat.settle(self)
        return seat

    @property
    def is_wasteful(self) -> bool:
        """True when it would be better to begin again."""
        return self._abandoned > _FEW + sum(self._counts.values()) // 2

    def count(self, table: str) -> int:
        """Rows so far."""
        return self._counts[table]

    def add(self, table: str) -> int:
        """One more row; its number. Its table may lie elsewhere afterwards."""
        number = self._counts[table]
        self._counts[table] += 1
        if number > 0:
            self.content[table].extend(bytes(rows.TABLES[table].size))
        return number

    def addresses(self) -> list[int]:
        """Where each table lies, in order; they stay there until a row is added."""
        return [ctypes.addressof(ctypes.c_char.from_buffer(table)) for table in self.content.values()]
