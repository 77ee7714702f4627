"""One robot's rows in the tables of the compiled cycle: its state is loaded into them, and unloaded.

While a robot is loaded its rows are valid, and the objects (handles, PIDs, controllers, its cycle) are out of date and
not read. Nothing runs in this module.
"""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Callable
from functools import partial
from struct import Struct
from typing import TYPE_CHECKING, Any

from slidectl.control.controller_interface import Compiled, Member, Parts
from slidectl.control.hardware_interface import JointStateHandle
from slidectl.control.loaded_controller import LoadedController
from slidectl.control.pid import Pid
from slidectl.errors import Refused
from slidectl.physics import MujocoRobotHW
from slidectl.physics.robot_hw import Drive
from slidectl.simulation.compiled.own_laws import LawCode
from slidectl.simulation.compiled.tables import (
    CONTROLLER,
    INTERPRETED,
    JOINT,
    RANGES,
    ROBOT,
    TABLES,
    Tables,
    address_of,
)

if TYPE_CHECKING:
    from slidectl.simulation.spawned_robots import SpawnedRobot

Update = Callable[[int, float], None]

_FLAG = Struct("=q")
_NUMBER = Struct("=d")
_JOINT_STATE = Struct("=4d")
_COMMAND_OFFSET = 8 * JOINT.names.index("command")
_PERIOD_OFFSET = 8 * ROBOT.names.index("period_s")
_PLAIN_OFFSET = 8 * ROBOT.names.index("is_plain")


