"""The base class of gateways, and the loop that runs one: it waits for the daemon, reconnects, and ends on a signal."""

from __future__ import annotations

import asyncio
import signal
import traceback
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

from slidectl.effects import Effect
from slidectl.errors import NoDaemon
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.paths import InstancePaths

_LOOK_EVERY_S = 0.1
"""Wall seconds between two attempts to connect to the daemon."""


@dataclass(frozen=True)
class GatewayOptions:
    """What the clients of any gateway may do, and who they are."""

    allow: tuple[str, ...] = ()
    """`files` and `code`: clients may also call services that use files, or run code, that they name."""
    any_user: bool = False
    """Accept connections of all users of this machine, without a token too."""


class Gateway:
    """A server of another protocol for the daemon. `open` comes first; then `attach` and `detach` alternate."""

    kind: ClassVar[str]
    """Its name in the table of gateway_kinds.py, or that of the entry point; set when the class is loaded."""

    def __init__(self) -> None:
        self.lost = asyncio.Event()
        """Set when the daemon has ended; cleared before `attach`."""

    async def open(self) -> str:
        """Listen, and return the address to show.

        Raises:
            Refused: the port is taken, or the host is not an address of this machine.
        """
        raise NotImplementedError

    async def attach(self, paths: InstancePaths) -> None:
        """Connect to the daemon. Raises NoDaemon: it has ended again."""
        raise NotImplementedError

    async def detach(self) -> None:
        """Disconnect from a daemon that has ended. Foreign clients stay connected if their protocol allows it."""
        raise NotImplementedError

    async def close(self) -> None:
        """Stop listening, and disconnect all foreign clients."""
        raise NotImplementedError

    def status(self) -> dict[str, Any]:
        """Values for `slidectl gateway status`: `connections`, `dropped`, and others."""
        raise NotImplementedError


async def serve(gateway: Gateway, paths: InstancePaths, opened: Callable[[str], None]) -> None:
    """Run a gateway until SIGTERM, SIGINT or SIGHUP. `opened` is called with its address when it listens and has a
    daemon.

    Raises:
        Refused: as `open`. NoDaemon: no daemon answers at the start.
    """
    ended = asyncio.Event()

    def end() -> None:
        ended.set()
        gateway.lost.set()  # wakes the loop below

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
                except Exception:  # possibly because the daemon ends; try again
                    traceback.print_exc()
                with suppress(TimeoutError):
                    await asyncio.wait_for(ended.wait(), _LOOK_EVERY_S)
        connection.close()
    finally:
        await gateway.close()


async def _attached(gateway: Gateway, paths: InstancePaths, address: str) -> DaemonConnection:
    """Attach the gateway and provide its status service. Raises NoDaemon."""
    gateway.lost.clear()

    async def status(_: dict[str, Any]) -> dict[str, Any]:
        counts = gateway.status()
        texts = {"names": list(counts), "values": [str(value) for value in counts.values()]}
        return {"address": address, **texts}

    connection = await DaemonConnection.open(paths, (Effect.READS, Effect.WRITES), on_lost=gateway.lost.set)
    try:
        name = status_service(gateway.kind)
        await connection.advertise_service(name, "slidectl/GatewayStatus", status, Effect.READS)
        await gateway.attach(paths)
    except BaseException:
        connection.close()
        await gateway.detach()
        raise
    return connection


def status_service(kind: str) -> str:
    """The name of the service that returns a gateway's status."""
    return f"/slidectl/gateways/{kind}"


def is_offered(service: dict[str, Any], permitted: Collection[Effect]) -> bool:
    """True when clients may call a service, given as in /slidectl/graph."""
    return service["effects"][0] in permitted
