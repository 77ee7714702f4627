"""Bases of the controllers whose command is one number per joint: for one joint, for one joint with a PID, for several.

Subclasses define the meaning of the numbers, the error, and the control law.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any, ClassVar

from slidectl import names
from slidectl.control import params
from slidectl.control.controller_interface import Controller, ControllerBase, Parts, State
from slidectl.control.duration import header_of
from slidectl.control.hardware_interface import JointCommandInterface, JointHandle
from slidectl.control.laws import law
from slidectl.control.node_handle import Message, MessageCallback, NodeHandle, Publisher
from slidectl.control.params import JOINT, JOINTS, Parameter, within
from slidectl.control.pid import GAINS, Pid, ReconfigurablePid
from slidectl.errors import MessageRefused, Reason, Refused

_WARNING_PERIOD_NS = 1_000_000_000


class CommandChecks(ControllerBase):
    """Subscribes to a topic of commands, and warns about commands that have no effect or are clipped."""

    _node: NodeHandle

    def _listen(self, node: NodeHandle, type_name: str, receive: MessageCallback, topic: str = "command") -> None:
        """Subscribe. This must be the last step of an init, since a latched command arrives at once."""
        self._node = node
        self._last_warning = ""
        self._last_warning_ns = 0
        node.subscribe(topic, type_name, receive)

    def _check(self, commands: Sequence[tuple[JointHandle, float, tuple[float, float]]], remark: str = "") -> None:
        """Check a command: each joint, its value, and the lowest and the highest value that is not clipped.

        `remark` is a warning about a value that is not clipped, and is added to the one about a clipped one.

        ros_control accepts nan and infinity, and runs with them.

        Raises:
            MessageRefused: a value is not finite.
        """
        name = self._node.namespace
        if not all(isfinite(value) for _, value, _ in commands):
            text = f"{name} refuses the command: it must be a finite number, not nan or infinity"
            self._node.log("error", text)
            raise MessageRefused(text)
        if not self._is_running():  # `starting` will overwrite the command
            return
        beyond = [
            (joint.name, value, "lower" if value < lowest else "upper", lowest if value < lowest else highest)
            for joint, value, (lowest, highest) in commands
            if not lowest <= value <= highest
        ]
        if not beyond:
            self._last_warning = ""
            if remark:
                self._warn(f"{name}: {remark}", remark)
            return
        parts = [
            f"{value:g} is beyond the {side} limit of joint {joint!r}; it gets {limit:g}"
            for joint, value, side, limit in beyond
        ]
        parts += [remark] if remark else []
        self._warn(f"{name}: {', '.join(parts)}", " ".join(f"{side} {joint}" for joint, _, side, _ in beyond))

    def _is_running(self) -> bool:
        """False, with a warning to the sender of the command, when the controller does not run."""
        if self.state is State.RUNNING:
            return True
        name = self._node.namespace
        start = f"start it: slidectl controller start {name.rpartition('/')[2]}"
        self._warn(f"{name} is not running: the command has no effect; {start}", "idle")
        return False

    def _warn(self, text: str, what: str) -> None:
        """Warn the sender of the command. The same warning is logged at most once per second."""
        now_ns = self._node.now_ns()
        if what != self._last_warning or not 0 <= now_ns - self._last_warning_ns < _WARNING_PERIOD_NS:
            self._last_warning = what
            self._last_warning_ns = now_ns
            self._node.log("warn", text)
        elif self._node.reasons is not None:
            self._node.reasons.append(Reason(text, "warn"))


class CommandController(CommandChecks, Controller[JointCommandInterface]):
    """Commands of joints through one interface, on `~command`."""


class ScalarController(CommandController):
    """One joint, one command on `~command` (std_msgs/Float64)."""

    _joint: JointHandle

    def bounds(self) -> tuple[float, float]:
        """The lowest and the highest command. Others are clipped to these."""
        return self._joint.lowest, self._joint.highest

    def remark(self, value: float) -> str:  # noqa: ARG002
        """A warning about a value that is not likely to be meant; empty for none."""
        return ""

    def set_command(self, value: float) -> None:
        """Follow this value from the next update on, in units of the command."""
        raise NotImplementedError

    def _receive(self, message: Message) -> None:
        value: float = message["data"]
        self._check([(self._joint, value, self.bounds())], self.remark(value))
        self.set_command(value)


class GroupController(CommandController):
    """Several joints, one command for all of them on `~command` (std_msgs/Float64MultiArray), in their order."""

    parameters: ClassVar[tuple[Parameter, ...]] = (JOINTS,)
    _joints: tuple[JointHandle, ...]

    def bounds(self) -> list[tuple[float, float]]:
        """For each joint the lowest and the highest command. Others are clipped to these."""
        return [(joint.lowest, joint.highest) for joint in self._joints]

    def set_commands(self, values: list[float]) -> None:
        """Follow these values from the next update on, in units of the command."""
        raise NotImplementedError

    def _get_joints(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Get the handles. Raises SlidectlError: `joints` is missing or empty, or names an unknown joint."""
        self._joints = tuple(interface.get_handle(name) for name in joint_names(node))

    def _receive(self, message: Message) -> None:
        values: list[float] = list(message["data"])
        if len(values) != len(self._joints):
            text = f"{self._node.namespace} drives {len(self._joints)} joints, and the command has {len(values)} values"
            self._node.log("error", text)
            raise MessageRefused(text)
        self._check(list(zip(self._joints, values, self.bounds(), strict=True)))
        self.set_commands(values)


