"""Message forms: publishing on any topic, once or at a rate (rqt_publisher), and calling services.

A form makes the same message as `slidectl pub` from the same values.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from html import escape
from typing import Any, NamedTuple

from viser import GuiFolderHandle, GuiHtmlHandle

from slidectl.client import Client
from slidectl.errors import NoDaemon, Refused, SlidectlError, UsageError, cut
from slidectl.extensions.viewing.page.page import SCROLLED, Page, Panel, WorldState, offer
from slidectl.msgs.fill import Time, field_paths, fill
from slidectl.msgs.message_expressions import number_converter
from slidectl.msgs.message_text import YamlForm
from slidectl.msgs.schema import FLOATS, SCALAR, Field, Schema, from_typedefs, nanoseconds
from slidectl.typed_values import read

_NONE = "none"
_SECOND = 10**9
_MOST_STEPS = 10_000
"""Limit of an expression: the page is blocked while it is evaluated."""
_MOST_RUNNING = 8
_AHEAD_NS = 5 * _SECOND
"""Simulated ns by which messages are sent to the daemon in advance: the page may be slower than the world."""
_MOST_AHEAD = 2000
_LONGEST_TURN_S = 0.01
"""CPU seconds per turn of the page for making messages: other panels wait meanwhile."""
_HIGHEST_HZ = 1000.0
_LIST_EVERY_S = 2.0
_LONGEST_WAIT_S = 60.0
_LONGEST_ANSWER = 20_000

Maker = Callable[[int, float, Time], dict[str, Any]]
"""Makes the message for i and t (s) at a simulated time."""


# --- forms ------------------------------------------------------------------------------------------------------------


class MessageForm:
    """One input per field, nested ones as `a.b`: a checkbox for a bool, else text. They go into the entered container.

    Numbers may be expressions in i and t, times `now`; arrays are YAML and may contain expressions. Empty inputs take
    the default.
    """

    def __init__(self, page: Page, schema: Schema, chosen: dict[str, str | bool]) -> None:
        """`chosen` maps paths to texts and is updated: the next form of the type starts with them."""
        self._schema = schema
        self._chosen = chosen
        self._fields = {path: _field(schema, path) for path in field_paths(schema.fields, schema.root)}
        gui = page.server.gui
        for path, field in self._fields.items():
            value = chosen.setdefault(path, _initial(field))
            handle = (
                gui.add_checkbox(path, value)
                if isinstance(value, bool)
                else gui.add_text(path, value, hint=field.type_text)
            )
            page.acting(handle, partial(chosen.__setitem__, path))

    def maker(self) -> Maker:
        """A function that makes messages of the present inputs. Raises UsageError: invalid YAML.

        The function raises UsageError, Refused: an invalid expression, or one that cannot be computed; BadMessage.
        """
        values: dict[str, Any] = {}
        for path, field in self._fields.items():
            text = self._chosen[path]
            if text == "":
                continue
            *parents, name = path.split(".")
            inside = values
            for parent in parents:
                inside = inside.setdefault(parent, {})
            is_text = isinstance(text, bool) or (field.type == "string" and field.array == SCALAR)
            try:
                inside[name] = text if is_text else read(str(text))
            except UsageError as error:
                raise UsageError(f"{path}: {error.message}", error.hint) from None
        schema = self._schema
        return lambda i, t, now: fill(
            schema.fields, schema.root, [values], now, number_converter(i, t, most_steps=_MOST_STEPS)
        )


def _field(schema: Schema, path: str) -> Field:
    found = Field("", schema.root)
    for name in path.split("."):
        found = next(field for field in schema.fields(found.type) if field.name == name)
    return found


def _initial(field: Field) -> str | bool:
    if field.array != SCALAR:
        return "" if field.array else "[]"
    if field.type == "bool":
        return False
    return "" if field.type == "string" else "0.0" if field.type in FLOATS else "0"


class FormPanel(Panel):
    """A dropdown of topics or services, and the form of the chosen one."""

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._chosen = _NONE
        self._values: dict[str, dict[str, str | bool]] = {}
        """Type -> the values in its form."""
        self._form: MessageForm | None = None
        self._inputs: GuiFolderHandle | None = None

    def schema_of(self, chosen: str) -> tuple[str, Schema] | None:
        """The type name and the schema of the form's message; None when the topic or service no longer exists."""
        raise NotImplementedError

    def add_dropdown(self, label: str, known: Iterable[str]) -> None:
        """Add the dropdown and an empty container for the form; call `choose` after all other elements are made."""
        options = (_NONE, *known)
        self._chosen = self._chosen if self._chosen in options else _NONE
        self._dropdown = self.gui.add_dropdown(label, options, initial_value=self._chosen)
        self.page.looking(self._dropdown, self.choose)
        self._container = self.gui.add_folder(None)
        self._inputs = None

    def choose(self, chosen: str) -> None:
        """Show the form of another topic or service."""
        self._chosen = chosen
        if self._inputs is not None:
            self._inputs.remove()
        self._form = self._inputs = None
        found = None if chosen == _NONE else self.schema_of(chosen)
        if found is not None:
            kind, schema = found
            with self._container:
                self._inputs = self.gui.add_folder(kind)
            with self._inputs:
                self._form = MessageForm(self.page, schema, self._values.setdefault(kind, {}))

    def offer_again(self, known: Iterable[str]) -> None:
        """Update the options of the dropdown."""
        options = (_NONE, *known)
        offer(self._dropdown, options)
        if self._chosen not in options:
            self.choose(_NONE)

    def leave(self) -> None:
        super().leave()
        self._form = None


