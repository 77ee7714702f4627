"""Physics: robots in a MuJoCo world, and the hardware that controllers see of them.

It uses no topics, no clients and no wall time.
"""

import os

from slidectl.errors import Refused

try:
    import mujoco  # noqa: F401 - loads OpenGL too, as MUJOCO_GL says
except Exception as error:
    if os.environ.get("MUJOCO_GL", "disable") == "disable":  # the daemon sets this value itself
        raise
    raise Refused(f"MuJoCo cannot be used with MUJOCO_GL={os.environ['MUJOCO_GL']}: {error}", "unset it") from None

from slidectl.physics.attached_robot import AttachedRobot
from slidectl.physics.mujoco_library import EngineError, pop_warnings
from slidectl.physics.robot_hw import MujocoRobotHW
from slidectl.physics.world import GRAVITY, HUGE, Diverged, Overlap, World

__all__ = [
    "GRAVITY",
    "HUGE",
    "AttachedRobot",
    "Diverged",
    "EngineError",
    "MujocoRobotHW",
    "Overlap",
    "World",
    "pop_warnings",
]
