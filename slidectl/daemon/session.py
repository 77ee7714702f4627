"""The session of one client: the rosbridge v2 operations on the graph.

It exchanges lines with its connection and calls the graph. Nothing that a client sends can do more harm than cause a
`status` line to it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from slidectl import msgs
from slidectl.control.node_handle import Reasons
from slidectl.daemon.outbox import Publications, Reader, TopicFeed
from slidectl.effects import EVERYTHING, Effect, NotPermitted
from slidectl.errors import NoDescriptors, Refused, SlidectlError, UsageError, listing
from slidectl.simulation.clock import Timer
from slidectl.simulation.graph import Graph
from slidectl.simulation.pending import Pending
from slidectl.simulation.services import Service
from slidectl.simulation.topics import TopicPublisher
from slidectl.wire import messages
from slidectl.wire.json_lines import LONGEST_LINE, encode
from slidectl.wire.messages import LEVELS, Message, shortened

if TYPE_CHECKING:
    from slidectl.simulation.host import InputRecorder

_MOST_OPEN_CALLS = 1000
_MOST_TIMED, _MOST_TIMED_BYTES = 10_000, 64 * 1024 * 1024
"""The most messages of a connection with a later time, and the most bytes of their lines."""
_LONGEST_LATE, _MOST_LATE = 4096, 8 * 1024 * 1024
"""Bytes of an answer, and of waiting lines, above which a late answer is dropped.

