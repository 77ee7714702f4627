"""The session of one browser. Most frames pass unchanged: the daemon itself implements rosbridge's protocol.

This module adds encoded messages, fragments and action operations. What a browser may do is for the daemon to judge.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import suppress
from itertools import count
from typing import Any

from slidectl import names
from slidectl.errors import SlidectlError, UsageError, listing
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.websocket.action_goals import ActionGoals
from slidectl.extensions.gateways.websocket.encodings import (
    COMPRESSIONS,
    SMALLEST_FRAGMENT,
    Encode,
    FragmentBuffer,
    encoder,
    fragments,
)
from slidectl.wire.json_lines import BadLine, check_size, decode, encode

Message = dict[str, Any]

_PUBLISH = b'{"op":"publish","topic":"'
_STATUS = b'{"op":"status"'
_LEVELS = ("info", "warning", "error", "none")
_SERVED_BY_TOPICS = ("advertise_action", "unadvertise_action", "action_feedback", "action_result")
_ACTION_OPS = ("send_action_goal", "cancel_action_goal")
_LONGEST_ID = 1000
_MOST_WISHES = 1000


class RosbridgeSession:
    """One browser's session with the daemon. `reply` sends the browser a frame: its bytes, and whether it is text."""

    def __init__(
        self,
        daemon: DaemonConnection,
        goals: ActionGoals,
        type_of: Callable[[str], Awaitable[str]],
        reply: Callable[[bytes, bool], None],
        most_bytes: int,
        is_reader: bool,
        holds: Callable[[int], None] = lambda _: None,
    ) -> None:
        """`type_of` returns the type of a topic, empty without one; with `is_reader` the browser may change nothing.

        `holds` is told how many bytes of unfinished fragments are held.
        """
        self.dropped = 0
        """Messages that the daemon dropped because the browser read too slowly."""
        self._daemon = daemon
        self._goals = goals
        self._type_of = type_of
        self._reply = reply
        self._is_reader = is_reader
        self._level = "error"
        self._fragment_size = 0
        self._fragments = FragmentBuffer(most_bytes, holds)
        self._sent_in_fragments = count(1)
        self._requests: dict[str, dict[str | None, str]] = {}
        """Topic -> subscription id -> compression, for topics with at least one compressed subscription."""
        self._encoders: dict[bytes, Encode] = {}

    # --- from the browser ---------------------------------------------------------------------------------------

    async def take(self, frame: bytes, is_whole: bool = False) -> None:
        """Process a frame of the browser; `is_whole` when it was reassembled from fragments. Raises NoDaemon."""
        message: Message = {}
        frame = frame.replace(b"\n", b" ")  # the daemon must read the same single line that is checked here
        try:
            check_size(frame)
            message = decode(frame)
        except BadLine:  # the daemon reports the error
            self._daemon.send_line(frame + b"\n")
            return
        try:
            if "fragment_size" in message:
                self._set_fragment_size(message.pop("fragment_size"))
            op = message.get("op")
            if op == "fragment":
                if is_whole:
                    raise UsageError("a fragment within fragments")
                if (whole := self._fragments.add(message)) is not None:
                    await self.take(whole, is_whole=True)
            elif op != "auth":  # the token was checked when the browser connected
                if self._is_reader and op in _ACTION_OPS:
                    raise UsageError("this gateway is read-only: it was started with --read-only")
                await self._carry_out(op, message, frame)
        except SlidectlError as error:
            self._complain(error, message)

    async def _carry_out(self, op: Any, message: Message, frame: bytes) -> None:
        if op == "subscribe":
            await self._subscribe(message)
        elif op == "send_action_goal":
            await self._goals.send(message, self._send_message)
        elif op == "cancel_action_goal":
            self._goals.cancel(message, self._send_message)
        elif op == "set_node":
            raise UsageError("the node of a browser has a name already")
        elif op in _SERVED_BY_TOPICS:
            raise UsageError(f"{op} is not offered", "serve an action by its topics: ROSLIB.SimpleActionServer")
        elif op == "set_level" and message.get("level") in _LEVELS:
            self._level = message["level"]
            # Warnings are always requested, to count drops, except with level none.
            self._daemon.send_line(encode({**message, "level": "warning" if self._level == "error" else self._level}))
        else:
            if op == "unsubscribe":
                await self._unsubscribe(message)
            self._daemon.send_line(frame + b"\n")

    def _set_fragment_size(self, size: Any) -> None:
        """Set the fragment size for all later frames, as rosbridge does. Raises UsageError."""
        if size is not None and (not isinstance(size, int) or size < SMALLEST_FRAGMENT):
            raise UsageError(f"'fragment_size' is a number of bytes from {SMALLEST_FRAGMENT} on")
        self._fragment_size = size or 0

    async def _subscribe(self, message: Message) -> None:
        compression, topic = message.pop("compression", None) or "none", message.get("topic")
        if compression not in COMPRESSIONS:
            what = f"compression {str(compression)[:60]!r} is not offered"
            raise UsageError(what, f"compression: {listing(COMPRESSIONS)}")
        if isinstance(topic, str) and len(topic) <= names.LONGEST:
            topic, wish_id = names.join("/", topic), _subscription_id(message)
            if len(wish_id or "") > _LONGEST_ID:
                raise UsageError(f"an id of more than {_LONGEST_ID} characters")
            before = self._requests.get(topic, {})
            if compression != "none" or before:
                if wish_id not in before and sum(map(len, self._requests.values())) >= _MOST_WISHES:
                    raise UsageError(f"{_MOST_WISHES} compressed subscriptions are the maximum")
                await self._choose(topic, {**before, wish_id: compression}, str(message.get("type") or ""))
        if compression == "cbor-raw":
            message["stamped"] = True
        self._daemon.send_line(encode(message))

    async def _unsubscribe(self, message: Message) -> None:
        topic = names.join("/", str(message.get("topic")))
        wish_id, wishes = _subscription_id(message), self._requests.get(topic, {})
        await self._choose(topic, {key: wish for key, wish in wishes.items() if wish_id not in (None, key)}, "")

    async def _choose(self, topic: str, wishes: dict[str | None, str], given: str) -> None:
        """Choose the encoder of the strongest compression. Raises UsageError, UnknownName: no such type."""
        compression = max(wishes.values(), key=COMPRESSIONS.index, default="none")
        if compression == "none":
            self._requests.pop(topic, None)
            self._encoders.pop(topic.encode(), None)
            return
        needs_type = compression != "png"
        type_name = (await self._type_of(topic) or given) if needs_type else ""
        if needs_type and not type_name:
            raise UsageError(
                f"no topic {topic}: with compression {compression!r} its type is needed", "give 'type' too"
            )
        self._encoders[topic.encode()] = encoder(compression, type_name)
        self._requests[topic] = wishes

    def _complain(self, error: SlidectlError, message: Message) -> None:
        """Send an error in the form in which the daemon answers refusals."""
        given = message.get("id")
        about = {"id": given} if isinstance(given, str | int) and len(str(given)) <= _LONGEST_ID else {}
        if message.get("op") == "call_service":
            service = str(message.get("service"))[: names.LONGEST]
            about |= {"service": service, "values": str(error), "result": False}
            self._send_message({"op": "service_response", **about})
        elif self._level != "none":
            self._send_message({"op": "status", "level": "error", **about, "msg": str(error)})

    # --- to the browser -----------------------------------------------------------------------------------------

    def pass_on(self, line: bytes) -> None:
        """Send a line of the daemon to the browser."""
        if self._encoders and line.startswith(_PUBLISH):
            pack = self._encoders.get(line[len(_PUBLISH) : line.index(b'"', len(_PUBLISH))])
            if pack is not None:
                with suppress(KeyError, TypeError, ValueError):  # the topic has another type now: send it unchanged
                    self._send(*pack(line))
                    return
        elif line.startswith(_STATUS):
            status = decode(line)
            self.dropped += status.get("dropped", 0)
            if status.get("level") == "warning" and self._level == "error":
                return
        self._send(line, True)

    def _send_message(self, message: Message) -> None:
        self._send(encode(message)[:-1], True)

    def _send(self, frame: bytes, is_text: bool) -> None:
        if is_text and self._fragment_size and len(frame) > self._fragment_size:
            for fragment in fragments(frame, self._fragment_size, f"fragment:{next(self._sent_in_fragments)}"):
                self._reply(fragment, True)
        else:
            self._reply(frame, is_text)

    def close(self) -> None:
        """Handle the browser's disconnection."""
        self._fragments.clear()
        self._goals.forget(self._send_message)
        self._daemon.close()


def _subscription_id(message: Message) -> str | None:
    """The subscription id as the daemon distinguishes subscriptions."""
    given = message.get("id")
    return None if given is None else str(given)
