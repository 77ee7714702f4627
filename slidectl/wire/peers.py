"""The client's end of a connection, as state: it makes the lines that a client sends, and sorts what arrives.

`ClientPeer` gives each request an id and keeps the answers that are awaited, the refusals, and what the client
subscribes to and provides. A connection, blocking or on asyncio, moves its lines and decides how to wait. Who may be
at the other end, and what is said when nobody is, stands here too.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from slidectl import __version__
from slidectl.errors import MessageRefused, NoDaemon, Refused
from slidectl.paths import InstancePaths, command
from slidectl.wire.json_lines import encode_bounded
from slidectl.wire.messages import Message, refusal

DEFAULT_QUEUE = 1000
_MOST_REFUSALS = 1000


def nobody_answers(paths: InstancePaths, error: OSError) -> NoDaemon:
    """Why no connection could be made to the daemon of `paths`."""
    hint = "start it with: " + command(paths, "daemon start")
    if isinstance(error, FileNotFoundError | ConnectionRefusedError):
        return NoDaemon(f"no daemon answers on {paths.socket_text}", hint)
    if isinstance(error, BlockingIOError | TimeoutError):
        return NoDaemon(
            f"the daemon on {paths.socket_text} accepts no connections: it hangs, is stopped, or has too many",
            f"see: {command(paths, 'daemon logs')}\nend it with: {command(paths, 'daemon stop')}",
        )
    return NoDaemon(f"no daemon answers on {paths.socket_text}: {error.strerror or error}", hint)


def went_away(last_status: str, hint: str | None = None) -> NoDaemon:
    """The daemon has ended a connection; its last status says why."""
    return NoDaemon(f"the daemon went away{f': {last_status}' if last_status else ''}", hint)


def check_daemon_user(uid: int | None, paths: InstancePaths) -> None:
    """Raise Refused when the daemon is another user's. `uid` is None where the kernel does not tell it."""
    if uid not in (None, os.geteuid()):
        raise Refused(f"the daemon on {paths.socket_text} belongs to another user (uid {uid})")


def why_not_client(uid: int | None) -> str:
    """Why a client of this user may not use this daemon; empty when it may."""
    if uid in (None, os.geteuid()):
        return ""
    return f"this daemon belongs to uid {os.geteuid()}; processes of uid {uid} may not use it"


class MessagesDropped(UserWarning):
    """A subscription was read too slowly: messages were dropped, and the reader did not ask for the newest alone."""


class Inbox:
    """The messages of one subscription that have arrived, in order.

    `dropped` counts the messages that the daemon or the client discarded, oldest first, because the reader was too
    slow. With the default `queue_length` the end of the subscription warns of them (MessagesDropped).
    """

    def __init__(
        self, topic: str, subscription_id: str, queue_length: int, take: Callable[[Message], None] | None
    ) -> None:
        self.topic = topic
        self.id = subscription_id
        self.dropped = 0
        self.tells = not queue_length and take is None
        """False when nobody is to be warned of dropped messages."""
        self.queue: deque[Message] = deque(maxlen=queue_length or DEFAULT_QUEUE)
        self._take = take

    def add(self, published: Message) -> None:
        """Take a publish object that has arrived."""
        if self._take is not None:
            self._take(published)
            return
        if len(self.queue) == self.queue.maxlen:
            self.dropped += 1
        self.queue.append(published["msg"])

    def __len__(self) -> int:
        """The number of messages that have arrived and are not read."""
        return len(self.queue)

    def warn_of_dropped(self) -> None:
        """Warn of dropped messages, once."""
        if self.dropped and self.tells:
            import warnings

            self.tells = False
            text = f"{self.dropped} messages of {self.topic} were dropped: {self.queue.maxlen} wait for a slow reader"
            hint = "read more often, or give subscribe a queue_length (1: the newest alone)"
            warnings.warn(f"{text}; {hint}", MessagesDropped, stacklevel=3)


