"""`AsyncClient`, the client on asyncio, for programs that do several things at the same time.

It speaks the wire as the blocking client does (wire/peers.py), and waits in tasks of one event loop instead. The only
file of this folder that imports asyncio; importing `slidectl.client` does not import it.
"""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Self

from slidectl import names, paths
from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut, UnknownName, Unused
from slidectl.operating_system import peer
from slidectl.wire.json_lines import BadLine, LineBuffer, decode
from slidectl.wire.messages import SYNCHRONIZE, Message, reasons_of, resolved, values_of
from slidectl.wire.peers import ClientPeer, Inbox, check_daemon_user, nobody_answers, went_away

if TYPE_CHECKING:
    from slidectl.msgs.typed import ResolveResponseMsg

AsyncHandler = Callable[[Message], Awaitable[Message]]

_MOST_UNSENT = 4 * 1024 * 1024
"""Limit of unsent bytes to the daemon; above it `drain` waits."""
_CHUNK = 64 * 1024
_MOST_SERVED = 100
"""Limit of unfinished requests of the services that a client provides; further requests fail."""


class AsyncClient:
    """A connection to a daemon, on one event loop. Use it by `async with`: leaving it is as for `Client`.

    Args:
        instance: the daemon's name; by default `SLIDECTL_SOCKET`, `SLIDECTL_INSTANCE` or `default` decide.
        socket: the path of the daemon's socket, instead of `instance`.
        timeout: default limit of each wait in wall seconds; `inf` for no limit.

    Several tasks may use it at the same time; each gets its own answers.
    """

    def __init__(self, instance: str | None = None, socket: str | None = None, timeout: float = 10.0) -> None:
        self.paths = paths.instance(instance, socket)
        self.timeout = timeout
        self.node = ""
        """The name that `set_node` gave to this client's node; empty without one."""
        self.reasons: list[str] = []
        """The daemon's warnings and errors from the request that was answered last.

        A task that reads them before it waits again has those of its own request. `warnings` and `errors` have them
        apart.
        """
        self.warnings: list[str] = []
        self.errors: list[str] = []
        self.on_lost: Callable[[], None] = lambda: None
        """Called when the daemon ends the connection, and not by `close`."""
        self.on_refused: Callable[[str], None] | None = None
        """Takes the text of a refusal of what was sent without waiting. None: `flush` raises it."""
        self.on_line: Callable[[bytes], None] | None = None
        """Takes every received line unchanged, for a relay; then only `send_line` is of use."""
        self.expects_subscribers = True
        """False: messages that nobody receives are no error at the end."""
        self._peer = ClientPeer()
        self._peer.on_call = self._serve
        self._transport: asyncio.Transport | None = None
        self._may_send = asyncio.Event()
        self._waiting: dict[str, asyncio.Future[Message]] = {}
        self._confirming: set[str] = set()
        """Ids of the operations whose refusals somebody waits for."""
        self._handlers: dict[str, AsyncHandler] = {}
        self._serving: set[asyncio.Task[None]] = set()
        self._full_names: dict[tuple[str, str], str] = {}
        self._published = False

    # --- the connection -----------------------------------------------------------------------------------------

    async def connect(self) -> Self:
        """Connect to the daemon; `async with` does it.

        Raises:
            NoDaemon: no daemon answers. Refused: the socket's folder is not private, or the daemon is another user's.
        """
        loop = asyncio.get_running_loop()
        try:
            paths.check_socket(self.paths)
            lines = _Lines(self._received, self._may_send, self._lost)
            async with asyncio.timeout(_limit(self.timeout)):
                transport, _ = await loop.create_unix_connection(lambda: lines, self.paths.socket_text)
        except OSError as error:
            raise nobody_answers(self.paths, error) from None
        if transport.is_closing():
            raise self._gone()
        try:
            check_daemon_user(peer(transport.get_extra_info("socket"))[1], self.paths)
        except BaseException:
            transport.close()
            raise
        transport.set_write_buffer_limits(high=_MOST_UNSENT)
        self._transport = transport
        self._may_send.set()
        return self

    @property
    def is_open(self) -> bool:
        """False before `connect`, after the daemon has ended, and after `close`."""
        return self._transport is not None

    def close(self) -> None:
        """Close the connection without waiting. Its advertisements and subscriptions end. Warns of dropped messages."""
        if self._transport is not None:
            self._transport.close()
            self._end()
        self._peer.warn_of_dropped()

    async def __aenter__(self) -> Self:
        return await self.connect()

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None and self._published:
                await self.flush()
                self._peer.check_heard()
        finally:
            self.close()

    async def drain(self) -> None:
        """Wait while too much is unsent. Raises NoDaemon."""
        await self._may_send.wait()
        if self._transport is None:
            raise self._gone()

    def pause(self) -> None:
        """Stop reading. The daemon counts the messages that it drops meanwhile, and reports them after `resume`."""
        if self._transport is not None:
            self._transport.pause_reading()

    def resume(self) -> None:
        """Start reading again after `pause`."""
        if self._transport is not None:
            self._transport.resume_reading()

    def send_line(self, raw: bytes) -> None:
        """Send a line, with its line end, unchanged. Does nothing after the daemon has ended."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(raw)

    async def restrict(self, *permitted: str) -> None:
        """Give up all effects but these on this connection, for good: "reads", "writes", "files", "code".

        Raises Refused: no such effect.
        """
        await self._confirm(*self._peer.request("restrict", permitted=list(permitted)))

    async def set_node(self, node: str) -> None:
        """Name this client's node. Raises Refused: the name is taken, or the client is in use already."""
        await self._confirm(*self._peer.request("set_node", node=node))
        self.node = node

    # --- services -----------------------------------------------------------------------------------------------

    async def call(self, service: str, request: Message | None = None, *, timeout: float | None = None) -> Message:
        """Call a service and return its response; missing fields of the request take their defaults.

        Cancelling the task cancels the call.

        Raises:
            Refused: the service failed; its text and exit code are the daemon's.
            TimedOut: no answer within `timeout` wall seconds. NoDaemon: the daemon went away.
        """
        return values_of(await self._call(service, request, timeout))

    async def _call(self, service: str, request: Message | None, timeout: float | None) -> Message:
        """Call a service and return the answer as received."""
        full = service if service.startswith("/") else await self._full("service", service)
        call_id, line = self._peer.call(full, request)
        try:
            return await self._answer(call_id, line, full, timeout)
        except (TimedOut, asyncio.CancelledError):  # else the daemon would keep the call for ever
            self.send_line(self._peer.cancel(call_id))
            raise

    async def _answer(self, request_id: str, line: bytes, what: str, timeout: float | None) -> Message:
        """Send a request and wait for its answer."""
        if self._transport is None:
            self._peer.forget(request_id)
            raise self._gone()
        answered: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        self._waiting[request_id] = answered
        self.send_line(line)
        seconds = self.timeout if timeout is None else timeout
        try:
            async with asyncio.timeout(_limit(seconds)):
                answer = await answered
        except TimeoutError:
            raise TimedOut(f"{what} did not answer within {seconds:g} s") from None
        finally:
            del self._waiting[request_id]
            self._peer.forget(request_id)
        self.reasons, self.warnings, self.errors = reasons_of(answer)
        return answer

    async def _confirm(self, request_id: str, line: bytes) -> None:
        """Send a request that is answered only when it is refused, and wait until it is handled.

        Raises Refused, TimedOut, NoDaemon.
        """
        self._confirming.add(request_id)
        try:
            self.send_line(line)
            await self.call(SYNCHRONIZE)
        finally:
            self._confirming.discard(request_id)
        self._peer.check_refused(request_id)

    async def advertise_service(self, service: str, type: str, handler: AsyncHandler, effect: str = "writes") -> None:
        """Provide a service until the client is closed. The handler takes a request and returns the response.

        With the effect "reads" clients may call it that may only read. Each request has a task of its own. An exception
        of the handler is the failure of the caller's call. A name without a leading slash is in the root namespace.

        Raises:
            Refused: the service exists already, or the type does not exist. NoDaemon.
        """
        service = names.join("/", service)
        self._handlers[service] = handler  # a request may arrive before the confirmation
        try:
            await self._confirm(*self._peer.request("advertise_service", service=service, type=type, effect=effect))
        except SlidectlError:
            self._handlers.pop(service, None)
            raise

    def unadvertise_service(self, service: str) -> None:
        """Stop providing a service."""
        if self._handlers.pop(service, None) is not None:
            self.send_line(self._peer.request("unadvertise_service", service=service)[1])

    def _serve(self, request: Message) -> None:
        service = request["service"]
        handler = self._handlers.get(service)
        if handler is None:
            self.send_line(self._peer.respond(request, f"{service} is no longer provided"))
        elif len(self._serving) >= _MOST_SERVED:
            text = f"{service} already has {_MOST_SERVED} calls in progress"
            self.send_line(self._peer.respond(request, text))
        else:
            task = asyncio.get_running_loop().create_task(self._serve_with(handler, request))
            self._serving.add(task)
            task.add_done_callback(self._serving.discard)

    async def _serve_with(self, handler: AsyncHandler, request: Message) -> None:
        try:
            line = self._peer.respond(request, await handler(request["args"]))
        except Exception as error:  # reported to the caller; also raised for a response that JSON cannot hold
            line = self._peer.respond(request, self.failure_of(error))
        self.send_line(line)

    def failure_of(self, error: Exception) -> str:
        """What the caller of a service is told when its handler raises this."""
        return str(error) or type(error).__name__

    # --- topics -------------------------------------------------------------------------------------------------

    def advertise(self, topic: str, type: str, latch: bool = False) -> None:
        """Become a publisher of a topic, by its full name, until the client is closed; as `Client.advertise`."""
        self.send_line(self._peer.advertise(names.join("/", topic), type, latch))

    def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic."""
        self.send_line(self._peer.unadvertise(topic))

    def publish(self, topic: str, message: Message, type: str | None = None, latch: bool = False) -> None:
        """Send one message without waiting. The topic is a full name; an existing one needs no type.

        `flush` raises if the message was refused, or `on_refused` takes the reason.
        """
        topic = names.join("/", topic)
        if type is not None or latch:
            self.send_line(self._peer.advertise(topic, type, latch))
        options = {"unheard": True} if self.expects_subscribers and not latch else {}
        try:
            self.send_line(self._peer.publish(topic, message, **options)[1])
        except BadLine as error:
            if self.on_refused is None:
                raise
            self.on_refused(str(error))
        self._published = True

    async def deliver(self, topic: str, message: Message, type: str | None = None, latch: bool = False) -> None:
        """Publish one message, and wait until its subscribers have it. Raises MessageRefused, TimedOut, NoDaemon."""
        topic = await self._full("topic", topic, "subscribers", type)
        if type is not None or latch:
            self.send_line(self._peer.advertise(topic, type, latch))
        publish_id, line = self._peer.publish(topic, message, ack=True)
        self._peer.awaited.add(publish_id)
        self._confirming.add(publish_id)
        try:
            await self._answer(publish_id, line, topic, None)
        finally:
            self._confirming.discard(publish_id)
        self._peer.check_refused(publish_id)

    async def flush(self, *, timeout: float | None = None) -> None:
        """Wait until the daemon has handled everything that was sent and passed it to the subscribers.

        Raises:
            MessageRefused: the first refusal, with its exit code. TimedOut. NoDaemon.
        """
        self._published = False
        await self.call(SYNCHRONIZE, timeout=timeout)
        self._peer.check_all_refused()

    async def subscribe(
        self,
        topic: str,
        type: str | None = None,
        queue_length: int = 0,
        throttle_rate: int = 0,
        take: Callable[[Message], None] | None = None,
    ) -> AsyncSubscription:
        """Receive the topic's messages from now on. The arguments are those of `Client.subscribe`.

        With `take`, each publish object is given to it when it arrives, and no messages are queued.

        Raises:
            Refused: the topic does not exist or has another type. NoDaemon.
        """
        topic = await self._full("topic", topic, "publishers", type)
        subscription = AsyncSubscription(self, topic, self._peer.next_id("subscribe"), queue_length, take)
        line = self._peer.subscribe(subscription, throttle_rate, queue_length, type, is_stamped=take is not None)
        try:
            await self._confirm(subscription.id, line)
        except BaseException as error:
            line = self._peer.unsubscribe(subscription)
            if not isinstance(error, Refused):  # a refused one does not exist
                self.send_line(line)
            raise
        return subscription

    def unsubscribe(self, topic: str) -> None:
        """End all subscriptions of this client to a topic."""
        for inbox in list(self._peer.inboxes.get(topic, ())):
            self.send_line(self._peer.unsubscribe(inbox))

    def end_subscription(self, subscription: AsyncSubscription) -> None:
        """End one subscription. `AsyncSubscription.close` calls this."""
        self.send_line(self._peer.unsubscribe(subscription))

    # --- names --------------------------------------------------------------------------------------------------

    async def _full(self, kind: str, name: str, role: str = "", type: str | None = None) -> str:
        """The full name of a relative one, cached. A new topic with a type is in the root namespace."""
        if name.startswith("/"):
            return name
        full = self._full_names.get((kind, name))
        if full is None:
            try:
                full = (await self.resolve(kind, name, role=role))["name"]
            except Unused:
                full = (await self.resolve(kind, name))["name"]
            except UnknownName:
                if type is None:
                    raise
                full = names.join("/", name)
            self._full_names[kind, name] = full
        return full

    async def resolve(
        self, kind: str, name: str, *, namespace: str = "/", role: str = "", with_field: bool = False
    ) -> ResolveResponseMsg:
        """The full name of a short one, as `Client.resolve`. Raises UnknownName, AmbiguousName, Unused."""
        request = {"kind": kind, "name": name, "namespace": namespace, "role": role, "with_field": with_field}
        response: ResolveResponseMsg = resolved(await self._call("/slidectl/resolve", request, None))
        return response

    # --- what arrives -------------------------------------------------------------------------------------------

    def _received(self, line: bytes) -> None:
        """Take a line that has arrived. Raises BadLine, which a daemon never causes."""
        if self.on_line is not None:
            self.on_line(line)
            return
        message = decode(line)
        answered = self._peer.receive(message)
        if message.get("op") == "status" and message.get("level") == "error":
            self._pass_on_refusal(message)
        if answered is not None and (waiting := self._waiting.get(answered)) is not None and not waiting.done():
            waiting.set_result(message)

    def _pass_on_refusal(self, status: Message) -> None:
        """Give a refusal that no task waits for to `on_refused`, if it is set."""
        refused = str(status.get("id"))
        if self.on_refused is not None and refused not in self._confirming:
            self._peer.refusals.pop(refused, None)
            self.on_refused(str(status.get("msg", "")))

    def _lost(self) -> None:
        """The daemon has ended the connection, or has sent what is no line."""
        if self._transport is not None:  # else `close` was called
            self._end()
            self.on_lost()

    def _end(self) -> None:
        """Fail all that waits with NoDaemon, and cancel the handlers."""
        self._transport = None
        self._may_send.set()
        for task in self._serving:
            task.cancel()
        for waiting in list(self._waiting.values()):
            if not waiting.done():
                with suppress(asyncio.InvalidStateError):
                    waiting.set_exception(self._gone())
        for inbox in [one for inboxes in self._peer.inboxes.values() for one in inboxes]:
            if isinstance(inbox, AsyncSubscription):
                inbox.wake()

    def _gone(self) -> NoDaemon:
        return went_away(self._peer.last_status)


class AsyncSubscription(Inbox):
    """Messages of one topic, in order. `async for` waits for each without a limit; `get` waits with one."""

    def __init__(
        self,
        client: AsyncClient,
        topic: str,
        subscription_id: str,
        queue_length: int,
        take: Callable[[Message], None] | None = None,
    ) -> None:
        super().__init__(topic, subscription_id, queue_length, take)
        self._client = client
        self._arrived = asyncio.Event()

    def add(self, published: Message) -> None:
        super().add(published)
        self._arrived.set()

    def wake(self) -> None:
        """Let waiting tasks look at the connection again: it has ended."""
        self._arrived.set()

    async def get(self, timeout: float | None = None) -> Message:
        """Return the next message; wait at most `timeout` wall seconds (the client's by default, `inf` for no limit).

        Raises:
            TimedOut: no message arrived. NoDaemon: the daemon ended.
        """
        seconds = self._client.timeout if timeout is None else timeout
        try:
            async with asyncio.timeout(_limit(seconds)):
                while not self.queue:
                    await self._client.drain()  # raises when the daemon has ended
                    self._arrived.clear()
                    await self._arrived.wait()
        except TimeoutError:
            raise TimedOut(f"no message on {self.topic} within {seconds:.3g} s") from None
        return self.queue.popleft()

    def __aiter__(self) -> AsyncIterator[Message]:
        return self

    async def __anext__(self) -> Message:
        return await self.get(math.inf)

    def close(self) -> None:
        """Unsubscribe. Messages in the queue can still be read. Warns of dropped messages."""
        self._client.end_subscription(self)
        self.warn_of_dropped()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


class _Lines(asyncio.Protocol):
    """The end of the transport: splits what arrives into lines, and notes whether more may be sent."""

    def __init__(self, received: Callable[[bytes], None], may_send: asyncio.Event, lost: Callable[[], None]) -> None:
        self._received = received
        self._may_send = may_send
        self._lost = lost
        self._incoming = LineBuffer()
        self._transport: asyncio.BaseTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def pause_writing(self) -> None:
        self._may_send.clear()

    def resume_writing(self) -> None:
        self._may_send.set()

    def data_received(self, data: bytes) -> None:
        try:
            self._incoming.feed(data)
            lines = self._incoming.lines
            while lines:
                self._received(lines.popleft())
        except BadLine:  # the daemon never sends such a line
            if self._transport is not None:
                self._transport.close()

    def connection_lost(self, error: Exception | None) -> None:
        if error is not None and self._transport is not None:
            # A write failed: what the daemon sent before its end, answers and the reason, has not been read yet.
            connection = self._transport.get_extra_info("socket").fileno()
            with suppress(OSError):
                while data := os.read(connection, _CHUNK):
                    self.data_received(data)
        self._lost()


def _limit(seconds: float) -> float | None:
    """A limit for asyncio, which has no infinite one."""
    return None if seconds == math.inf else seconds
