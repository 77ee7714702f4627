"""Simulation control: pause, step, speed, reset, save and load."""

from __future__ import annotations

from collections.abc import Hashable
from functools import partial
from typing import TYPE_CHECKING, Any

from slidectl.client import Client
from slidectl.errors import Refused
from slidectl.extensions.viewing.page.page import Page, Panel, WorldState

if TYPE_CHECKING:
    from slidectl.msgs.typed import StatusResponseMsg

_SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5", "10", "max")
_NONE = "none"


class SimulationPanel(Panel):
    """The functions of `slidectl sim`."""

    title = "Simulation"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._cycles = 1
        self._name = "here"
        self._stepping: tuple[Client, str] | None = None
        """The connection and the call id of the step in progress."""
        if not page.read_only:
            for label, key, action in (("Pause or resume", "space", self._toggle), ("Step", ".", self._step)):
                # viser's type of hotkeys lacks ".", but its browser part accepts it.
                command = self.gui.add_command(label, hotkey=key)  # type: ignore[arg-type]
                command.on_trigger(_triggered(page, action))

    def shape(self, world: WorldState) -> Hashable:  # noqa: ARG002
        return tuple(sorted(one["name"] for one in self.page.client.snapshots()))

    def build(self, world: WorldState) -> None:
        acting = self.page.acting
        self._state = self.gui.add_markdown(_text(world.status))
        self._pause = self.gui.add_button("")
        acting(self._pause, lambda _: self._toggle())
        cycles = self.gui.add_number("cycles of a step", self._cycles, min=1, max=1_000_000, step=1)
        acting(cycles, partial(setattr, self, "_cycles"))
        acting(self.gui.add_button("Step", hint="key: ."), lambda _: self._step())
        self._speed: Any = self.gui.add_dropdown("speed", _SPEEDS)
        self._seen_speed = ""
        acting(self._speed, self._set_speed)
        reset = self.gui.add_button_group("reset", ("robots", "robots and time"))
        acting(reset, self._reset)
        name = self.gui.add_text("snapshot", self._name)
        acting(name, partial(setattr, self, "_name"))
        acting(self.gui.add_button("Save"), lambda _: self._save())
        known = tuple(one["name"] for one in self.page.client.snapshots())
        self._snapshots: Any = self.gui.add_dropdown("load", (_NONE, *known))
        acting(self._snapshots, self._load)
        self.refresh(world)

    def refresh(self, world: WorldState) -> None:
        self._state.content = _text(world.status)
        is_still = world.status["paused"] and not self._stepping
        self._pause.label = "Resume (space)" if is_still else "Pause (space)"
        speed = f"{world.status['speed']:g}" if world.status["speed"] else "max"
        if speed != self._seen_speed:  # compared to the last seen speed: the dropdown may be newer than `world`
            self._seen_speed = speed
            self._speed.options = tuple(dict.fromkeys((*_SPEEDS, speed)))
            self._speed.value = speed

    def update(self) -> None:
        if self._stepping is None:
            return
        client, call = self._stepping
        if client is not self.page.client:  # that daemon has ended
            self._stepping = None
        elif client.is_answered(call):
            self._stepping = None
            self.page.look_again()
            answer = client.answer(call)
            if not answer["success"]:
                raise Refused(answer["message"])

    def _status(self) -> StatusResponseMsg:
        """The slidectl/Status. The answer of finished steps arrives before it and is processed."""
        status = self.page.client.call("/slidectl/status")
        self.page.attempt(self.update)
        return status

    def _toggle(self) -> None:
        paused = self._status()["paused"] and not self._stepping
        self.page.call("/gazebo/unpause_physics" if paused else "/gazebo/pause_physics")
        self.page.look_again()

    def _step(self) -> None:
        self._status()
        if self._stepping:
            raise Refused("the world is stepping", "Pause ends it")
        client = self.page.client
        self._stepping = client, client.call_async("/slidectl/step", {"cycles": self._cycles})

    def _set_speed(self, value: str) -> None:
        self.page.call("/slidectl/set_speed", {"speed": 0.0 if value == "max" else float(value)})

    def _reset(self, what: str) -> None:
        self.page.call("/gazebo/reset_world" if what == "robots" else "/gazebo/reset_simulation")

    def _save(self) -> None:
        at = self.page.client.save(self._name)
        self.page.notify(f"{self._name} saved at {at:.3f} s")
        self.page.look_again()

    def _load(self, name: str) -> None:
        self._snapshots.value = _NONE  # allows choosing the same one again
        if name != _NONE:
            at = self.page.client.load(name)
            self.page.notify(f"{name} loaded: it is {at:.3f} s")


def _triggered(page: Page, action: Any) -> Any:
    async def triggered(_: Any) -> None:
        page.do(action)

    return triggered


def _text(status: StatusResponseMsg) -> str:
    return f"time **{status['time']:.3f} s**, cycle {status['cycles']}, {status['timestep']:g} s each"
