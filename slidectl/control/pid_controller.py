"""Base of the controllers of one joint with a PID: live gains in `~pid`, and the `~state` topic.

The error and what becomes of it are the children's part.
"""

from __future__ import annotations

from typing import ClassVar

from slidectl.control.duration import to_stamp
from slidectl.control.laws import Parts, law
from slidectl.control.live_pid import GAINS, LivePid
from slidectl.control.node import Message, NodeHandle, Publisher
from slidectl.control.parameters import JOINT, Parameter, within
from slidectl.control.pid import Gains, Pid
from slidectl.control.scalar import ScalarController

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
    _live_pid: LivePid
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
        self._live_pid.set_gains(gains)

    def parts(self) -> Parts | None:
        """What runs compiled besides this controller; None while its PID publishes each step."""
        if self._pid.observer is not None:
            return None
        return Parts(self._state, self._joint, self._pid, (self._joint,))

    def _offer_pid(self, node: NodeHandle) -> None:
        self._live_pid = LivePid(node.child("pid"))
        self._pid = self._live_pid.pid

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
