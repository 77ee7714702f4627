"""Injected faults of sensors, commands, joints, masses, controllers and topics; the services `/slidectl/fault/*`.

The effect of a fault depends on its seed and the simulated time only: every run gives the same bits. The interpreter
runs the cycle of a robot while it has faults that are not over; robots and topics without faults are not touched.
"""

from __future__ import annotations

import json
import math
from bisect import bisect_right, insort
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from operator import itemgetter
from random import Random
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from slidectl import names
from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message
from slidectl.effects import Effect
from slidectl.errors import Refused, SlidectlError, UnknownName, UsageError, quoted
from slidectl.fault_kinds import KINDS, OPTIONS, QUANTITIES, REQUIRED, check_span, checked_options
from slidectl.physics import World
from slidectl.physics.model_changes import Change, JointFriction, Payload, StuckJoint
from slidectl.simulation.clock import NEVER, SECOND, Timer
from slidectl.simulation.feature import Feature

if TYPE_CHECKING:
    from slidectl.simulation.cycle import Stages
    from slidectl.simulation.simulation import Simulation
    from slidectl.simulation.spawned_robots import SpawnedRobot

Values = list[float]
_MOST_WAITING = 10_000
"""The most late messages of one topic."""


class FaultRequest(NamedTuple):
    """A checked request for a fault. It acts in cycles with a time from `start_ns` on and before `end_ns`."""

    name: str
    kind: str
    target: str
    """The full name: /ROBOT/JOINT, /ROBOT/LINK, the controller in its namespace, or the topic."""
    robot: str
    """The robot's name; empty for a topic."""
    part: str
    """The joint, link or controller, by its name within the robot."""
    start_ns: int
    end_ns: int
    """NEVER: it lasts until it is removed."""
    seed: int
    options: dict[str, Any]


class Fault:
    """One fault, and its state so far. Subclasses define the effect."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("count", "is_done")

    def __init__(self, request: FaultRequest) -> None:
        self.request = request
        self.count = 0
        """The number of cycles, or messages, in which it acted."""
        self.is_done = False
        """True for a fault that happens once and has happened."""

    def holds(self, time_ns: int) -> bool:
        """True when it acts at that time."""
        return self.request.start_ns <= time_ns < self.request.end_ns and not self.is_done

    def is_over(self, time_ns: int) -> bool:
        """True when it will not act any more."""
        return time_ns >= self.request.end_ns or self.is_done

    def source(self, number: int) -> Random:
        """The random numbers for one cycle or message, seeded by seed, kind, target and number."""
        return Random(f"{self.request.seed}/{self.request.kind}/{self.request.target}/{number}")

    def end(self) -> None:
        """Undo what the fault changed, and discard its state."""

    def message(self, time_ns: int) -> Message:
        """The fault as slidectl/Fault."""
        request = self.request
        return {
            "name": request.name,
            "kind": request.kind,
            "target": request.target,
            "start": request.start_ns / SECOND,
            "end": math.inf if request.end_ns == NEVER else request.end_ns / SECOND,
            "seed": request.seed,
            "options": json.dumps(request.options),
            "state": "over" if self.is_over(time_ns) else "active" if time_ns >= request.start_ns else "waiting",
            "count": self.count,
        }


# -- faults of robots --------------------------------------------------------------------------------------------------


class RobotFault(Fault):
    """A fault in a robot's cycle. Each stage passes in `acts` whether the fault acts at that time."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("busy_until_ns",)

    busy_until_ns = 0
    """The end of a slow update that began with the last read; 0 when there is none."""

    def __init__(self, request: FaultRequest, robot: SpawnedRobot) -> None:
        super().__init__(request)
        self.robot = robot
        self.part = request.part

    def after_read(self, time_ns: int, acts: bool) -> None:
        """Called after the joints were read."""

    def before_update(self, acts: bool) -> None:
        """Called before the controllers run."""

    def before_write(self, time_ns: int, acts: bool) -> None:
        """Called after the controllers have run."""

    def before_step(self, acts: bool) -> None:
        """Called before the physics step, with commands written, or during a long update."""


