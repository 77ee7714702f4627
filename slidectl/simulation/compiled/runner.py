"""The runner of compiled cycles: it calls the machine code, and does what that leaves to the interpreter.

The machine code returns (each return is a turn of the interpreter) for a robot or a controller without rows, for a
publication, and for a step that mj_step alone cannot make; then it continues from there. Robots stay in the tables
until other code reads them.
"""

from __future__ import annotations

import ctypes
from array import array
from functools import partial
from typing import TYPE_CHECKING

from slidectl.physics import EngineError
from slidectl.physics.mujoco_library import address_of, error_hook_address
from slidectl.simulation.compiled import tables as turns
from slidectl.simulation.compiled.object_file import Cycle
from slidectl.simulation.compiled.own_laws import LawCode
from slidectl.simulation.compiled.robot_rows import InterpretedUpdate, RobotRows
from slidectl.simulation.compiled.tables import NEW_CYCLE, Progress, Tables
from slidectl.simulation.cycle import CHECK_EVERY, Runner, is_sane
from slidectl.simulation.graph import WORLD_NODE
from slidectl.simulation.history import EVERY

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slidectl.simulation.loop import Loop
    from slidectl.simulation.spawned_robots import SpawnedRobot


_FEW_ROWS = 1000
"""With up to this number of unused rows it is not worth making all tables again."""

_FIRST_LOOK = 16
"""Cycles before `enough` is called for the first time."""


