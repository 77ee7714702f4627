"""A blocking connection to a daemon: call, publish, subscribe, provide services, find names.

It starts no thread: what arrives is sorted while a call waits. When the daemon ends, calls raise NoDaemon; the client
does not connect again. Standard library only.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Self, cast

from slidectl import names, paths
from slidectl.client.link import ClientLink, SocketLink
from slidectl.errors import NoDaemon, Refused, TimedOut, UnknownName, Unused, listing
from slidectl.paths import command
from slidectl.wire.messages import SYNCHRONIZE, Message, reasons_of, resolved, values_of
from slidectl.wire.peers import ClientPeer, Inbox, typed

if TYPE_CHECKING:
    from slidectl.msgs.typed import Call, ResolveResponseMsg

_PROBE_S = 0.5


def _typed(call: Callable[..., Message]) -> Call:
    """Give type checkers the responses of the known services."""
    return cast("Call", call)


class GraphClient:
    """The graph of a daemon as one client uses it. `Client` adds the world, parameters and controllers."""

    def __init__(
        self,
        instance: str | None = None,
        socket: str | None = None,
        timeout: float = 10.0,
        link: ClientLink | None = None,
    ) -> None:
        self._link = link or SocketLink(paths.instance(instance, socket), time.monotonic() + timeout)
        self._peer = ClientPeer()
        self._peer.on_call = self._serve
        self._peer.on_other_version = lambda version: self.on_other_version(version)
        self.on_other_version: Callable[[str], None] = lambda _version: None
        """Called once with the daemon's version if it differs from the client's; empty if the daemon sends none."""
        self.paths = self._link.paths
        self.timeout = timeout
        self.reasons: list[str] = []
        """The daemon's warnings and errors from the request that was answered last.

        That is the last `call`, `answer`, `deliver` or `flush`, whether it raised or not. `warnings` and `errors` have
        them apart.
        """
        self.warnings: list[str] = []
        self.errors: list[str] = []
        self._published = False
        self._full_names: dict[tuple[str, str], str] = {}
        self._handlers: dict[str, Callable[[Message], Message]] = {}
        """Service -> handler, of the services that this client provides."""

    # --- services -----------------------------------------------------------------------------------------------

    @_typed
    def call(self, service: str, request: Message | None = None, *, timeout: float | None = None) -> Message:
        """Call a service and wait for its response; missing fields of the request take their defaults.

        Raises:
            Refused: the service failed; its text and exit code are the daemon's.
            TimedOut: no answer within `timeout` wall seconds. NoDaemon: the daemon went away.
        """
        return values_of(self._answer(self.call_async(service, request), timeout))

    def call_async(self, service: str, request: Message | None = None) -> str:
        """Send a call and return its id without waiting; `answer` waits for the response."""
        full = service if service.startswith("/") else self._full("service", service)
        call_id, line = self._peer.call(full, request)
        self._send_line(line)
        return call_id

    def answer(self, call_id: str, *, timeout: float | None = None) -> Message:
        """Wait for the response to an earlier `call_async` and return it. Raises as `call` does."""
        return values_of(self._answer(call_id, timeout))

    def _answer(self, call_id: str, timeout: float | None) -> Message:
        """Wait for the answer and return the object as received."""
        answers = self._peer.answers
        if call_id not in answers:
            seconds = self.timeout if timeout is None else timeout
            try:
                if not self._becomes(lambda: call_id in answers, seconds):
                    raise self._timed_out("the service did not answer", seconds)
            except BaseException:
                self._peer.forget(call_id)
                raise
        answer = self._peer.answer(call_id)
        self.reasons, self.warnings, self.errors = reasons_of(answer)
        return answer

    def is_answered(self, call_id: str) -> bool:
        """True when the response to an earlier `call_async` has arrived: `answer` will not wait."""
        return call_id in self._peer.answers

    def forget(self, call_id: str) -> None:
        """Discard the response to an earlier `call_async`, now or when it arrives."""
        self._peer.forget(call_id)

    def restrict(self, *permitted: str) -> None:
        """Give up all effects but these on this connection, for good: "reads", "writes", "files", "code".

        For programs that act for others, as gateways do: the daemon refuses the rest. Raises Refused: no such effect.
        """
        self._confirm(*self._peer.request("restrict", permitted=list(permitted)))

    def _confirm(self, request_id: str, line: bytes) -> None:
        """Send a request that is answered only when it is refused, and wait until it is handled. Raises Refused."""
        self._send_line(line)
        self.call(SYNCHRONIZE)
        self._peer.check_refused(request_id)

    def advertise_service(
        self, service: str, type: str, handler: Callable[[Message], Message], effect: str = "writes"
    ) -> None:
        """Provide a service until the client is closed. The handler takes a request and returns the response.

        With the effect "reads" clients may call it that may only read.

        Requests are answered while the client waits in a call. An exception of the handler is the failure of the
        caller's call. A name without a leading slash is in the root namespace.

        Raises:
            Refused: the service exists already, or the type does not exist.
        """
        service = names.join("/", service)
        if service in self._handlers:
            raise Refused(f"this client already provides {service}")
        self._handlers[service] = handler
        try:
            self._confirm(*self._peer.request("advertise_service", service=service, type=type, effect=effect))
        except Refused:
            del self._handlers[service]
            raise

    def _serve(self, request: Message) -> None:
        handler = self._handlers.get(request["service"])
        if handler is None:  # a script that advertised the service without a handler reads `events`
            return
        try:
            line = self._peer.respond(request, handler(request["args"]))
        except Exception as error:  # reported to the caller; also raised for a response that JSON cannot hold
            line = self._peer.respond(request, str(error) or type(error).__name__)
        self._send_line(line)

    # --- topics -------------------------------------------------------------------------------------------------

    def advertise(self, topic: str, type: str | None = None, latch: bool = False) -> None:
        """Become a publisher until the client is closed; `latch` keeps the last message for new subscribers."""
        if line := self._peer.advertise(self._full("topic", topic, "subscribers", type), type, latch):
            self._send_line(line)
            self._published = True

    def publish(self, topic: str, message: Message, type: str | None = None, latch: bool = False) -> None:
        """Send one message. An existing topic needs no type; `flush` raises if the message was refused."""
        # A latched message is kept for later subscribers.
        self._publish(topic, message, type, latch, **({} if latch else {"unheard": True}))
        self._published = True

    def _publish(self, topic: str, message: Message, type_name: str | None, latch: bool, **options: object) -> str:
        """Send a publish object with these options, such as `type`. Returns its id."""
        if not topic.startswith("/"):
            topic = self._full("topic", topic, "subscribers", type_name)
        if type_name is not None or latch:
            self.advertise(topic, type_name, latch)
        publish_id, line = self._peer.publish(topic, message, **options)
        self._send_line(line)
        return publish_id

    def publish_at(
        self, topic: str, message: Message, time_ns: int, type: str | None = None, latch: bool = False
    ) -> str:
        """Send a message that the daemon publishes at the end of the first cycle whose simulated time is at least
        `time_ns`.

        Returns an id without waiting, for `is_answered` and `published`. A client may have at most 10000 waiting
        messages. They are discarded when the client disconnects.
        """
        at = {"secs": time_ns // 10**9, "nsecs": time_ns % 10**9}
        publish_id = self._publish(topic, message, type, latch, at=at, ack=True, **typed(type))
        self._peer.awaited.add(publish_id)
        return publish_id

    def published(self, publish_id: str, *, timeout: float | None = None) -> bool:
        """Wait until a message of `publish_at` is published. False when it reached the daemon after its time."""
        answer = self._answer(publish_id, timeout)
        self._peer.check_refused(publish_id)
        return not answer.get("late", False)

    def deliver(self, topic: str, message: Message, type: str | None = None, latch: bool = False) -> None:
        """`publish` and `flush` in one round trip. Raises as `flush`."""
        publish_id = self._publish(topic, message, type, latch, ack=True)
        self._peer.awaited.add(publish_id)
        self._flushed(publish_id, None)

    def flush(self, *, timeout: float | None = None) -> None:
        """Wait until the daemon has processed everything that was sent and passed it to the subscribers.

        Raises:
            MessageRefused: the first refusal, with its exit code. TimedOut. NoDaemon.
        """
        self._flushed(self.call_async(SYNCHRONIZE), timeout)

    def _flushed(self, request_id: str, timeout: float | None) -> None:
        self._published = False
        values_of(self._answer(request_id, timeout))
        self._peer.check_all_refused()

    def subscribe(
        self,
        topic: str,
        type: str | None = None,
        queue_length: int = 0,
        throttle_rate: int = 0,
        take: Callable[[Message], None] | None = None,
        wait: bool = True,
    ) -> Subscription:
        """Receive the topic's messages from now on.

        Args:
            type: needed only for a topic that is not advertised yet.
            queue_length: the newest messages kept for a slow reader; 0 means 1000.
            throttle_rate: minimum interval between two messages in wall milliseconds.
            take: called, while a call waits, with each publish object: `topic`, `msg` and `time`, the simulated time of
                publication. A message latched before the subscription has `latch`, and the time of the subscription.
                With `take` no messages are queued.
            wait: False returns without waiting, so that many subscriptions begin together; `flush` raises refusals.

        Raises:
            Refused: the topic does not exist or has another type.
        """
        topic = self._full("topic", topic, "publishers", type)
        subscription = Subscription(self, topic, self._peer.next_id("subscribe"), queue_length, take)
        line = self._peer.subscribe(subscription, throttle_rate, queue_length, type, is_stamped=take is not None)
        try:
            self._send_line(line)
            if wait:
                self.call(SYNCHRONIZE)
        except BaseException:
            self.unsubscribe(subscription)
            raise
        self._peer.check_subscribed(subscription)
        return subscription

    def unsubscribe(self, subscription: Subscription) -> None:
        """End a subscription. `Subscription.close` calls this."""
        if line := self._peer.unsubscribe(subscription):
            with suppress(NoDaemon):  # a daemon that ended has no subscriptions left
                self._send_line(line)

    # --- names --------------------------------------------------------------------------------------------------

    def topics(self, *, timeout: float | None = None) -> dict[str, str]:
        """Every topic -> its type."""
        answer = self.call("/rosapi/topics", timeout=timeout)
        return dict(zip(answer["topics"], answer["types"], strict=True))

    def services(self) -> list[str]:
        """Every service, sorted."""
        return list(self.call("/rosapi/services")["services"])

    def _full(self, kind: str, name: str, role: str = "", type: str | None = None) -> str:
        """The full name of a relative one, cached. A new topic with a type is in the root namespace."""
        if name.startswith("/"):
            return name
        full = self._full_names.get((kind, name))
        if full is None:
            try:
                full = self.resolve(kind, name, role=role)["name"]
            except Unused:
                full = self.resolve(kind, name)["name"]
            except UnknownName:
                if type is None:
                    raise
                full = names.join("/", name)
            self._full_names[kind, name] = full
        return full

    def resolve(
        self, kind: str, name: str, *, namespace: str = "/", role: str = "", with_field: bool = False
    ) -> ResolveResponseMsg:
        """The full name of a short one: the name itself, or the only name that ends with it, as on the command line.

        Args:
            kind: `topic`, `service`, `parameter` (or a namespace of parameters), `node` or `robot`.
            namespace: relative names begin here; it also decides between several matches.
            role: of a topic: only those with `publishers`, or with `subscribers`; empty for all.
            with_field: of a topic: a field may follow the name.

        Returns:
            slidectl/Resolve's response: `name` is the full name; then `field`, `type`, `typedefs`, `response_typedefs`
            and `nodes`, as far as the kind has them.

        Raises:
            UnknownName: no match. AmbiguousName: several matches. Unused: the topic has no node in the role.
        """
        request = {"kind": kind, "name": name, "namespace": namespace, "role": role, "with_field": with_field}
        response: ResolveResponseMsg = resolved(self._answer(self.call_async("/slidectl/resolve", request), None))
        return response

    # --- what arrives -------------------------------------------------------------------------------------------

    def events(self, timeout: float = math.inf) -> Iterator[Message]:
        """Every object that arrives, as received. Ends when nothing arrives for `timeout` seconds."""
        while (message := self._link.receive(self.monotonic() + timeout)) is not None:
            self._receive(message)
            yield message

    def wait_until(self, condition: Callable[[], bool], timeout: float | None, failure: str) -> None:
        """Read what arrives until the condition is true. Raises TimedOut with the text of `failure`, NoDaemon."""
        seconds = self.timeout if timeout is None else timeout
        if not self._becomes(condition, seconds):
            raise self._timed_out(failure, seconds)

    def _becomes(self, condition: Callable[[], bool], seconds: float) -> bool:
        link = self._link
        deadline = link.monotonic() + seconds
        while not condition():
            message = link.receive(deadline)
            if message is None:
                return False
            self._receive(message)
        return True

    def _receive(self, message: Message) -> None:
        self._peer.receive(message)
        self._link.last_status = self._peer.last_status

    def _timed_out(self, failure: str, seconds: float) -> TimedOut:
        return TimedOut(f"{failure} within {seconds:.3g} s", self._why_nothing_happens())

    def _why_nothing_happens(self) -> str | None:
        """The hint of a TimedOut: the world is paused or waits for lock-step, or the daemon hangs; None if unknown."""
        call_id = self.call_async("/slidectl/status")
        if not self._becomes(lambda: self.is_answered(call_id), _PROBE_S):
            self.forget(call_id)
            return "the daemon itself does not answer; see: " + command(self.paths, "daemon logs")
        status = self.answer(call_id)
        if status.get("paused") and status.get("trouble"):
            return f"the simulation is paused ({status['trouble']}); first: {command(self.paths, 'sim reset')}"
        if status.get("paused"):
            return "the simulation is paused; resume it with: " + command(self.paths, "sim resume")
        if status.get("lockstep"):
            return "the world waits for clients in lock-step: " + listing(status["lockstep"])
        return None

    # --- the connection -----------------------------------------------------------------------------------------

    @property
    def daemon_pid(self) -> int:
        """The daemon's process id: from the kernel, or from the daemon where the kernel does not tell it."""
        pid = self._link.daemon_pid
        return int(self.call("/slidectl/status")["pid"]) if pid is None else pid

    def another(self) -> Self:
        """Open a further connection to the same daemon, with the same `timeout`. Raises as the constructor."""
        return type(self)(link=self._link.another(self.monotonic() + self.timeout), timeout=self.timeout)

    def monotonic(self) -> float:
        """The clock of all waits, in s: the machine's, or that of a world in this process that has its own."""
        return self._link.monotonic()

    def fileno(self) -> int:
        """The file descriptor of the socket, for the caller's `select`."""
        return self._link.fileno()

    def call_back(self, action: Callable[[], object] | None) -> bool:
        """Set a callback for a world in this process: run between two cycles when something arrived while other clients
        wait.

        None removes it. Returns False for a world in another process; use `fileno` there.
        """
        return self._link.call_back(action)

    def _send_line(self, line: bytes) -> None:
        """Send a line. Raises TimedOut, NoDaemon."""
        self._link.send(line, self._link.monotonic() + self.timeout)

    def close(self) -> None:
        """Close the connection without waiting. Its advertisements and subscriptions end. Warns of dropped messages."""
        self._link.close()
        self._peer.warn_of_dropped()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None and self._published:
                self.flush()
                self._peer.check_heard()
        finally:
            self.close()


class Subscription(Inbox):
    """Messages of one topic, in order. Iterating waits for each without a limit; `get` waits with one.

    `dropped` counts the messages that the daemon or the client discarded, oldest first, because the reader was too
    slow. With the default `queue_length` the end of the subscription warns of them (MessagesDropped).
    """

    def __init__(
        self,
        client: GraphClient,
        topic: str,
        subscription_id: str,
        queue_length: int,
        take: Callable[[Message], None] | None = None,
    ) -> None:
        super().__init__(topic, subscription_id, queue_length, take)
        self._client = client

    def get(self, timeout: float | None = None) -> Message:
        """Return the next message; wait at most `timeout` wall seconds (the client's by default, `inf` for no limit).

        Raises:
            TimedOut: no message arrived. NoDaemon: the daemon ended.
        """
        queue = self.queue
        if not queue:
            self._client.wait_until(lambda: bool(queue), timeout, f"no message on {self.topic}")
        return queue.popleft()

    def __iter__(self) -> Iterator[Message]:
        return self

    def __next__(self) -> Message:
        return self.get(math.inf)

    def close(self) -> None:
        """Unsubscribe. Messages in the queue can still be read. Warns of dropped messages."""
        self._client.unsubscribe(self)
        self.warn_of_dropped()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