class RobotRows:
    """The rows of one robot. `is_loaded`: the rows, and not the objects, are valid."""

    def __init__(self, robot: SpawnedRobot, number: int, tables: Tables, laws: LawCode) -> None:
        """Reserve rows for all parts of the robot, or only one that marks it as plain."""
        self.robot = robot
        self.parts = robot.parts
        self.number = number
        self.running = self.parts.manager.running
        self.is_loaded = False
        self.publications: dict[int, CompiledController] = {}
        """Controllers that publish, by their position in the order of updates."""
        self.interpreted: dict[int, InterpretedUpdate] = {}
        """Controllers without a row, by the same position."""
        self._places = robot.attached.joints
        self._tables = tables.content
        self._fill: list[Callable[[], None]] = []
        """Functions that fill the rows from the objects."""
        self._give: list[Callable[[], None]] = []
        """Functions that write back to objects what laws change."""
        self._compiled: list[CompiledController] = []
        self._handles: list[tuple[Any, int]] = []
        """Each handle with the offset of its row."""
        self._laws = laws
        self._law_changes = laws.changes
        self._is_possible = self._reserve(tables)

    def fits(self) -> bool:
        """True when the rows match the robot, and it needs nothing that rows cannot do."""
        cycle, hardware, manager = self.parts.cycle, self.parts.hardware, self.parts.manager
        special = hardware.estop or cycle.is_stopped or cycle.is_intercepted or manager.switching
        return self._is_possible and not special and not self.is_outdated()

    def is_outdated(self) -> bool:
        """True when other controllers run than those with rows, a law has got its code, or the robot's indices in
        MuJoCo's arrays have changed."""
        have_laws_changed = self._law_changes != self._laws.changes
        are_others = self.parts.manager.running is not self.running or not self._may_compile()
        return have_laws_changed or are_others or self.has_moved()

    def _may_compile(self) -> bool:
        """False when a user's controller with a row may not be compiled any more."""
        return all(compiled.entry.may_compile for compiled in self._compiled)

    def has_moved(self) -> bool:
        """True when the robot's indices in MuJoCo's arrays are not those of its rows."""
        return self.robot.attached.joints is not self._places

    def compiled_controllers(self) -> frozenset[str]:
        """The names of controllers that have rows."""
        places = range(len(self.running)) if self._is_possible else ()
        return frozenset(self.running[place].name for place in places if place not in self.interpreted)

    def load(self) -> None:
        """Make the rows valid, unless a user's controller fails while they are filled."""
        for fill in self._fill:
            fill()
        if not self._may_compile():
            self._mark_plain()
            return
        for publication in self.publications.values():
            publication.update_wanted()
        self.is_loaded = True

    def unload(self) -> None:
        """Write the rows back to the objects. If a Ctrl-C interrupts this, the next call does all of it again."""
        if not self.is_loaded:
            return
        for give in self._give:
            give()
        self._mark_plain()
        self.is_loaded = False

    @property
    def count(self) -> int:
        """The number of its rows in all tables."""
        return len(self._fill)

    def period_s(self) -> float:
        """The period of the controllers' present update, s."""
        found: float = _NUMBER.unpack_from(self._tables["robots"], self.number * ROBOT.size + _PERIOD_OFFSET)[0]
        return found

    def _mark_plain(self) -> None:
        """Leave the robot to the interpreter: the machine code reads nothing of its controllers."""
        _FLAG.pack_into(self._tables["robots"], self.number * ROBOT.size + _PLAIN_OFFSET, True)
        for compiled in self._compiled:
            compiled.release()

    def show_joints(self) -> None:
        """Update the handles from the rows, for a controller that has no row."""
        joints = self._tables["joints"]
        for handle, offset in self._handles:
            _show(joints, offset, handle)

    # -- making the rows -------------------------------------------------------------------------------------------

    def _reserve(self, tables: Tables) -> bool:
        """Reserve all rows. Returns True when the robot can run compiled."""
        starts = [tables.count(name) for name in RANGES]
        limits, drives = self.parts.hardware.limits(), self.parts.hardware.drives
        controllers = [entry.try_to_compile(partial(_compiled, entry, self._laws)) for entry in self.running]
        is_possible = (
            type(self.parts.hardware) is MujocoRobotHW
            and self.parts.hardware.has_compiled_form
            and all(_is_compiled(drive) for drive in drives)
            and (not controllers or any(controllers))
        )
        if is_possible:
            places: dict[int, int] = {}  # row numbers by the identity of the handles
            for joint in self.parts.hardware.driven():
                places[id(joint.handle)] = row = self._reserve_row(tables, "joints", *joint)
                self._handles.append((joint.handle, row * JOINT.size))
            for position, controller in enumerate(controllers):
                self._reserve_controller(tables, position, controller, places)
            for limit in limits:
                self._reserve_row(tables, "limits", limit, places[id(limit.handle)])
            for drive in drives:
                pid = self._reserve_pid(tables, drive.pid)
                self._reserve_row(tables, "drives", drive, pid, places[id(drive.handle)])
        counts = [tables.count(name) for name in RANGES]
        ranges = [part for start, end in zip(starts, counts, strict=True) for part in (start, end - start)]
        self._reserve_row(tables, "robots", self.parts.cycle, False, *ranges)
        self._mark_plain()
        return is_possible

    def _reserve_controller(
        self, tables: Tables, position: int, compiled: CompiledController | None, places: dict[int, int]
    ) -> None:
        if compiled is None or any(id(handle) not in places for handle in compiled.handles):
            self._reserve_row(tables, "controllers", None, INTERPRETED, 0, 0, 0, 0, 0)
            entry = self.running[position]
            names = {name for claim in entry.controller.claimed_resources for name in claim.resources}
            claimed = [(handle, offset) for handle, offset in self._handles if handle.name in names]
            self.interpreted[position] = InterpretedUpdate(self, entry.update, self._tables["joints"], claimed)
            return
        compiled.make_rows(places, lambda pid: self._reserve_pid(tables, pid))
        number = tables.add("controllers")
        self._compiled.append(compiled)
        self._fill.append(
            partial(compiled.entry.try_to_compile, partial(compiled.fill, self._tables["controllers"], number))
        )
        self._give.append(partial(compiled.entry.try_to_compile, compiled.give))
        if compiled.parts.publishers:
            self.publications[position] = compiled

    def _reserve_pid(self, tables: Tables, pid: Pid | None) -> int:
        """The PID's row number; 0, which is not read, without a PID."""
        return 0 if pid is None else self._reserve_row(tables, "pids", pid)

    def _reserve_row(self, tables: Tables, table: str, source: object, *places: float) -> int:
        """Reserve a row for an object; `places` are the columns without an attribute. Returns its number."""
        columns, rows = TABLES[table], tables.content[table]
        number = self.number if table == "robots" else tables.add(table)
        self._fill.append(partial(columns.fill, rows, number, source, *places))
        if columns.changing:
            self._give.append(partial(columns.give, rows, number, source))
        return number


class InterpretedUpdate:
    """A controller without a row. It reads all handles of its robot; its commands are taken from those it claims."""

    __slots__ = ("_claimed", "_joints", "rows", "update")

    def __init__(self, rows: RobotRows, update: Update, joints: bytearray, claimed: list[tuple[Any, int]]) -> None:
        self.rows = rows
        self.update = update
        self._joints = joints
        self._claimed = [(handle, offset + _COMMAND_OFFSET) for handle, offset in claimed]

    def copy_commands(self) -> None:
        """Copy the commands from the claimed handles to their rows."""
        for handle, offset in self._claimed:
            _NUMBER.pack_into(self._joints, offset, handle.command)


