"""slidectl: the ros_control and Gazebo tutorials without ROS and without Gazebo.

The package exports `Client`, `AsyncClient` and `Simulation`. They are imported on first use, so that importing the
package is fast.
Not even typing is imported, so that a Ctrl-C in the first milliseconds of a command reaches the command's handler.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from slidectl.client.async_client import AsyncClient
    from slidectl.client.client import Client
    from slidectl.simulation.simulation import Simulation

__version__ = "0.1.0"
__all__ = ["AsyncClient", "Client", "Simulation", "__version__"]


def __getattr__(name: str) -> Any:
    if name == "Client":
        from slidectl.client import Client

        return Client
    if name == "AsyncClient":
        from slidectl.client.async_client import AsyncClient

        return AsyncClient
    if name == "Simulation":
        from slidectl.simulation.simulation import Simulation

        return Simulation
    raise AttributeError(f"module 'slidectl' has no attribute {name!r}")
