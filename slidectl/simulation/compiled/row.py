"""Objects and their rows: state goes into a row and comes back, whole or as far as somebody looks at it.

Which object has which row, and when rows are the truth, is `seat.py`'s affair.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from typing import TYPE_CHECKING, Any

from slidectl.control.controller import ControllerBase
from slidectl.control.handles import JointStateHandle
from slidectl.control.laws import Columns, Parts
from slidectl.simulation.compiled import rows

if TYPE_CHECKING:
    from slidectl.simulation.compiled.seat import Seat

FLAG = Struct("=q")
NUMBER = Struct("=d")
_JOINT_STATE = Struct("=4d")
_COMMAND_OFFSET = 8 * rows.JOINT.names.index("command")

Update = Callable[[int, float], None]


class Row:
    """One object's row: `places` are the columns that no attribute fills."""

    __slots__ = ("_columns", "_number", "_places", "_source", "table")

    def __init__(
        self, table: bytearray, columns: Columns, number: int, source: object, places: tuple[float, ...]
    ) -> None:
        self.table = table
        self._columns = columns
        self._number = number
        self._source = source
        self._places = places

    @property
    def end(self) -> int:
        """Where the row ends in its table, bytes."""
        return (self._number + 1) * self._columns.size

    def fill(self) -> None:
        """From the object, all columns."""
        self._columns.fill(self.table, self._number, self._source, *self._places)

    def give(self) -> None:
        """To the object, what laws change."""
        self._columns.give(self.table, self._number, self._source)


class Speaker:
    """A controller in a row with a publisher: its flag `wanted`, the last column, and what `publish` looks at."""

    __slots__ = ("_flag", "_publisher", "_row", "_shown", "controller")

    def __init__(
        self, controller: ControllerBase, parts: Parts, row: Row, shown: list[tuple[JointStateHandle, int]]
    ) -> None:
        self.controller = controller
        self._publisher: Any = parts.publisher
        self._row = row
        self._flag = row.end - FLAG.size
        self._shown = shown

    def look(self) -> None:
        """Is somebody listening?"""
        FLAG.pack_into(self._row.table, self._flag, self._publisher.wanted)

    def show(self, joints: bytearray) -> None:
        """Let the controller and its joints' handles be as they are in the rows, as far as `publish` looks at them."""
        self._row.give()
        for handle, place in self._shown:
            show(joints, place, handle)


class Guest:
    """A controller without a row: it sees all handles of its robot, and the commands of those that it claims count."""

    __slots__ = ("_claimed", "_joints", "seat", "update")

    def __init__(self, seat: Seat, update: Update, joints: bytearray, claimed: list[tuple[Any, int]]) -> None:
        self.seat = seat
        self.update = update
        self._joints = joints
        self._claimed = [(handle, place + _COMMAND_OFFSET) for handle, place in claimed]

    def take_commands(self) -> None:
        """Let the rows be as the controller left the handles."""
        for handle, place in self._claimed:
            NUMBER.pack_into(self._joints, place, handle.command)


def show(joints: bytearray, place: int, handle: Any) -> None:
    """Let a handle be as its row is."""
    handle.position, handle.velocity, handle.effort, command = _JOINT_STATE.unpack_from(joints, place)
    handle.command = command