class ClientPeer:
    """The requests of one client and what has arrived for it."""

    def __init__(self) -> None:
        self.answers: dict[str, Message] = {}
        """Id -> answer, of the awaited requests that were answered."""
        self.awaited: set[str] = set()
        """Ids of the requests whose answers are kept; other answers are discarded."""
        self.refusals: dict[str, Refused] = {}
        """Id -> error, of operations that were refused; the first 1000 that nobody has asked for."""
        self.inboxes: dict[str, list[Inbox]] = {}
        """Topic -> its subscriptions."""
        self.last_status = ""
        """The text of a status that belongs to no request, if it came last. When the daemon ends, it says why."""
        self.on_call: Callable[[Message], None] = lambda _request: None
        """Called with each request of a service that this client provides."""
        self.on_other_version: Callable[[str], None] = lambda _version: None
        """Called once with the daemon's version if it differs from the client's; empty if the daemon sends none."""
        self._advertised: dict[tuple[str, str | None, bool], str] = {}
        self._first_call: str | None = None
        self._sent: dict[str, int] = {}
        """Topic -> number of messages published with `unheard`."""
        self._unheard: dict[str, int] = {}
        """Topic -> number of those messages that no subscriber received."""
        self._serial = 0

    # --- what the client sends ----------------------------------------------------------------------------------

    def next_id(self, purpose: str) -> str:
        """A new id."""
        self._serial += 1
        return f"{purpose}:{self._serial}"

    def request(self, op: str, **fields: Any) -> tuple[str, bytes]:
        """The id and the line of an operation. Raises BadLine: it is too long; the other methods raise it too."""
        request_id = self.next_id(op)
        return request_id, encode_bounded({"op": op, "id": request_id, **fields})

    def call(self, service: str, request: Message | None) -> tuple[str, bytes]:
        """The id and the line of a call; its answer is kept for the id."""
        call_id = self.next_id("call")
        message = {"op": "call_service", "id": call_id, "service": service, "args": request or {}}
        if self._first_call is None:  # the first call also asks for the daemon's version: no extra round trip
            self._first_call = call_id
            message["version"] = __version__
        line = encode_bounded(message)
        self.awaited.add(call_id)
        return call_id, line

    def cancel(self, call_id: str) -> bytes:
        """The line that cancels a call: it gets no answer."""
        self.forget(call_id)
        return encode_bounded({"op": "cancel_call", "id": call_id})

    def advertise(self, topic: str, type: str | None, latch: bool) -> bytes:
        """The line that makes the client a publisher; empty when it is one of this kind already."""
        if (topic, type, latch) in self._advertised:
            return b""
        advertise_id, line = self.request("advertise", topic=topic, latch=latch, **typed(type))
        self._advertised[topic, type, latch] = advertise_id
        return line

    def unadvertise(self, topic: str) -> bytes:
        """The line that ends all that `advertise` began for a topic."""
        self._advertised = {key: sent for key, sent in self._advertised.items() if key[0] != topic}
        return encode_bounded({"op": "unadvertise", "topic": topic})

    def publish(self, topic: str, message: Message, **options: Any) -> tuple[str, bytes]:
        """The id and the line of a message. With the option `unheard` it counts for `check_heard`."""
        publish_id = self.next_id("publish")
        line = encode_bounded({"op": "publish", "id": publish_id, "topic": topic, "msg": message, **options})
        if "unheard" in options:
            self._sent[topic] = self._sent.get(topic, 0) + 1
        return publish_id, line

    def subscribe(
        self, inbox: Inbox, throttle_rate: int, queue_length: int, type: str | None, is_stamped: bool
    ) -> bytes:
        """The line that subscribes, with an id of `next_id`. The inbox gets what arrives from now on.

        `is_stamped`: each publish object has the simulated time of its publication.
        """
        options = {"queue_length": queue_length, "throttle_rate": throttle_rate, **typed(type)}
        if is_stamped:
            options["stamped"] = True
        line = encode_bounded({"op": "subscribe", "id": inbox.id, "topic": inbox.topic, **options})
        self.inboxes.setdefault(inbox.topic, []).append(inbox)
        return line

    def unsubscribe(self, inbox: Inbox) -> bytes:
        """The line that ends a subscription; empty when it has ended. Nothing more gets into the inbox."""
        inboxes = self.inboxes.get(inbox.topic, [])
        if inbox not in inboxes:
            return b""
        inboxes.remove(inbox)
        return encode_bounded({"op": "unsubscribe", "id": inbox.id, "topic": inbox.topic})

    def check_subscribed(self, inbox: Inbox) -> None:
        """Raise the refusal of a subscription, and forget it, if it was refused."""
        if inbox.id in self.refusals:
            self.unsubscribe(inbox)
            self.check_refused(inbox.id)

    def respond(self, request: Message, values: Message | str) -> bytes:
        """The line of the answer to a request of a service that this client provides; a text is a failure."""
        answer = {"op": "service_response", "id": request["id"], "service": request["service"], "values": values}
        return encode_bounded({**answer, "result": not isinstance(values, str)})

    # --- what arrives -------------------------------------------------------------------------------------------

    def receive(self, message: Message) -> str | None:
        """Sort an object from the daemon. Returns the id of the awaited request that it answers, or None."""
        op = message.get("op")
        self.last_status = ""
        if op == "publish":
            for inbox in tuple(self.inboxes.get(message["topic"], ())):
                inbox.add(message)
            return None
        if op == "call_service":
            self.on_call(message)
            return None
        if op == "status":
            self._receive_status(message)
        elif op != "service_response":
            return None
        elif message.get("id") == self._first_call and message.get("version") != __version__:
            self._first_call = ""
            self.on_other_version(str(message.get("version", "")))
        answered = message.get("id")
        if answered not in self.awaited:
            return None
        self.answers[answered] = message
        return str(answered)

    def _receive_status(self, status: Message) -> None:
        if status.get("level") == "error":
            refused = str(status.get("id"))
            self._advertised = {key: sent for key, sent in self._advertised.items() if sent != refused}
            if len(self.refusals) < _MOST_REFUSALS:
                self.refusals[refused] = refusal(MessageRefused, str(status.get("msg", "")), status)
        topic = status.get("topic", "")
        for inbox in self.inboxes.get(topic, ()):
            inbox.dropped += int(status.get("dropped", 0))
        if status.get("unheard"):
            self._unheard[topic] = self._unheard.get(topic, 0) + 1
        if "id" not in status and "dropped" not in status:
            self.last_status = str(status.get("msg", ""))

    def answer(self, request_id: str) -> Message:
        """Take out the answer to an awaited request; it has arrived."""
        self.awaited.discard(request_id)
        return self.answers.pop(request_id)

    def forget(self, request_id: str) -> None:
        """Discard the answer to an awaited request, now or when it arrives."""
        self.awaited.discard(request_id)
        self.answers.pop(request_id, None)

    def check_refused(self, request_id: str) -> None:
        """Raise the refusal of an operation if it was refused."""
        if (error := self.refusals.pop(request_id, None)) is not None:
            raise error

    def check_all_refused(self) -> None:
        """Raise the first refusal that nobody has asked for, and forget the others."""
        refusals: Sequence[Refused] = tuple(self.refusals.values())
        self.refusals.clear()
        if refusals:
            raise refusals[0]

    def warn_of_dropped(self) -> None:
        """Warn of the dropped messages of all subscriptions, once."""
        for inboxes in self.inboxes.values():
            for inbox in inboxes:
                inbox.warn_of_dropped()

    def check_heard(self) -> None:
        """Raise MessageRefused for a topic none of whose counted messages reached a subscriber."""
        for topic, unheard in self._unheard.items():
            if unheard == self._sent.get(topic):
                raise MessageRefused(f"nobody subscribes to {topic}: {unheard} published, none of them received")


def typed(type: str | None) -> Message:
    """The field of a type that may be left out."""
    return {} if type is None else {"type": type}
