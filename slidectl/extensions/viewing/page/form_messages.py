"""Messages that the page makes: of texts in a form as `slidectl pub` makes them, at a rate, and while a base is driven.

The panels send most messages themselves. These here need expressions, simulated time, or an end that does not depend on
the browser.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from slidectl.client import Client
from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut, UsageError
from slidectl.msgs.fill import Time, fill
from slidectl.msgs.message_expressions import number_converter
from slidectl.msgs.schema import SCALAR, Field, Schema, from_typedefs, nanoseconds
from slidectl.typed_values import read

if TYPE_CHECKING:
    from slidectl.extensions.viewing.page.page import Page

_SECOND = 10**9
_MOST_STEPS = 10_000
"""Limit of an expression: the page is blocked while it is evaluated."""
_MOST_RUNNING = 8
_AHEAD_NS = 5 * _SECOND
"""Simulated ns by which messages are sent to the daemon in advance: the page may be slower than the world."""
_MOST_AHEAD = 2000
_LONGEST_TURN_S = 0.01
"""CPU seconds per turn of the page for making messages: browsers wait meanwhile."""
_LOWEST_HZ, _HIGHEST_HZ = 0.01, 1000.0
_DRIVE_S = 0.3
"""Wall seconds after which a base that is not driven any more is stopped: a browser may end, or lose its network."""
_STILL = {"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}

Message = dict[str, Any]
Maker = Callable[[int, float, Time], Message]
"""Makes the message for i and t (s) at a simulated time."""


def _maker(schema: Schema, texts: dict[str, Any]) -> Maker:
    """A function that makes messages of the texts of a form: path (`a.b`) -> text, or a bool.

    Numbers may be expressions in i and t, times `now`; arrays are YAML and may contain expressions. Empty texts take
    the default.

    Raises:
        UsageError: invalid YAML. The function raises UsageError, Refused: an invalid expression, or one that cannot be
            computed; BadMessage.
    """
    values: Message = {}
    for path, text in texts.items():
        if text == "":
            continue
        *parents, name = path.split(".")
        inside = values
        for parent in parents:
            inside = inside.setdefault(parent, {})
        field = _field(schema, path)
        is_text = isinstance(text, bool) or (field.type == "string" and field.array == SCALAR)
        try:
            inside[name] = text if is_text else read(str(text))
        except UsageError as error:
            raise UsageError(f"{path}: {error.message}", error.hint) from None
    return lambda i, t, now: fill(
        schema.fields, schema.root, [values], now, number_converter(i, t, most_steps=_MOST_STEPS)
    )


def _field(schema: Schema, path: str) -> Field:
    """The field at a path. Raises UsageError: there is none."""
    found = Field("", schema.root)
    for name in path.split("."):
        inner = next((field for field in schema.fields(found.type) if field.name == name), None)
        if inner is None:
            raise UsageError(f"{schema.root} has no field {path}")
        found = inner
    return found


def _requested(client: Client, request: Message) -> tuple[str, Maker]:
    """The full name of the topic or service of a form, and the maker of its messages."""
    kind = "service" if "service" in request else "topic"
    found = client.resolve(kind, str(request[kind]))
    return found["name"], _maker(from_typedefs(found["typedefs"]), dict(request["texts"]))


def filled(client: Client, request: Message) -> Message:
    """The `message` of the `texts` of a form for a `topic` or a `service`, at this time."""
    _, make = _requested(client, request)
    return {"message": make(0, 0.0, _parts(_now_ns(client)))}


def _now_ns(client: Client) -> int:
    return nanoseconds(client.call("/rosapi/get_time")["time"])


def _parts(time_ns: int) -> Time:
    return time_ns // _SECOND, time_ns % _SECOND


class PagePublications:
    """The topics that are published at a rate, and the bases that are driven. All end with the page or the daemon."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._running: dict[str, _TimedPublication] = {}
        self._driven: dict[str, float] = {}
        """Topic of a base -> wall time at which it is stopped."""

    def state(self) -> list[Message]:
        """Each running publication."""
        return [
            {"topic": topic, "rate": one.rate, "published": one.published, "reason": one.reason}
            for topic, one in self._running.items()
        ]

    def begin(self, request: Message) -> None:
        """Publish the message of the `texts` of a form on a `topic` at a `rate` in Hz of simulated time.

        Raises:
            UsageError, Refused, BadMessage: the message cannot be made, or there are too many publications.
        """
        rate = float(request["rate"])
        if not _LOWEST_HZ <= rate <= _HIGHEST_HZ:
            raise UsageError(f"a rate is from {_LOWEST_HZ:g} to {_HIGHEST_HZ:g} Hz")
        topic, make = _requested(self._page.client, request)
        make(0, 0.0, (0, 0))  # report errors before the running publication is stopped
        if len(self._running.keys() | {topic}) > _MOST_RUNNING:
            raise Refused(f"{_MOST_RUNNING} topics are published at a rate, and there can be no more", "stop one")
        self._stop(topic)
        self._running[topic] = _TimedPublication(self._page.client, topic, rate, make)

    def end(self, request: Message) -> None:
        """Stop publishing on a `topic`."""
        self._stop(str(request["topic"]))

    def drive(self, request: Message) -> None:
        """Send a base its `twist` on a `topic`. It is stopped when this is not repeated for 0.3 s.

        Raises:
            MessageRefused; Refused: too many bases.
        """
        topic, twist = str(request["topic"]), request["twist"]
        if len(self._driven.keys() | {topic}) > _MOST_RUNNING:
            raise Refused(f"{_MOST_RUNNING} bases are driven, and there can be no more")
        self._page.client.deliver(topic, twist)
        self._driven[topic] = time.monotonic() + _DRIVE_S
        if twist == _STILL:
            del self._driven[topic]

    def update(self) -> None:
        """Send what is due."""
        now = time.monotonic()
        for topic in [topic for topic, due in self._driven.items() if now >= due]:
            del self._driven[topic]
            self._page.client.deliver(topic, _STILL)
        for topic, one in list(self._running.items()):
            try:
                one.advance(self._page.client)
            except NoDaemon:
                raise
            except SlidectlError as error:
                self._stop(topic)
                raise Refused(f"{topic} is no longer published: {error.message}", error.hint) from None

    def leave(self) -> None:
        """End all publications, and stop the driven bases: nothing else would."""
        for topic in self._driven:
            try:
                self._page.client.deliver(topic, _STILL)
            except (NoDaemon, TimedOut):  # it hears nothing of the others either
                break
            except SlidectlError:  # this base has gone
                continue
        self._driven.clear()
        for topic in list(self._running):
            self._stop(topic)

    def _stop(self, topic: str) -> None:
        one = self._running.pop(topic, None)
        if one is not None:
            one.client.close()


