"""Gateways to other protocols: ROS 1, WebSocket, Foxglove. Each is a process and a client of the daemon.

It exports the names that authors of gateways import; they are imported on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slidectl.extensions.gateways.daemon_connection import DaemonConnection
    from slidectl.extensions.gateways.gateway import Gateway, GatewayOptions

__all__ = ["DaemonConnection", "Gateway", "GatewayOptions"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from slidectl.extensions.gateways import daemon_connection, gateway

    return getattr(gateway if hasattr(gateway, name) else daemon_connection, name)
