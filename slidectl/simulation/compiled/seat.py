"""One robot's seat in the tables: its state goes into rows and comes back.

While a robot is seated its rows are the truth, and the objects behind it (handles, PIDs, controllers, its cycle) are
not looked at. Nothing runs here.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

from slidectl.control.controller import ControllerBase
from slidectl.control.laws import Parts
from slidectl.control.pid import Pid
from slidectl.physics import MujocoRobotHW
from slidectl.physics.drives import MOTOR, Drive
from slidectl.simulation.assembly import SpawnedRobot
from slidectl.simulation.compiled import rows
from slidectl.simulation.compiled.row import FLAG, NUMBER, Guest, Row, Speaker, Update, show

if TYPE_CHECKING:
    from slidectl.simulation.compiled.tables import Tables

_PERIOD_OFFSET = 8 * rows.ROBOT.names.index("period_s")
_PLAIN_OFFSET = 8 * rows.ROBOT.names.index("is_plain")


class Seat:
    """One robot's rows. `is_taken`: they are the truth."""

    def __init__(self, robot: SpawnedRobot, number: int) -> None:
        self.robot = robot
        self.parts = robot.parts
        self.number = number
        self.updates: tuple[Update, ...] = self.parts.manager.updates
        self._places = robot.body.joints
        self.is_taken = False
        self.is_possible = False
        self.speakers: dict[int, Speaker] = {}
        """By the controller's position in the order of updates."""
        self.guests: dict[int, Guest] = {}
        """The other controllers, which run in the interpreter."""
        self._living: list[Row] = []
        """Rows of objects that may change while the robot is not seated."""
        self._changing: list[Row] = []
        """Those in which laws change something."""
        self._constant: list[Row] = []
        self._handles: list[tuple[Any, int]] = []
        self._tables: dict[str, bytearray] = {}

    def fits(self) -> bool:
        """Is the robot still as it was when the tables were made, and does it do nothing that rows cannot?"""
        cycle, hardware, manager = self.parts.cycle, self.parts.hardware, self.parts.manager
        special = hardware.estop or cycle.is_stopped or manager.switching
        return self.is_possible and not special and not self.is_outdated()

    def is_outdated(self) -> bool:
        """Do other controllers run now than those that have rows, or has the robot moved in MuJoCo's arrays?"""
        return self.parts.manager.updates is not self.updates or self.has_moved()

    def has_moved(self) -> bool:
        """Has the robot other places in MuJoCo's arrays than its rows say?"""
        return self.robot.body.joints is not self._places

    def take(self) -> None:
        """From now on the rows are the truth."""
        for row in self._living:
            row.fill()
        for speaker in self.speakers.values():
            speaker.look()
        self.is_taken = True

    def release(self) -> None:
        """From now on the objects are the truth again. If a Ctrl-C comes in between it is done once more, whole."""
        if not self.is_taken:
            return
        for row in self._changing:
            row.give()
        self._mark_plain()
        self.is_taken = False

    @property
    def rows(self) -> int:
        """How many rows it has in all tables."""
        return len(self._living) + len(self._constant)

    def _mark_plain(self) -> None:
        FLAG.pack_into(self._tables["robots"], self.number * rows.ROBOT.size + _PLAIN_OFFSET, True)

    def period_s(self) -> float:
        """The period of the controllers' present update."""
        found: float = NUMBER.unpack_from(self._tables["robots"], self.number * rows.ROBOT.size + _PERIOD_OFFSET)[0]
        return found

    def show_joints(self) -> None:
        """Let the handles be as the rows are, for a controller that has no row."""
        joints = self._tables["joints"]
        for handle, place in self._handles:
            show(joints, place, handle)

    # -- making the rows -------------------------------------------------------------------------------------------

    def settle(self, tables: Tables) -> None:
        """Reserve rows for everything that the robot consists of, or one alone that says that it is plain."""
        self._tables = tables.content
        starts = [tables.count(name) for name in rows.RANGES]
        limits, drives = self.parts.hardware.limits(), self.parts.hardware.drives
        compiled = [_form(update) for update in self.updates]
        self.is_possible = (
            type(self.parts.hardware) is MujocoRobotHW
            and all(_is_law(drive) for drive in drives)
            and (not compiled or any(form is not None for form in compiled))
        )
        if self.is_possible:
            places = self._settle_joints(tables)
            for position, form in enumerate(compiled):
                self._settle_controller(tables, position, form, places)
            for limit in limits:
                self._settle_row(tables, "limits", limit, places[id(limit.handle)])
            for drive in drives:
                pid = self._settle_pid(tables, drive.pid)
                self._settle_row(tables, "drives", drive, pid, places[id(drive.handle)])
        counts = [tables.count(name) for name in rows.RANGES]
        ranges = [part for start, end in zip(starts, counts, strict=True) for part in (start, end - start)]
        self._settle_row(tables, "robots", self.parts.cycle, False, *ranges)
        for row in self._constant:
            row.fill()
        self._mark_plain()

    def _settle_joints(self, tables: Tables) -> dict[int, int]:
        """Row numbers by the identity of the handles."""
        places = {}
        for joint in self.parts.hardware.driven():
            places[id(joint.handle)] = tables.count("joints")
            self._handles.append((joint.handle, tables.count("joints") * rows.JOINT.size))
            self._settle_row(tables, "joints", *joint)
        return places

    def _settle_controller(self, tables: Tables, position: int, form: Form | None, places: dict[int, int]) -> None:
        if form is None or any(id(handle) not in places for handle in form[2].handles()):
            self._settle_row(tables, "controllers", None, rows.IN_PYTHON, 0)
            self._seat_guest(position)
            return
        controller, kind, parts = form
        own: list[float] = []
        if parts.pid is not None:
            own.append(self._settle_pid(tables, parts.pid))
        if parts.joint is not None:
            own.append(places[id(parts.joint)])
        if parts.publisher is not None:
            own.append(False)
        table = rows.KIND_TABLES[kind]
        self._settle_row(tables, "controllers", None, kind, tables.count(table))
        row = self._settle_row(tables, table, controller, *own)
        if parts.publisher is not None:
            shown = [(handle, places[id(handle)] * rows.JOINT.size) for handle in parts.shown]
            self.speakers[position] = Speaker(controller, parts, row, shown)

    def _settle_pid(self, tables: Tables, pid: Pid | None) -> int:
        """Its row number; 0, which nobody looks at, without one."""
        if pid is None:
            return 0
        number = tables.count("pids")
        self._settle_row(tables, "pids", pid)
        return number

    def _seat_guest(self, position: int) -> None:
        update = self.updates[position]
        owner = getattr(update, "__self__", None)
        claims = owner.claimed_resources if isinstance(owner, ControllerBase) else ()
        names = {name for claim in claims for name in claim.resources}
        claimed = [(handle, place) for handle, place in self._handles if handle.name in names]
        self.guests[position] = Guest(self, update, self._tables["joints"], claimed)

    def _settle_row(self, tables: Tables, table: str, source: object, *places: float) -> Row:
        columns = rows.TABLES[table]
        number = self.number if table == "robots" else tables.add(table)
        row = Row(tables.content[table], columns, number, source, places)
        (self._constant if table in rows.CONSTANT else self._living).append(row)
        if columns.changing:
            self._changing.append(row)
        return row


