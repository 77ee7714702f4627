"""Sliders for joint commands, and a table of joint states (joint_state_publisher_gui, rqt_publisher)."""

from __future__ import annotations

import math
import time
from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from viser import GuiHtmlHandle

from slidectl import names
from slidectl.description.robot import MOVING
from slidectl.extensions.viewing.page.page import Message, Page, Panel, WorldState, html_table

if TYPE_CHECKING:
    from slidectl.msgs.typed import RobotInfoMsg

_SCALAR, _ARRAY = "std_msgs/Float64", "std_msgs/Float64MultiArray"
_QUANTITIES = ("Position", "Velocity", "Effort")
_UNITS = {"Position": ("rad", "m"), "Velocity": ("rad/s", "m/s"), "Effort": ("N m", "N")}
"""Units for revolute and for prismatic joints."""
_SPANS = {"Position": (2 * math.pi, 1.0), "Velocity": (2 * math.pi, 1.0), "Effort": (10.0, 10.0)}
"""Half the range of a slider for joints without limits, for revolute and for prismatic joints."""
_FOLLOW_MS = 200
_SETTLE_S = 1.0


class _Drive(NamedTuple):
    """A running controller with a command topic of one or more numbers."""

    controller: str
    topic: str
    quantity: str
    joints: tuple[str, ...]
    """The claimed joints."""
    is_array: bool


class JointsPanel(Panel):
    """A slider for each command, and a table of all joints."""

    title = "Joints"

    def __init__(self, page: Page) -> None:
        super().__init__(page)
        self._commands: dict[str, list[float]] = {}
        """Command topic -> values of its sliders."""
        self._tables: dict[str, GuiHtmlHandle] = {}
        """Robot -> its table."""
        self._settled: dict[str, float] = {}
        """Command topic -> wall time until which its sliders ignore commands from others, after a user moved one."""

    def shape(self, world: WorldState) -> Hashable:
        limits = ("name", "type", "lower", "upper", "max_velocity", "max_effort")
        return tuple(
            (robot["name"], tuple(_drives(robot, world)), *(tuple(joint[key] for key in limits) for joint in joints))
            for robot, joints in _robots(world)
        )

    def build(self, world: WorldState) -> None:
        commands, self._commands, self._tables = self._commands, {}, {}
        for number, (robot, joints) in enumerate(_robots(world)):
            with self.gui.add_folder(robot["name"], expand_by_default=not number):
                for drive in _drives(robot, world):
                    about = {joint["name"]: joint for joint in joints}
                    sliders = self._add_sliders(drive, about, commands.get(drive.topic))
                    self._follow(drive, sliders, world.topics)
                self._tables[robot["name"]] = self.gui.add_html("")
        if not self._tables:
            self.gui.add_markdown("no joints: `slidectl spawn slider`")
        self.refresh(world)

    def _add_sliders(
        self, drive: _Drive, joints: Mapping[str, Mapping[str, Any]], before: list[float] | None
    ) -> list[Any]:
        """Add the sliders of a controller; `before` are their earlier values. Returns them."""
        sliders = []
        driven = drive.joints
        if drive.is_array:
            driven = tuple(map(str, self.page.client.params.get(f"{names.parent(drive.topic)}/joints", ())))
        now = self._commands[drive.topic] = []
        for index, name in enumerate(driven):
            joint = joints.get(name, {"type": "", "position": None})
            low, high = bounds(joint, drive.quantity)
            value = before[index] if before is not None and index < len(before) else None
            if value is None:
                value = joint["position"] if drive.quantity == "Position" and joint["position"] is not None else 0.0
            now.append(placed(value, low, high))
            unit = _UNITS[drive.quantity][joint["type"] == "prismatic"]
            label = f"{drive.controller}: {name}" if drive.is_array else drive.controller
            slider = self.gui.add_slider(
                label, low, high, step_of(low, high), now[index], hint=f"{drive.topic}: {name}, {unit}"
            )
            self.page.acting(slider, partial(self._send, drive, index), coalesce=True)
            sliders.append(slider)
        return sliders

    def _follow(self, drive: _Drive, sliders: list[Any], topics: dict[str, str]) -> None:
        """Update the sliders from others' commands: from the published set point, else the command topic."""
        state = names.join(names.parent(drive.topic), "state")
        is_told = not drive.is_array and topics.get(state) == "control_msgs/JointControllerState"
        commands = self._commands[drive.topic]

        def take(published: Message) -> None:
            if time.monotonic() < self._settled.get(drive.topic, 0.0):
                return
            message = published["msg"]
            values = message["data"] if drive.is_array else [message["set_point" if is_told else "data"]]
            for index, (slider, value) in enumerate(zip(sliders, values, strict=False)):
                if value is not None and math.isfinite(value):
                    commands[index] = value
                    slider.value = placed(value, slider.min, slider.max)

        topic = state if is_told else drive.topic
        self.subscribe(topic, queue_length=1, throttle_rate=_FOLLOW_MS, take=take, wait=False)

    def _send(self, drive: _Drive, index: int, value: float) -> None:
        values = self._commands.get(drive.topic)
        if values is not None and index < len(values):  # the panel may have been rebuilt
            values[index] = value
            self._settled[drive.topic] = time.monotonic() + _SETTLE_S
            self.page.client.deliver(drive.topic, {"data": values if drive.is_array else value})

    def refresh(self, world: WorldState) -> None:  # noqa: ARG002
        if not self._tables:
            return
        answer = self.page.client.call("/slidectl/joint_states")
        rows: dict[str, list[tuple[object, ...]]] = {name: [] for name in self._tables}
        for full, *state in zip(*(answer[key] for key in ("joints", "position", "velocity", "effort")), strict=True):
            robot, _, joint = full.partition("::")
            if robot in rows:
                rows[robot].append((joint, *state))
        for robot, table in self._tables.items():
            table.content = html_table(("joint", "position", "velocity", "effort"), rows[robot])

    def leave(self) -> None:
        super().leave()
        self._tables = {}


