"""The control cycle: one robot's part of it, and the runners of a loop's cycles.

A robot's part is read, update, limits and write, in the order of gazebo_ros_control. The interpreter runs the cycles
in this file, machine code in `compiled/`, with the same results to the bit. This is the hot path of the whole program;
times are integer nanoseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from slidectl.control.duration import to_seconds
from slidectl.control.laws import law
from slidectl.control.user_classes import HookGuard, is_of_a_user, raised
from slidectl.control.user_modules import UserCode
from slidectl.errors import SlidectlError
from slidectl.physics import HUGE
from slidectl.simulation.history import EVERY

if TYPE_CHECKING:
    from slidectl.control.controller_manager import ControllerManager
    from slidectl.control.hardware_interface import RobotHW
    from slidectl.simulation.loop import Loop
    from slidectl.simulation.spawned_robots import SpawnedRobot

CHECK_EVERY = 256
"""Cycles between two divergence checks of the physics; counted from time 0, however the steps are divided."""
_LOOK_MASK = 7
"""The interpreter calls `enough` once in this number of cycles plus one."""


@law
def control_is_due(cycle: ControlCycle, time_ns: int) -> bool:
    """True when the controllers run in the cycle at this time. `period_s` is then the time since their last run."""
    elapsed = time_ns - cycle.last_update_ns
    if elapsed < cycle.control_period_ns:
        return False
    cycle.last_update_ns = time_ns
    if elapsed != cycle.period_ns:
        cycle.period_ns = elapsed
        cycle.period_s = to_seconds(elapsed)
    return True


@law
def begin_to_write(cycle: ControlCycle, time_ns: int) -> float:
    """Begin the write. Returns the time since the last one, s."""
    elapsed = time_ns - cycle.last_write_ns
    cycle.last_write_ns = time_ns
    if elapsed != cycle.write_period_ns:
        cycle.write_period_ns = elapsed
        cycle.write_period_s = to_seconds(elapsed)
    return cycle.write_period_s


def is_sane(velocities: memoryview[float]) -> bool:
    """True when no velocity is huge or NaN: the rule of the compiled cycle, in the interpreter."""
    for velocity in velocities:  # noqa: SIM110 - half the time of a generator, in each cycle
        if not -HUGE < velocity < HUGE:
            return False
    return True


class CycleFailed(SlidectlError):
    """Code of a user's class, hardware or a feature, has failed in a cycle, which cannot go on without it."""


def guarded(hook: Callable[..., None], what: str, cls: type, code: UserCode) -> Callable[..., None]:
    """The hook of the class. That of a user's is wrapped: any exception becomes CycleFailed, with file and line."""
    if not is_of_a_user(cls):
        return hook
    guard = HookGuard(cls, code)

    def call(*arguments: Any) -> None:
        try:
            with guard:
                hook(*arguments)
        except Exception as failure:
            text = failure.message if issubclass(type(failure), SlidectlError) else raised(failure)  # type: ignore[attr-defined]
            raise CycleFailed(f"{what}: {text}") from failure

    return call


class Stages(NamedTuple):
    """The functions that a robot's cycle calls, in this order. `update` is ControllerManager.update."""

    read: Callable[[int, float], None]
    update: Callable[..., None]
    write: Callable[[int, float], None]


