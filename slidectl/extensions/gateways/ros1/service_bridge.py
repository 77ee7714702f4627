"""Services between the daemon and nodes of ROS 1, both ways.

`ServiceServer` provides native services to foreign clients. `call_service` calls a foreign one, for the daemon.
"""

from __future__ import annotations

import asyncio
import math
import traceback
from collections import deque
from urllib.parse import urlsplit

from slidectl import msgs
from slidectl.errors import BadMessage, NoDaemon, Refused, SlidectlError
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros1.ros1_types import Ros1Type, ros1_type
from slidectl.extensions.gateways.ros1.tcpros import (
    LONGEST_MESSAGE,
    Fields,
    OutgoingConnection,
    TcprosConnection,
    frame,
)
from slidectl.wire.messages import Message

ANY_MD5 = "*"
_TRUE = ("1", "true")
_DONE, _FAILED = b"\x01", b"\x00"


class ServiceServer:
    """The provider of all native services to ROS nodes."""

    def __init__(self, node: str) -> None:
        self._node = node
        self.services: dict[str, tuple[str, str]] = {}
        """Service -> type and node."""
        self._daemon: DaemonConnection | None = None

    def attach(self, daemon: DaemonConnection) -> None:
        self._daemon = daemon

    def detach(self) -> None:
        """Handle the end of the daemon. Clients stay connected; calls fail until a daemon is back."""
        self._daemon = None
        self.services = {}

    def accept(self, connection: TcprosConnection, header: Fields) -> None:
        """Process a client's header. The refusal texts are rospy's."""
        for required in ("service", "md5sum", "callerid"):
            if required not in header:
                connection.refuse(f"Missing required '{required}' field")
                return
        service = header["service"]
        if service not in self.services:
            connection.refuse(f"[{self._node}] is not a provider of  [{service}]")
            return
        type_name, node = self.services[service]
        md5 = msgs.service_md5(type_name)
        if header["md5sum"] not in (ANY_MD5, md5):
            connection.refuse(
                f"request from [{header['callerid']}]: md5sums do not match: [{header['md5sum']}] vs. [{md5}]"
            )
            return
        request, response = msgs.request_type(type_name), msgs.response_type(type_name)
        connection.send_header(
            {
                "callerid": node,
                "md5sum": md5,
                "request_type": request,
                "response_type": response,
                "service": service,
                "type": type_name,
            }
        )
        if header.get("probe") == "1":
            connection.close()
            return
        is_persistent = header.get("persistent", "").lower() in _TRUE
        ServiceClientLink(self, connection, service, ros1_type(request), ros1_type(response), is_persistent)

    async def call(self, service: str, request: Message) -> Message:
        """Call a native service. Raises SlidectlError."""
        if self._daemon is None:
            raise NoDaemon("the daemon has gone")
        return await self._daemon.call(service, request, timeout=math.inf)


class ServiceClientLink:
    """A foreign client of one service. Its requests are answered one after the other."""

    def __init__(
        self,
        server: ServiceServer,
        connection: TcprosConnection,
        service: str,
        request: Ros1Type,
        response: Ros1Type,
        is_persistent: bool,
    ) -> None:
        self._server = server
        self._connection = connection
        self._service = service
        self._request = request
        self._response = response
        self._is_persistent = is_persistent
        self._waiting: deque[bytes | str] = deque()
        """Received requests, or reasons why a request could not be received."""
        self._task: asyncio.Task[None] | None = None
        connection.on_message = lambda body, _: self._take(body)
        connection.on_too_long = self._take
        connection.on_closed = self._end

    def _take(self, request: bytes | str) -> None:
        """Queue a request. Reading stops while a second one waits, so that a fast client fills its own buffers."""
        self._waiting.append(request)
        self._connection.keep(len(request))
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._serve())
        else:
            self._connection.pause_reading()

    async def _serve(self) -> None:
        """Answer all waiting requests."""
        while self._waiting:
            request = self._waiting.popleft()
            self._connection.write(await self._answer(request))
            self._connection.keep(-len(request))
            await self._connection.writable()
            if not self._is_persistent:
                self._connection.close()
                return
        self._connection.resume_reading()
        self._task = None

    async def _answer(self, request: bytes | str) -> bytes:
        try:
            if isinstance(request, str):
                raise BadMessage(request)
            values = await self._server.call(self._service, self._request.unpack(request))
            return _DONE + frame(self._response.pack(values))
        except SlidectlError as error:
            return _FAILED + frame(f"service cannot process request: {error}".encode())
        except Exception as error:  # an internal error fails only this call
            traceback.print_exc()
            return _FAILED + frame(f"service cannot process request: internal error: {error!r}".encode())

    def _end(self) -> None:
        if self._task is not None:
            self._task.cancel()


async def service_type(service: str, uri: str, caller: str) -> tuple[str, str]:
    """Ask a foreign service for its type and md5 sum. Raises SlidectlError."""
    outgoing = await OutgoingConnection.connect(
        *_address(uri), {"callerid": caller, "md5sum": ANY_MD5, "probe": "1", "service": service}
    )
    header = await outgoing.header()
    outgoing.connection.close()
    return header.get("type", ""), header.get("md5sum", "")


async def call_service(service: str, uri: str, type_name: str, request: Message, caller: str) -> Message:
    """Call a foreign service and return its response. No time limit; the call ends when the server disconnects.

    Raises:
        SlidectlError: the call failed, with the reason.
    """
    outgoing = await OutgoingConnection.connect(
        *_address(uri),
        {"callerid": caller, "md5sum": msgs.service_md5(type_name), "service": service, "type": type_name},
        has_status=True,
    )
    try:
        await outgoing.header()
        body = ros1_type(msgs.request_type(type_name)).pack(request)
        if len(body) > LONGEST_MESSAGE:
            raise Refused(f"{service}: a request of {len(body)} bytes exceeds {LONGEST_MESSAGE}")
        answer, is_done = await outgoing.exchange(frame(body))
    finally:
        outgoing.connection.close()
    if not is_done:
        reason = answer.decode("utf-8", "replace")
        raise Refused(f"service [{service}] responded with an error: {reason}")
    return ros1_type(msgs.response_type(type_name)).unpack(answer)


def _address(uri: str) -> tuple[str, int]:
    """Host and port of `rosrpc://host:port`. Raises Refused."""
    try:
        parts = urlsplit(uri)
        if parts.scheme == "rosrpc" and parts.hostname and parts.port:
            return parts.hostname, parts.port
    except ValueError:
        pass
    raise Refused(f"{uri[:200]!r} is not the address of a service: rosrpc://HOST:PORT")