def _robots(world: WorldState) -> Iterator[tuple[RobotInfoMsg, Sequence[Mapping[str, Any]]]]:
    """Each robot with moving joints, and these joints."""
    for robot in world.robots:
        if joints := [joint for joint in robot["joints"] if joint["type"] in MOVING]:
            yield robot, joints


def _drives(robot: RobotInfoMsg, world: WorldState) -> Iterator[_Drive]:
    space = robot["namespace"]
    for one in world.controllers.get(space, ()) if robot["kind"] == "robot" else ():
        topic = names.join(space, f"{one['name']}/command")
        claims = [claim for claim in one["claimed_resources"] if claim["resources"]]
        kind = world.topics.get(topic)
        if one["state"] == "running" and claims and kind in (_SCALAR, _ARRAY):
            told = (one["type"].rpartition("/")[2], claims[0]["hardware_interface"])
            quantity = next((word for text in told for word in _QUANTITIES if word in text), "Position")
            joints = tuple(claims[0]["resources"])
            yield _Drive(one["name"], topic, quantity, joints[:1] if kind == _SCALAR else joints, kind == _ARRAY)


def bounds(joint: Mapping[str, Any], quantity: str) -> tuple[float, float]:
    """The range of commands for a slidectl/JointInfo: its limits, or a default range."""
    if quantity == "Position":
        low, high = joint.get("lower"), joint.get("upper")
    else:
        high = joint.get(f"max_{quantity.lower()}")
        low = -high if high is not None else None
    if low is not None and high is not None and math.isfinite(high - low) and low < high:
        return float(low), float(high)
    span = _SPANS[quantity][joint["type"] == "prismatic"]
    return -span, span


def placed(value: float, low: float, high: float) -> float:
    """The value rounded and limited to a slider's range."""
    return min(max(round(value, 4), low), high)


def step_of(low: float, high: float) -> float:
    """The step of a slider: a power of ten, at most a thousandth of the range."""
    return float(min(0.01, 10.0 ** math.floor(math.log10((high - low) / 1000))))
