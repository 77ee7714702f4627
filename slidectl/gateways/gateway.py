"""What all gateways have in common: they wait for the daemon, come back when it does, and end when they are told to."""

from __future__ import annotations

import asyncio
import signal
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ClassVar

from slidectl.errors import NoDaemon
from slidectl.gateways.daemon_connection import DaemonConnection
from slidectl.paths import InstancePaths

_LOOK_EVERY_S = 0.1
"""Between two looks whether there is a daemon again."""
_READING = frozenset(
    [
        *(f"/rosapi/{name}" for name in (
            "action_servers", "get_param", "get_param_names", "get_ros_version", "get_time", "has_param",
            "message_details", "node_details", "nodes", "publishers", "search_param", "service_host", "service_node",
            "service_providers", "service_request_details", "service_response_details", "service_type", "services",
            "services_for_type", "subscribers", "topic_type", "topics", "topics_and_raw_types", "topics_for_type",
        )),
        *(f"/slidectl/{name}" for name in (
            "fault/kinds", "fault/list", "graph", "joint_states", "list_robots", "resolve", "scene", "snapshots",
            "sources", "status", "trace", "update_times", "wait",
        )),
        *(f"/slidectl/get_{name}" for name in (
            "entities", "entities_states", "entity_bounds", "entity_info", "entity_state", "simulation_state",
            "simulator_features", "spawnables",
        )),
        *(f"/gazebo/get_{name}" for name in (
            "joint_properties", "link_properties", "link_state", "model_properties", "model_state",
            "physics_properties", "world_properties",
        )),
    ]
)  # fmt: skip
"""The services that change nothing."""
_READING_ENDS = ("/controller_manager/list_controllers", "/controller_manager/list_controller_types")


class Gateway:
    """Speaks another protocol for the daemon. `open` comes first; then `attach` and `detach` alternate."""

    kind: ClassVar[str]

    def __init__(self) -> None:
        self.lost = asyncio.Event()
        """Set when the daemon has gone; cleared before `attach`."""

    async def open(self) -> str:
        """Listen, and return the address to show.

        Raises:
            Refused: the port is taken, or the host is not of this machine.
        """
        raise NotImplementedError

    async def attach(self, paths: InstancePaths) -> None:
        """There is a daemon. Raises NoDaemon: it has gone again."""
        raise NotImplementedError

    async def detach(self) -> None:
        """The daemon has gone. Foreign clients stay where their protocol lets them."""
        raise NotImplementedError

    async def close(self) -> None:
        """Stop listening, and let all foreign clients go."""
        raise NotImplementedError

    def status(self) -> dict[str, Any]:
        """Numbers and texts for `slidectl gateway status`: `connections`, `dropped`, and what else is of use."""
        raise NotImplementedError


async def serve(gateway: Gateway, paths: InstancePaths, opened: Callable[[str], None]) -> None:
    """Run a gateway until SIGTERM or SIGINT. `opened` is called with its address when it listens and has a daemon.

    Raises:
        Refused: as `open`. NoDaemon: none answers at the start.
    """
    ended = asyncio.Event()

    def end() -> None:
        ended.set()
        gateway.lost.set()  # that is what is waited for

    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        loop.add_signal_handler(number, end)
    address = await gateway.open()
    try:
        connection = await _attached(gateway, paths, address)
        opened(address)
        while not ended.is_set():
            await gateway.lost.wait()
            if ended.is_set():
                break
            connection.close()
            await gateway.detach()
            while not ended.is_set():
                try:
                    connection = await _attached(gateway, paths, address)
                    break
                except NoDaemon:
                    pass
                except Exception:  # a daemon that ends meanwhile may be the reason, and it is tried again
                    traceback.print_exc()
                with suppress(TimeoutError):
                    await asyncio.wait_for(ended.wait(), _LOOK_EVERY_S)
        connection.close()
    finally:
        await gateway.close()


async def _attached(gateway: Gateway, paths: InstancePaths, address: str) -> DaemonConnection:
    """Attach it, and offer its status in the graph. Raises NoDaemon."""
    gateway.lost.clear()

    async def status(_: dict[str, Any]) -> dict[str, Any]:
        counts = gateway.status()
        texts = {"names": list(counts), "values": [str(value) for value in counts.values()]}
        return {"address": address, **texts}

    connection = await DaemonConnection.open(paths, on_lost=gateway.lost.set)
    try:
        await connection.advertise_service(status_service(gateway.kind), "slidectl/GatewayStatus", status)
        await gateway.attach(paths)
    except BaseException:
        connection.close()
        await gateway.detach()
        raise
    return connection


def status_service(kind: str) -> str:
    """The name of the service by which a gateway tells its status."""
    return f"/slidectl/gateways/{kind}"


def is_reading(service: str) -> bool:
    """Whether a service, by its full name, changes nothing: one that a read-only gateway lets its clients call."""
    return service in _READING or service.endswith(_READING_ENDS)
