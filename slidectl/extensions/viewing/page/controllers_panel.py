"""The controllers of all robots: load, start, stop, unload and switch them, as rqt_controller_manager does."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from viser import GuiButtonGroupHandle, GuiHtmlHandle

from slidectl.client.manager import STARTED, UNLOADED, Manager, claimed_text, configured
from slidectl.errors import UsageError
from slidectl.extensions.viewing.page.page import Page, Panel, WorldState, html_table, offer

if TYPE_CHECKING:
    from slidectl.msgs.typed import ControllerStateMsg

_NOTHING = "nothing"
_STOP, _START = "switch: stop", "switch: start"
_ACTIONS: dict[str, Callable[[Manager, str], object]] = {
    "load": lambda manager, name: manager.load(name),
    "load and start": lambda manager, name: manager.bring_up([name]),
    "start": lambda manager, name: manager.start([name]),
    "stop": lambda manager, name: manager.switch((), [name]),
    "unload": lambda manager, name: manager.unload(name),
}


class ControllersPanel(Panel):
    """For each robot: a table, a row of buttons per controller, and a switch."""

    title = "Controllers"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._known: dict[str, dict[str, str]] = {}
        """Namespace -> known controller -> its type in the parameters; empty for loaded ones."""
        self._used: set[str] = set()
        """Namespaces in which a user did something; their folders are open."""
        self._chosen: dict[tuple[str, str], str] = {}
        """Namespace and label -> the value of the dropdown before the panel was rebuilt."""
        self._tables: dict[str, GuiHtmlHandle] = {}
        self._buttons: dict[tuple[str, str], GuiButtonGroupHandle] = {}
        """Namespace and controller -> buttons."""
        self._dropdowns: dict[tuple[str, str], Any] = {}
        """Namespace and label -> dropdown."""

    def shape(self, world: WorldState) -> Hashable:
        parameters = self.page.client.params.names()
        return tuple(
            (space, frozenset((*_names(loaded), *configured(parameters, space))))
            for space, loaded in world.controllers.items()
        )

    def build(self, world: WorldState) -> None:
        self._known = {}
        for number, (space, loaded) in enumerate(world.controllers.items()):
            manager = self.page.client.controllers(space)
            known = self._known[space] = {name: manager.type_parameter(name) for name in manager.known()}
            known |= dict.fromkeys(_names(loaded), "")
            with self.gui.add_folder(space, expand_by_default=not number or space in self._used):
                self._tables[space] = self.gui.add_html("")
                for name in known:
                    buttons = self._buttons[space, name] = self.gui.add_button_group(name, tuple(_ACTIONS))
                    self.page.acting(buttons, partial(self._act, space, name))
                if known:
                    both = [self.gui.add_dropdown(label, (_NOTHING,)) for label in (_STOP, _START)]
                    self._dropdowns[space, _STOP], self._dropdowns[space, _START] = both
                    button = self.gui.add_button("Switch", hint="stop and start in one cycle")
                    self.page.acting(button, partial(self._switch, space, both))
                else:
                    self.gui.add_markdown("no controllers yet: `slidectl controller config FILE.yaml`")
        if not self._tables:
            self.gui.add_markdown("no robot with controllers: `slidectl spawn slider`")
        self.refresh(world)
        for key, dropdown in self._dropdowns.items():
            if self._chosen.get(key) in dropdown.options:
                dropdown.value = self._chosen[key]

    def refresh(self, world: WorldState) -> None:
        for space, table in self._tables.items():
            loaded = world.controllers.get(space, [])
            states = {one["name"]: one["state"] for one in loaded}
            others = {name: type for name, type in self._known[space].items() if name not in states}
            table.content = html_table(
                ("controller", "state", "type", "claims"),
                [(one["name"], one["state"], one["type"], claimed_text(one["claimed_resources"])) for one in loaded]
                + [(name, UNLOADED, type, "") for name, type in others.items()],
            )
            running = {name for name, state in states.items() if state in STARTED}
            for name in self._known[space]:
                idle = ("start", "unload") if name in states else ("load", "load and start")
                offer(self._buttons[space, name], ("stop",) if name in running else idle)
            if states or others:
                offer(self._dropdowns[space, _STOP], (_NOTHING, *sorted(running)))
                offer(self._dropdowns[space, _START], (_NOTHING, *sorted(states.keys() - running)))

    def leave(self) -> None:
        self._chosen |= {key: dropdown.value for key, dropdown in self._dropdowns.items()}
        for elements in (self._tables, self._buttons, self._dropdowns):
            elements.clear()

    def _manager(self, space: str) -> Manager:
        self._used.add(space)
        self.page.look_again()
        return Manager(self.page.client, space, warn=lambda text: self.page.notify(space, text, "yellow"))

    def _act(self, space: str, name: str, action: str) -> None:
        _ACTIONS[action](self._manager(space), name)

    def _switch(self, space: str, both: Sequence[Any], _: object) -> None:
        stop, start = ([] if dropdown.value == _NOTHING else [dropdown.value] for dropdown in both)
        if not stop and not start:
            raise UsageError("nothing to switch", "choose what to stop, what to start, or both")
        manager = self._manager(space)
        manager.switch(start, stop)
        manager.check_started(start)


def _names(controllers: Sequence[ControllerStateMsg]) -> list[str]:
    return [one["name"] for one in controllers]
