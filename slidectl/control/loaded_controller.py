"""A loaded controller of a manager: its state, its updates and their times, what aborted it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from slidectl import names
from slidectl.control.controller_interface import HOOKS, ControllerBase, State
from slidectl.control.duration import NANOSECONDS
from slidectl.control.hardware_interface import (
    ControllerInfo,
    JointStateHandle,
    JointStateInterface,
    ResourceManager,
)
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import UPDATE_BUDGET, value_of
from slidectl.control.user_classes import WatchedHandles, described, is_of_a_user, watched
from slidectl.control.user_modules import UserCode

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
        self.loaded_with: Any = node.get_param(node.namespace, None)
        """Its parameters right after it was loaded, for `configure` and snapshots; None: it must be loaded again."""
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