def joint_names(node: NodeHandle) -> list[str]:
    """The value of `joints`. Raises SlidectlError: it is missing, of another type, or empty."""
    found: list[str] = params.value_of(node, JOINTS)
    where = names.join(node.namespace, JOINTS.name)
    if not found:
        raise Refused(f"parameter {where} must name at least one joint")
    for name in dict.fromkeys(found):
        if found.count(name) > 1:
            node.log("warn", f"parameter {where} names {name!r} twice: the later command is used")
    return found


def warn_of_other_joints(node: NodeHandle, place: str, known: Sequence[str]) -> None:
    """Warn about names in the namespace `place` that are not in `known`: parameters below them have no effect."""
    tree = node.get_param(place, None)
    for name in tree if isinstance(tree, dict) else ():
        if name not in known:
            where = names.join(node.namespace, f"{place}/{name}")
            node.log("warn", f"{where} has no effect: {name!r} is not a joint of this controller")


UPDATES_PER_STATE = 10


@law
def state_is_due(goal: PidController) -> bool:
    """Count an update. True on every tenth update, when the state is due; counts the states too."""
    goal.updates_to_state -= 1
    if goal.updates_to_state:
        return False
    goal.updates_to_state = UPDATES_PER_STATE
    goal.states += 1
    return True


class PidController(ScalarController):
    """Base of controllers of one joint with a PID. The state is published on every tenth update."""

    parameters: ClassVar[tuple[Parameter, ...]] = (JOINT, *within("pid", GAINS))
    _pid: Pid
    _state: Publisher

    def __init__(self) -> None:
        super().__init__()
        # Counted over the life of the controller: stopping and starting do not reset them.
        self.updates_to_state = 1
        self.states = 0
        self.set_point = 0.0
        self.error = 0.0
        """The error of the last update."""

    def parts(self) -> Parts:
        """The parts of the compiled form."""
        return Parts((self._state,), self._joint, self._pid, (self._joint,))

    def _offer_pid(self, node: NodeHandle) -> None:
        """Read the gains and advertise the state. Raises SlidectlError: gains are missing or wrong."""
        self._pid = ReconfigurablePid(node.child("pid")).pid
        self._state = node.advertise("state", "control_msgs/JointControllerState")

    @staticmethod
    def track(goal: Any, pid: Pid, joint: JointHandle, period_s: float) -> None:
        """The law of an update: it sets the joint's command and `goal.error`. `goal` is this controller, or its row."""
        raise NotImplementedError

    def update(self, time_ns: int, period_s: float) -> None:
        self.track(self, self._pid, self._joint, period_s)
        if self._pid.observer is not None:
            self._pid.report(self.error, period_s)
        if state_is_due(self) and self._state.wanted:
            self.publish(time_ns, period_s)

    def _publish_state(self, time_ns: int, period_s: float, *, value: float, value_dot: float) -> None:
        """Publish control_msgs/JointControllerState, with this process value and its derivative."""
        pid = self._pid
        self._state.sequence = self.states - 1
        self._state.publish(
            {
                "header": header_of(time_ns),
                "set_point": self.set_point,
                "process_value": value,
                "process_value_dot": value_dot,
                "error": self.error,
                "time_step": period_s,
                "command": self._joint.command,
                "p": pid.p,
                "i": pid.i,
                "d": pid.d,
                "i_clamp": pid.i_max,
                "antiwindup": pid.antiwindup,
            }
        )
