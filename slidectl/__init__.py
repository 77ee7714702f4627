"""slidectl: the ros_control and Gazebo tutorials without ROS and without Gazebo.

The package's front door. `Client` is resolved on first use, so that importing the package costs nothing.
"""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"
__all__ = ["Client", "__version__"]


def __getattr__(name: str) -> Any:
    if name == "Client":
        from slidectl.client import Client

        return Client
    raise AttributeError(f"module 'slidectl' has no attribute {name!r}")
