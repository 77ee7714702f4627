"""Base of the controllers of one joint that take one number as their command.

Gets the joint and the `command` topic, refuses what is no number, and says when a command will be cut or lost. What
the number does is the children's part.
"""

from __future__ import annotations

from math import isfinite

from slidectl.control.controller import Controller
from slidectl.control.handles import JointHandle
from slidectl.control.interfaces import JointCommandInterface
from slidectl.control.node import Message, NodeHandle
from slidectl.control.states import State
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
