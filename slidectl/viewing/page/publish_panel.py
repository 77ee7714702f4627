"""Messages to any topic, once or at a rate, with values that may change with the time (rqt_publisher)."""

from __future__ import annotations

import time
from collections import deque
from functools import partial
from html import escape

from viser import GuiFolderHandle, GuiHtmlHandle

from slidectl.client import Client
from slidectl.errors import NoDaemon, Refused, SlidectlError
from slidectl.msgs.fill import Time
from slidectl.msgs.schema import from_typedefs
from slidectl.viewing.page.message_form import Maker, MessageForm
from slidectl.viewing.page.page import Page, Panel, WorldState

_NONE = "none"
_SECOND = 10**9
_MOST_RUNNING = 8
_AHEAD_NS = 5 * _SECOND
"""Simulated, for which messages are handed over before their time: the page need not be as quick as the world."""
_MOST_AHEAD = 2000
_LONGEST_TURN_S = 0.01
"""For which messages are made in one turn of the page, which others wait for; of the processor's time."""
_HIGHEST_HZ = 1000.0


class PublishPanel(Panel):
    """A form for one topic, and what is published at a rate. That ends with the page, and with the daemon."""

    title = "Publish"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._topic = _NONE
        self._rate = 10.0
        self._chosen: dict[str, dict[str, str | bool]] = {}
        """Type -> the values in its form."""
        self._known: dict[str, str] = {}
        self._form: MessageForm | None = None
        self._inputs: GuiFolderHandle | None = None
        self._running: dict[str, _TimedPublication] = {}

    def build(self, world: WorldState) -> None:
        gui, acting = self.gui, self.page.acting
        self._known = world.topics
        self._topic = self._topic if self._topic in world.topics else _NONE
        self._topics = gui.add_dropdown("publish topic", (_NONE, *sorted(world.topics)), initial_value=self._topic)
        self.page.looking(self._topics, self._choose_topic)
        self._container = gui.add_folder(None)
        self._inputs = None
        acting(gui.add_button("Publish once"), lambda _: self._publish_once())
        rate = gui.add_number("Hz of simulated time", self._rate, min=0.01, max=_HIGHEST_HZ, step=0.01)
        acting(rate, self._choose_rate)
        acting(gui.add_button("Publish at the rate"), lambda _: self._begin())
        self._list = gui.add_folder(None)
        self._make_form()

    def leave(self) -> None:
        for one in self._running.values():
            one.client.close()
        self._running.clear()
        self._form = None

    def refresh(self, world: WorldState) -> None:
        if world.topics != self._known:
            self._known = world.topics
            self._topics.options = (_NONE, *sorted(world.topics))
            if self._topic not in world.topics:
                self._choose_topic(_NONE)
        for topic, one in self._running.items():
            one.text.content = escape(f"{topic}: {one.rate:g} Hz, {one.published} published. {one.reason}")

    def update(self) -> None:
        for topic, one in list(self._running.items()):
            try:
                one.advance(self.page.client)
            except NoDaemon:
                raise
            except SlidectlError as error:
                self._stop(topic)
                raise Refused(f"{topic} is no longer published: {error.message}", error.hint) from None

    def _choose_topic(self, topic: str) -> None:
        self._topic = topic
        self._make_form()

    def _choose_rate(self, value: float) -> None:
        self._rate = min(max(0.01, value), _HIGHEST_HZ)

    def _make_form(self) -> None:
        if self._inputs is not None:
            self._inputs.remove()
        self._form = self._inputs = None
        kind = self._known.get(self._topic)
        if kind is not None:
            parts = self.page.call("/rosapi/message_details", {"type": kind})["typedefs"]
            with self._container:
                self._inputs = self.gui.add_folder(kind)
            with self._inputs:
                self._form = MessageForm(self.page, from_typedefs(parts), self._chosen.setdefault(kind, {}))

    def _maker(self) -> Maker:
        if self._form is None:
            raise Refused("no topic to publish on", "choose one")
        if not self.page.call("/rosapi/subscribers", {"topic": self._topic})["subscribers"]:
            self.page.notify(f"Nobody subscribes to {self._topic}", color="yellow")
        return self._form.maker()

    def _publish_once(self) -> None:
        make, client = self._maker(), self.page.client
        client.deliver(self._topic, make(0, 0.0, _parts(_now_ns(client))))
        if client.reasons:
            self.page.notify(self._topic, "\n".join(client.reasons), "yellow")

    def _begin(self) -> None:
        make = self._maker()
        make(0, 0.0, (0, 0))  # what is wrong is told before what runs is stopped
        if len(self._running.keys() | {self._topic}) > _MOST_RUNNING:
            raise Refused(f"{_MOST_RUNNING} topics are published at a rate, and there can be no more", "stop one")
        self._stop(self._topic)
        one = self._running[self._topic] = _TimedPublication(self.page.client, self._topic, self._rate, make)
        with self._list, self.gui.add_folder(None) as one.folder:
            one.text = self.gui.add_html("")
            self.page.acting(self.gui.add_button(f"Stop {self._topic}"), partial(self._stop, self._topic))

    def _stop(self, topic: str, _: object = None) -> None:
        one = self._running.pop(topic, None)
        if one is not None:
            one.client.close()
            one.folder.remove()


class _TimedPublication:
    """Messages on a topic at times of the simulation, which the daemon gets before. Closing `client` takes them back.

    i counts the messages, and t is i / rate. Both begin anew when the time of the world goes back. Times that have
    passed already, as after a leap forward, are left out.
    """

    folder: GuiFolderHandle
    text: GuiHtmlHandle

    def __init__(self, client: Client, topic: str, rate: float, make: Maker) -> None:
        self.client = client.another()
        self.rate = rate
        self.published = 0
        self.reason = ""
        """What the subscribers said last of a message that they took."""
        self._topic = topic
        self._make = make
        self._waiting: deque[str] = deque()
        self._begin_ns = self._latest_ns = _now_ns(client)
        self._index = 0

    def advance(self, client: Client) -> None:
        """Take in what was published, and hand over what comes next.

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


def _now_ns(client: Client) -> int:
    now = client.call("/rosapi/get_time")["time"]
    return int(now["secs"] * _SECOND + now["nsecs"])


def _parts(time_ns: int) -> Time:
    return time_ns // _SECOND, time_ns % _SECOND
