"""Gains that can be changed while a controller runs, and saved as a controllers file (rqt_reconfigure).

The panel shows every dynamic_reconfigure server, including each PID. A typed value is applied after a pause without
input, so that typing 150 does not apply 1 and 15.
"""

from __future__ import annotations

import math
import time
from collections.abc import Hashable
from functools import partial
from html import escape
from typing import Any

import yaml
from viser import ClientHandle, GuiHtmlHandle

from slidectl import names
from slidectl.client import Subscription
from slidectl.control.reconfigure import Values
from slidectl.description.parameter_trees import nest
from slidectl.errors import Refused
from slidectl.extensions.viewing.page.page import PADDING, Message, Page, Panel, WorldState, html_table

_STILL_S = 0.5
_LATCHED_S = 0.5
"""Wall seconds to wait for a latched message; the page tries again later."""
_MOST_CHANGES, _MOST_SHOWN = 100, 5
_SERVICE = "/set_parameters"


class GainsPanel(Panel):
    """The gains of one robot, the last changes of all robots, and the file."""

    title = "Gains"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._robot = ""
        """The namespace of the chosen robot."""
        self._saved = ""
        self._changes: list[tuple[str, Values, Values]] = []
        """Namespace of the gains, old values, new values; newest last."""
        self._servers: dict[str, list[str]] = {}
        """Namespace of a robot -> namespaces of its gains."""
        self._typed: dict[tuple[str, str], tuple[float | bool, float]] = {}
        """Namespace of the gains and name -> typed value, and the wall time at which it is applied."""
        self._inputs: dict[tuple[str, str], Any] = {}
        self._values: dict[str, Values] = {}
        self._updates: dict[str, Subscription] = {}
        self._history: GuiHtmlHandle | None = None

    def shape(self, world: WorldState) -> Hashable:
        answer = self.page.client.call("/rosapi/services_for_type", {"type": "dynamic_reconfigure/Reconfigure"})
        spaces = [service.removesuffix(_SERVICE) for service in answer["services"] if service.endswith(_SERVICE)]
        found = {
            robot: [one for one in spaces if names.is_under(one, robot) and f"{one}/parameter_updates" in world.topics]
            for robot in world.controllers
        }
        self._servers = {robot: servers for robot, servers in found.items() if servers}
        if self._robot not in self._servers:
            self._robot = next(iter(self._servers), "")
        return self._robot, tuple((robot, tuple(servers)) for robot, servers in self._servers.items())

    def build(self, world: WorldState) -> None:
        self._history = None
        if not self._servers:
            self.gui.add_markdown("no gains: `slidectl controller spawn NAME` loads a controller that has some")
            return
        chosen = self.gui.add_dropdown("robot", tuple(self._servers), initial_value=self._robot)
        self.page.looking(chosen, self._choose)
        for space in self._servers[self._robot]:
            self._add_inputs(space)
        self.page.acting(self.gui.add_button("Undo"), lambda _: self._undo())
        self._history = self.gui.add_html("")
        save = self.gui.add_button("Save as YAML", hint="a file for spawn --controllers")
        self.page.answering(save, lambda _, browser: self._save(browser))
        self._file = self.gui.add_html(self._saved)
        self.refresh(world)

    def _add_inputs(self, space: str) -> None:
        client = self.page.client
        with client.subscribe(f"{space}/parameter_descriptions") as descriptions:
            described = descriptions.get(_LATCHED_S)
        updates = self._updates[space] = self.subscribe(f"{space}/parameter_updates", queue_length=1)
        values = self._values[space] = _values(updates.get(_LATCHED_S))
        low, high = _values(described["min"]), _values(described["max"])
        with self.gui.add_folder(space.removeprefix(self._robot).lstrip("/")):
            for option in described["groups"][0]["parameters"]:
                name, hint = option["name"], option["description"]
                if name not in values:
                    self.gui.add_html(escape(f"{name}: type {option['type']}, which is not turned here"))
                    continue
                value = values[name]
                if isinstance(value, bool):
                    one: Any = self.gui.add_checkbox(name, value, hint=hint)
                else:
                    span = min(low[name], value), max(high[name], value)  # files may exceed the limits
                    step = 10.0 ** math.floor(math.log10(abs(value)) - 1) if 0 < abs(value) < math.inf else 0.1
                    one = self.gui.add_number(name, float(value), min=span[0], max=span[1], step=step, hint=hint)
                    one.precision = 7
                self._inputs[space, name] = one
                self.page.acting(one, partial(self._type, space, name))

    def _choose(self, robot: str) -> None:
        self._robot = robot
        self.page.look_again()

    def _type(self, space: str, name: str, value: float | bool) -> None:
        self._typed[space, name] = value, time.monotonic() + _STILL_S

    def refresh(self, world: WorldState) -> None:  # noqa: ARG002
        for space, updates in self._updates.items():
            while len(updates):
                self._show(space, _values(updates.get()))
        for (space, name), (value, due) in list(self._typed.items()):
            if time.monotonic() >= due:
                del self._typed[space, name]
                if space in self._values:
                    self._change(space, {name: value})
        if self._history is not None:
            rows = [
                (names.join(space, name), f"{was:g}", f"{is_now:g}")
                for space, before, after in reversed(self._changes[-_MOST_SHOWN:])
                for (name, was), is_now in zip(before.items(), after.values(), strict=True)
            ]
            self._history.content = html_table(("last changes", "from", "to"), rows) if rows else ""

    def _change(self, space: str, wanted: Values) -> None:
        """Set gains. Raises Refused; the inputs show the actual gains in any case."""
        before = self._values[space]
        try:
            after = self._set(space, wanted)
        except Refused:
            self._show(space, before)
            raise
        changed = [name for name in after if after[name] != before[name]]
        if changed:
            done = space, {name: before[name] for name in changed}, {name: after[name] for name in changed}
            self._changes = [*self._changes[1 - _MOST_CHANGES :], done]
        self._show(space, after)

    def _undo(self) -> None:
        if not self._changes:
            raise Refused("there is no change to undo")
        space, before, _ = self._changes.pop()
        values = self._set(space, before)
        if space in self._values:
            self._show(space, values)

    def _set(self, space: str, wanted: Values) -> Values:
        """Set gains and return all values. Raises Refused."""
        entries = [{"name": name, "value": value} for name, value in wanted.items()]
        config = {
            "bools": [one for one in entries if isinstance(one["value"], bool)],
            "doubles": [one for one in entries if not isinstance(one["value"], bool)],
        }
        return _values(self.page.call(space + _SERVICE, {"config": config})["config"])

    def _show(self, space: str, values: Values) -> None:
        self._values[space] = values
        for name, value in values.items():
            if (space, name) in self._inputs and (space, name) not in self._typed:
                self._inputs[space, name].value = value

    def _save(self, browser: ClientHandle) -> None:
        """Send the robot's controller parameters as a file to the requesting browser, and show them in all."""
        manager = self.page.client.controllers(self._robot)
        tree = {name: self.page.client.params[names.join(self._robot, name)] for name in manager.configured()}
        text = yaml.safe_dump(nest(self._robot, tree), sort_keys=False, allow_unicode=True)
        file = f"{self._robot.strip('/').replace('/', '_') or 'robot'}_control.yaml"
        self._saved = f'<pre style="{PADDING};font-size:0.75em;overflow-x:auto">{escape(text)}</pre>'
        self._file.content = self._saved
        browser.send_file_download(file, text.encode(), save_immediately=True)

    def leave(self) -> None:
        super().leave()
        for kept in (self._updates, self._inputs, self._values):
            kept.clear()


def _values(config: Message) -> Values:
    """Name -> value, of a dynamic_reconfigure/Config."""
    return {one["name"]: one["value"] for one in (*config["doubles"], *config["bools"])}