class SignalFault(RobotFault):
    """Changes a joint's reading or command. By default the new values are a function of the present ones.

    Subclasses override `change`.
    """

    def __init__(self, request: FaultRequest, robot: SpawnedRobot) -> None:
        super().__init__(request, robot)
        self.is_of_command = request.kind.startswith("command")

    def change(self, time_ns: int, values: Values) -> Values | None:
        """The changed values; None when the fault leaves them as they are."""
        changed = _CHANGES[self.request.kind](self, time_ns, values)
        return None if changed == values else changed

    def note(self, time_ns: int, values: Values) -> None:
        """Called with the values while the fault does not act."""

    def commands(self) -> Sequence[tuple[Any, str]]:
        """The handle that commands the joint now, with each of its command attributes."""
        return self.robot.parts.hardware.commands(self.part)

    def after_read(self, time_ns: int, acts: bool) -> None:
        if not self.is_of_command:
            quantities = QUANTITIES if self.request.options["of"] == "all" else [self.request.options["of"]]
            handles = self.robot.parts.hardware.handles(self.part)
            self._pass(time_ns, acts, [[(handle, quantity) for quantity in quantities] for handle in handles])

    def before_write(self, time_ns: int, acts: bool) -> None:
        if self.is_of_command:
            self._pass(time_ns, acts, [self.commands()])

    def _pass(self, time_ns: int, acts: bool, places: Sequence[Sequence[tuple[Any, str]]]) -> None:
        """Change the values of the first places, and set the others to the same."""
        values = [getattr(handle, attribute) for handle, attribute in places[0]]
        if not acts:
            self.note(time_ns, values)
            return
        changed = self.change(time_ns, values)
        if changed is not None:
            self.count += 1
            for like in places:
                for (handle, attribute), value in zip(like, changed, strict=True):
                    setattr(handle, attribute, value)


def _add_noise(fault: SignalFault, time_ns: int, values: Values) -> Values:
    source = fault.source(time_ns)
    return [value + source.gauss(0.0, fault.request.options["sd"]) for value in values]


def _add_drift(fault: SignalFault, time_ns: int, values: Values) -> Values:
    drift = fault.request.options["rate"] * ((time_ns - fault.request.start_ns) / SECOND)
    return [value + drift for value in values]


def _saturate(fault: SignalFault, _: int, values: Values) -> Values:
    most = fault.request.options["limit"]
    return [min(max(values[0], -most), most), *values[1:]]


def _quantise(fault: SignalFault, _: int, values: Values) -> Values:
    step = fault.request.options["step"]
    return [step * math.floor(value / step + 0.5) for value in values]


_CHANGES: dict[str, Callable[[SignalFault, int, Values], Values]] = {
    "sensor-noise": _add_noise,
    "sensor-bias": lambda fault, _, values: [value + fault.request.options["bias"] for value in values],
    "sensor-drift": _add_drift,
    "sensor-quantisation": _quantise,
    "command-saturation": _saturate,
    "command-reversed": lambda _fault, _time_ns, values: [-value for value in values],
}


class LostSignal(SignalFault):
    """Keeps the last values that came through. Without the option `probability` nothing comes through."""

    saved_or_none: ClassVar[tuple[str, ...]] = ("kept",)

    kept: Values | None = None

    def note(self, time_ns: int, values: Values) -> None:  # noqa: ARG002
        self.kept = values

    def change(self, time_ns: int, values: Values) -> Values | None:
        probability = self.request.options.get("probability", 1.0)
        if self.kept is None or len(self.kept) != len(values) or self.source(time_ns).random() >= probability:
            self.kept = values
            return None
        return self.kept

    def end(self) -> None:
        self.kept = None


