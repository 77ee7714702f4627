"""The controller manager: loads, lists, switches and unloads the controllers of one robot, and updates them.

After ros_control's controller_manager. All calls come from one thread, between two cycles or (`update`) in one.
It does not know the names of the services that call it, nor the clients that wait for an answer.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from slidectl import names
from slidectl.control import registry
from slidectl.control.controller_interface import HOOKS, ControllerBase, State
from slidectl.control.duration import NANOSECONDS, to_seconds
from slidectl.control.hardware_interface import (
    JOINT_STATES,
    CommandAttribute,
    Conflict,
    ControllerInfo,
    HardwareComponent,
    JointHandle,
    JointStateHandle,
    JointStateInterface,
    ResourceManager,
    RobotHW,
    SwitchState,
    UnknownResource,
)
from slidectl.control.node_handle import NodeHandle, Reasons
from slidectl.control.params import UPDATE_BUDGET, judge, value_of
from slidectl.control.registry import ControllerTypes
from slidectl.control.ros2_names import refuse_others
from slidectl.control.user_classes import (
    CallbackGuard,
    WatchedHandles,
    described,
    file_of,
    is_of_a_user,
    watched,
    watched_hardware,
)
from slidectl.control.user_modules import UserCode
from slidectl.description import interfaces
from slidectl.errors import BadName, Refused, SlidectlError, UnknownName, listing, quoted

if TYPE_CHECKING:
    from slidectl.msgs.typed import ControllerStateMsg, HardwareInterfaceResourcesMsg

T = TypeVar("T")

_LONGEST_BUDGET_S = 1e9


class UpdateTimes:
    """Wall time, in ns, of the updates of one controller in the interpreter since its last start."""

    saved_attributes: ClassVar[None] = None

    def __init__(self, name: str, node: NodeHandle) -> None:
        self._name = name
        self._node = node
        self._next_warning_ns = 0
        self.budget_ns = 0
        """A longer update causes a warning; 0: no warnings."""
        self.clear()

    def clear(self) -> None:
        """Reset all counts and times."""
        self.count = self.total_ns = self.longest_ns = self.over_budget = 0
        self.notable_ns = 0
        """`add` passes longer updates to `note`: they are the longest so far, or over the budget."""

    def set_budget(self, budget_s: float) -> None:
        """Set the budget in seconds; 0 or less: no budget."""
        self.budget_ns = round(min(max(0.0, budget_s), _LONGEST_BUDGET_S) * NANOSECONDS)
        self.notable_ns = 0

    def add(self, took_ns: int, now_ns: int) -> None:
        """Record an update. `now_ns` is a time of `perf_counter_ns`."""
        self.count += 1
        self.total_ns += took_ns
        if took_ns > self.notable_ns:
            self.note(took_ns, now_ns)

    def note(self, took_ns: int, now_ns: int) -> None:
        """Record an update that is the longest so far or over the budget. Log a warning when it is over the budget."""
        self.longest_ns = max(self.longest_ns, took_ns)
        self.notable_ns = min(self.longest_ns, self.budget_ns or self.longest_ns)
        if 0 < self.budget_ns < took_ns:
            self.over_budget += 1
            if now_ns >= self._next_warning_ns:
                self._next_warning_ns = now_ns + NANOSECONDS
                took, budget = f"{took_ns / 1000:.1f} us", f"{self.budget_ns / 1000:g} us"
                text = (
                    f"an update took {took}; its budget is {budget}, which {self.over_budget} of {self.count} exceeded"
                )
                self._node.log("warn", f"controller {self._name!r}: {text}")

    def message(self) -> dict[str, Any]:
        """The times as slidectl/UpdateTimes, in seconds."""
        mean_ns = self.total_ns / self.count if self.count else 0.0
        times = {"mean": mean_ns, "longest": self.longest_ns, "budget": self.budget_ns}
        seconds = {key: value / NANOSECONDS for key, value in times.items()}
        return {"name": self._name, "updates": self.count, "over_budget": self.over_budget, **seconds}


class LoadedController:
    """A loaded controller of a manager. Times are nanoseconds of simulated time."""

    __slots__ = (
        *("_code", "_is_of_user", "_watched", "controller", "failure", "info", "is_configured", "is_of_ros2"),
        *("loaded_with", "may_compile", "node", "reads_from", "states_read", "times", "writes_to"),
    )

    def __init__(
        self,
        name: str,
        type_name: str,
        controller: ControllerBase,
        node: NodeHandle,
        code: UserCode,
        handles: WatchedHandles | None = None,
        *,
        is_of_ros2: bool = False,
        states_read: Iterable[str] = (),
    ) -> None:
        """`code`: the users' code of the world. `handles`: the joint handles that a user's controller has got; None for
        a controller of slidectl. `is_of_ros2`: its robot is one of ROS 2. `states_read`: as the attribute."""
        self.controller = controller
        self.node = node
        self.info = ControllerInfo(name, type_name, controller.claimed_resources)
        self.times = UpdateTimes(name, node)
        self.failure = ""
        """The message of the exception that aborted it since its last start; empty: none."""
        self.may_compile = True
        """False when the compiled form that a user's class declares has failed."""
        self.writes_to: tuple[LoadedController, ...] = ()
        """The chainable controllers whose references it claims: it precedes them in a chain."""
        self.reads_from: tuple[LoadedController, ...] = ()
        """The chainable controllers whose exported states it reads."""
        self.is_of_ros2 = is_of_ros2
        self.is_configured = not is_of_ros2
        """False in the state `unconfigured` of ROS 2, in which it cannot start. Its `init` was called nevertheless."""
        self.loaded_with: Any = node.get_param(node.namespace, None) if is_of_ros2 else None
        """Its parameters right after it was loaded, for `configure`; None: it must be loaded again."""
        self.states_read = tuple(states_read)
        """The states of joints that it can read, as `joint1/position`; only for a robot of ROS 2."""
        self._is_of_user = is_of_a_user(type(controller))
        self._code = code
        self._watched = watched(type(controller), code, handles)
        self._read_budget()
        node.watch_param(UPDATE_BUDGET.name, self._read_budget)

    def _read_budget(self) -> None:
        self.times.set_budget(value_of(self.node, UPDATE_BUDGET))
        if self.times.budget_ns and self.controller.compiled is not None:
            where = names.join(self.node.namespace, UPDATE_BUDGET.name)
            self.node.log("warn", f"parameter {where} has no effect while the controller runs compiled")

    @property
    def name(self) -> str:
        """The name under which it was loaded."""
        return self.info.name

    @property
    def state(self) -> State:
        """The controller's state."""
        return self.controller.state

    @property
    def shown_state(self) -> str:
        """The state for clients: of a controller of a robot of ROS 2, the one that ros2_control has for it."""
        if not self.is_of_ros2:
            return str(self.state)
        return "active" if self.is_running else "inactive" if self.is_configured else "unconfigured"

    @property
    def is_running(self) -> bool:
        """True in the state RUNNING, in which it is updated each cycle."""
        return self.state is State.RUNNING

    @property
    def is_aborted(self) -> bool:
        """True in the state ABORTED: its start or its code has failed."""
        return self.state is State.ABORTED

    @property
    def needs(self) -> tuple[LoadedController, ...]:
        """The controllers that must run while this one runs."""
        return (*self.writes_to, *self.reads_from)

    @property
    def depth(self) -> int:
        """How many controllers of a chain follow this one; 0 without a chain."""
        return max((one.depth + 1 for one in self.needs), default=0)

    def exported(self) -> Sequence[tuple[type[ResourceManager[Any]], JointStateHandle]]:
        """The handles that the controller exports, with the interface of each."""
        controller = self.controller
        return [*controller.exported_references, *((JointStateInterface, one) for one in controller.exported_states)]

    def start(self, time_ns: int) -> None:
        """Start the controller, and reset its times and failure."""
        self.times.clear()
        self.failure = ""
        self.enter_state(State.RUNNING, time_ns)

    def enter_state(self, state: State, time_ns: int) -> None:
        """Call the hook of the state, then set it. An exception of the hook aborts the controller."""
        try:
            with self._watched:
                self.controller.enter_state(state, time_ns)
        except Exception as failure:
            self.fail(failure, time_ns, HOOKS[state])

    @property
    def bare_update(self) -> Callable[[int, float], None]:
        """The update without the measurement of its time."""
        return self._watched_update if self._is_of_user else self.controller.update

    def _watched_update(self, time_ns: int, period_s: float) -> None:
        with self._watched:
            self.controller.update(time_ns, period_s)

    def publish(self, time_ns: int, period_s: float) -> None:
        """Publish the messages that the compiled law made due. Raises the controller's exceptions."""
        with self._watched:
            self.controller.publish(time_ns, period_s)

    def update(self, time_ns: int, period_s: float) -> None:
        """Run one update and record its wall time. Raises the controller's exceptions."""
        began_ns = perf_counter_ns()
        self.bare_update(time_ns, period_s)
        now_ns = perf_counter_ns()
        self.times.add(now_ns - began_ns, now_ns)

    def update_if_running(self, time_ns: int, period_s: float) -> None:
        """Run one update, unless an earlier controller stopped this one in the same cycle. An exception aborts it."""
        try:
            if self.is_running:
                self.update(time_ns, period_s)
        except Exception as failure:
            self.fail(failure, time_ns, "update")

    def fail(self, failure: Exception, time_ns: int, hook: str = "") -> None:
        """Log the exception of the controller's code, and abort the controller. `hook`: the method that raised it."""
        where = f" in {hook}" if hook else ""
        self._abort(f"controller {self.name!r} failed{where} and is aborted: {described(failure)}", time_ns)

    def fail_with(self, other: LoadedController, time_ns: int) -> None:
        """Abort the controller, because another one of its chain is aborted."""
        self._abort(f"controller {self.name!r} is aborted: {other.name!r}, which is in its chain, is aborted", time_ns)

    def _abort(self, text: str, time_ns: int) -> None:
        self.failure = text
        self.node.log("fatal", text)
        if type(self.controller) in self._code.cut_off:
            self.controller.state = State.ABORTED
            return
        try:
            with self._watched:
                self.controller.enter_state(State.ABORTED, time_ns)
        except Exception as another:
            self.node.log("fatal", f"controller {self.name!r} failed while aborting: {described(another)}")
            self.controller.state = State.ABORTED

    def try_to_compile(self, action: Callable[[], T]) -> T | None:
        """Call an action that the compiled form needs. If a user's class fails in it, `update` runs interpreted."""
        if not self._is_of_user:
            return action()
        try:
            with watched(type(self.controller), self._code):
                return action()
        except Exception as failure:
            self.may_compile = False
            self.node.log("warn", f"controller {self.name!r} runs in the interpreter: {described(failure)}")
            return None

    def message(self) -> ControllerStateMsg:
        """The entry as controller_manager_msgs/ControllerState."""
        claimed: list[HardwareInterfaceResourcesMsg] = [
            {"hardware_interface": claim.hardware_interface, "resources": list(claim.resources)}
            for claim in self.info.claimed_resources
        ]
        state = self.shown_state
        return {"name": self.name, "state": state, "type": self.info.type, "claimed_resources": claimed}

    def commands(self) -> list[str]:
        """The commands that it claims, by their names in ros2_control, as `joint1/effort`."""
        claims = self.info.claimed_resources
        return [name for one in claims for name in interfaces.ros2_commands(one.hardware_interface, one.resources)]

    def references(self) -> list[str]:
        """The references that it exports, without its own name, as `joint1/position`."""
        found = []
        for kind, handle in self.controller.exported_references:
            found += interfaces.ros2_commands(kind.type_name, [handle.name.removeprefix(f"{self.name}/")])
        return found

    def shown_states(self) -> list[str]:
        """The states that it exports, without its own name, as `joint1/position`."""
        joints = [one.name.removeprefix(f"{self.name}/") for one in self.controller.exported_states]
        return [f"{joint}/{state}" for joint in joints for state in JOINT_STATES]

    def message_of_ros2(self, rate_hz: int) -> dict[str, Any]:
        """The entry as slidectl/ControllerState, which has the fields of ros2_control."""
        commands = self.commands() if self.is_configured else []
        return {
            "name": self.name,
            "state": self.shown_state,
            "type": self.info.type,
            "update_rate": rate_hz,
            "claimed_interfaces": commands if self.is_running else [],
            "required_command_interfaces": commands,
            "required_state_interfaces": list(self.states_read) if self.is_configured else [],
            "is_chainable": bool(self.exported()),
            "is_chained": self.controller.is_chained,
            "exported_state_interfaces": self.shown_states() if self.is_configured else [],
            "reference_interfaces": self.references() if self.is_configured else [],
            "chain_connections": [
                {"name": one.name, "reference_interfaces": one.references()} for one in self.writes_to
            ],
        }


