"""roscore's node /rosout: what anybody says on /rosout comes out on /rosout_agg."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from slidectl.gateways.daemon_connection import DaemonConnection

NODE = "/rosout"
_LOGGER = {"name": "ros", "level": "info"}


async def open_rosout(connect: Callable[[str], Awaitable[DaemonConnection]]) -> DaemonConnection:
    """The node, as a connection to the daemon. Raises Refused, NoDaemon."""
    connection = await connect(NODE)
    connection.advertise("/rosout_agg", "rosgraph_msgs/Log")

    def take(published: dict[str, Any]) -> None:
        connection.publish("/rosout_agg", published["msg"])

    async def loggers(_: dict[str, Any]) -> dict[str, Any]:
        return {"loggers": [_LOGGER]}

    async def set_level(_: dict[str, Any]) -> dict[str, Any]:
        return {}

    await connection.subscribe("/rosout", "rosgraph_msgs/Log", take)
    await connection.advertise_service(f"{NODE}/get_loggers", "roscpp/GetLoggers", loggers)
    await connection.advertise_service(f"{NODE}/set_logger_level", "roscpp/SetLoggerLevel", set_level)
    return connection
