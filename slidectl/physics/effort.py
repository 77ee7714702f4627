"""What Gazebo lets through of an effort on a joint: Joint::CheckAndTruncateForce.

Pure arithmetic on the URDF's `<limit>`; an absent limit cuts nothing, a limit of zero lets nothing through.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from slidectl.control.laws import law
from slidectl.description.robot import Joint


@law
def truncated(effort: float, velocity: float, max_effort: float, max_velocity: float) -> float:
    """The effort that acts at this velocity: none that pushes further beyond the velocity limit, then the clamp."""
    if effort > 0.0:
        if velocity > max_velocity:
            return 0.0
        return max_effort if effort > max_effort else effort
    if effort < 0.0:
        if velocity < -max_velocity:
            return 0.0
        return -max_effort if effort < -max_effort else effort
    return effort


@dataclass(frozen=True, slots=True)
class EffortTruncation:
    """Bounds of a joint: `effort` in N or N·m, `velocity` in m/s or rad/s; infinite when there is none."""

    effort: float = math.inf
    velocity: float = math.inf

    @staticmethod
    def of(joint: Joint) -> EffortTruncation:
        """The bounds of the joint's `<limit>`; a negative value means no bound, as in Gazebo."""
        if joint.limit is None:
            return EffortTruncation()
        return EffortTruncation(_bound(joint.limit.effort), _bound(joint.limit.velocity))

    def cut(self, effort: float, velocity: float) -> float:
        """The effort that acts at this velocity: none that pushes further beyond the velocity limit, then the clamp."""
        return truncated(effort, velocity, self.effort, self.velocity)


def _bound(value: float) -> float:
    return value if value >= 0.0 else math.inf