class LateSignal(SignalFault):
    """Delays the values by a time; before that has passed, the first known values are used."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("past",)

    def __init__(self, request: FaultRequest, robot: SpawnedRobot) -> None:
        super().__init__(request, robot)
        self.past: deque[tuple[int, Values]] = deque()
        """Times and values; the first entry is the one in use."""

    def note(self, time_ns: int, values: Values) -> None:
        if self.past and self.past[-1][0] == time_ns:
            self.past.pop()
        self.past.append((time_ns, values))
        then = time_ns - from_seconds(self.request.options["delay"])
        while len(self.past) > 1 and self.past[1][0] <= then:
            self.past.popleft()

    def change(self, time_ns: int, values: Values) -> Values | None:
        if self.past and len(self.past[0][1]) != len(values):  # another interface drives the joint
            self.past.clear()
        self.note(time_ns, values)
        return self.past[0][1]

    def end(self) -> None:
        self.past.clear()


class ChangeFault(RobotFault):
    """Changes the model while the fault acts."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("change",)

    def __init__(self, request: FaultRequest, robot: SpawnedRobot, change: Change) -> None:
        super().__init__(request, robot)
        self.change = change

    def excludes(self, other: ChangeFault) -> bool:
        """True when both change the same at overlapping times."""
        last_start_ns = max(self.request.start_ns, other.request.start_ns)
        if self.robot is not other.robot or last_start_ns >= min(self.request.end_ns, other.request.end_ns):
            return False
        if isinstance(self.change, Payload):
            return isinstance(other.change, Payload) and self.change.body == other.change.body
        return self.part == other.part and not isinstance(other.change, Payload)

    def after_read(self, time_ns: int, acts: bool) -> None:  # noqa: ARG002
        if acts and isinstance(self.change, StuckJoint) and (effort := self.change.effort()) is not None:
            for handle in self.robot.parts.hardware.handles(self.part):
                handle.effort = effort

    def before_step(self, acts: bool) -> None:
        if acts:
            self.change.hold()
            self.count += 1

    def end(self) -> None:
        self.change.release()


class PushFault(RobotFault):
    """A wrench on a link."""

    def __init__(self, request: FaultRequest, robot: SpawnedRobot, world: World) -> None:
        super().__init__(request, robot)
        self._world = world

    def before_step(self, acts: bool) -> None:
        if not acts:
            return
        self.count += 1
        world, request = self._world, self.request
        if not any(wrench.source == request.name for wrench in world.applied_forces.wrenches):  # a reset removes it
            duration_ns = -1 if request.end_ns == NEVER else request.end_ns - request.start_ns - 1
            acting = request.options["force"], request.options["torque"], request.start_ns, duration_ns
            world.add_wrench(self.robot.name, self.part, *acting, request.name)

    def end(self) -> None:
        self._world.drop_wrenches(self.request.name)


class RaisedByFault(SlidectlError):
    """The exception of a controller with the fault `controller-raise`."""


class ControllerFault(RobotFault):
    """A controller raises, is killed, or has a slow update."""

    def before_update(self, acts: bool) -> None:
        manager, kind = self.robot.parts.manager, self.request.kind
        if acts and kind == "controller-raise":
            self.is_done = manager.fail(self.part, RaisedByFault(f"fault {self.request.name!r} made it raise"))
        elif acts and kind == "controller-kill":
            self.is_done = manager.kill(self.part)
        self.count += self.is_done

    def is_over(self, time_ns: int) -> bool:
        return super().is_over(time_ns) and time_ns >= self.busy_until_ns

    def begin_update(self, time_ns: int) -> None:
        """Begin the controller's update; a `controller-slow` fault makes it long."""
        is_running = any(entry.name == self.part for entry in self.robot.parts.manager.running)
        if self.request.kind == "controller-slow" and is_running and self.holds(time_ns):
            self.count += 1
            self.busy_until_ns = time_ns + from_seconds(self.request.options["takes"])

    def before_write(self, time_ns: int, acts: bool) -> None:  # noqa: ARG002
        self.busy_until_ns = 0

    def end(self) -> None:
        self.busy_until_ns = 0