class CompiledRunner(Runner):
    """Runs the cycles of a loop's robots with the machine code `code`."""

    def __init__(self, loop: Loop, code: Cycle) -> None:
        self._loop = loop
        self._graph = loop.graph
        self._world = loop.world
        self._code = code
        self._progress = Progress(robot=NEW_CYCLE, error_hook=error_hook_address())
        self._step_address = address_of("mj_step")
        self._tables = Tables()
        self._laws = LawCode(code.laws, partial(loop.graph.log, "warn", WORLD_NODE))
        self._robots: Sequence[SpawnedRobot] = ()
        self._rows: list[RobotRows] = []
        """The rows of all robots, in their order."""
        self._rows_of: dict[SpawnedRobot, RobotRows] = {}
        self._is_new = True
        """True after robots were added or the world was rebuilt, until all have their rows."""
        self._given_back: list[RobotRows] = []
        """Rows of robots that are not loaded, until they are loaded again."""
        self._left_over = 0
        """The number of unused rows."""
        self._acting: InterpretedUpdate | None = None
        """The controller without a row that runs now."""
        self._topic_changes = -1
        self._addresses = array("Q")
        self._step: Callable[[], None] | None = None
        """The function `World.step` at the last check."""

    # -- loading and unloading robots ------------------------------------------------------------------------------

    def set_robots(self, robots: Sequence[SpawnedRobot]) -> None:
        """Replace the robots: by the same ones with more at the end, or by others."""
        if robots[: len(self._rows)] != self._robots[: len(self._rows)]:
            self._begin_again()
        self._robots = robots
        self._is_new = True

    def follow_world(self) -> None:
        """Follow a rebuilt world: unload robots whose indices in it have changed."""
        for rows in self._rows:
            if rows.has_moved():
                self._unload(rows)
        self._is_new = True

    def _begin_again(self) -> None:
        self.give_back_all()
        self._tables = Tables()
        self._left_over = 0
        self._rows.clear()
        self._rows_of.clear()
        self._given_back.clear()

    def give_back(self, robot: SpawnedRobot) -> None:
        """Bring the robot's objects up to date, before other code reads or changes them."""
        rows = self._rows_of.get(robot)
        if rows is not None:
            self._unload(rows)

    def compiled_controllers(self, robot: SpawnedRobot) -> frozenset[str]:
        """The names of the robot's running controllers that have rows."""
        rows = self._rows_of.get(robot)
        return frozenset() if rows is None or rows.is_outdated() else rows.compiled_controllers()

    def give_back_all(self) -> None:
        """Bring the objects of all robots up to date."""
        for rows in self._rows:
            self._unload(rows)

    def _unload(self, rows: RobotRows) -> None:
        if rows.is_loaded:
            if self._acting is not None and self._acting.rows is rows:  # its commands are newer than the rows
                self._acting.copy_commands()
            self._given_back.append(rows)
            rows.unload()

    def load_laws(self, wait: bool = False) -> None:
        """Load the code of users' laws that has been compiled meanwhile; with `wait`, wait for all of it."""
        if wait:
            self._prepare()  # requests the code of the laws
        changes = self._laws.changes
        self._laws.load_finished(wait)
        if self._laws.changes != changes:
            self.give_back_all()

    def _prepare(self) -> None:
        if self._is_new or any(rows.is_outdated() for rows in self._given_back):
            self._make_rows()
        for rows in self._given_back:
            if not rows.is_loaded and rows.fits():
                rows.load()
        self._given_back = [rows for rows in self._given_back if not rows.is_loaded]
        if self._topic_changes != self._graph.topics.changes:
            self._update_publications()

    def _make_rows(self) -> None:
        """Make rows for new robots, and new rows for robots that have changed."""
        if self._left_over > _FEW_ROWS + self._tables.rows // 2:
            self._begin_again()
        outdated = [rows for rows in self._given_back if rows.is_outdated()]
        for rows in outdated:
            self._left_over += rows.count
            self._rows[rows.number] = RobotRows(rows.robot, rows.number, self._tables, self._laws)
        self._given_back = [self._rows[rows.number] for rows in self._given_back]
        for robot in self._robots[len(self._rows) :]:
            self._rows.append(RobotRows(robot, self._tables.add("robots"), self._tables, self._laws))
            self._given_back.append(self._rows[-1])
        self._rows_of = {rows.robot: rows for rows in self._rows}
        self._find_memory()
        self._is_new = False

    def _find_memory(self) -> None:
        """Set the addresses of all tables and arrays for the machine code."""
        memory, progress = self._world.memory(), self._progress
        progress.robots = len(self._rows)
        progress.model, progress.data = memory.model, memory.data
        progress.positions, progress.dofs = memory.positions, memory.dofs
        addresses = self._tables.addresses()
        progress.controllers = addresses["controllers"]
        progress.joints, progress.pids = addresses["joints"], addresses["pids"]
        arrays = (*memory.arrays, self._loop.history.address)
        self._addresses = array("Q", [ctypes.addressof(progress), *addresses.values(), *arrays])

    def _update_publications(self) -> None:
        """Update which publishers have subscribers."""
        self._topic_changes = self._graph.topics.changes
        for rows in self._rows:
            for publication in rows.publications.values():
                publication.update_wanted()

    def _update_step(self) -> None:
        """Update which function makes the steps, and whether there are external efforts."""
        self._step = self._world.step
        self._progress.step = self._step_address if self._world.steps_alone else 0
        self._progress.has_outside = self._world.applied_forces.has_efforts

    # -- the cycles ------------------------------------------------------------------------------------------------

    def run(self, count: int) -> int:
        """Run at most `count` cycles, up to and with the first after which a timer is due, or the physics diverged."""
        loop, world, clock, progress = self._loop, self._world, self._graph.clock, self._progress
        before = clock.cycles
        progress.time_ns, progress.step_ns, progress.cycles = clock.time_ns, loop.step_ns, before
        # At real time this is called for every cycle, with cold caches: state is read again only after a change.
        if self._laws.compiling:
            self.load_laws()
        if self._is_new or self._given_back or self._topic_changes != self._graph.topics.changes:
            self._prepare()
        if self._step is not world.step or self._progress.has_outside != world.applied_forces.has_efforts:
            self._update_step()
        loop.in_cycle = True
        try:
            if loop.enough is None:
                self._run_turns(before + count)
            else:
                self._run_until_enough(before + count, loop.enough)
        finally:
            loop.in_cycle = False
            clock.time_ns = progress.time_ns
            clock.cycles = progress.cycles
            if progress.robot != NEW_CYCLE:  # an error ended the cycle early
                clock.cycles += 1
                self.give_back_all()
                progress.robot, progress.controller = NEW_CYCLE, 0
        done = clock.cycles - before
        if clock.time_ns >= self._graph.timers.next_ns:
            if not loop.driven:  # a script's own timers read the objects that the script holds
                self.give_back_all()
            self._graph.timers.fire()
        return done

    def _run_until_enough(self, end: int, enough: Callable[[], bool]) -> None:
        """Run few cycles, then twice as many between calls of `enough`: a call costs as much as a cycle."""
        progress, timers = self._progress, self._graph.timers
        some = _FIRST_LOOK
        while True:
            until = min(end, progress.cycles + some)
            to_check = self._run_turns(until)
            is_last = progress.cycles >= end or progress.cycles < until or progress.time_ns >= timers.next_ns
            if to_check or is_last or progress.cycles % CHECK_EVERY == 0 or enough():
                break
            some *= 2

    def _run_turns(self, end: int) -> bool:
        """Call the machine code and do its interpreter turns, until the last cycle, a due timer or a check.

        Returns True when the physics is to be checked.
        """
        progress, code = self._progress, self._code.run
        world, clock, timers, topics = self._world, self._graph.clock, self._graph.timers, self._graph.topics
        while True:
            self._allow(end)
            turn = code(self._addresses.buffer_info()[0])
            clock.time_ns = progress.time_ns
            to_check = turn == turns.DIVERGED
            if turn != turns.DONE and not to_check:
                self._run_in_interpreter(turn)
                if self._is_new:  # a switch may have changed the robot's motors
                    self._find_memory()
                if world.step is not self._step:  # external efforts or an observer of the steps were added
                    self._update_step()
                if topics.changes != self._topic_changes:
                    self._update_publications()
                if turn != turns.STEP_IN_PYTHON:  # in the middle of a cycle
                    continue
                # The machine code checks for divergence only when it makes the step itself.
                to_check = progress.cycles % CHECK_EVERY == 0 or not is_sane(world.views.qvel)
            if to_check or progress.cycles >= end or progress.time_ns >= timers.next_ns:
                return to_check

    def _allow(self, end: int) -> None:
        """Set how many cycles may run before the interpreter must check again: those up to `end`, and up to and with
        the one after which a timer is due, at least one. Each cycle begins here while /clock has subscribers, and when
        the loop has something to call before it."""
        progress, graph = self._progress, self._graph
        is_between_cycles = progress.robot == NEW_CYCLE
        if graph.clock_topic.publisher.wanted or self._loop.before_cycle:
            progress.left = 1
            if is_between_cycles:
                self._begin_cycle()
            return
        until_timer = -(-(graph.timers.next_ns - progress.time_ns) // progress.step_ns)
        if not is_between_cycles:  # the time is already that of the running cycle
            until_timer += 1
        progress.left = max(1, min(end - progress.cycles, until_timer))

    def _begin_cycle(self) -> None:
        progress, clock = self._progress, self._graph.clock
        progress.time_ns += progress.step_ns
        clock.time_ns = progress.time_ns
        progress.robot = 0
        if self._graph.clock_topic.publisher.wanted:
            self._graph.clock_topic.tick(progress.time_ns, progress.step_ns)
        for hook in self._loop.before_cycle:
            hook(progress.time_ns)
        if self._topic_changes != self._graph.topics.changes:
            self._update_publications()

    # -- the interpreter's turns -----------------------------------------------------------------------------------

    def _run_in_interpreter(self, turn: int) -> None:
        progress = self._progress
        if turn == turns.STEP_IN_PYTHON:
            self._make_step()
        elif turn == turns.FAILED:
            raise EngineError(self._code.error_text().decode(errors="replace"))
        elif turn == turns.ROBOT_IN_PYTHON:
            self._run_robot(self._rows[progress.robot])
        elif turn == turns.PUBLICATION:
            self._publish(self._rows[progress.robot], progress.controller - 1)
        elif turn == turns.NOT_FINITE:
            self._end_in_python(self._rows[progress.robot], progress.controller)
        elif turn == turns.LEFT:
            self._end_in_python(self._rows[progress.robot], progress.controller - 1)
        elif turn == turns.RAISED:
            failure = ArithmeticError("its compiled law failed: a division by zero, or an index beyond the end")
            self._end_in_python(self._rows[progress.robot], progress.controller, failure)
        else:
            self._update(self._rows[progress.robot], progress.controller - 1)

    def _make_step(self) -> None:
        progress = self._progress
        self._world.step()
        progress.robot = NEW_CYCLE
        progress.left -= 1
        progress.cycles += 1
        if progress.cycles % EVERY == 0:
            self._loop.history.keep(progress.time_ns)
        self._update_step()

    def _run_robot(self, rows: RobotRows) -> None:
        """Run the whole cycle of a robot that is not loaded; afterwards load it, when that is possible."""
        rows.parts.cycle.run(self._progress.time_ns)
        self._progress.robot += 1
        if rows.fits():
            rows.load()
        if rows.is_loaded:
            self._given_back = [other for other in self._given_back if other is not rows]

    def _publish(self, rows: RobotRows, position: int) -> None:
        publication = rows.publications[position]

        def publish(time_ns: int, period_s: float) -> None:
            publication.show(self._tables.content["joints"])
            rows.running[position].publish(time_ns, period_s)

        self._try(rows, position, publish)

    def _update(self, rows: RobotRows, position: int) -> None:
        interpreted = rows.interpreted[position]
        rows.show_joints()
        self._acting = interpreted
        self._try(rows, position, interpreted.update)
        if rows.is_loaded:
            interpreted.copy_commands()

    def _try(self, rows: RobotRows, position: int, action: Callable[[int, float], None]) -> None:
        """Call the action of one controller. If it fails, or unloads the robot, the interpreter ends the cycle."""
        failure: Exception | None = None
        try:
            action(self._progress.time_ns, rows.period_s())
        except Exception as raised:
            failure = raised
            self._unload(rows)
        finally:
            self._acting = None
        if not rows.is_loaded:
            self._end_in_python(rows, position + 1, failure)

    def _end_in_python(self, rows: RobotRows, done: int, failure: Exception | None = None) -> None:
        """End the robot's cycle in the interpreter; `done` of its controllers have already run in it."""
        self._unload(rows)
        time_ns = self._progress.time_ns
        rows.parts.manager.finish_update(done, time_ns, rows.period_s(), failure)
        rows.parts.cycle.write(time_ns)
        self._progress.controller = 0
        self._progress.robot += 1