class ControlCycle:
    """Calls the hardware and the controller manager of one robot as GazeboRosControlPlugin::Update does.

    Controllers run when `control_period_ns` has passed since their last run; the hardware is written in every cycle.
    """

    saved_attributes: ClassVar[tuple[str, ...]] = (
        "control_period_ns",
        "emergency_stop",
        "_was_stopped",
        "last_update_ns",
        "last_write_ns",
        "period_ns",
        "period_s",
        "write_period_ns",
        "write_period_s",
    )

    __slots__ = (
        "_interceptors",
        "_read",
        "_stages",
        "_update",
        "_write",
        "is_intercepted",
        *saved_attributes,
    )

    def __init__(self, hardware: RobotHW, manager: ControllerManager, control_period_ns: int, time_ns: int) -> None:
        """`time_ns` is the present time. From 0 the first period would be the whole simulated time so far."""
        cls, code = type(hardware), manager.known.code
        read = guarded(hardware.read, f"{cls.__name__}.read", cls, code)
        write = guarded(hardware.write, f"{cls.__name__}.write", cls, code)
        self._stages = Stages(read, manager.update, write)
        self._interceptors: dict[object, Callable[[Stages], Stages]] = {}
        self._read, self._update, self._write = self._stages
        self.is_intercepted = False
        self.control_period_ns = control_period_ns
        self.emergency_stop = False
        self._was_stopped = False
        self.rewind(time_ns)

    @property
    def is_stopped(self) -> bool:
        """True while controllers run under an emergency stop, and until the first update after it."""
        return self.emergency_stop or self._was_stopped

    def intercept(self, owner: object, make: Callable[[Stages], Stages] | None) -> None:
        """Replace the stages by those that `make` returns for the present ones; None ends that of this owner.

        The stages of the owner that came last are called first. Replaced stages run in the interpreter only.
        """
        if make is None:
            self._interceptors.pop(owner, None)
        else:
            self._interceptors[owner] = make
        self.is_intercepted = bool(self._interceptors)
        stages = self._stages
        for one in self._interceptors.values():
            stages = one(stages)
        self._read, self._update, self._write = stages

    def read_joints(self, time_ns: int) -> None:
        """Read the joints outside of a cycle."""
        self._read(time_ns, 0.0)

    def rewind(self, time_ns: int) -> None:
        """Count the periods of the next cycle from this time."""
        self.last_update_ns = self.last_write_ns = time_ns
        self.period_ns = self.write_period_ns = 0
        self.period_s = self.write_period_s = 0.0

    def run(self, time_ns: int) -> None:
        """Run the cycle at `time_ns`, before the physics step."""
        if control_is_due(self, time_ns):
            self._read(time_ns, self.period_s)
            if self.emergency_stop or self._was_stopped:
                self._update(time_ns, self.period_s, not self.emergency_stop)
                self._was_stopped = self.emergency_stop
            else:
                self._update(time_ns, self.period_s)
        self.write(time_ns)

    def write(self, time_ns: int) -> None:
        """Apply limits and write commands: the end of the cycle at `time_ns`."""
        self._write(time_ns, begin_to_write(self, time_ns))


class Runner:
    """Runs cycles: the clock advances, each robot's part runs, the physics steps, timers fire.

    A runner may keep the state of robots in memory of its own. Before other code reads a robot, the runner writes the
    state back to that robot.
    """

    def run(self, count: int) -> int:
        """Run at most `count` cycles, up to and with the first after which a timer is due, the physics is to be
        checked or has a huge velocity, or `enough` returns True.

        Returns the number run. Raises EngineError: MuJoCo cannot go on.
        """
        raise NotImplementedError

    def set_robots(self, robots: Sequence[SpawnedRobot]) -> None:
        """Replace the robots, in this order."""
        raise NotImplementedError

    def give_back(self, robot: SpawnedRobot) -> None:
        """Bring the robot's objects up to date, before other code reads or changes them."""

    def give_back_all(self) -> None:
        """Bring the objects of all robots up to date."""

    def follow_world(self) -> None:
        """Follow a rebuilt world: the indices of robots in it may have changed."""

    def compiled_controllers(self, robot: SpawnedRobot) -> frozenset[str]:  # noqa: ARG002
        """The names of the robot's controllers that run as machine code."""
        return frozenset()


class PlainRunner(Runner):
    """The interpreter. Its robots are always up to date."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._cycles: tuple[Callable[[int], None], ...] = ()

    def set_robots(self, robots: Sequence[SpawnedRobot]) -> None:
        self._cycles = (*self._loop.before_cycle, *(robot.parts.cycle.run for robot in robots))

    def run(self, count: int) -> int:
        loop, world, robots = self._loop, self._loop.world, self._cycles
        clock, timers, clock_topic, step_ns = loop.graph.clock, loop.graph.timers, loop.graph.clock_topic, loop.step_ns
        clock_publisher, enough, velocities = clock_topic.publisher, loop.enough, world.views.qvel
        time_ns = clock.time_ns
        keep, done, kept = loop.history.keep, 0, EVERY - clock.cycles % EVERY
        loop.in_cycle = True
        try:
            for done in range(1, min(count, CHECK_EVERY - clock.cycles % CHECK_EVERY) + 1):
                time_ns += step_ns
                clock.time_ns = time_ns
                if clock_publisher.wanted:
                    clock_topic.tick(time_ns, step_ns)
                for robot in robots:
                    robot(time_ns)
                world.step()
                if done == kept:
                    keep(time_ns)
                    kept += EVERY
                if not is_sane(velocities):
                    break
                if time_ns >= timers.next_ns or (enough is not None and not done & _LOOK_MASK and enough()):
                    break
        finally:
            loop.in_cycle = False
            clock.cycles += done
        if time_ns >= timers.next_ns:
            timers.fire()
        return done