class FaultyCycle:
    """The stages of a robot's cycle with its faults, in the order in which the faults were added.

    Each read begins with the true values of the last read, from which angles are unwrapped. Each write ends with the
    commands of the controllers.
    """

    saved_attributes: ClassVar[tuple[str, ...]] = ("_faults", "_true", "_updated_ns", "_written_ns")

    _stages: Stages
    """The cycle's own stages."""

    def __init__(self, robot: SpawnedRobot) -> None:
        self._robot = robot
        self._faults: list[RobotFault] = []
        """The faults that are not over."""
        self._true: list[tuple[Any, float, float, float]] = []
        """Handles of the joints, with the true values of the last read."""
        self._updated_ns = self._written_ns = 0
        """Times of the last update and the last write before an update that takes long."""

    def set_faults(self, faults: list[RobotFault]) -> None:
        """Replace the active faults."""
        self.restore_true_values()
        self._faults = faults
        self.follow()

    def follow(self) -> None:
        """Put these stages into the robot's cycle while there are faults; without faults, restore its own."""

        def around(own: Stages) -> Stages:
            self._stages = own
            return own._replace(read=self.read, update=self.update, write=self.write)

        self._robot.parts.cycle.intercept(self, around if self._faults else None)

    def read(self, time_ns: int, period_s: float) -> None:
        if any(fault.busy_until_ns for fault in self._faults):
            return
        self.restore_true_values()
        self._stages.read(time_ns, period_s)
        hardware = self._robot.parts.hardware
        handles = [handle for joint in hardware.interfaces() for handle in hardware.handles(joint)]
        self._true = [(handle, handle.position, handle.velocity, handle.effort) for handle in handles]
        faults = self._current(time_ns)
        for fault in faults:
            fault.after_read(time_ns, fault.holds(time_ns))
        if period_s > 0.0:  # in a cycle
            for fault in faults:
                if isinstance(fault, ControllerFault):
                    fault.begin_update(time_ns)
            if any(fault.busy_until_ns for fault in faults):
                cycle = self._robot.parts.cycle
                self._updated_ns, self._written_ns = time_ns - cycle.period_ns, cycle.last_write_ns

    def update(self, time_ns: int, period_s: float, reset_controllers: bool = False) -> None:
        faults = self._current(time_ns)
        if any(time_ns < fault.busy_until_ns for fault in faults):
            self._robot.parts.cycle.last_update_ns = self._updated_ns
            return
        for fault in faults:
            fault.before_update(fault.holds(time_ns))
        self._stages.update(time_ns, period_s, reset_controllers)

    def write(self, time_ns: int, period_s: float) -> None:
        faults = self._current(time_ns)
        if any(time_ns < fault.busy_until_ns for fault in faults):
            self._robot.parts.cycle.last_write_ns = self._written_ns
        else:
            self._write(time_ns, period_s, faults)
        for fault in faults:
            fault.before_step(fault.holds(time_ns))

    def _write(self, time_ns: int, period_s: float, faults: list[RobotFault]) -> None:
        signals = [fault for fault in faults if isinstance(fault, SignalFault) and fault.is_of_command]
        places = [place for fault in signals for place in fault.commands()]
        commands = [(handle, attribute, getattr(handle, attribute)) for handle, attribute in places]
        for fault in faults:
            fault.before_write(time_ns, fault.holds(time_ns))
        self._stages.write(time_ns, period_s)
        for handle, attribute, command in commands:
            setattr(handle, attribute, command)

    def restore_true_values(self) -> None:
        """Set the handles to the true values of the last read."""
        for handle, position, velocity, effort in self._true:
            handle.position, handle.velocity, handle.effort = position, velocity, effort
        self._true = []

    def _current(self, time_ns: int) -> list[RobotFault]:
        """The faults that are not over. Faults that have just ended are undone."""
        over = [fault for fault in self._faults if fault.is_over(time_ns)]
        if over:
            for fault in over:
                fault.end()
            self._faults = [fault for fault in self._faults if fault not in over]
            if not self._faults:
                self.restore_true_values()
                self.follow()
        return self._faults


# -- faults of topics --------------------------------------------------------------------------------------------------


