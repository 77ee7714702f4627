"""Physics: robots in a MuJoCo world, and the hardware that controllers see of them.

Knows no topics, no clients and no wall time.
"""

from slidectl.physics.engine import EngineError, take_warnings
from slidectl.physics.world import GRAVITY, Diverged, Snapshot, World

__all__ = ["GRAVITY", "Diverged", "EngineError", "Snapshot", "World", "take_warnings"]
