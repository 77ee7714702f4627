"""slidectl: the ros_control and Gazebo tutorials without ROS and without Gazebo.

What the package gives. `Client` and `Simulation` are resolved on first use, so that importing the package costs
nothing; not even typing is imported, so that a Ctrl-C in a command's first milliseconds finds somebody who takes it.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.1.0"
__all__ = ["Client", "Simulation", "__version__"]


def __getattr__(name: str) -> Any:
    if name == "Client":
        from slidectl.client import Client

        return Client
    if name == "Simulation":
        from slidectl.simulation.simulation import Simulation

        return Simulation
    raise AttributeError(f"module 'slidectl' has no attribute {name!r}")
