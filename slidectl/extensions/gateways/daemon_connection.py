"""A gateway's connection to the daemon, on asyncio: calls, topics and services of the wire protocol.

The blocking client (slidectl/client) serves one task at a time; a gateway has many.
"""

from __future__ import annotations

import asyncio
import os
import traceback
from collections.abc import Awaitable, Callable, Collection
from contextlib import suppress
from typing import Any

from slidectl.effects import Effect
from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut
from slidectl.extensions.gateways.tasks import Tasks
from slidectl.operating_system import peer
from slidectl.paths import InstancePaths, check_private, command
from slidectl.wire.lines import LONGEST_LINE, BadLine, LineBuffer, decode, encode

Message = dict[str, Any]
Take = Callable[[Message], None]
ServiceHandler = Callable[[Message], Awaitable[Message]]

CALL_LIMIT_S = 10.0
GRAPH_CHANGES, PARAMETER_CHANGES = "/slidectl/graph_changes", "/slidectl/parameter_changes"
"""Topics that announce changes: std_msgs/Empty and slidectl/ParameterChanges."""
_MOST_UNSENT = 4 * 1024 * 1024
"""Limit of unsent bytes to the daemon; above it `drain` waits."""
_MOST_SERVED = 100
"""Limit of unfinished requests per service; further requests fail."""
_SYNCHRONIZE = "/rosapi/get_time"


