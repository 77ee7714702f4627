"""Base classes of controllers: life cycle, access to hardware interfaces, and the hooks that an author overrides.

Only the manager changes a controller's state; hooks never do. A controller has no access to other controllers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Generic, NamedTuple

from slidectl.control.hardware_interface import (
    AnyInterface,
    ClaimedResources,
    I,
    JointCommandInterface,
    JointHandle,
    JointStateHandle,
    RobotHW,
)
from slidectl.control.laws import Columns, LawTables
from slidectl.control.node_handle import NodeHandle, Publisher
from slidectl.control.params import Parameter
from slidectl.control.pid import Pid
from slidectl.control.saved_classes import recreated
from slidectl.errors import Refused, listing


@recreated
class State(StrEnum):
    """The states of a controller."""

    CONSTRUCTED = "constructed"
    """Before `init`. No client sees this state: the manager lists a controller only after its init."""
    INITIALIZED = "initialized"
    RUNNING = "running"
    STOPPED = "stopped"
    WAITING = "waiting"
    ABORTED = "aborted"


HOOKS = {
    State.RUNNING: "starting",
    State.STOPPED: "stopping",
    State.WAITING: "waiting",
    State.ABORTED: "aborting",
}
"""The hook that is called when a controller enters a state."""


class Compiled:
    """The compiled form of a controller: the law of its `update`, and the columns of its row and of its members' rows.

    `update(row, tables, time_ns, period_s)` is a law: it changes the rows as the method changes the objects. It returns
    0 or False; PUBLISH or True when `publish` is due; or LEAVE. After its columns a row has `pid` and `joint`, indices
    into `tables`, and `wanted`: a publisher has subscribers. A member's row has `pid` and `joint`.
    """

    __slots__ = ("instead_of", "members", "row", "update")

    def __init__(
        self,
        update: Callable[[Any, LawTables, int, float], int],
        columns: Columns | None = None,
        members: Columns | None = None,
        instead_of: str = "",
    ) -> None:
        """`instead_of`: methods besides `update` and `publish` that the law replaces, separated by blanks."""
        self.update = update
        self.row = (columns or Columns()).with_places("pid joint wanted")
        self.members = (members or Columns()).with_places("pid joint")
        self.instead_of = ("update", "publish", *instead_of.split(), *self.row.attributes)
        """Methods and attributes. A subclass that overrides one of them cannot run in this compiled form."""


class Member(NamedTuple):
    """One of several equal parts of a controller: an object with the attributes of a row, its joint and its PID."""

    source: object
    joint: JointStateHandle | None = None
    pid: Pid | None = None


@dataclass(frozen=True, slots=True)
class Parts:
    """The objects that a controller uses while it runs compiled."""

    publishers: tuple[Publisher, ...] = ()
    """The publishers of `publish`, which is called only while one of them is wanted."""
    joint: JointHandle | None = None
    pid: Pid | None = None
    shown: tuple[JointStateHandle, ...] = ()
    """Joints whose state `publish` reads."""
    members: Sequence[Member] = ()
    numbers: Any = None
    """A writable buffer of doubles that the law and the methods share."""

    def handles(self) -> list[JointStateHandle]:
        """All joint handles of these parts."""
        joints = [self.joint, *(member.joint for member in self.members)]
        return [*self.shown, *(joint for joint in joints if joint is not None)]

    def pids(self) -> list[Pid]:
        """All PIDs of these parts."""
        pids = [self.pid, *(member.pid for member in self.members)]
        return [pid for pid in pids if pid is not None]


class MissingInterface(Refused):
    """A controller needs an interface that the robot does not have."""

    def __init__(self, wanted: str, hw: RobotHW) -> None:
        super().__init__(
            f"this controller needs {wanted}, which this robot does not have",
            f"interfaces of this robot: {listing(hw.interface_names())}",
        )


class ControllerBase:
    """States, requests and hooks. Times are nanoseconds of simulated time, periods seconds."""

    compiled: ClassVar[Compiled | None] = None
    """The compiled form of `update`, declared by the class that defines `update`; None: interpreter only."""

    parameters: ClassVar[tuple[Parameter, ...]] = ()
    """All parameters that the controller reads in its namespace. `slidectl check` judges files by them."""

    exported_references: Sequence[tuple[type[JointCommandInterface], JointHandle]] = ()
    """Set by the `init` of a chainable controller: handles for other controllers, whose `command` is a reference of
    this one, and the interface of each. A handle is named for its degree of freedom; the manager puts `<controller>/`
    before the name."""
    exported_states: Sequence[JointStateHandle] = ()
    """As `exported_references`: handles of states that this controller shows, in the JointStateInterface."""
    is_chained = False
    """Set by the manager before a chainable controller starts. True: other controllers write its references, so that it
    takes none from topics."""

    def __init__(self) -> None:
        self.state = State.CONSTRUCTED
        self.claimed_resources: tuple[ClaimedResources, ...] = ()

    # Hooks that a controller's author overrides.

    def starting(self, time_ns: int) -> None:
        """Called once when the controller starts, before its first update."""

    def update(self, time_ns: int, period_s: float) -> None:
        """One cycle: read states, write commands."""
        raise NotImplementedError

    def stopping(self, time_ns: int) -> None:
        """Called once when the controller stops, after its last update."""

    def waiting(self, time_ns: int) -> None:
        """Called each cycle while the hardware is not ready for the start."""

    def aborting(self, time_ns: int) -> None:
        """Called when the start, or the controller itself, failed."""

    # Hooks of a controller that declares `compiled`.

    def parts(self) -> Parts | None:
        """The parts of the controller for its compiled form; None when it cannot run compiled now."""
        return None

    def publish(self, time_ns: int, period_s: float) -> None:
        """Publish the messages that the last update made due. Called only while a publisher of the parts is wanted."""

    def check_restored(self) -> None:
        """Raise Refused when state restored from a snapshot is inconsistent. Compiled code does not check indices."""

    # Methods that the manager calls.

    def init_request(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> None:
        """Get the interfaces, call the init hooks and record the claims.

        `root` is the robot's namespace, `node` the controller's own.

        Raises:
            SlidectlError: an interface is missing, or a hook refused.
        """
        self.claimed_resources = self._claim(hw, root, node)
        self.state = State.INITIALIZED

    def enter_state(self, state: State, time_ns: int) -> None:
        """Call the hook of the state, then set it. The state may equal the present one."""
        getattr(self, HOOKS[state])(time_ns)
        self.state = state

    def _claim(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> tuple[ClaimedResources, ...]:
        raise NotImplementedError


class Controller(ControllerBase, Generic[I]):
    """A controller that uses one interface, `interface_type`. Override one of the two init hooks."""

    interface_type: type[I]

    def init(self, interface: I, node: NodeHandle) -> None:
        """Get handles, parameters and topics. Raises SlidectlError to refuse."""

    def init_in_root(self, interface: I, root: NodeHandle, node: NodeHandle) -> None:
        """As `init`, for a controller that also needs the robot's namespace. Called after `init`."""

    def _claim(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> tuple[ClaimedResources, ...]:
        interface = hw.get(self.interface_type)
        if interface is None:
            raise MissingInterface(self.interface_type.type_name, hw)
        interface.pop_claims()
        self.init(interface, node)
        self.init_in_root(interface, root, node)
        return (ClaimedResources(interface.type_name, interface.pop_claims()),)


class MultiInterfaceController(ControllerBase):
    """A controller that uses several interfaces, those of `interface_types`. Override one of the two init hooks."""

    interface_types: ClassVar[tuple[type[AnyInterface], ...]] = ()
    allow_optional_interfaces: ClassVar[bool] = False
    """True: `hw.get` in `init` returns None for an interface that the robot does not have."""

    def init(self, hw: RobotHW, node: NodeHandle) -> None:
        """Get handles, parameters and topics. `hw` has only the interfaces of `interface_types`."""

    def init_in_root(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> None:
        """As `init`, for a controller that also needs the robot's namespace. Called after `init`."""

    def _claim(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> tuple[ClaimedResources, ...]:
        interfaces: list[AnyInterface] = []
        restricted = RobotHW()
        for interface_type in self.interface_types:
            interface: AnyInterface | None = hw.get(interface_type)
            if interface is not None:
                interface.pop_claims()
                interfaces.append(interface)
                restricted.register_interface(interface)
            elif not self.allow_optional_interfaces:
                raise MissingInterface(interface_type.type_name, hw)
        self.init(restricted, node)
        self.init_in_root(restricted, root, node)
        return tuple(ClaimedResources(interface.type_name, interface.pop_claims()) for interface in interfaces)