BEST_EFFORT = 1
STRICT = 2
MOST_NAMES = 1000
"""Most names in one request, for hooks are called for every name. A robot has a few dozen controllers at most."""


def _way_out(conflicts: Sequence[Conflict], starting: Collection[str]) -> str:
    """The switch that frees the resources of those that start; empty when they only conflict with one another."""
    claims = list(dict.fromkeys(name for conflict in conflicts for name in conflict.controllers))
    in_the_way = [name for name in claims if name not in starting]
    if not in_the_way:
        return ""
    to_start = " ".join(name for name in claims if name in starting)
    return f"; slidectl controller switch --start {to_start} --stop {' '.join(in_the_way)}"


def _in_update_order(loaded: Iterable[LoadedController]) -> tuple[LoadedController, ...]:
    """The controllers in load order, but each before those whose references it writes, which were loaded before it."""
    ordered: list[LoadedController] = []
    for entry in loaded:
        following = [position for position, one in enumerate(ordered) if one in entry.writes_to]
        ordered.insert(min(following, default=len(ordered)), entry)
    return tuple(ordered)


def _known(
    loaded: Mapping[str, LoadedController], wanted: Iterable[str], verb: str, strict: bool, node: NodeHandle
) -> list[LoadedController]:
    """The controllers of these names. Logs a warning about unknown ones, or raises when `strict`."""
    found = [loaded[name] for name in wanted if name in loaded]
    unknown = [name for name in wanted if name not in loaded]
    if unknown and strict:
        raise _not_loaded(loaded, unknown[0], verb, node)
    unconfigured = [entry.name for entry in found if verb == "start" and not entry.is_configured]
    if unconfigured:
        reason = f"cannot start controller {quoted(unconfigured[0])}: it is unconfigured"
        hint = f"configure it first: slidectl controller configure {unconfigured[0]}"
        if strict:
            raise Refused(reason, hint)
        node.log("warn", f"{reason}; {hint}; the rest of the request goes on")
        found = [entry for entry in found if entry.is_configured]
    if unknown:
        node.log("warn", f"no controller {listing(map(quoted, unknown))} to {verb}; the rest of the request goes on")
    if len(found) > MOST_NAMES:
        raise Refused(f"{len(found)} controllers to {verb}, and {MOST_NAMES} is the most in one request")
    return found


