"""Joint handles: named places where the hardware puts what it measured and a controller puts its command.

A handle is plain data with slots, since the cycle reads and writes it a thousand times a second. It knows
neither physics nor controllers.
"""

from __future__ import annotations

from math import inf


class JointStateHandle:
    """State of one joint: position (m or rad), velocity (m/s or rad/s), effort (N or N·m)."""

    __slots__ = ("effort", "name", "position", "velocity")

    def __init__(self, name: str, position: float = 0.0, velocity: float = 0.0, effort: float = 0.0) -> None:
        self.name = name
        self.position = position
        self.velocity = velocity
        self.effort = effort

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"


class JointHandle(JointStateHandle):
    """State and command of one joint. The unit of `command` is that of the interface it is registered with."""

    __slots__ = ("command", "highest", "lowest")

    def __init__(
        self, name: str, position: float = 0.0, velocity: float = 0.0, effort: float = 0.0, command: float = 0.0
    ) -> None:
        super().__init__(name, position, velocity, effort)
        self.command = command
        self.lowest = -inf
        """The hardware lets no command below this through, nor one above `highest`."""
        self.highest = inf
