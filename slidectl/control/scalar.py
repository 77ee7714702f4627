"""Base of the controllers of one joint that take one number as their command.

Gets the joint and the `command` topic, and refuses what is no number. What the number does is the children's part.
"""

from __future__ import annotations

from math import isfinite

from slidectl.control.controller import Controller
from slidectl.control.interfaces import JointCommandInterface
from slidectl.control.node import Message, NodeHandle
from slidectl.control.states import State
from slidectl.errors import MessageRefused

_TOLD_EVERY_NS = 1_000_000_000


class ScalarController(Controller[JointCommandInterface]):
    """One joint, one command on `~command` (std_msgs/Float64)."""

    _node: NodeHandle

    def set_command(self, value: float) -> None:
        """Follow this value from the next update on, in units of the command."""
        raise NotImplementedError

    def _listen(self, node: NodeHandle) -> None:
        self._node = node
        self._told_in: State | None = None
        self._told_ns = 0
        node.subscribe("command", "std_msgs/Float64", self._receive)

    def _receive(self, message: Message) -> None:
        """Take a command. ros_control would take nan and infinities too, and run with them."""
        value: float = message["data"]
        if not isfinite(value):
            text = f"{self._node.namespace} takes no command of nan or infinity: it must be a finite number"
            self._node.log("error", text)
            raise MessageRefused(text)
        self._tell_if_idle()
        self.set_command(value)

    def _tell_if_idle(self) -> None:
        """A command before the start is lost, since starting sets its own; say so, but not a hundred times a second."""
        if self.state is State.RUNNING:
            self._told_in = None
            return
        now_ns = self._node.now_ns()
        if self._told_in is not self.state or not 0 <= now_ns - self._told_ns < _TOLD_EVERY_NS:
            self._told_in = self.state
            self._told_ns = now_ns
            self._node.log("warn", f"{self._node.namespace} is not running: the command has no effect")
