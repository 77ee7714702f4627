"""All topics with their numbers of users, and the rate and last message of chosen ones (rqt_topic)."""

from __future__ import annotations

import math
import time
from collections.abc import Hashable
from functools import partial
from html import escape
from typing import Any

import yaml
from viser import GuiHtmlHandle

from slidectl import msgs
from slidectl.client import Client
from slidectl.errors import cut
from slidectl.extensions.viewing.graph_drawing import NodeGraph, read_graph
from slidectl.extensions.viewing.page.page import HIGHEST, SCROLLED, Page, Panel, WorldState, html_table
from slidectl.extensions.viewing.world_monitor import FollowedTopic

_NONE = "none"
_MOST = 8
_SHOW_S = 0.25
_MOST_ELEMENTS, _LONGEST_TEXT = 12, 200
_SLOW_MS, _FAST_MS = 200, 10
_FAST_HZ = 80.0
"""A rate measured through a throttle of `_FAST_MS` from which on the true rate may be higher."""


class TopicsPanel(Panel):
    """The list of topics, and the monitored ones."""

    title = "Topics"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._text = ""
        self._chosen: list[str] = []
        self._monitored: dict[str, _MonitoredTopic] = {}
        self._show_at = 0.0

    def shape(self, world: WorldState) -> Hashable:
        return tuple(world.topics.items()), tuple(self._chosen)

    def build(self, world: WorldState) -> None:  # noqa: ARG002
        client = self.page.client
        types = client.topics()  # before the page's own subscriptions
        for name in self._chosen:
            if name in types:
                self._monitored[name] = _MonitoredTopic(client, name, types[name])
        self._graph = read_graph(client)
        free = [name for name in self._graph.topics if name not in self._chosen]
        topic = self.gui.add_dropdown("monitor topic", (_NONE, *free), disabled=len(self._chosen) >= _MOST)
        self.page.looking(topic, self._choose)
        for name in self._chosen:
            with self.gui.add_folder(name):
                shown = self.gui.add_html(f'<i style="{SCROLLED}">no such topic now</i>')
                self.page.looking(self.gui.add_button(f"Stop {name}"), partial(self._stop, name))
            if name in self._monitored:
                self._monitored[name].shown = shown
        text = self.gui.add_text("topic contains", self._text)
        self.page.looking(text, self._choose_text)
        self._list = self.gui.add_html(self._table(self._graph))
        self.page.looking(self.gui.add_button("Refresh topics"), lambda _: self._read_again())
        self._show_at = 0.0

    def leave(self) -> None:
        for one in self._monitored.values():
            one.stop()
        self._monitored.clear()

    def refresh(self, world: WorldState) -> None:
        now = time.monotonic()
        if now >= self._show_at:
            self._show_at = now + _SHOW_S
            for one in self._monitored.values():
                one.show(round(world.status["time"] * 1e9))

    def _table(self, graph: NodeGraph) -> str:
        text = self._text.lower()
        rows = [
            (name, use.type, len(use.publishers), len(use.subscribers))
            for name, use in graph.topics.items()
            if text in f"{name} {use.type}".lower()
        ]
        table = html_table(("topic", "type", "publishers", "subscribers"), rows)
        return f'<div style="{HIGHEST}">{table}</div>'

    def _choose(self, name: str) -> None:
        if name in self._graph.topics and name not in self._chosen and len(self._chosen) < _MOST:
            self._chosen.append(name)
            self.page.look_again()

    def _stop(self, name: str, _: object) -> None:
        if name in self._chosen:
            self._chosen.remove(name)
            self.page.look_again()

    def _choose_text(self, value: str) -> None:
        self._text = value
        self._list.content = self._table(self._graph)

    def _read_again(self) -> None:
        self._graph = read_graph(self.page.client)
        self._list.content = self._table(self._graph)


class _MonitoredTopic:
    """The rate of messages in simulated time, and the last message.

    Messages with a header are throttled, since their count is in it. Messages with lists may be long, so at most a
    hundred per second are received.
    """

    shown: GuiHtmlHandle

    def __init__(self, client: Client, name: str, kind: str) -> None:
        self._kind = kind
        fields = msgs.fields(kind)
        is_counted = any(field.name == "header" for field in fields)
        self._is_cut = not is_counted and any(field.array >= 0 for field in fields)
        throttle_ms = _SLOW_MS if is_counted else _FAST_MS if self._is_cut else 0
        self._followed = FollowedTopic(client, name, throttle_ms, is_counted)
        self._last: tuple[object, str] = (None, "")

    def stop(self) -> None:
        """End the subscription."""
        self._followed.subscription.close()

    def show(self, now_ns: int) -> None:
        """Show a new message or rate."""
        rate, message = self._rate(now_ns), self._followed.message
        if message is self._last[0] and rate == self._last[1]:
            return
        self._last = message, rate
        content = f'<div style="{SCROLLED}">{escape(self._kind)}: {rate}</div>'
        if message:
            text = yaml.safe_dump(_shortened(message), sort_keys=False, default_flow_style=None, width=60)
            content += f'<pre style="{SCROLLED}">{escape(text)}</pre>'
        self.shown.content = content

    def _rate(self, now_ns: int) -> str:
        rate = self._followed.rate(now_ns)
        if rate is None:
            return "no rate yet" if self._followed.message else "no message yet"
        return f"{_FAST_HZ:g} Hz or more" if self._is_cut and rate >= _FAST_HZ else f"{rate:.1f} Hz"


def _shortened(value: Any) -> Any:
    """The value with long lists and texts cut."""
    if isinstance(value, dict):
        return {key: _shortened(inner) for key, inner in value.items()}
    if isinstance(value, list):
        more = len(value) - _MOST_ELEMENTS
        return [*map(_shortened, value[:_MOST_ELEMENTS]), *([f"and {more} more"] if more > 0 else [])]
    if isinstance(value, str):
        return cut(value, _LONGEST_TEXT)
    return math.nan if value is None else value  # NaN is null in JSON