class _TimedPublication:
    """Messages on a topic at simulated times, sent to the daemon in advance. Closing `client` withdraws them.

    i counts the messages, and t is i / rate. Both restart when simulated time goes back. Times that have already
    passed, for example after a jump forward, are skipped.
    """

    def __init__(self, client: Client, topic: str, rate: float, make: Maker) -> None:
        self.client = client.another()
        self.rate = rate
        self.published = 0
        self.reason = ""
        """The warnings of the last published message."""
        self._topic = topic
        self._make = make
        self._waiting: deque[str] = deque()
        self._begin_ns = self._latest_ns = _now_ns(client)
        self._index = 0

    def advance(self, client: Client) -> None:
        """Process what was published, and send the next messages.

        Raises MessageRefused; Refused, BadMessage: a message cannot be made. NoDaemon.
        """
        now_ns = _now_ns(self.client)
        if now_ns < self._latest_ns:
            self.client.close()
            self.client = client.another()
            self._waiting.clear()
            self._begin_ns, self._index = now_ns, 0
        self._latest_ns = now_ns
        while self._waiting and self.client.is_answered(self._waiting[0]):
            self.client.published(self._waiting.popleft())
            self.published += 1
            self.reason = " ".join(self.client.reasons) or self.reason
        end = time.thread_time() + _LONGEST_TURN_S
        while len(self._waiting) < _MOST_AHEAD and time.thread_time() < end:
            due_ns = self._begin_ns + round(self._index * _SECOND / self.rate)
            if due_ns < now_ns:
                self._begin_ns += now_ns - due_ns
                due_ns = now_ns
            if due_ns > now_ns + _AHEAD_NS:
                break
            message = self._make(self._index, self._index / self.rate, _parts(due_ns))
            self._waiting.append(self.client.publish_at(self._topic, message, due_ns))
            self._index += 1