def _show(joints: bytearray, offset: int, handle: Any) -> None:
    """Update a handle from its row."""
    handle.position, handle.velocity, handle.effort, command = _JOINT_STATE.unpack_from(joints, offset)
    handle.command = command


def _is_compiled(drive: Drive) -> bool:
    """False for drives that need the interpreter: with a PID that publishes each step, or with several commands."""
    return type(drive) is Drive and (drive.pid is None or drive.pid.observer is None)


class CompiledController:
    """A controller that runs compiled, and its rows, in memory of their own with a fixed address."""

    def __init__(self, entry: LoadedController, form: Compiled, law: int, parts: Parts) -> None:
        """`law` is the address of the law's code."""
        self.entry = entry
        self.controller = entry.controller
        self.parts = parts
        self.handles = parts.handles()
        self._form = form
        self._law = law
        self._row = bytearray(form.row.size)
        self._members = bytearray(form.members.size * len(parts.members))
        self._numbers = memoryview(b"")
        """Held while its address is in use: the memory of a held view cannot change its size."""
        self._places: list[tuple[int, int]] = []
        """Row numbers of PID and joint: of the controller, then of each member."""
        self._shown: list[tuple[JointStateHandle, int]] = []

    def make_rows(self, joints: dict[int, int], reserve_pid: Callable[[Pid | None], int]) -> None:
        """Find the joints' rows, by the identity of their handles, and reserve rows for the PIDs."""
        own = Member(None, self.parts.joint, self.parts.pid)
        for _, joint, pid in (own, *self.parts.members):
            self._places.append((reserve_pid(pid), 0 if joint is None else joints[id(joint)]))
        self._shown = [(handle, joints[id(handle)] * JOINT.size) for handle in self.parts.shown]

    def fill(self, controllers: bytearray, number: int) -> None:
        """Write its row and its members' rows, and their addresses into the table of controllers."""
        own, *others = self._places
        self._form.row.fill(self._row, 0, self.controller, *own, self._is_wanted)
        for k, (member, places) in enumerate(zip(self.parts.members, others, strict=True)):
            self._form.members.fill(self._members, k, member.source, *places)
        parts = self.controller.parts()  # its numbers may be another object now
        self._numbers = memoryview(array("d") if parts is None or parts.numbers is None else parts.numbers)
        numbers = self._numbers
        if (numbers.format, numbers.ndim, numbers.c_contiguous, numbers.readonly) != ("d", 1, True, False):
            raise Refused(
                "the numbers of its parts() are not a writable block of doubles", 'for example array("d", ...)'
            )
        memory = (address_of(self._row), address_of(self._members), len(others))
        CONTROLLER.fill(controllers, number, None, self._law, *memory, address_of(self._numbers), len(self._numbers))

    def release(self) -> None:
        """Release the numbers: their address is no longer in use."""
        self._numbers.release()

    def give(self) -> None:
        """Write the rows back to the controller and its members."""
        self._form.row.give(self._row, 0, self.controller)
        if self._form.members.changing:
            for k, member in enumerate(self.parts.members):
                self._form.members.give(self._members, k, member.source)

    @property
    def _is_wanted(self) -> bool:
        return any(publisher.wanted for publisher in self.parts.publishers)

    def update_wanted(self) -> None:
        """Write into the row whether a publisher has a subscriber."""
        _FLAG.pack_into(self._row, self._form.row.size - _FLAG.size, self._is_wanted)

    def show(self, joints: bytearray) -> None:
        """Update the controller and its joints' handles from the rows, as far as `publish` reads them."""
        self.give()
        for handle, offset in self._shown:
            _show(joints, offset, handle)


def _compiled(entry: LoadedController, laws: LawCode) -> CompiledController | None:
    """The controller, if it can run compiled: for example not while a PID of it publishes each step.

    A subclass or an instance may override `update`, `publish` or a column, for example as a property. Then the compiled
    form of its parent is not valid for it.
    """
    controller = entry.controller
    form = controller.compiled
    if form is None or not entry.may_compile:
        return None
    classes = type(controller).__mro__
    owner = next(cls for cls in classes if "compiled" in vars(cls))
    heirs = itertools.takewhile(lambda cls: cls is not owner, classes)
    own = {"update", "publish"} & vars(controller).keys()
    if own or any(name in vars(heir) for heir in heirs for name in form.instead_of):
        return None
    parts = controller.parts()
    if parts is None or any(pid.observer is not None for pid in parts.pids()):
        return None
    law = laws.address(form)
    return CompiledController(entry, form, law, parts) if law else None