def _is_law(drive: Drive) -> bool:
    """Motors are none, and a PID that publishes each step speaks in the interpreter."""
    return drive.kind != MOTOR and (drive.pid is None or drive.pid.observer is None)


Form = tuple[ControllerBase, int, Parts]


def _form(update: Update) -> Form | None:
    """The controller behind an `update`, the kind of its row and its parts, when it runs compiled.

    A class or an instance that has an `update`, a `publish` or a column of its own, say as a property, means it: what
    its parent declares does not hold for it.
    """
    controller = getattr(update, "__self__", None)
    if not isinstance(controller, ControllerBase):
        return None
    owner: Any = next(cls for cls in type(controller).__mro__ if "update" in vars(cls))
    kind = rows.CONTROLLER_KINDS.get(owner) if "compiled" in vars(owner) else None
    if kind is None or _has_own_ways(controller, owner):
        return None
    parts = controller.parts()
    return (controller, kind, parts) if parts is not None else None


def _has_own_ways(controller: ControllerBase, owner: Any) -> bool:
    heirs = itertools.takewhile(lambda cls: cls is not owner, type(controller).__mro__)
    ways = {"update", "publish"}
    return not ways.isdisjoint(vars(controller)) or any(
        not vars(heir).keys().isdisjoint({*ways, *owner.compiled.columns.names}) for heir in heirs
    )