class TopicFault(Fault):
    """Drops or delays messages."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("seen",)

    seen = 0
    """The number of messages that came while it acted."""

    def lateness_ns(self) -> int | None:
        """The delay of the next message; None when it is dropped."""
        self.seen += 1
        if self.source(self.seen).random() >= self.request.options["probability"]:
            return 0
        self.count += 1
        return from_seconds(self.request.options["delay"]) if "delay" in self.request.options else None

    def end(self) -> None:
        self.seen = 0


class FaultyTopic:
    """Passes the messages of one topic through its faults, in the order in which the faults were added."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("waiting", "_timer")

    def __init__(self, simulation: Simulation, topic: str) -> None:
        self._graph = simulation.graph
        self._topic = topic
        self._faults: list[TopicFault] = []
        self.waiting: list[tuple[int, TopicFault, Message]] = []
        """Late messages in the order of their due times, each with the fault that delays it."""
        self._is_full = False
        self._timer = Timer(0, self._deliver)
        self._timer.cancel()

    def handle(self, message: Message, behind: TopicFault | None = None) -> None:
        """Pass on a message; with `behind`, one that this fault has delayed."""
        now_ns = self._graph.clock.time_ns
        for fault in self._faults[0 if behind is None else self._faults.index(behind) + 1 :]:
            late_ns = fault.lateness_ns() if fault.holds(now_ns) else 0
            if late_ns is None:
                return
            if late_ns:
                self._hold(now_ns + late_ns, fault, message)
                return
        self._graph.topics.hand_on(self._topic, message, self.handle)

    def set_faults(self, faults: list[TopicFault]) -> None:
        """Replace the faults, and drop late messages of others."""
        self._faults = faults
        self.waiting = [late for late in self.waiting if late[1] in faults]
        self._arm()

    def _hold(self, due_ns: int, fault: TopicFault, message: Message) -> None:
        if len(self.waiting) < _MOST_WAITING:
            insort(self.waiting, (due_ns, fault, message), key=_DUE)
            if self.waiting[0][2] is message:
                self._arm()
        elif not self._is_full:
            self._is_full = True
            text = f"{_MOST_WAITING} late messages of {self._topic} wait, the most: others get lost"
            self._graph.log("warn", names.OWN_NODE, text)

    def _arm(self) -> None:
        self._timer.cancel()
        if self.waiting:
            self._graph.timers.arm(self._timer, self.waiting[0][0])

    def _deliver(self) -> None:
        count = bisect_right(self.waiting, self._graph.clock.time_ns, key=_DUE)
        due = self.waiting[:count]
        del self.waiting[:count]
        for _, fault, message in due:
            if fault in self._faults:  # a subscriber may remove faults
                with suppress(SlidectlError):  # the publisher cannot receive an error any more
                    self.handle(message, fault)
        self._arm()


_DUE = itemgetter(0)


# -- all faults --------------------------------------------------------------------------------------------------------

_SIGNALS: dict[str, type[SignalFault]] = {
    **dict.fromkeys(_CHANGES, SignalFault),
    **dict.fromkeys(("sensor-dropout", "sensor-frozen", "command-loss"), LostSignal),
    **dict.fromkeys(("sensor-delay", "command-delay"), LateSignal),
}


