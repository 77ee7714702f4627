"""Bases of the controllers of one joint: those that take one number as their command, and those of them with a PID.

What the number does, the error and what becomes of it are the children's part.
"""

from __future__ import annotations

from math import isfinite
from typing import ClassVar

from slidectl.control.controller_interface import Controller, Parts, State
from slidectl.control.duration import to_stamp
from slidectl.control.hardware_interface import JointCommandInterface, JointHandle
from slidectl.control.laws import law
from slidectl.control.node_handle import Message, NodeHandle, Publisher
from slidectl.control.params import JOINT, Parameter, within
from slidectl.control.pid import Gains, Pid
from slidectl.control.reconfigurable_pid import GAINS, ReconfigurablePid
from slidectl.errors import MessageRefused

_TOLD_EVERY_NS = 1_000_000_000


class ScalarController(Controller[JointCommandInterface]):
    """One joint, one command on `~command` (std_msgs/Float64)."""

    _node: NodeHandle
    _joint: JointHandle

    def bounds(self) -> tuple[float, float]:
        """The lowest and the highest command that is followed as it is; the others are cut to these."""
        return self._joint.lowest, self._joint.highest

    def set_command(self, value: float) -> None:
        """Follow this value from the next update on, in units of the command."""
        raise NotImplementedError

    def _listen(self, node: NodeHandle) -> None:
        self._node = node
        self._told = ""
        self._told_ns = 0
        node.subscribe("command", "std_msgs/Float64", self._receive)

    def _receive(self, message: Message) -> None:
        """Take a command. ros_control would take nan and infinities too, and run with them."""
        value: float = message["data"]
        if not isfinite(value):
            text = f"{self._node.namespace} takes no command of nan or infinity: it must be a finite number"
            self._node.log("error", text)
            raise MessageRefused(text)
        lowest, highest = self.bounds()
        if self.state is not State.RUNNING:  # starting will set a command of its own
            self._tell("idle", f"{self._node.namespace} is not running: the command has no effect")
        elif not lowest <= value <= highest:
            side, limit = ("lower", lowest) if value < lowest else ("upper", highest)
            joint = f"joint {self._joint.name!r}"
            self._tell(
                side, f"{self._node.namespace}: {value:g} is beyond the {side} limit of {joint}; it gets {limit:g}"
            )
        else:
            self._told = ""
        self.set_command(value)

    def _tell(self, what: str, text: str) -> None:
        """Say it to whoever sent the command; on the log not a hundred times a second."""
        now_ns = self._node.now_ns()
        if what != self._told or not 0 <= now_ns - self._told_ns < _TOLD_EVERY_NS:
            self._told = what
            self._told_ns = now_ns
            self._node.log("warn", text)
        elif self._node.reasons is not None:
            self._node.reasons.append(text)


UPDATES_PER_STATE = 10


@law
def state_is_due(goal: PidController) -> bool:
    """Count an update. True on every tenth, when the state is to be published; that is counted too."""
    goal.updates_to_state -= 1
    if goal.updates_to_state:
        return False
    goal.updates_to_state = UPDATES_PER_STATE
    goal.states += 1
    return True


class PidController(ScalarController):
    """A joint, its PID, and its state on every tenth update."""

    parameters: ClassVar[tuple[Parameter, ...]] = (JOINT, *within("pid", GAINS))
    _pid: Pid
    _reconfigurable_pid: ReconfigurablePid
    _state: Publisher

    def __init__(self) -> None:
        super().__init__()
        # Counted over the life of the controller: stopping and starting leave it alone.
        self.updates_to_state = 1
        self.states = 0
        self.set_point = 0.0
        self.error = 0.0
        """Of the last update."""

    @property
    def gains(self) -> Gains:
        """The gains now in use."""
        return self._pid.gains

    def set_gains(self, gains: Gains) -> None:
        """Use these gains from the next update on; parameters and subscribers are told."""
        self._reconfigurable_pid.set_gains(gains)

    def parts(self) -> Parts | None:
        """What runs compiled besides this controller; None while its PID publishes each step."""
        if self._pid.observer is not None:
            return None
        return Parts(self._state, self._joint, self._pid, (self._joint,))

    def _offer_pid(self, node: NodeHandle) -> None:
        self._reconfigurable_pid = ReconfigurablePid(node.child("pid"))
        self._pid = self._reconfigurable_pid.pid

    def _offer_state(self, node: NodeHandle) -> None:
        self._state = node.advertise("state", "control_msgs/JointControllerState")

    def _tell_state(self, time_ns: int, period_s: float, *, value: float, value_dot: float) -> None:
        self._state.sequence = self.states - 1
        self._state.publish(self._state_message(time_ns, period_s, value, value_dot))

    def _state_message(self, time_ns: int, period_s: float, value: float, value_dot: float) -> Message:
        """As control_msgs/JointControllerState."""
        pid = self._pid
        return {
            "header": {"seq": 0, "stamp": to_stamp(time_ns), "frame_id": ""},
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