def _not_loaded(loaded: Mapping[str, LoadedController], name: str, verb: str, node: NodeHandle) -> SlidectlError:
    """The error for a controller that is not loaded: whether it could be, by its parameters."""
    with suppress(SlidectlError):  # the name may be none
        if node.get_param(f"{name}/type", None) is not None:
            hint = f"load and start it: slidectl controller spawn {name}; load it only: slidectl controller load {name}"
            return Refused(f"controller {quoted(name)} is not loaded, so there is nothing to {verb}", hint)
    return UnknownName("controller", name, list(loaded), f"to {verb}")


@dataclass
class Switch:
    """An accepted switch. `advance` carries it out, once per cycle, after the updates.

    A name may occur several times in a request; its hooks are then called as often.
    """

    start_request: list[LoadedController]
    stop_request: list[LoadedController]
    asap: bool
    timeout_s: float
    init_time_ns: int
    on_done: Callable[[bool], None]
    reasons: Reasons | None
    """The reasons of the request. Errors in later cycles are added to them."""
    start: list[ControllerInfo] = field(default_factory=list)
    """The controllers that really start; `stop`: that really stop; `running`: that run afterwards."""
    stop: list[ControllerInfo] = field(default_factory=list)
    running: list[ControllerInfo] = field(default_factory=list)
    modes: list[tuple[LoadedController, bool]] = field(default_factory=list)
    """The chainable controllers that run afterwards, and whether in chained mode."""
    has_begun: bool = False

    def check_chains(self, loaded: Collection[LoadedController], strict: bool, node: NodeHandle) -> None:
        """Leave out, with a warning, what would leave a controller without one that it needs.

        Raises Refused: strict, and there is such a controller.
        """
        while found := self._broken_chain(loaded):
            request, entry, refusal = found
            if strict:
                raise refusal
            node.log("warn", f"{described(refusal)}; the rest of the request goes on")
            request[:] = [one for one in request if one is not entry]

    def _broken_chain(
        self, loaded: Collection[LoadedController]
    ) -> tuple[list[LoadedController], LoadedController, Refused] | None:
        """A list of the request, the controller in it that must not be there, and why; None when there is none."""
        runs = [one for one in loaded if one in self.start_request or (one.is_running and one not in self.stop_request)]
        for entry in self.start_request:
            for need in entry.needs:
                if need not in runs:
                    verb = "writes the references" if need in entry.writes_to else "reads the states"
                    why = "this switch stops" if need.is_running else "does not run"
                    text = f"cannot start controller {entry.name!r}: it {verb} of {need.name!r}, which {why}"
                    hint = f"start both: slidectl controller switch --start {need.name} {entry.name}"
                    return self.start_request, entry, Refused(text, "" if need.is_running else hint)
        for entry in self.stop_request:
            for user in runs if entry.is_running and entry not in runs else ():
                if entry in user.needs:
                    verb = "writes its references" if entry in user.writes_to else "reads its states"
                    text = f"cannot stop controller {entry.name!r}: {user.name!r}, which {verb}, goes on"
                    hint = f"stop both: slidectl controller switch --stop {user.name} {entry.name}"
                    return self.stop_request, entry, Refused(text, hint)
        return None

    def plan_chains(self, loaded: Iterable[LoadedController]) -> None:
        """Set `modes`, and restart the running controllers whose mode changes. Call it after `plan`."""
        after = {info.name for info in self.running}
        runs = [entry for entry in loaded if entry.name in after]
        for entry in runs:
            if entry.controller.exported_references:
                is_chained = any(entry in one.writes_to for one in runs)
                self.modes.append((entry, is_chained))
                if entry.is_running and entry.controller.is_chained != is_chained:
                    self.stop_request.append(entry)
                    if entry not in self.start_request:
                        self.start_request.append(entry)
        # Each stops before those that it needs, and starts after them.
        self.stop_request.sort(key=lambda entry: -entry.depth)
        self.start_request.sort(key=lambda entry: entry.depth)

    def plan(self, loaded: Iterable[LoadedController], strict: bool) -> None:
        """Set `start`, `stop` and `running`.

        Raises:
            Refused: strict and a controller runs already or does not run; or a running one is in both lists.
        """
        for entry in loaded:
            is_running = entry.is_running
            stops, starts = entry in self.stop_request, entry in self.start_request
            if stops and not is_running:
                if strict:
                    raise Refused(f"cannot stop controller {entry.name!r}: it is not running")
                stops = False
            if starts and is_running and not stops:
                if strict:
                    raise Refused(f"cannot start controller {entry.name!r}: it is running already")
                starts = False
            if starts and stops:
                raise Refused(f"controller {entry.name!r} cannot be started and stopped in one switch")
            if stops:
                self.stop.append(entry.info)
            if starts:
                self.start.append(entry.info)
            if starts or (is_running and not stops):
                self.running.append(entry.info)

    def advance(self, hw: RobotHW, time_ns: int) -> bool:
        """One cycle of the switch: stop, then start what the hardware is ready for. True when it is finished."""
        if not self.has_begun:
            hw.do_switch(self.start, self.stop)
            self.has_begun = True
            for entry in self.stop_request:
                if entry.is_running:
                    entry.enter_state(State.STOPPED, time_ns)
            for entry, is_chained in self.modes:
                if entry.controller.is_chained != is_chained:
                    entry.controller.is_chained = is_chained
        if not self.asap:
            return self._start(self.start_request, None, hw, time_ns)
        for entry in self.start_request:
            if not entry.is_running and all(need.is_running for need in entry.needs):
                self._start([entry], entry.info, hw, time_ns)
        return all(
            entry.is_running or entry.is_aborted or any(need.is_aborted for need in entry.needs)
            for entry in self.start_request
        )

    def give_up(self, time_ns: int) -> None:
        """Abort the controllers that should start, because the hardware failed."""
        for entry in self.start_request:
            if not entry.is_running:
                entry.enter_state(State.ABORTED, time_ns)

    def _start(self, entries: list[LoadedController], info: ControllerInfo | None, hw: RobotHW, time_ns: int) -> bool:
        """Start the entries, let them wait, or abort them, by the hardware's state for `info`. False: they wait."""
        if hw.switch_result(info) is SwitchState.DONE:
            for entry in entries:
                if all(need.is_running for need in entry.needs):  # else it is aborted with its chain
                    entry.start(time_ns)
            return True
        has_timed_out = 0.0 < self.timeout_s < to_seconds(time_ns - self.init_time_ns)
        is_over = hw.switch_result(info) is SwitchState.ERROR or has_timed_out
        for entry in entries:
            entry.enter_state(State.ABORTED if is_over else State.WAITING, time_ns)
        return is_over


