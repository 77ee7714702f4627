"""The graph of nodes and topics as a picture (rqt_graph), and the tree of frames with their ages (rqt_tf_tree)."""

from __future__ import annotations

import re
import time
from collections.abc import Hashable, Mapping
from html import escape
from typing import Any

from slidectl.errors import SlidectlError
from slidectl.extensions.viewing.graph_drawing import as_svg, read_graph
from slidectl.extensions.viewing.page.page import SCROLLED, Page, Panel, WorldState
from slidectl.transform_tree import MOVING, STATIC, Edge, Frames

_SHOW_S = 0.5


class GraphPanel(Panel):
    """The graph is read when the topics change and by its button; frames are followed while the checkbox is set."""

    title = "Graph"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._words = ""
        self._is_followed = False
        self._frames = Frames()
        self._show_at = 0.0

    def shape(self, world: WorldState) -> Hashable:
        return tuple(world.topics)

    def build(self, world: WorldState) -> None:  # noqa: ARG002
        words = self.gui.add_text("graph of", self._words, hint="nodes, topics or namespaces; empty: all")
        self.page.looking(words, self._choose_words)
        self._picture = self.gui.add_html("")
        self.page.looking(self.gui.add_button("Refresh the graph"), lambda _: self._read())
        followed = self.gui.add_checkbox("tf tree", self._is_followed)
        self.page.looking(followed, self._follow)
        self._tree = self.gui.add_html("")
        self._follow_frames()
        self._read()

    def refresh(self, world: WorldState) -> None:
        now = time.monotonic()
        if self._is_followed and now >= self._show_at:
            self._show_at = now + _SHOW_S
            now = world.status["time"]
            lines = "\n".join(f"{'  ' * depth}{name}{_age(edge, now)}" for depth, name, edge in self._frames.tree())
            self._tree.content = f'<pre style="{SCROLLED}">{escape(lines) or "no frames yet"}</pre>'

    def _choose_words(self, value: str) -> None:
        self._words = value
        self._draw()

    def _read(self) -> None:
        self._graph = read_graph(self.page.client).without_services()
        self._draw()

    def _draw(self) -> None:
        try:
            picture = as_svg(self._graph.about(self._words.split()) if self._words.strip() else self._graph)
        except SlidectlError as error:
            picture = f"<pre>{escape(str(error))}</pre>"
        # As wide as the panel, but never too small to read: viser's HTML cannot be zoomed.
        fitted = re.sub(r'^<svg ([^>]*?)width="\d+" height="\d+"', r'<svg \1style="width:100%;min-width:40em"', picture)
        self._picture.content = f'<div style="{SCROLLED}">{fitted}</div>'

    def _follow(self, value: bool) -> None:
        self._is_followed = value
        self.leave()
        self._frames = Frames()
        self._tree.content = ""
        self._follow_frames()

    def _follow_frames(self) -> None:
        for topic in (MOVING, STATIC) if self._is_followed else ():
            self.subscribe(topic, "tf2_msgs/TFMessage", queue_length=1000, take=self._take, wait=False)

    def _take(self, published: Mapping[str, Any]) -> None:
        self._frames.add(published["msg"], published["topic"] == STATIC)


def _age(edge: Edge | None, now: float) -> str:
    """The age of a frame's transform, in simulated time."""
    if edge is None:
        return ""
    return " static" if edge.is_static else f" {max(now - edge.time_ns / 1e9, 0.0):.1f} s"
