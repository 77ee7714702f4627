"""Services between the daemon and nodes of ROS 1, both ways.

`ServiceServer` provides native services to foreign clients. `call_service` calls a foreign one, for the daemon.
"""

from __future__ import annotations

import math
import traceback
from urllib.parse import urlsplit

from slidectl import msgs
from slidectl.errors import NoDaemon, Refused, SlidectlError
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros1.ros1_types import Ros1Type, ros1_type
from slidectl.extensions.gateways.ros1.tcpros import (
    ANY_MD5,
    LONGEST_MESSAGE,
    SENDER_GONE,
    Fields,
    TcprosConnection,
    check_has,
    connect,
    frame,
)
from slidectl.wire.messages import Message

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

    async def serve(self, connection: TcprosConnection, header: Fields) -> None:
        """Answer the requests of a client, one after the other. Raises Refused, with rospy's texts."""
        check_has(header, "service", "md5sum", "callerid")
        service = header["service"]
        if service not in self.services:
            raise Refused(f"[{self._node}] is not a provider of  [{service}]")
        type_name, node = self.services[service]
        md5 = msgs.service_md5(type_name)
        if header["md5sum"] not in (ANY_MD5, md5):
            raise Refused(
                f"request from [{header['callerid']}]: md5sums do not match: [{header['md5sum']}] vs. [{md5}]"
            )
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
        goes_on = header.get("probe") != "1"
        while goes_on:
            answer = await self._answer(connection, service, ros1_type(request), ros1_type(response))
            connection.reader.handled()
            await connection.write(answer)
            goes_on = header.get("persistent", "").lower() in _TRUE

    async def _answer(self, connection: TcprosConnection, service: str, request: Ros1Type, response: Ros1Type) -> bytes:
        """Read a request and call the service. Returns the answer with its status."""
        try:
            values = request.unpack(await connection.read_message())
            if self._daemon is None:
                raise NoDaemon("the daemon has ended")
            return _DONE + frame(response.pack(await self._daemon.call(service, values, timeout=math.inf)))
        except SlidectlError as error:
            return _FAILED + frame(f"service cannot process request: {error}".encode())
        except (EOFError, OSError):
            raise
        except Exception as error:  # an internal error fails only this call
            traceback.print_exc()
            return _FAILED + frame(f"service cannot process request: internal error: {error!r}".encode())


async def service_type(service: str, uri: str, caller: str) -> tuple[str, str]:
    """Ask a foreign service for its type and md5 sum. Raises SlidectlError."""
    fields = {"callerid": caller, "md5sum": ANY_MD5, "probe": "1", "service": service}
    connection, header = await connect(*_address(uri), fields)
    connection.close()
    return header.get("type", ""), header.get("md5sum", "")


async def call_service(service: str, uri: str, type_name: str, request: Message, caller: str) -> Message:
    """Call a foreign service and return its response. No time limit; the call ends when the server disconnects.

    Raises:
        SlidectlError: the call failed, with the reason.
    """
    fields = {"callerid": caller, "md5sum": msgs.service_md5(type_name), "service": service, "type": type_name}
    connection, _ = await connect(*_address(uri), fields)
    try:
        body = ros1_type(msgs.request_type(type_name)).pack(request)
        if len(body) > LONGEST_MESSAGE:
            raise Refused(f"{service}: a request of {len(body)} bytes; the maximum is {LONGEST_MESSAGE}")
        await connection.write(frame(body))
        is_done = await connection.reader.readexactly(1) != _FAILED
        answer = await connection.read_message()
    except (OSError, EOFError):
        raise Refused(f"transport error completing service call: {SENDER_GONE}") from None
    finally:
        connection.close()
    if not is_done:
        raise Refused(f"service [{service}] responded with an error: {answer.decode('utf-8', 'replace')}")
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