Names = list[str]
Messages = list[dict[str, Any]]
ControllerStates = list["ControllerStateMsg"]


class ControllerManager:
    """The controllers of one robot. Refusals are logged as errors and answered with False."""

    def __init__(self, hw: RobotHW, node: NodeHandle, types: ControllerTypes = registry.common) -> None:
        """`node` is the robot's namespace: a controller's parameters and topics are below `<node>/<name>`. `types` are
        those that the world knows."""
        self._hw = hw
        self._node = node
        self.known = types
        """The types of controllers that can be loaded."""
        self._loaded: dict[str, LoadedController] = {}
        """In load order."""
        self._order: tuple[LoadedController, ...] = ()
        """All loaded controllers in the order of their updates: the load order, but each before those whose references
        it writes."""
        self._running: tuple[LoadedController, ...] = ()
        self._updates: tuple[tuple[Callable[[int, float], None], UpdateTimes], ...] = ()
        self._commands: tuple[tuple[LoadedController, list[CommandAttribute]], ...] = ()
        """The commands of each running controller."""
        self._commanded: tuple[JointHandle, ...] = ()
        """The joints of these commands."""
        self._further: tuple[CommandAttribute, ...] = ()
        """Those of these commands that are not the attribute `command`."""
        self._switch: Switch | None = None
        self.on_change: Callable[[], None] = lambda: None
        """Called when controllers have started, stopped or failed."""

    # The cycle.

    def update(self, time_ns: int, period_s: float, reset_controllers: bool = False) -> None:
        """One cycle: update every running controller, then carry on with a pending switch.

        A controller that starts in this cycle has its first update in the next one. `reset_controllers` stops
        and starts all running ones first.
        """
        if reset_controllers:
            self.restart_running(time_ns)
        # UpdateTimes.add inline, with one clock reading per controller: hot path, a further call would be measurable.
        clock_ns = perf_counter_ns
        began_ns = clock_ns()
        try:
            for update, times in self._updates:
                update(time_ns, period_s)
                now_ns = clock_ns()
                took_ns = now_ns - began_ns
                times.count += 1
                times.total_ns += took_ns
                if took_ns > times.notable_ns:
                    times.note(took_ns, now_ns)
                began_ns = now_ns
        except Exception as failure:
            self._carry_on(self._updates.index((update, times)), failure, time_ns, period_s)
        # Hot path: one sum finds whether a command may be wrong. It is nan for infinity and nan.
        total = 0.0
        for handle in self._commanded:
            total += handle.command
        if total - total != 0.0 or self._further:
            self._check_commands(time_ns)
        if self._switch is not None:
            self.manage_switch(time_ns)

    def finish_update(self, done: int, time_ns: int, period_s: float, failure: Exception | None = None) -> None:
        """Finish an `update` in which `done` controllers were updated. `failure`: the exception of the last of them."""
        if failure is not None:
            self._carry_on(done - 1, failure, time_ns, period_s)
        else:
            self._update_rest(done, time_ns, period_s)
        self._check_commands(time_ns)
        if self._switch is not None:
            self.manage_switch(time_ns)

    def _check_commands(self, time_ns: int) -> None:
        """Abort each controller with a command that is not finite: the world could not go on. Its joints get the
        commands that move them least, since a limit would remember the wrong one."""
        failed = []
        for entry, commands in self._commands:
            errors = [text for one in commands if entry.is_running and (text := one.error_text())]
            if errors:
                failed.append(entry)
                entry.fail(Refused(errors[0]), time_ns, "update")
                for one in commands:
                    if one.error_text():
                        one.rest()
        if failed:
            self._abort_chains(failed, time_ns)
            self._refresh()

    def _abort_chains(
        self, failed: Iterable[LoadedController], time_ns: int, starting: Collection[LoadedController] = ()
    ) -> None:
        """Abort the whole chains of controllers that have failed, as far as they run or are `starting`.

        A chain also ends for a controller that reads states of one in it, but such a reader ends no chain.
        """
        aborted = list(failed)
        for one in aborted:
            for entry in self._order:
                is_next = one in entry.needs or entry in one.writes_to
                if is_next and entry not in aborted and (entry.is_running or entry in starting):
                    entry.fail_with(one, time_ns)
                    aborted.append(entry)

    def manage_switch(self, time_ns: int) -> None:
        """Advance a pending switch by one cycle. For a paused simulation; `update` does it by itself."""
        switch = self._switch
        if switch is None:
            return
        ok = True
        with self._node.answering(switch.reasons):
            try:
                with watched_hardware(self._hw, self.known.code):
                    finished = switch.advance(self._hw, time_ns)
            except Refused as failure:
                self._node.log("fatal", described(failure))
                switch.give_up(time_ns)
                finished, ok = True, False
            starting = switch.start_request
            self._abort_chains([one for one in starting if one.is_aborted and switch.has_begun], time_ns, starting)
        self._refresh()
        if finished:
            self._switch = None
            switch.on_done(ok)

    def restart_running(self, time_ns: int) -> None:
        """Stop and start every running controller, one after the other."""
        running = sorted(self._running, key=lambda entry: entry.depth)  # starts each after those that it needs
        for entry in running:
            entry.enter_state(State.STOPPED, time_ns)
            if not entry.is_aborted:
                entry.start(time_ns)
        self._abort_chains([entry for entry in running if entry.is_aborted], time_ns)
        self._refresh()

    def stop_running(self, time_ns: int) -> None:
        """Stop every running controller, in the order of updates, because the robot is removed."""
        for entry in self._running:
            entry.enter_state(State.STOPPED, time_ns)
        self._refresh()

    def _carry_on(self, position: int, failure: Exception, time_ns: int, period_s: float) -> None:
        """Abort the controller at this position and update those after it."""
        failed = self._running[position]
        failed.fail(failure, time_ns, "update")
        self._abort_chains([failed], time_ns)
        self._update_rest(position + 1, time_ns, period_s)
        self._refresh()

    def _update_rest(self, done: int, time_ns: int, period_s: float) -> None:
        """Update the running controllers after the first `done`."""
        for entry in self._running[done:]:
            entry.update_if_running(time_ns, period_s)
            if entry.is_aborted:
                self._abort_chains([entry], time_ns)

    def _reorder(self) -> None:
        """Set the order of updates. It is called after each change of the loaded controllers."""
        self._order = _in_update_order(self._loaded.values())

    def _refresh(self) -> None:
        self._running = tuple(entry for entry in self._order if entry.is_running)
        self._updates = tuple((entry.bare_update, entry.times) for entry in self._running)
        self._commands = tuple(
            (entry, commands)
            for entry in self._running
            if (commands := self._hw.commands_of(entry.info.claimed_resources))
        )
        found = [command for _, commands in self._commands for command in commands]
        self._commanded = tuple(command.handle for command in found if command.attribute == "command")
        self._further = tuple(command for command in found if command.attribute != "command")
        self.on_change()

    # Queries.

    @property
    def is_of_ros2(self) -> bool:
        """True for a robot with a `<ros2_control>` tag: the states of its controllers are those of ros2_control."""
        return self._hw.is_of_ros2

    @property
    def switching(self) -> bool:
        """True while an accepted switch is not finished: it waits for the next cycle, or for the hardware."""
        return self._switch is not None

    @property
    def running(self) -> tuple[LoadedController, ...]:
        """The running controllers, in the order of their updates. A change of these makes a new tuple."""
        return self._running

    def names(self) -> list[str]:
        """The names of all loaded controllers, in load order."""
        return list(self._loaded)

    def loaded(self) -> Sequence[tuple[str, str]]:
        """Names and types of all controllers, in load order."""
        return [(entry.name, entry.info.type) for entry in self._loaded.values()]

    def get(self, name: str) -> ControllerBase | None:
        """The loaded controller of that name, else None."""
        entry = self._loaded.get(name)
        return entry.controller if entry is not None else None

    def list(self) -> ControllerStates:
        """All loaded controllers in the order of updates, each as controller_manager_msgs/ControllerState."""
        return [entry.message() for entry in self._order]

    def list_as_in_ros2(self, rate_hz: int) -> Messages:
        """As `list`, each as slidectl/ControllerState. `rate_hz` is the rate of the updates."""
        return [entry.message_of_ros2(rate_hz) for entry in self._order]

    def states(self) -> dict[str, str]:
        """Name -> state of all loaded controllers as clients see it, in load order."""
        return {entry.name: entry.shown_state for entry in self._loaded.values()}

    def components(self) -> Sequence[HardwareComponent]:
        """The hardware components of a robot of ROS 2."""
        return self._hw.components()

    def exporting(self) -> Sequence[LoadedController]:
        """The configured controllers that export references or states."""
        return [entry for entry in self._loaded.values() if entry.is_configured and entry.exported()]

    def claimed_commands(self) -> set[str]:
        """The commands that running controllers claim, by their names in ros2_control."""
        return {name for entry in self._running for name in entry.commands()}

    def update_times(self) -> Messages:
        """The update times of all loaded controllers, in load order, each as slidectl/UpdateTimes."""
        return [entry.times.message() for entry in self._loaded.values()]

    def types(self) -> Names:
        """The controller types that can be loaded; for a robot of ROS 2, those that behave as in ros2_controllers."""
        return self.known.types_of_ros2() if self.is_of_ros2 else self.known.types()

    def base_classes(self) -> Names:
        """The base class of each of `types`."""
        return len(self.types()) * [registry.BASE_CLASS_OF_ROS2 if self.is_of_ros2 else registry.BASE_CLASS]

    # Loading.

    def load(self, name: str) -> bool:
        """Load and initialise the controller with the parameters `<node>/<name>`. False: refused, nothing remains."""
        try:
            self.load_again(name)
        except Exception as failure:
            return self._refuse(f"cannot load controller {quoted(name)}: {described(failure)}")
        return True

    def load_again(self, name: str) -> None:
        """As `load`, but raises the error."""
        if name in self._loaded:
            is_running = self._loaded[name].is_running
            verb = "configure" if not self._loaded[name].is_configured else "start"
            next_step = ", and running" if is_running else f"; {verb} it: slidectl controller {verb} {name}"
            raise Refused(f"it is loaded already{next_step}")
        self.check_new(name)
        self._loaded[name] = self._load(name)
        self._reorder()

    def check_new(self, name: str) -> None:
        """Raise Refused when a controller of that name is loaded, BadName when the name is not legal."""
        if name in self._loaded:
            raise Refused("it is loaded already")
        if not names.is_legal(name) or name.startswith("~"):
            raise BadName(name)

    def _load(self, name: str) -> LoadedController:
        node = self._node.child(name)
        try:
            type_name, for_ros2 = _type_of(node, self._hw.is_of_ros2)
            controller, code = self.known.create(type_name, for_ros2=for_ros2), self.known.code
            guard = CallbackGuard(type(controller), code, node) if is_of_a_user(type(controller)) else None
            node.guard = guard
            of_all = WatchedHandles(*self._hw.joint_handles(only_new=False), file_of(type(controller)))
            self._hw.joint_handles(only_new=True)
            with watched(type(controller), code, of_all):
                controller.init_request(self._hw, self._node, node)
        except BaseException as failure:
            node.shutdown()
            if isinstance(failure, UnknownResource) and failure.kind == JointStateInterface.kind:
                failure.hint = f"{failure.hint}\n{self._about(failure.name)}"
            raise
        node.guard_params(partial(judge, node, controller.parameters))
        handles, commands = self._hw.joint_handles(only_new=True)
        watch = None
        if guard is not None:
            watch = guard.handles = WatchedHandles(handles, commands, file_of(type(controller)))
        is_of_ros2 = self._hw.is_of_ros2
        read = sorted({handle.name for handle in handles}) if is_of_ros2 else ()
        states = [f"{joint}/{state}" for joint in read for state in JOINT_STATES]
        entry = LoadedController(
            name, type_name, controller, node, code, watch, is_of_ros2=is_of_ros2, states_read=states
        )
        of_others = {id(handle): (kind, one) for one in self._loaded.values() for kind, handle in one.exported()}
        used = [of_others[id(handle)] for handle in handles if id(handle) in of_others]
        entry.writes_to = tuple({one: None for kind, one in used if kind.claims})
        entry.reads_from = tuple({one: None for kind, one in used if not kind.claims})
        for kind, handle in entry.exported():
            handle.name = f"{name}/{handle.name}"
            self._hw.export(kind, handle)
        return entry

    def _about(self, joint: str) -> str:
        """What to do about a joint that no controller can get."""
        owner, slash, _ = joint.rpartition("/")
        if not slash:
            return self._hw.about_joint(joint)
        if owner in self._loaded:
            names_there = list(dict.fromkeys(handle.name for _, handle in self._loaded[owner].exported()))
            return f"controller {quoted(owner)} exports: {listing(names_there)}"
        return f"{quoted(joint)} is of controller {quoted(owner)}: load it first: slidectl controller load {owner}"

    def _users_of(self, entry: LoadedController) -> Sequence[LoadedController]:
        """The loaded controllers that have handles of this one."""
        return [one for one in self._order if entry in one.needs]

    def _users_first(self) -> Sequence[str]:
        """The names of all controllers, each before those whose handles it has."""
        return [one.name for one in sorted(self._order, key=lambda one: -one.depth)]

    def _check_unused(self, entry: LoadedController) -> None:
        """Raise Refused when another controller has handles of this one."""
        if users := [one.name for one in self._users_of(entry)]:
            verb = "have" if len(users) > 1 else "has"
            hint = f"unload before it: slidectl controller unload {' '.join(users)}"
            raise Refused(f"{listing(map(quoted, users))} {verb} interfaces of it", hint)

    def _shut_down(self, entry: LoadedController) -> None:
        """End its topics, services and exported handles."""
        self._hw.withdraw(handle.name for _, handle in entry.exported())
        entry.node.shutdown()

    def configure(self, name: str) -> bool:
        """Make a controller of a robot of ROS 2 `inactive`, so that it can start. Its parameters count as they are now.

        False: it is not loaded, it runs, a switch is pending, or it cannot be loaded with its parameters.
        """
        entry = self._idle(name, "configure")
        if entry is None:
            return False
        has_changed = entry.loaded_with != entry.node.get_param(entry.node.namespace, None)
        if has_changed or (entry.is_configured and not self._users_of(entry)):
            try:
                self._check_unused(entry)
                self._clean_up(entry)
                self._shut_down(entry)
                entry = self._loaded[name] = self._load(name)  # an existing key keeps its place in the order
            except Exception as failure:
                return self._refuse(f"cannot configure controller {quoted(name)}: {described(failure)}")
            self._reorder()
        entry.is_configured = True
        return True

    def clean_up(self, name: str) -> bool:
        """Make a controller of a robot of ROS 2 `unconfigured`. False: it is not loaded, it runs, or a switch is
        pending."""
        entry = self._idle(name, "clean up")
        if entry is not None and entry.is_configured:
            self._clean_up(entry)
        return entry is not None

    def _clean_up(self, entry: LoadedController) -> None:
        entry.is_configured, entry.loaded_with = False, None

    def _idle(self, name: str, verb: str) -> LoadedController | None:
        """The controller of that name, unless it runs or a switch is pending. Logs why it is None."""
        entry = self._loaded.get(name)
        if entry is None:
            self._refuse(f"cannot {verb}: {described(_not_loaded(self._loaded, name, verb, self._node))}")
        elif self._switch is not None:
            self._refuse(f"cannot {verb} controller {quoted(name)}: a switch is in progress")
        elif entry.is_running:
            hint = f"deactivate it first: slidectl controller stop {name}"
            self._refuse(f"cannot {verb} controller {quoted(name)}: it is active; {hint}")
        else:
            return entry
        return None

    def unload(self, name: str) -> bool:
        """Remove a controller that is not running. False: it runs, it is not loaded, or a switch is pending."""
        entry = self._loaded.get(name)
        if entry is None:
            return self._refuse(f"cannot unload: {described(UnknownName('controller', name, self.names()))}")
        if self._switch is not None:
            return self._refuse(f"cannot unload controller {quoted(name)}: a switch is in progress")
        if entry.is_running:
            return self._refuse(f"cannot unload controller {quoted(name)}: it is running; stop it first")
        try:
            self._check_unused(entry)
        except Refused as refusal:
            return self._refuse(f"cannot unload controller {quoted(name)}: {described(refusal)}")
        del self._loaded[name]
        self._reorder()
        self._shut_down(entry)
        return True

    def renew(self, name: str) -> State:
        """Import the file of a loaded controller's class again, for `exchange`. Returns the controller's state.

        Raises:
            Refused: it is not loaded. SlidectlError: as `ControllerTypes.renewed`; nothing has changed.
        """
        entry = self._loaded.get(name)
        if entry is None:
            hint = f"load it: slidectl controller load {name}"
            raise Refused(f"cannot reload controller {quoted(name)}: it is not loaded", hint)
        try:
            self._check_unused(entry)
        except Refused as refusal:
            raise Refused(f"cannot reload controller {quoted(name)}: {refusal}", refusal.hint) from None
        self.known.renewed(type(entry.controller))
        return entry.state

    def failure_of(self, name: str) -> str:
        """The message of the exception that aborted a controller since its last start; empty: none."""
        return self._loaded[name].failure if name in self._loaded else ""

    def exchange(self, name: str) -> bool:
        """Replace a stopped controller with a new one of the class that its type means now. The load order stays.

        False: the new class cannot be loaded, so the former class is loaded again.
        """
        entry = self._loaded[name]
        if entry.is_running:
            return self._refuse(f"cannot reload controller {quoted(name)}: it is still running")
        former, is_configured = type(entry.controller), entry.is_configured
        self._shut_down(entry)
        try:
            self._loaded[name] = self._load(name)  # an existing key keeps its place in the order
            self._loaded[name].is_configured = is_configured
        except Exception as failure:
            text = f"cannot load controller {quoted(name)} from its edited file: {described(failure)}"
            self.known.restore(former)
        else:
            self._reorder()
            return True
        try:
            self._loaded[name] = self._load(name)
            self._loaded[name].is_configured = is_configured
        except Exception:
            del self._loaded[name]
            self._reorder()
            return self._refuse(f"{text}; nor can the former class be loaded again")
        self._reorder()
        return self._refuse(f"{text}; the former class is loaded again")

    def save_state(self) -> dict[str, Any]:
        """The state of the controllers for a snapshot, in load order."""
        entries = self._loaded.items()
        return {
            "controllers": {name: entry.controller for name, entry in entries},
            "states": {name: entry.state for name, entry in entries},
            "failures": {name: entry.failure for name, entry in entries},
            "configured": [name for name, entry in entries if entry.is_configured],
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore states and failures. The controllers' own attributes are already restored."""
        for name, entry in self._loaded.items():
            entry.controller.state, entry.failure = state["states"][name], state["failures"][name]
            entry.is_configured = name in state["configured"]
        running = [entry for entry in self._order if entry.is_running]
        for entry in running:
            if entry.controller.exported_references:
                entry.controller.is_chained = any(entry in one.writes_to for one in running)
        if running != list(self._running):
            self._refresh()

    def keep_only(self, kept: Sequence[str]) -> None:
        """Stop and unload all controllers but these."""
        gone = [entry for name, entry in self._loaded.items() if name not in kept]
        for entry in sorted(gone, key=lambda one: -one.depth):
            if entry.is_running:
                entry.enter_state(State.STOPPED, self._node.now_ns())
        self._refresh()
        for entry in reversed(gone):
            self.unload(entry.name)

    def reload_libraries(self, force_kill: bool) -> bool:
        """Prepare a reload of libraries, for which all controllers are unloaded. Registered classes stay.

        Refused without `force_kill` while controllers are loaded; for a robot of ROS 2, while controllers run.
        """
        in_the_way = len(self._running if self.is_of_ros2 else self._loaded)
        if in_the_way and not force_kill:
            are = "active" if self.is_of_ros2 else "loaded"
            return self._refuse(f"cannot reload while {in_the_way} controllers are {are}; unload them, or force it")
        if self._loaded:
            self._node.log("info", f"stopping and unloading {len(self._loaded)} controllers")
            is_stopped = self.request_switch([], self.names(), BEST_EFFORT)
            if is_stopped:
                self.manage_switch(self._node.now_ns())
            if not is_stopped or not all(map(self.unload, self._users_first())):
                return self._refuse("cannot reload: the controllers could not be stopped and unloaded")
        self._node.log("info", f"searched again for controllers of {registry.BASE_CLASS}")
        return True

    def fail(self, name: str, failure: Exception) -> bool:
        """Abort a running controller as if its update had raised `failure`. False: no controller of that name runs."""
        entry = self._loaded.get(name)
        if entry is None or not entry.is_running:
            return False
        entry.fail(failure, self._node.now_ns())
        self._abort_chains([entry], self._node.now_ns())
        self._refresh()
        return True

    def kill(self, name: str) -> bool:
        """Stop a controller at once and unload it, and before it those that have handles of it. False: it is not
        loaded, or a switch is pending."""
        entry = self._loaded.get(name)
        if entry is None or self._switch is not None:
            return False
        for user in self._users_of(entry):
            self.kill(user.name)
        if entry.is_running:
            entry.enter_state(State.STOPPED, self._node.now_ns())
            self._refresh()
        return self.unload(name)

    # Switching.

    def request_switch(
        self,
        start: Sequence[str],
        stop: Sequence[str],
        strictness: int,
        start_asap: bool = False,
        timeout_s: float = 0.0,
        on_done: Callable[[bool], None] = lambda _: None,
    ) -> bool:
        """Accept a switch, carried out at the end of the next cycle. False: refused, nothing changes.

        `on_done(True)` is called when it is finished, even if a controller to start was aborted; `on_done(False)` when
        the hardware failed. `timeout_s` is the simulated time for the hardware to become ready; 0: no limit.
        """
        node, is_strict = self._node, strictness == STRICT
        try:
            if self._switch is not None:
                raise Refused("another switch is in progress")
            if strictness not in (BEST_EFFORT, STRICT):
                text = f"strictness {strictness} is neither BEST_EFFORT (1) nor STRICT (2); BEST_EFFORT is used"
                node.log("warn", text)
            to_stop = _known(self._loaded, stop, "stop", is_strict, node)
            to_start = _known(self._loaded, start, "start", is_strict, node)
            switch = Switch(to_start, to_stop, start_asap, timeout_s, node.now_ns(), on_done, node.reasons)
            switch.check_chains(self._loaded.values(), is_strict, node)
            switch.plan(self._loaded.values(), is_strict)
            switch.plan_chains(self._loaded.values())
            conflicts = self._hw.check_for_conflict(switch.running)
            if conflicts:
                for conflict in conflicts:
                    node.log("warn", f"resource conflict: {conflict}")
                text = f"resource conflict: {'; '.join(map(str, conflicts))}"
                raise Refused(text + _way_out(conflicts, {info.name for info in switch.start}))
            with watched_hardware(self._hw, self.known.code):
                is_possible = self._hw.prepare_switch(switch.start, switch.stop)
            if not is_possible:
                raise Refused("the hardware cannot run this combination of controllers")
        except SlidectlError as refusal:
            return self._refuse(f"cannot switch controllers: {described(refusal)}")
        self._switch = switch
        return True

    def _refuse(self, reason: str) -> bool:
        self._node.log("error", reason)
        return False


def _type_of(node: NodeHandle, for_ros2: bool) -> tuple[str, bool]:
    """The parameter `type`, and whether the controller is one of ros2_controllers.

    Raises Refused: it is not set, or is a type of ROS 2 that is not here.
    """
    type_name = node.get_param("type", None)
    if not isinstance(type_name, str):
        hint = "load its configuration first: slidectl controller config FILE.yaml"
        raise Refused(f"parameter {names.join(node.namespace, 'type')} is not set", hint)
    values = node.get_param(node.namespace, {})
    is_of_ros2 = registry.is_of_ros2(type_name, values, for_ros2)
    if not is_of_ros2:
        refuse_others(type_name, values)
    return type_name, is_of_ros2
