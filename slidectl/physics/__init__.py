"""Physics: robots in a MuJoCo world, and the hardware that controllers see of them.

Knows no topics, no clients and no wall time.
"""

from slidectl.physics.body import Body
from slidectl.physics.mujoco_library import EngineError, take_warnings
from slidectl.physics.robot_hw import MujocoRobotHW
from slidectl.physics.world import GRAVITY, Diverged, Overlap, World

__all__ = [
    "GRAVITY",
    "Body",
    "Diverged",
    "EngineError",
    "MujocoRobotHW",
    "Overlap",
    "World",
    "take_warnings",
]