def _now_ns(client: Client) -> int:
    return nanoseconds(client.call("/rosapi/get_time")["time"])


def _parts(time_ns: int) -> Time:
    return time_ns // _SECOND, time_ns % _SECOND


# --- topics -----------------------------------------------------------------------------------------------------------


class PublishPanel(FormPanel):
    """A form for one topic, and publications at a rate. These end with the page or the daemon."""

    title = "Publish"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._rate = 10.0
        self._types: dict[str, str] = {}
        """Topic -> type."""
        self._running: dict[str, _TimedPublication] = {}

    def build(self, world: WorldState) -> None:
        gui, acting = self.gui, self.page.acting
        self._types = world.topics
        self.add_dropdown("publish topic", sorted(world.topics))
        acting(gui.add_button("Publish once"), lambda _: self._publish_once())
        rate = gui.add_number("Hz of simulated time", self._rate, min=0.01, max=_HIGHEST_HZ, step=0.01)
        acting(rate, partial(setattr, self, "_rate"))
        acting(gui.add_button("Publish at the rate"), lambda _: self._begin())
        self._list = gui.add_folder(None)
        self.choose(self._chosen)

    def schema_of(self, chosen: str) -> tuple[str, Schema] | None:
        kind = self._types.get(chosen)
        if kind is None:
            return None
        return kind, from_typedefs(self.page.call("/rosapi/message_details", {"type": kind})["typedefs"])

    def leave(self) -> None:
        super().leave()
        for one in self._running.values():
            one.client.close()
        self._running.clear()

    def refresh(self, world: WorldState) -> None:
        self._types = world.topics
        self.offer_again(sorted(world.topics))
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

    def _maker(self) -> Maker:
        if self._form is None:
            raise Refused("no topic to publish on", "choose one")
        if not self.page.call("/rosapi/subscribers", {"topic": self._chosen})["subscribers"]:
            self.page.notify(f"Nobody subscribes to {self._chosen}", color="yellow")
        return self._form.maker()

    def _publish_once(self) -> None:
        make, client = self._maker(), self.page.client
        client.deliver(self._chosen, make(0, 0.0, _parts(_now_ns(client))))
        if client.reasons:
            self.page.notify(self._chosen, "\n".join(client.reasons), "yellow")

    def _begin(self) -> None:
        make = self._maker()
        make(0, 0.0, (0, 0))  # report errors before the running publication is stopped
        if len(self._running.keys() | {self._chosen}) > _MOST_RUNNING:
            raise Refused(f"{_MOST_RUNNING} topics are published at a rate, and there can be no more", "stop one")
        self._stop(self._chosen)
        one = self._running[self._chosen] = _TimedPublication(self.page.client, self._chosen, self._rate, make)
        with self._list, self.gui.add_folder(None) as one.folder:
            one.text = self.gui.add_html("")
            self.page.acting(self.gui.add_button(f"Stop {self._chosen}"), partial(self._stop, self._chosen))

    def _stop(self, topic: str, _: object = None) -> None:
        one = self._running.pop(topic, None)
        if one is not None:
            one.client.close()
            one.folder.remove()


