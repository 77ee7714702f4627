"""The log: messages on /rosout, filtered by severity and text (rqt_console)."""

from __future__ import annotations

from collections import deque
from functools import partial
from html import escape
from typing import Any

from slidectl.errors import cut
from slidectl.extensions.viewing.page.page import SCROLLED, Page, Panel, WorldState

_SEVERITIES = {"debug": 1, "info": 2, "warn": 4, "error": 8, "fatal": 16}
_COLOURS = {"debug": "#888", "warn": "#c77700", "error": "#d33", "fatal": "#d33"}
_MOST_SHOWN, _MOST_KEPT = 200, 2000
_LONGEST_LINE = 500


class LogPanel(Panel):
    """The last log lines, newest at the bottom. They stay when the daemon ends."""

    title = "Log"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._lines: deque[tuple[int, str, str]] = deque(maxlen=_MOST_KEPT)
        """Level, text for the filter, HTML."""
        self._severity = "debug"
        self._text = ""
        self._paused = False
        self._is_new = True

    def build(self, world: WorldState) -> None:
        severity = self.gui.add_dropdown("severity from", tuple(_SEVERITIES), initial_value=self._severity)
        self.page.looking(severity, partial(self._choose, "_severity"))
        text = self.gui.add_text("log contains", self._text)
        self.page.looking(text, partial(self._choose, "_text"))
        paused = self.gui.add_checkbox("pause the log", self._paused)
        self.page.looking(paused, partial(setattr, self, "_paused"))
        self.page.looking(self.gui.add_button("Clear the log"), lambda _: self._clear())
        self._shown = self.gui.add_html("")
        self._is_new = True
        self.subscribe("/rosout", "rosgraph_msgs/Log", queue_length=_MOST_KEPT, take=self._take)
        self.refresh(world)

    def refresh(self, world: WorldState) -> None:  # noqa: ARG002
        if not self._is_new or self._paused:
            return
        self._is_new = False
        level, text = _SEVERITIES[self._severity], self._text.lower()
        found = [line for line in self._lines if line[0] >= level and text in line[1].lower()]
        lines = "".join(line[2] for line in found[-_MOST_SHOWN:])
        # With column-reverse, the end is visible without scrolling.
        style = f"{SCROLLED};font-family:monospace;display:flex;flex-direction:column-reverse"
        self._shown.content = f'<div style="{style}"><div>{lines}</div></div>'

    def _take(self, published: dict[str, Any]) -> None:
        line = published["msg"]
        stamp = line["header"]["stamp"]
        time = f"{stamp['secs'] + stamp['nsecs'] / 1e9:.3f}"
        level = line["level"]
        severity = next((name for name, value in _SEVERITIES.items() if value >= level), "fatal")
        text = cut(f"{time} {severity} {line['name']}: {line['msg']}", _LONGEST_LINE)
        style = f' style="color:{_COLOURS[severity]}"' if severity in _COLOURS else ""
        self._lines.append((level, text, f"<div{style}>{escape(text)}</div>"))
        self._is_new = True

    def _choose(self, what: str, value: str) -> None:
        setattr(self, what, value)
        self._is_new = True

    def _clear(self) -> None:
        self._lines.clear()
        self._is_new = True
