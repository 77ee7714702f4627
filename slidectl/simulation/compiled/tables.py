"""The tables of the compiled cycle: their columns and memory, and the record of its progress.

PIDs, limits and drives declare their own columns next to their laws; this module has those of the cycle itself. The
rows of controllers are in memory of their own. Nothing runs in this module.
"""

from __future__ import annotations

import ctypes
from typing import Any

from slidectl.control.laws import Columns
from slidectl.control.limits import LimitHandle
from slidectl.control.pid import Pid
from slidectl.physics.robot_hw import Drive

JOINT = Columns(
    changing="position velocity effort command",
    fixed="lowest highest",
    places="qpos dof turns is_pushed max_effort max_velocity",
    whole="qpos dof turns is_pushed",
)
"""`qpos` and `dof` are indices into MuJoCo's arrays, `turns` is true for angles; the bounds are Gazebo's.
`is_pushed`: the command is the effort; otherwise a drive computes the effort from it."""

ROBOT = Columns(
    changing="last_update_ns last_write_ns period_ns write_period_ns period_s write_period_s",
    fixed="control_period_ns",
    places="is_plain first_joint joints first_controller controllers first_limit limits first_drive drives",
    whole="last_update_ns last_write_ns period_ns write_period_ns control_period_ns "
    "is_plain first_joint joints first_controller controllers first_limit limits first_drive drives",
)
"""A ControlCycle, and the robot's ranges of rows in the other tables. `is_plain`: the interpreter runs the robot."""

_PLACES = "law row members count numbers size"
CONTROLLER = Columns(places=_PLACES, whole=_PLACES)
"""The controllers of all robots in their order: the addresses of the law's code, of the controller's own row, of its
`count` members' rows, and of its `size` numbers."""
CONTROLLER_SIZE = CONTROLLER.size

INTERPRETED = 0
"""The address of the law of a controller that runs in the interpreter."""

TABLES: dict[str, Columns] = {
    "robots": ROBOT,
    "joints": JOINT,
    "controllers": CONTROLLER,
    "limits": LimitHandle.columns,
    "drives": Drive.columns,
    "pids": Pid.columns,
}
"""All tables, in the order of `kernel.CycleTables`; MuJoCo's arrays follow."""
RANGES = ("joints", "controllers", "limits", "drives")
"""Tables in which each robot has a range of rows; the ranges are in ROBOT."""

DONE, PUBLICATION, LEFT, RAISED, ROBOT_IN_PYTHON, CONTROLLER_IN_PYTHON, NOT_FINITE, STEP_IN_PYTHON, DIVERGED, FAILED = (
    range(10)
)
"""Return values of the compiled cycle: all cycles are done, the interpreter has its turn, or an error. The first four
are results of a law: nothing, PUBLISH, LEAVE, or an exception."""

NEW_CYCLE = -1


class Progress(ctypes.Structure):
    """The progress of the cycles: `robot` and `controller` come next, in the cycle at `time_ns`."""

    time_ns: int
    step_ns: int
    cycles: int
    left: int
    robot: int
    controller: int
    robots: int
    positions: int
    dofs: int
    has_outside: int
    step: int
    """Address of mj_step; 0: the interpreter makes the steps."""
    model: int
    data: int
    error_hook: int
    """Address of MuJoCo's variable `mju_user_error`, or 0."""
    controllers: int
    joints: int
    pids: int
    """Addresses of these tables."""


Progress._fields_ = [(name, ctypes.c_int64) for name in Progress.__annotations__]


class Tables:
    """The memory of all rows. It grows at its end: rows keep their numbers, but a growing table may move."""

    def __init__(self) -> None:
        self.content = {name: bytearray(columns.size) for name, columns in TABLES.items()}
        self._counts = dict.fromkeys(TABLES, 0)

    def count(self, table: str) -> int:
        """The number of rows of a table."""
        return self._counts[table]

    @property
    def rows(self) -> int:
        """The number of rows of all tables."""
        return sum(self._counts.values())

    def add(self, table: str) -> int:
        """Add a row. Returns its number. The table's address may change."""
        number = self._counts[table]
        self._counts[table] += 1
        if number > 0:
            self.content[table].extend(bytes(TABLES[table].size))
        return number

    def addresses(self) -> dict[str, int]:
        """The address of each table, in order; valid until a row is added."""
        return {name: address_of(table) for name, table in self.content.items()}


def address_of(memory: Any) -> int:
    """The address of a writable buffer; 0 when it is empty."""
    return ctypes.addressof(ctypes.c_char.from_buffer(memory)) if len(memory) else 0