class Faults(Feature):
    """The faults of one simulation, by name, in the order in which they were added."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("_faults", "_cycles", "_topics")

    MOST: ClassVar[int] = 1000

    def attach(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._graph = simulation.graph
        self._faults: dict[str, Fault] = {}
        self._cycles: dict[str, FaultyCycle] = {}
        """Cycles of the robots that have faults, by name."""
        self._topics: dict[str, FaultyTopic] = {}
        node = simulation.graph.node(names.join(names.OWN_NODE, "fault"), names.OWN_NODE)
        node.advertise_service("add", "slidectl/AddFault", self._serve_add)
        node.advertise_service("remove", "slidectl/RemoveFaults", lambda r: {"names": self.remove(*r["names"])})
        node.advertise_service("list", "slidectl/ListFaults", lambda _: {"faults": self.messages()}, Effect.READS)
        node.advertise_service("kinds", "slidectl/ListFaultKinds", _serve_kinds, Effect.READS)

    def add(
        self,
        target: str,
        kind: str,
        start: float | None = None,
        end: float | None = None,
        seed: int = 0,
        name: str = "",
        namespace: str = "/",
        **options: Any,
    ) -> Message:
        """Add a fault from one simulated time (s; default: now) to another (default: its removal).

        Returns slidectl/Fault.

        Raises:
            UnknownName, AmbiguousName: no such kind or target. UsageError: options that the kind does not have.
            Refused: a time in the past, a name in use, a fault that excludes this one.
        """
        self._simulation.loop.between_cycles("add a fault")
        checked = checked_options(kind, options)
        now_ns = self._graph.clock.time_ns
        start_ns = now_ns if start is None else from_seconds(start)
        end_ns = NEVER if end is None or end == math.inf else from_seconds(end)
        if start_ns < now_ns:
            hint = "leave the beginning out for now; slidectl sim reset --time begins at 0 again"
            raise Refused(f"it is {now_ns / SECOND:g} s already: a fault cannot begin at {start_ns / SECOND:g} s", hint)
        check_span(start_ns / SECOND, end_ns / SECOND)
        if len(self._faults) >= self.MOST:
            raise Refused(f"there are {self.MOST} faults already, the maximum", "slidectl fault clear")
        target_kind = KINDS[kind].target
        targets = self._targets(target_kind)
        full = names.resolve(target, targets, kind=target_kind, namespace=namespace)
        robot, part = targets[full]
        owner = robot.name if robot is not None else ""
        request = FaultRequest(self._free_name(name, kind), kind, full, owner, part, start_ns, end_ns, seed, checked)
        fault = self._made(request)
        if isinstance(fault, ChangeFault):
            fault.change.check()
            for other in self._faults.values():
                if isinstance(other, ChangeFault) and fault.excludes(other):
                    text = f"{other.request.kind} {other.request.name!r} is on {other.request.target} in that time"
                    hint = "give other times, or remove that one first"
                    raise Refused(f"{text}, and the two exclude each other", hint)
        if isinstance(fault, RobotFault):
            fault.robot.node.enter()  # brings its handles up to date
            fault.after_read(now_ns, False)
            fault.before_write(now_ns, False)
        self._faults[request.name] = fault
        self._install(fault)
        return fault.message(now_ns)

    def remove(self, *wanted: str) -> list[str]:
        """Remove these faults, all or none; without names, all. Returns their names. Raises UnknownName."""
        self._simulation.loop.between_cycles("remove a fault")
        for name in wanted:
            if name not in self._faults:
                raise UnknownName("fault", name, list(self._faults))
        gone = list(dict.fromkeys(wanted)) or list(self._faults)
        for name in gone:
            fault = self._faults.pop(name)
            fault.end()
            self._install(fault)
        return gone

    def save_parts(self) -> list[Any]:
        """The requests of all faults."""
        return [fault.request for fault in self._faults.values()]

    def drop_parts(self) -> None:
        self.remove()

    def make_parts(self, parts: list[Any]) -> None:
        """Replace all faults by new ones for these requests.

        Raises Refused: there is no such part. UsageError: the options, the name, a time or the seed is wrong.
        """
        wanted = [FaultRequest(*one) for one in parts]
        for request in wanted:
            _check(request)
            kind = KINDS[request.kind].target
            if kind not in ("topic", "controller"):  # these may have been removed since
                robot, part = self._targets(kind).get(request.target, (None, ""))
                if robot is None or (robot.name, part) != (request.robot, request.part):
                    raise Refused(f"the fault {request.name} is on the {kind} {request.target}, which is not there")
        self._faults = {request.name: self._made(request) for request in wanted}
        for fault in self._faults.values():
            self._install(fault)

    def resume(self) -> None:
        """Apply restored changes of the model again, before the world gets its own state."""
        for fault in self._faults.values():
            if isinstance(fault, ChangeFault) and fault.change.is_held:
                fault.change.hold()
        for cycle in self._cycles.values():
            cycle.follow()

    def status(self) -> Message:
        return {"faults": [fault["name"] for fault in self.messages() if fault["state"] != "over"]}

    def messages(self) -> list[Message]:
        """All faults, each as slidectl/Fault."""
        return [fault.message(self._graph.clock.time_ns) for fault in self._faults.values()]

    def reset(self) -> None:
        """They act again at their times, if these are still to come."""
        for fault in self._faults.values():
            fault.end()
            if self._graph.clock.time_ns < fault.request.start_ns or not self._graph.clock.time_ns:
                fault.count, fault.is_done = 0, False
        for topic in self._topics.values():
            topic.set_faults([])
        for fault in self._faults.values():
            self._install(fault)

    def _install(self, changed: Fault) -> None:
        """Update the robot or topic of a fault to its present faults."""
        if isinstance(changed, TopicFault):
            topic = changed.request.target
            faults = [
                one for one in self._faults.values() if isinstance(one, TopicFault) and one.request.target == topic
            ]
            faulty = self._topics.setdefault(topic, FaultyTopic(self._simulation, topic))
            faulty.set_faults(faults)
            if not faults:
                del self._topics[topic]
            self._graph.topics.intercept(topic, faulty.handle, begins=bool(faults))
            return
        assert isinstance(changed, RobotFault)
        robot, time_ns = changed.robot, self._graph.clock.time_ns
        mine = [one for one in self._faults.values() if isinstance(one, RobotFault) and one.robot is robot]
        cycle = self._cycles.setdefault(robot.name, FaultyCycle(robot))
        cycle.set_faults([fault for fault in mine if not fault.is_over(time_ns)])
        if not mine:
            del self._cycles[robot.name]

    def on_delete(self, robot: SpawnedRobot) -> None:
        """Drop the robot's faults."""
        self._cycles.pop(robot.name, None)
        for name, fault in list(self._faults.items()):
            if isinstance(fault, RobotFault) and fault.robot is robot:
                del self._faults[name]

    def _targets(self, kind: str) -> dict[str, tuple[SpawnedRobot | None, str]]:
        """All possible targets of a kind, by full name; topics have no robot."""
        robots = [robot for robot in self._simulation.robots if robot.is_controlled]
        if kind == "topic":
            return dict.fromkeys(self._graph.topics.names(), (None, ""))
        if kind == "controller":
            return {
                names.join(robot.namespace, name): (robot, name)
                for robot in robots
                for name in robot.parts.manager.names()
            }
        parts: dict[str, Callable[[SpawnedRobot], Any]] = {
            "joint": lambda robot: robot.parts.hardware.interfaces(),
            "moving joint": lambda robot: robot.attached.joints,
            "link": lambda robot: [link for link in robot.description.links if link != "world"],
        }
        return {f"/{robot.name}/{part}": (robot, part) for robot in robots for part in parts[kind](robot)}

    def _free_name(self, name: str, kind: str) -> str:
        if name in self._faults:
            raise Refused(f"there is a fault {name!r} already", "give another name, or remove that one first")
        if name and not names.is_component(name):
            raise UsageError(f"{quoted(name)} is not a name for a fault: a letter, then letters, digits and '_'")
        stem, number = kind.replace("-", "_"), 1
        while f"{stem}_{number}" in self._faults:
            number += 1
        return name or f"{stem}_{number}"

    def _made(self, request: FaultRequest) -> Fault:
        kind, options, world = request.kind, request.options, self._simulation.world
        if KINDS[kind].target == "topic":
            return TopicFault(request)
        robot = self._simulation.robots.get(request.robot)
        if kind in _SIGNALS:
            return _SIGNALS[kind](request, robot)
        if kind == "push":
            return PushFault(request, robot, world)
        if kind.startswith("controller"):
            return ControllerFault(request, robot)
        change: Change
        if kind == "joint-stuck":
            change = StuckJoint(world, robot.attached, robot.parts.hardware, request.part)
        elif kind == "joint-friction":
            change = JointFriction(world, robot.attached, request.part, options["friction"], options["damping"])
        else:
            change = Payload(world, robot.attached, request.part, options["mass"], options["at"])
        return ChangeFault(request, robot, change)

    def _serve_add(self, request: Message) -> Message:
        times = {field: request[field] for field in ("start", "end")}
        for field, given in times.items():
            if len(given) > 1:
                raise UsageError(f"{field} is one time, or none, not {len(given)}")
        start, end = (given[0] if given else None for given in times.values())
        try:
            options = json.loads(request["options"] or "{}")
        except (ValueError, RecursionError):
            options = None
        if not isinstance(options, dict):
            raise UsageError(f"options is a JSON object, not {request['options']!r}", 'such as {"sd": 0.001}')
        checked_options(request["kind"], options)  # before they are used as keywords
        named = request["name"], request["namespace"] or "/"
        return {"fault": self.add(request["target"], request["kind"], start, end, request["seed"], *named, **options)}


def _check(request: FaultRequest) -> None:
    """Raise UsageError for a request, which may come from a file, that no client can make."""
    numbers = request.start_ns, request.end_ns, abs(request.seed)
    if not names.is_component(request.name) or not all(type(one) is int and 0 <= one <= NEVER for one in numbers):
        raise UsageError(f"the name, a time or the seed of the fault {request.name!r} is not valid")
    checked_options(request.kind, request.options)


def _serve_kinds(_: Message) -> Message:
    kinds = []
    for name, kind in KINDS.items():
        texts = [
            f"{option} ({OPTIONS[option].text}){'' if value == REQUIRED else f' = {json.dumps(value)}'}"
            for option, value in kind.options.items()
        ]
        kinds.append({"name": name, "target": kind.target, "text": kind.text, "options": texts})
    return {"kinds": kinds}