Immediate answers have another bound: a connection with so many unread bytes is not served.
"""
_GIVEN_NODE = re.compile(r"/slidectl(_\d+)+")
"""The name of a connection that does not name its node."""


class Session:
    """The graph as one client uses it, under the node name `node`. `closed` removes all that the client had.

    `process_session` is the session id of the client's process, 0 when it is unknown.
    """

    def __init__(
        self,
        connection: Reader,
        graph: Graph,
        publications: Publications,
        unexpected: Callable[[str], None],
        node: str,
        process_session: int,
        recorder: InputRecorder | None = None,
    ) -> None:
        self.node = node
        self._recorder = recorder
        self.unexpected = unexpected
        """Logs the exception that is being handled, an internal error."""
        self._process_session = process_session
        self._connection = connection
        self._graph = graph
        self._publications = publications
        self._level = LEVELS["warning"]
        self._publishers: dict[str, TopicPublisher] = {}
        self._feeds: dict[str, TopicFeed] = {}
        self._calls: dict[Pending, Any] = {}
        """Open calls, each with its id."""
        self._timed: dict[Timer, int] = {}
        """Messages with a later time, each with the bytes of its line."""
        self._line_bytes = 0
        self._services: dict[str, Service] = {}
        self._asked: dict[str, Pending] = {}
        self._serial = 0
        self._permitted = EVERYTHING
        """What this client may do; `restrict` takes some of it away."""

    # --- for the connection -------------------------------------------------------------------------------------

    @property
    def waiting(self) -> bool:
        """True while answers or messages may still come for a client that sends no more."""
        return bool(self._calls or self._feeds or self._timed)

    def handle(self, line: bytes) -> None:
        """Handle one line; the client gets a status about any error."""
        self._line_bytes = len(line)
        message, error = messages.read_operation(line)
        if error is not None:
            self.send_error(error, message)
            return
        if self._recorder is not None:
            self._recorder.record(self, line, message)
        self._carry_out(getattr(self, f"_{message['op']}"), message)

    def _carry_out(self, action: Callable[[Message], None], message: Message) -> None:
        """Call the operation of a message; the client gets a status about any error."""
        log = self._graph.log
        log.reasons = []
        self._graph.caller = self._process_session
        self._graph.calling_node = self.node
        self._graph.services.permitted = self._permitted
        try:
            if message["op"] not in messages.READING and Effect.WRITES not in self._permitted:
                raise NotPermitted(f"the op {message['op']!r}", Effect.WRITES, self._permitted)
            action(message)
        except SlidectlError as error:
            self.send_error(error, message)
        except Exception as error:
            if isinstance(error, OSError) and error.errno in NoDescriptors.ERRNOS:
                self.send_error(NoDescriptors("the daemon"), message)
                return
            self.unexpected(f"{self.node} sent {repr(message)[:200]}")
            self.send_error(Refused(f"internal error: {error!r}; the daemon's log has more"), message)
        finally:
            log.reasons = None
            self._graph.caller = 0
            self._graph.calling_node = ""
            self._graph.services.permitted = EVERYTHING

    def report(self, topic: str, dropped: int) -> bytes:
        """The line about dropped messages; empty when the client's level excludes it."""
        if self._level > LEVELS["warning"]:
            return b""
        return encode(messages.dropped_status(topic, dropped))

    def warn(self, text: str) -> None:
        """Send a status line that belongs to no request."""
        if self._level <= LEVELS["warning"]:
            self._connection.send(encode(messages.warning_status(text)))

    def closed(self) -> None:
        """Remove all that the client had, and cancel its open requests, after it has disconnected."""
        if self._recorder is not None:
            self._recorder.record_end(self)
        for pending in list(self._calls):
            pending.cancel()
        self._calls.clear()
        for timer in self._timed:
            timer.cancel()
        self._timed.clear()
        for asked in list(self._asked.values()):
            asked.reject(Refused(f"{self.node} went away before it answered"))
        for feed in self._feeds.values():
            feed.close()
        self._feeds.clear()
        self._graph.close_node(self.node)

    def send_error(self, error: SlidectlError, message: Message) -> None:
        """Send the error of a message to the client; a service call gets it as its answer."""
        if message.get("op") == "call_service" and isinstance(message.get("service"), str):
            self._connection.send(encode(messages.refused_call(error, message, self._reasons())))
        elif self._level <= LEVELS["error"] or message.get("ack"):
            self._connection.send(encode(messages.error_status(error, message, self._reasons())))

    def _reasons(self) -> Message:
        """The warnings and errors so far of the line that is being handled, as a part of its answer."""
        return messages.with_levels(self._graph.log.reasons)

    # --- topics -------------------------------------------------------------------------------------------------

    def _advertise(self, message: Message) -> None:
        topic = messages.name(message, "topic")
        kind = messages.text(message, "type", "") or self._graph.topics.type_of(topic)
        latch = bool(message.get("latch", False))
        known = self._publishers.get(topic)
        if known is not None and known.latch == latch:
            self._graph.topics.advertise(topic, kind, self.node).close()  # raises when the type is another one
            return
        self._publishers[topic] = self._graph.topics.advertise(topic, kind, self.node, latch)
        if known is not None:
            known.close()

    def _unadvertise(self, message: Message) -> None:
        topic = messages.name(message, "topic")
        _owned(self._publishers, topic, "advertised")
        self._publishers.pop(topic).close()

    def _publish(self, message: Message) -> None:
        """Publish at once, or with `at` at the end of the first cycle at or after that time."""
        if message.get("at") is None:
            self._publish_now(message)
            return
        topic = messages.name(message, "topic")
        due_ns, now_ns = messages.time_ns(message, "at"), self._graph.clock.time_ns
        if due_ns <= now_ns:
            self._publish_now(message, is_late=due_ns < now_ns)
            return
        size = self._line_bytes
        if len(self._timed) >= _MOST_TIMED or sum(self._timed.values()) + size > _MOST_TIMED_BYTES:
            most = f"{_MOST_TIMED} messages, or {_MOST_TIMED_BYTES >> 20} MiB,"
            raise Refused(f"{most} of this connection wait for their time", "send the others later")
        kind = messages.text(message, "type", "") or self._graph.topics.type_of(topic)
        message["msg"] = msgs.check(kind, message.get("msg", {}))  # raises now, not when it is due

        def publish() -> None:
            del self._timed[timer]
            self._carry_out(self._publish_now, message)
            self._connection.check_end()

        timer = self._graph.timers.at(due_ns, publish, absolute=True)
        self._timed[timer] = size

    def _publish_now(self, message: Message, is_late: bool = False) -> None:
        topic = messages.name(message, "topic")
        content = message.get("msg", {})
        publisher = self._publishers.get(topic)
        if publisher is None:
            self._graph.topics.publish(topic, messages.text(message, "type", "") or None, content, self.node)
        else:
            publisher.publish(msgs.check(self._graph.topics.type_of(topic), content))
        if message.get("unheard") and not self._graph.topics.subscribers(topic):
            self._connection.send(encode(messages.unheard_status(message, topic)))
        if message.get("ack"):
            self._connection.send(encode(messages.delivered_status(message, is_late, self._reasons())))

    def _subscribe(self, message: Message) -> None:
        topic = messages.name(message, "topic")
        throttle, queue = messages.number(message, "throttle_rate"), messages.number(message, "queue_length")
        if messages.text(message, "compression", "none") != "none":
            raise UsageError(f"compression {shortened(message['compression'])} is not supported", "compression: none")
        kind, stamped = messages.text(message, "type", "") or None, bool(message.get("stamped", False))
        feed = self._feeds.get(topic)
        if feed is None:
            feed = TopicFeed(topic, self._connection, self._publications, self._graph.clock.stamp)
            feed.want(messages.subscription_id(message), throttle, int(queue), stamped)
            feed.begin(self._graph.topics, kind, self.node)
            self._feeds[topic] = feed
            return
        if kind is not None:  # raises when the type is another one
            self._graph.topics.subscribe(topic, kind, self.node, lambda _: None).close()
        feed.want(messages.subscription_id(message), throttle, int(queue), stamped)

    def _unsubscribe(self, message: Message) -> None:
        topic = messages.name(message, "topic")
        if _owned(self._feeds, topic, "subscribed").unwant(messages.subscription_id(message)):
            self._feeds.pop(topic).close()

    # --- services -----------------------------------------------------------------------------------------------

    def _call_service(self, message: Message) -> None:
        service = messages.name(message, "service")
        if len(self._calls) >= _MOST_OPEN_CALLS:
            raise Refused(f"{_MOST_OPEN_CALLS} calls of this connection wait for their answers", "read them first")
        request = self._by_name(service, message.get("args") or {})
        pending = self._graph.services.call(service, request)
        if not pending.done:
            self._calls[pending] = message.get("id")
        call_id, reasons = messages.returned(message), self._graph.log.reasons
        pending.then(lambda answered: self._answer(answered, service, call_id, reasons))

    def _cancel_call(self, message: Message) -> None:
        """Cancel the calls with this id: they get no answers."""
        if message.get("id") is None:
            raise UsageError("cancel_call without the id of the call")
        for pending in [pending for pending, given in self._calls.items() if given == message["id"]]:
            del self._calls[pending]
            pending.cancel()

    def _by_name(self, service: str, values: Any) -> Any:
        """The arguments by name; they may be a list, in the order of the fields."""
        if not isinstance(values, list):
            return values
        fields = msgs.fields(msgs.request_type(self._graph.services.type_of(service)))
        if len(values) > len(fields):
            raise UsageError(f"{service} takes {len(fields)} arguments, not {len(values)}")
        return {field.name: value for field, value in zip(fields, values, strict=False)}

    def _answer(self, pending: Pending, service: str, call_id: Message, reasons: Reasons | None) -> None:
        self._calls.pop(pending, None)
        response = messages.response(service, call_id, messages.with_levels(reasons))
        if pending.error is None:
            response |= {"values": pending.result(), "result": True}
        else:
            response |= messages.failure(pending.error)
        try:
            line = encode(response)
            if len(line) > LONGEST_LINE:
                what = f"its answer has {len(line)} bytes, and a line has at most {LONGEST_LINE}"
                line = encode(response | messages.failure(Refused(f"{service}: {what}", "ask for less")))
            if len(line) > _LONGEST_LATE and self._connection.unread > _MOST_LATE:
                what = f"its answer of {len(line)} bytes was dropped: this connection does not read its answers"
                line = encode(response | messages.failure(Refused(f"{service}: {what}")))
        except Exception as error:  # this may be called from within a control cycle, which must not fail
            self.unexpected(f"the answer of {service} to {self.node}")
            line = encode(response | messages.failure(Refused(f"internal error: {error!r}; the daemon's log has more")))
        self._connection.send(line)

    def _advertise_service(self, message: Message) -> None:
        service = messages.name(message, "service")
        effect = messages.text(message, "effect", Effect.WRITES)
        if effect not in (Effect.READS, Effect.WRITES):
            raise UsageError(f"unknown effect {shortened(effect)}", f"effects: {Effect.READS}, {Effect.WRITES}")
        self._services[service] = self._graph.services.advertise(
            service,
            messages.text(message, "type"),
            self.node,
            lambda request: self._ask(service, request),
            Effect(effect),
        )

    def _unadvertise_service(self, message: Message) -> None:
        service = messages.name(message, "service")
        _owned(self._services, service, "provided")
        self._services.pop(service).close()

    def _ask(self, service: str, request: Message) -> Pending:
        """Forward a call of a service that this client provides. Raises Refused when it does not read its calls."""
        if self._connection.is_overfull:
            raise Refused(f"{self.node}, which provides {service}, does not read its calls")
        self._serial += 1
        call_id = f"service_request:{service}:{self._serial}"

        def nobody_waits() -> None:
            self._asked.pop(call_id, None)

        pending = Pending(on_cancel=nobody_waits)
        self._asked[call_id] = pending
        self._connection.send(encode({"op": "call_service", "id": call_id, "service": service, "args": request}))
        return pending

    def _service_response(self, message: Message) -> None:
        pending = self._asked.pop(str(message.get("id")), None)
        if pending is None:
            raise Refused(f"no call waits for the service response {shortened(message.get('id'))}")
        values = message.get("values", {})
        if message.get("result", True):
            pending.resolve(values)
        else:
            pending.reject(Refused(values if isinstance(values, str) else "the provider failed"))

    def _set_node(self, message: Message) -> None:
        """Rename the node. Raises Refused: the connection has topics, services or calls under its present name."""
        if self._publishers or self._feeds or self._services or self._calls or self._graph.knows_node(self.node):
            raise Refused(f"this connection is the node {self.node} already", "set_node is its first op")
        name = messages.name(message, "node")
        if _GIVEN_NODE.fullmatch(name):
            raise Refused(f"{name} is reserved for clients without a name", "choose another one")
        self._graph.claim_node(name)
        self._graph.close_node(self.node)  # services drop their state about the old name
        self.node = self._connection.node = name

    def _restrict(self, message: Message) -> None:
        """Give up all effects but these, for good. A gateway does so for each of its clients."""
        permitted = message.get("permitted")
        if not isinstance(permitted, list) or not all(each in list(Effect) for each in permitted):
            raise UsageError("'permitted' is a list of effects", f"effects: {', '.join(Effect)}")
        self._permitted = self._permitted & {Effect(each) for each in permitted}

    def _set_level(self, message: Message) -> None:
        level = messages.text(message, "level")
        if level not in LEVELS:
            raise UsageError(f"unknown level {shortened(level)}", f"levels: {', '.join(LEVELS)}")
        self._level = LEVELS[level]


def _owned(owned: dict[str, Any], name: str, how: str) -> Any:
    """The entry of the connection under this name. Raises Refused."""
    if name not in owned:
        raise Refused(f"{name} is not {how} on this connection", f"{how}: {listing(owned)}")
    return owned[name]
