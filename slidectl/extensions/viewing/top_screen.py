"""The screen of `slidectl top`: sections of rows that fit a terminal, and its keys."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from functools import partial
from typing import Any

from rich.text import Text

from slidectl.client.manager import STARTED
from slidectl.errors import SlidectlError
from slidectl.extensions.viewing.world_monitor import Record, WorldMonitor

_COLUMNS = {
    "controllers": ("name", "state", "claims", "type"),
    "joints": ("name", "position", "velocity", "effort", "set_point"),
    "topics": ("topic", "rate", "type"),
    "log": ("time", "level", "message"),
}
"""Section -> keys of its records. A narrow terminal omits the last ones."""
_NUMBERS = {"position", "velocity", "effort", "set_point", "rate"}
_CUT = {"type", "claims"}
_LEAST_WIDTH = 14
"""Minimum width of the last column; below it the column is omitted."""
_ACTION_LIMIT_S = 3.0
_HINTS = "? help  q quit  space pause  . step  tab section  enter start/stop  / filter  s sort"
_HELP = """\
q           quit
space       pause the world, or let it go on
.           run one cycle
tab         go to the next section
up, down    choose a row (j and k, too)
enter       start or stop the controller that is chosen
/           show only rows with a text; enter ends it, escape forgets it
s           sort the section by the next column
r           sort the other way round
?           this help, until a key is pressed"""


class TopScreen:
    """The state of the screen: active section, chosen row, order of rows, filter."""

    def __init__(self, text: str = "") -> None:
        """`text` is the initial filter: only rows that contain it are shown."""
        self.monitor: WorldMonitor | None = None
        self.gone = ""
        """Why there is no daemon; empty while there is one."""
        self._filter = text
        self._note = ""
        self._help = self._types = False
        self._section = "controllers"
        self._chosen = dict.fromkeys(_COLUMNS, 0)
        self._order: dict[str, tuple[str, bool]] = {"topics": ("rate", True)}
        """Section -> sort key of its rows, and whether the order is descending."""

    # --- keys ---------------------------------------------------------------------------------------------------

    def press(self, key: str) -> bool:
        """Carry out a key's action. Returns False to quit."""
        self._note = ""
        if self._types:
            self._type(key)
        elif self._help:
            self._help = False
        elif key == "q":
            return False
        elif key in (actions := self._actions()):
            try:
                actions[key]()
            except SlidectlError as error:  # also NoDaemon, which the next refresh reports
                self._note = f"error: {error.message}"
        return True

    def _actions(self) -> dict[str, Callable[[], object]]:
        show_help = partial(setattr, self, "_help", True)
        return {
            "space": self._pause, ".": self._step, "enter": self._switch, "tab": self._next_section,
            "up": lambda: self._move(-1), "k": lambda: self._move(-1),
            "down": lambda: self._move(1), "j": lambda: self._move(1),
            "s": self._sort, "r": self._reverse, "?": show_help, "h": show_help,
            "/": partial(setattr, self, "_types", True),
        }  # fmt: skip

    def _type(self, key: str) -> None:
        if key == "escape":
            self._filter = ""
        elif key == "backspace":
            self._filter = self._filter[:-1]
        elif key == "space" or (len(key) == 1 and key.isprintable()):
            self._filter += " " if key == "space" else key
        self._types = key not in ("enter", "escape")

    def _next_section(self) -> None:
        every = list(_COLUMNS)
        self._section = every[(every.index(self._section) + 1) % len(every)]

    def _move(self, rows: int) -> None:
        last = len(self._rows(self._section)) - 1
        self._chosen[self._section] = max(0, min(self._chosen[self._section] + rows, last))

    def _sort(self) -> None:
        """Sort by the next column; after the last one, use the daemon's order."""
        columns = _COLUMNS[self._section]
        by = self._order.pop(self._section, ("", False))[0]
        if by != columns[-1]:
            key = columns[columns.index(by) + 1] if by else columns[0]
            self._order[self._section] = (key, key in _NUMBERS)

    def _reverse(self) -> None:
        if self._section in self._order:
            key, falling = self._order[self._section]
            self._order[self._section] = (key, not falling)

    def _pause(self) -> None:
        if self.monitor is not None:
            service = "unpause_physics" if self.monitor.status["paused"] else "pause_physics"
            self._call(f"/gazebo/{service}")

    def _step(self) -> None:
        self._call("/slidectl/step", cycles=1)

    def _call(self, service: str, **request: Any) -> None:
        if self.monitor is not None:
            self.monitor.client.call(service, request, timeout=_ACTION_LIMIT_S)
            self.monitor.refresh()

    def _switch(self) -> None:
        """Start or stop the chosen controller."""
        rows = self._rows("controllers")
        if self._section != "controllers" or not rows or self.monitor is None:
            return
        row = rows[min(self._chosen["controllers"], len(rows) - 1)]
        manager = self.monitor.client.controllers(row["manager"])
        local = row["name"].removeprefix(row["manager"].rstrip("/") + "/")
        if row["state"] in STARTED:
            manager.switch((), [local])
        else:
            manager.start([local])
        self._note = f"{row['name']}: {manager.states().get(local)} (was {row['state']})"
        self.monitor.refresh()

    # --- lines --------------------------------------------------------------------------------------------------

    def lines(self, width: int, height: int) -> list[Text]:
        """The lines of the screen, at most `height` of `width` characters."""
        if self._types:
            end = f"filter: {self._filter}_"
        else:
            end = self._note or (f"filter: {self._filter}  (/ changes it)" if self._filter else _HINTS)
        head = self._head()
        if self._help:
            shown = [*head, *map(Text, _HELP.splitlines())]
        else:
            shown = [*head, *self._body(width, height - len(head) - 1)]
        shown = shown[: height - 1]
        shown += [Text()] * (height - 1 - len(shown))
        shown.append(Text(end, style="reverse" if self._note or self._types else "dim"))
        for line in shown:
            line.truncate(width)
        return shown

    def plain(self) -> str:
        """All rows, as text."""
        lines = [line.plain for line in self._head()]
        for section in _COLUMNS:
            lines += ["", *(line.plain.rstrip() for line in self._table(section, 10_000, self._rows(section)))]
        return "\n".join(lines)

    def as_data(self) -> Record:
        """The status, and the rows of each section; log lines as text."""
        sections = {section: self._rows(section) for section in _COLUMNS}
        status = self.monitor.status if self.monitor else {}
        return {"status": status, **sections, "log": [row["line"] for row in sections["log"]]}

    def _head(self) -> list[Text]:
        if self.monitor is None:
            return [Text(self.gone, style="bold red")]
        status = self.monitor.status
        state = "running" if not status["paused"] else f"paused: {status['trouble']}" if status["trouble"] else "paused"
        asked = f"{status['speed']:g}" if status["speed"] else "max"
        speed = f"real-time factor {status['speed_reached'] or 0:.3g} of {asked}"
        first = Text(f"{status['instance']}: {status['time']:.3f} s, {state}, {speed}", style="bold")
        for what, names in (("emergency stop of", status["estop"]), ("faults:", status["faults"])):
            if names:
                first.append(f", {what} {' '.join(names)}", style="red")
        if self.gone:
            first = Text(self.gone, style="bold red")
        mean, p99, worst = (
            "-" if status[key] is None else f"{1e6 * status[key]:.0f} us"
            for key in ("cycle_mean", "cycle_p99", "cycle_worst")
        )
        counts = (
            f"robots: {len(status['robots'])}; controllers: {status['controllers_running']} of {status['controllers']}"
        )
        return [first, Text(f"{counts} running; cycle {mean} mean, {p99} p99, {worst} worst")]

    def _body(self, width: int, room: int) -> list[Text]:
        """The sections, each with a title line. If not all fit, the active section comes first."""
        sections = sorted(_COLUMNS, key=lambda section: section != self._section)[: max(1, room // 2)]
        rows = {section: self._rows(section) for section in _COLUMNS if section in sections}
        if "log" in rows:
            rows["log"] = _wrapped(rows["log"], width)
        shares = dict.fromkeys(rows, 2)
        while sum(shares.values()) < room:
            short = [section for section in rows if shares[section] < 1 + len(rows[section])]
            if not short:
                break
            shares[min(short, key=shares.__getitem__)] += 1
        lines: list[Text] = []
        for section, share in shares.items():
            count, chosen = len(rows[section]), min(self._chosen[section], len(rows[section]) - 1)
            first = max(0, count - share + 1) if section == "log" else max(0, chosen - share + 2)
            table = self._table(section, width, rows[section][first : first + share - 1])
            if section == self._section:
                table[0].stylize("reverse")
                if count and section != "log":
                    table[1 + chosen - first].stylize("reverse")
            lines += table
        return lines

    def _rows(self, section: str) -> list[Record]:
        """The filtered rows, in order."""
        if self.monitor is None:
            return []
        rows: list[Record] = getattr(self.monitor, section)
        wanted = self._filter.lower()
        rows = [row for row in rows if any(wanted in _cell(value).lower() for value in row.values())]
        if section in self._order:
            key, falling = self._order[section]
            known = [row for row in rows if row[key] is not None]
            rows = sorted(known, key=lambda row: row[key], reverse=falling) + [row for row in rows if row[key] is None]
        return rows

    def _table(self, section: str, width: int, rows: list[Record]) -> list[Text]:
        """The title line, then one line per row; the title of the sort column is underlined."""
        keys = _COLUMNS[section]
        by = self._order.get(section, ("", False))[0]
        if not rows:
            return [Text(f"{section.upper()}: none", style="bold"), Text()]
        titles = [key.replace("_", " ").upper() for key in keys]
        titles[0] = section.upper()
        cells = [[_cell(row[key]) for key in keys] for row in rows]
        widths = [max(len(line[index]) for line in [titles, *cells]) for index in range(len(keys))]
        while section != "log" and (over := sum(widths) + 2 * (len(widths) - 1) - width) > 0:
            last = len(widths) - 1
            if last > 1 and keys[last] in _CUT and widths[last] > _LEAST_WIDTH:
                widths[last] = max(widths[last] - over, _LEAST_WIDTH)
            elif last > 1 or (last and widths[0] - over < _LEAST_WIDTH // 2):
                widths.pop()
            else:
                widths[0] -= over
        lines = [Text(style="bold"), *(Text() for _ in rows)]
        for line, row in zip(lines, [titles, *cells], strict=True):
            for key, text, size in zip(keys, row, widths, strict=False):  # a narrow terminal has fewer columns
                shown = text if len(text) <= size else f"…{text[len(text) - size + 1 :]}"
                style = "underline" if line is lines[0] and key == by else _STYLES.get(text, "")
                line.append(shown.rjust(size) if key in _NUMBERS else shown.ljust(size), style=style).append("  ")
        return lines


_STYLES = {
    "running": "green", "active": "green", "waiting": "yellow", "aborted": "red",
    "warn": "yellow", "error": "red", "fatal": "red",
}  # fmt: skip


def _wrapped(rows: list[Record], width: int) -> list[Record]:
    """The lines of the log with messages of more than one row where they are wider than the screen."""
    before = sum(max([len(key), *(len(_cell(row[key])) for row in rows)]) + 2 for key in ("time", "level"))
    room = max(_LEAST_WIDTH, width - before)
    return [
        {**(row if number == 0 else dict.fromkeys(row, "")), "message": part}
        for row in rows
        for number, part in enumerate(textwrap.wrap(row["message"], room, break_on_hyphens=False) or [""])
    ]


def _cell(value: Any) -> str:
    if value is None or value == []:
        return "-"
    if isinstance(value, float):
        return f"{value:z.3f}" if abs(value) < 1e6 else f"{value:.4g}"
    return " ".join(value) if isinstance(value, list) else str(value)