class DaemonConnection(asyncio.Protocol):
    """A connection to the daemon, made by `open`. It runs on one event loop.

    `on_refused` takes the text of a refusal of something that was sent without waiting for an answer. When `on_line` is
    set, it takes every received line unchanged, and then only `send_line` is of use.
    """

    def __init__(self, on_lost: Callable[[], None]) -> None:
        self.on_refused: Callable[[str], None] = lambda _: None
        self.on_line: Callable[[bytes], None] | None = None
        self.node = ""
        self._on_lost = on_lost
        self._transport: asyncio.Transport | None = None
        self._incoming = LineBuffer()
        self._last_status = ""
        self._serial = 0
        self._calls: dict[str, asyncio.Future[Message]] = {}
        self._refusals: dict[str, SlidectlError] = {}
        """Id -> refusal, of subscribe and advertise requests in progress."""
        self._awaited: set[str] = set()
        self._takers: dict[str, Take] = {}
        self._handlers: dict[str, ServiceHandler] = {}
        self._served = Tasks()
        self._may_send = asyncio.Event()
        self._may_send.set()

    @classmethod
    async def open(
        cls,
        paths: InstancePaths,
        permitted: Collection[Effect],
        node: str = "",
        on_lost: Callable[[], None] | None = None,
    ) -> DaemonConnection:
        """Connect to the daemon of `paths`; `on_lost` is called when the daemon ends.

        The daemon refuses all but the `permitted` effects on this connection.

        Raises:
            NoDaemon: no daemon answers. Refused: the node's name is taken, or the daemon is another user's.
        """
        try:
            check_private(paths.folder_text)
            loop = asyncio.get_running_loop()
            transport, made = await loop.create_unix_connection(
                lambda: cls(on_lost or (lambda: None)), paths.socket_text
            )
        except OSError as error:
            why = (
                "" if isinstance(error, FileNotFoundError | ConnectionRefusedError) else f": {error.strerror or error}"
            )
            hint = "start it with: " + command(paths, "daemon start")
            raise NoDaemon(f"no daemon answers on {paths.socket_text}{why}", hint) from None
        _, uid = peer(transport.get_extra_info("socket"))
        if uid not in (None, os.geteuid()):
            transport.close()
            raise Refused(f"the daemon on {paths.socket_text} belongs to another user (uid {uid})")
        try:
            if node:
                await made._confirmed("set_node", node=node)
                made.node = node
            await made._confirmed("restrict", permitted=sorted(permitted))
        except BaseException:
            made.close()
            raise
        return made

    # --- asyncio.Protocol ---------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.set_write_buffer_limits(high=_MOST_UNSENT)

    def pause_writing(self) -> None:
        self._may_send.clear()

    def resume_writing(self) -> None:
        self._may_send.set()

    def data_received(self, data: bytes) -> None:
        try:
            self._incoming.feed(data)
            lines = self._incoming.lines
            while lines:
                if self.on_line is not None:
                    self.on_line(lines.popleft())
                else:
                    self._take(decode(lines.popleft()))
        except BadLine:  # the daemon never sends such a line
            self.close()

    def connection_lost(self, error: Exception | None) -> None:  # noqa: ARG002
        if self._transport is None:  # `close` was called
            return
        self._end()
        self._on_lost()

    # --- for gateways -------------------------------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        """False after the daemon has ended or `close` was called."""
        return self._transport is not None

    async def call(self, service: str, request: Message | None = None, timeout_s: float = CALL_LIMIT_S) -> Message:
        """Call a service and return its response.

        Raises:
            Refused: the service failed, with the daemon's text and exit code. TimedOut. NoDaemon: the daemon ended.
        """
        answer = await self._ask({"op": "call_service", "service": service, "args": request or {}}, timeout_s)
        values = answer.get("values")
        if not answer.get("result", True):
            error = Refused(str(values))
            error.exit_code = int(answer.get("exit_code", error.exit_code))
            raise error
        return values if isinstance(values, dict) else {}

    def advertise(self, topic: str, type: str, latch: bool = False) -> None:
        """Become a publisher of a topic."""
        self._send({"op": "advertise", "topic": topic, "type": type, "latch": latch})

    def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic."""
        self._send({"op": "unadvertise", "topic": topic})

    def publish(self, topic: str, message: Message) -> None:
        """Send a message without waiting. A refusal goes to `on_refused`."""
        self._send({"op": "publish", "topic": topic, "msg": message})

    async def subscribe(
        self, topic: str, type: str, take: Take, queue_length: int = 0, throttle_rate_ms: int = 0
    ) -> None:
        """Call `take` with each publish object of the topic: topic, msg, time, and latch if it was latched.

        Raises:
            Refused: the topic has another type, or the type does not exist. NoDaemon.
        """
        options = {"queue_length": queue_length, "throttle_rate": throttle_rate_ms, "stamped": True}
        self._takers[topic] = take
        try:
            await self._confirmed("subscribe", topic=topic, type=type, **options)
        except SlidectlError:
            self._takers.pop(topic, None)
            raise

    def unsubscribe(self, topic: str) -> None:
        """End a subscription."""
        if self._takers.pop(topic, None) is not None:
            self._send({"op": "unsubscribe", "topic": topic})

    async def advertise_service(
        self, service: str, type: str, handler: ServiceHandler, effect: Effect = Effect.WRITES
    ) -> None:
        """Provide a service. A SlidectlError of the handler is the failure of the call.

        Raises:
            Refused: the service exists already, or the type does not exist. NoDaemon.
        """
        self._handlers[service] = handler  # a request may arrive before the confirmation
        try:
            await self._confirmed("advertise_service", service=service, type=type, effect=effect)
        except SlidectlError:
            self._handlers.pop(service, None)
            raise

    def unadvertise_service(self, service: str) -> None:
        """Stop providing a service."""
        if self._handlers.pop(service, None) is not None:
            self._send({"op": "unadvertise_service", "service": service})

    async def drain(self) -> None:
        """Wait while too much is unsent. Raises NoDaemon."""
        await self._may_send.wait()
        if self._transport is None:
            raise self._gone()

    def send_line(self, raw: bytes) -> None:
        """Send a line, with its line end, unchanged. Does nothing after the daemon has ended."""
        if self._transport is not None:
            self._transport.write(raw)

    def pause(self) -> None:
        """Stop reading. The daemon counts the messages that it drops meanwhile, and reports them after `resume`."""
        if self._transport is not None:
            self._transport.pause_reading()

    def resume(self) -> None:
        """Start reading again after `pause`."""
        if self._transport is not None:
            self._transport.resume_reading()

    def close(self) -> None:
        """End the connection, with its advertisements and subscriptions. `on_lost` is not called."""
        if self._transport is not None:
            transport, self._transport = self._transport, None
            transport.close()
            self._end()

    # --- inside -------------------------------------------------------------------------------------------------

    def _send(self, message: Message) -> None:
        line = encode(message)
        if len(line) > LONGEST_LINE:
            self.on_refused(f"{message['op']} of {len(line)} bytes does not fit a line of {LONGEST_LINE}")
            return
        self.send_line(line)

    async def _ask(self, message: Message, timeout_s: float = CALL_LIMIT_S) -> Message:
        """Send a call and wait for its service_response."""
        if self._transport is None:
            raise self._gone()
        self._serial += 1
        call_id = f"call:{self._serial}"
        answered: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        self._calls[call_id] = answered
        self._send({**message, "id": call_id})
        try:
            return await asyncio.wait_for(answered, timeout_s)
        except TimeoutError:
            raise TimedOut(f"{message['service']} did not answer within {timeout_s:g} s") from None
        finally:
            self._calls.pop(call_id, None)
            if not answered.done() or answered.cancelled():  # else the daemon would keep the call for ever
                self._send({"op": "cancel_call", "id": call_id})

    async def _confirmed(self, op: str, **fields: Any) -> None:
        """Send a request that is answered only when refused, and wait until the daemon has processed it.

        Raises:
            Refused, TimedOut, NoDaemon.
        """
        self._serial += 1
        sent_id = f"{op}:{self._serial}"
        self._awaited.add(sent_id)
        try:
            self._send({"op": op, "id": sent_id, **fields})
            await self._ask({"op": "call_service", "service": _SYNCHRONIZE})
        finally:
            self._awaited.discard(sent_id)
        if (refusal := self._refusals.pop(sent_id, None)) is not None:
            raise refusal

    def _take(self, message: Message) -> None:
        op = message.get("op")
        if op == "publish":
            if (take := self._takers.get(message["topic"])) is not None:
                take(message)
        elif op == "service_response":
            answered = self._calls.get(str(message.get("id")))
            if answered is not None and not answered.done():
                answered.set_result(message)
        elif op == "call_service":
            self._serve(message)
        elif op == "status":
            self._take_status(message)

    def _take_status(self, status: Message) -> None:
        text = str(status.get("msg", ""))
        if status.get("level") != "error":
            self._last_status = text
            return
        refusal = Refused(text)
        refusal.exit_code = int(status.get("exit_code", refusal.exit_code))
        if status.get("id") in self._awaited:
            self._refusals[status["id"]] = refusal
        else:
            self.on_refused(text)

    def _serve(self, request: Message) -> None:
        handler = self._handlers.get(request["service"])
        if handler is None or len(self._served) >= _MOST_SERVED:
            why = "is provided no longer" if handler is None else f"has {_MOST_SERVED} calls under way already"
            self._respond(request, f"{request['service']} {why}", is_done=False)
            return
        self._served.begin(self._serve_with(handler, request))

    async def _serve_with(self, handler: ServiceHandler, request: Message) -> None:
        try:
            self._respond(request, await handler(request["args"]), is_done=True)
        except SlidectlError as error:
            self._respond(request, str(error), is_done=False)
        except Exception:  # an error of the gateway fails only this call
            traceback.print_exc()
            self._respond(request, "internal error; the log of the gateway has more", is_done=False)

    def _respond(self, request: Message, values: Message | str, is_done: bool) -> None:
        about = {"op": "service_response", "id": request["id"], "service": request["service"]}
        self._send({**about, "values": values, "result": is_done})

    def _end(self) -> None:
        """Fail all waiting calls with NoDaemon and cancel the handlers."""
        self._transport = None
        self._may_send.set()
        self._served.cancel()
        for answered in list(self._calls.values()):
            if not answered.done():
                with suppress(asyncio.InvalidStateError):
                    answered.set_exception(self._gone())

    def _gone(self) -> NoDaemon:
        return NoDaemon("the daemon went away" + (f": {self._last_status}" if self._last_status else ""))