class _TimedPublication:
    """Messages on a topic at simulated times, sent to the daemon in advance. Closing `client` withdraws them.

    i counts the messages, and t is i / rate. Both restart when simulated time goes back. Times that have already
    passed, for example after a jump forward, are skipped.
    """

    folder: GuiFolderHandle
    text: GuiHtmlHandle

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


# --- services ---------------------------------------------------------------------------------------------------------


class _Call(NamedTuple):
    """A call in progress; it does not change with the dropdown."""

    id: str
    service: str
    response: Schema
    deadline: float


class ServicesPanel(FormPanel):
    """Calls any service: a form of its request, and the response as YAML (rqt_service_caller).

    Only one call is in progress at a time. The page stays responsive meanwhile.
    """

    title = "Services"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._look_at = 0.0
        self._response = Schema("", {})
        self._call: _Call | None = None

    def build(self, world: WorldState) -> None:  # noqa: ARG002
        self.add_dropdown("service", self.page.client.services())
        self.page.acting(self.gui.add_button("Call"), lambda _: self._begin())
        self._answer = self.gui.add_html("")
        self.choose(self._chosen)

    def schema_of(self, chosen: str) -> tuple[str, Schema]:
        found = self.page.client.resolve("service", chosen)
        self._response = from_typedefs(found["response_typedefs"])
        return found["type"], from_typedefs(found["typedefs"])

    def leave(self) -> None:
        super().leave()
        self._call = None

    def refresh(self, world: WorldState) -> None:  # noqa: ARG002
        if time.monotonic() >= self._look_at:
            self._look_at = time.monotonic() + _LIST_EVERY_S
            self.offer_again(self.page.client.services())
        client, call = self.page.client, self._call
        if call is not None and client.is_answered(call.id):
            self._call = None
            try:
                text = YamlForm(call.response).printer(call.response.root)(client.answer(call.id)) or "an empty answer"
            except SlidectlError as error:
                self._tell(call.service, f"failed: {error}")
            else:
                remarks = (f"# {line}" for reason in client.reasons for line in reason.splitlines())
                self._tell(call.service, "\n".join([text, *remarks]))
            self.page.look_again()
        elif call is not None and time.monotonic() >= call.deadline:
            client.forget(call.id)
            self._call = None
            self._tell(call.service, f"no answer within {_LONGEST_WAIT_S:g} s")

    def _begin(self) -> None:
        if self._form is None:
            raise Refused("no service to call", "choose one")
        if self._call:
            raise Refused("the call before is not answered yet")
        client = self.page.client
        request = self._form.maker()(0, 0.0, _parts(_now_ns(client)))
        call = client.call_async(self._chosen, request)
        self._call = _Call(call, self._chosen, self._response, time.monotonic() + _LONGEST_WAIT_S)
        self._tell(self._chosen, "calling ...")

    def _tell(self, service: str, text: str) -> None:
        shown = escape(cut(f"{service}\n{text}", _LONGEST_ANSWER), quote=False)
        self._answer.content = f'<pre style="{SCROLLED}">{shown}</pre>'
