"""Keyboard control of a base (after teleop_twist_keyboard) and of a joint, as messages for their command topics.

A driver takes keys and makes messages. It knows no terminal and no wall time.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

from slidectl import names
from slidectl.client.manager import RUNNING
from slidectl.errors import Refused
from slidectl.msgs.schema import nanoseconds

if TYPE_CHECKING:
    from slidectl.client import Client
    from slidectl.msgs.typed import JointInfoMsg, RobotInfoMsg

Message = dict[str, Any]

TWIST = "geometry_msgs/Twist"
_STATE_EVERY_MS = 50
_DIRECTIONS = {
    "u": (1, 0, 0, 1), "i": (1, 0, 0, 0), "o": (1, 0, 0, -1), "j": (0, 0, 0, 1), "l": (0, 0, 0, -1),
    "m": (-1, 0, 0, -1), ",": (-1, 0, 0, 0), ".": (-1, 0, 0, 1),
    "U": (1, 1, 0, 0), "I": (1, 0, 0, 0), "O": (1, -1, 0, 0), "J": (0, 1, 0, 0), "L": (0, -1, 0, 0),
    "M": (-1, 1, 0, 0), "<": (-1, 0, 0, 0), ">": (-1, -1, 0, 0), "t": (0, 0, 1, 0), "b": (0, 0, -1, 0),
    "up": (1, 0, 0, 0), "down": (-1, 0, 0, 0), "left": (0, 0, 0, 1), "right": (0, 0, 0, -1),
}  # fmt: skip
"""Key -> x, y, z and turn."""
_STILL = (0, 0, 0, 0)
_FACTORS = {"q": (1.1, 1.1), "z": (0.9, 0.9), "w": (1.1, 1.0), "x": (0.9, 1.0), "e": (1.0, 1.1), "c": (1.0, 0.9)}
"""Key -> factors of the speed and the turning speed."""
_POSITION, _VELOCITY, _EFFORT = "JointPositionController", "JointVelocityController", "JointEffortController"
_ARROWS = {"up": 1, "right": 1, "down": -1, "left": -1}


class BaseDriver:
    """Makes twists for a base, in m/s and rad/s. `topic` is the command topic, `help` describes the keys."""

    help = """\
   u    i    o        i and , drive, j and l turn, the others do both; arrow keys, too
   j    k    l        with shift it moves sideways; t and b: up and down
   m    ,    .        it stops when the key is let go; k and space: at once
q/z both speeds   w/x speed   e/c turning speed: by 10 %   Ctrl-C ends it"""

    def __init__(self, topic: str, speed: float, turn: float) -> None:
        self.topic = topic
        self._speed, self._turn = speed, turn
        self._direction = _STILL

    def press(self, key: str) -> bool:
        """Process a key press. Returns True while it moves something; a key without a function stops."""
        if key in _FACTORS:
            self._speed, self._turn = self._speed * _FACTORS[key][0], self._turn * _FACTORS[key][1]
            return any(self._direction)
        self._direction = _DIRECTIONS.get(key, _STILL)
        return any(self._direction)

    def stop(self) -> None:
        """Stop: the key was released."""
        self._direction = _STILL

    def message(self) -> Message | None:
        """The message to publish; None while it is unknown."""
        x, y, z, turn = self._direction
        linear = {"x": x * self._speed, "y": y * self._speed, "z": z * self._speed}
        return {"linear": linear, "angular": {"x": 0.0, "y": 0.0, "z": turn * self._turn}}

    def text(self) -> str:
        """The speeds and the motion in one line."""
        x, y, z, turn = self._direction
        return f"speed {self._speed:.3g} m/s, turn {self._turn:.3g} rad/s: x {x} y {y} z {z} turn {turn}"


class JointDriver:
    """Makes commands for the controller that moves one joint alone: a moving set point, a velocity, or an effort.

    Raises:
        UnknownName, AmbiguousName: no such joint. Refused: no running controller takes commands for it alone.
    """

    help = """\
up, right   forwards           down, left   backwards
q/z         speed by 10 %      Ctrl-C ends it
It stops when the key is let go; any other key stops it at once."""

    def __init__(self, client: Client, joint: str, speed: float | None, namespace: str = "/") -> None:
        """`speed` is in m/s or rad/s, for an effort controller in N or N m; None for a default."""
        joints = _joints(client)
        full = names.resolve(joint, joints, kind="joint", namespace=namespace)
        robot, self._joint = joints[full]
        name, self._kind = _controller_of(client, robot, self._joint["name"])
        controller = names.join(robot["namespace"], name)
        self.topic = names.join(controller, "command")
        length = "m" if self._joint["type"] == "prismatic" else "rad"
        is_effort = self._kind == _EFFORT
        self._unit = ("N" if length == "m" else "N m") if is_effort else f"{length}/s"
        self._speed = (1.0 if is_effort else 0.1 if length == "m" else 0.5) if speed is None else speed
        self._direction = 0
        self._client, self._full = client, full
        self._set_point: float | None = None
        """None before the first motion, and after the start of a motion until the next state message."""
        self._time_ns = 0
        """The simulated time of the set point."""
        self._has_state = False
        if self._kind == _POSITION:
            with suppress(Refused):  # not all controllers publish a state
                client.subscribe(f"{controller}/state", throttle_rate=_STATE_EVERY_MS, take=self._take)
                self._has_state = True

    def press(self, key: str) -> bool:
        if key in ("q", "z"):
            self._speed *= _FACTORS[key][0]
            return bool(self._direction)
        was_still, self._direction = not self._direction, _ARROWS.get(key, 0)
        if was_still and self._direction and self._kind == _POSITION:
            self._begin()
        return bool(self._direction)

    def _begin(self) -> None:
        """Read the set point, which others may have moved. Without a state topic, use the joint position."""
        self._time_ns, self._set_point = self._now_ns(), None
        if not self._has_state:
            found = _joints(self._client).get(self._full)
            self._set_point = found[1]["position"] if found else None

    def _take(self, published: Message) -> None:
        if self._set_point is None and nanoseconds(published["time"]) > self._time_ns:
            self._set_point = float(published["msg"]["set_point"])

    def _now_ns(self) -> int:
        return nanoseconds(self._client.call("/rosapi/get_time")["time"])

    def stop(self) -> None:
        self._direction = 0

    def message(self) -> Message | None:
        value = self._direction * self._speed
        if self._kind == _POSITION:
            if self._set_point is None:
                return None
            if self._direction:
                now_ns = self._now_ns()
                if now_ns == self._time_ns:  # the world is paused
                    return None
                value = self._set_point + value * max(0, now_ns - self._time_ns) * 1e-9
                if self._joint["lower"] is not None:
                    value = max(value, self._joint["lower"])
                if self._joint["upper"] is not None:
                    value = min(value, self._joint["upper"])
                self._set_point, self._time_ns = value, now_ns
            value = self._set_point
        return {"data": value}

    def text(self) -> str:
        doing = {1: "forwards", -1: "backwards", 0: "stopped"}[self._direction]
        place = "" if self._set_point is None else f", set point {self._set_point:.3f} {self._unit.removesuffix('/s')}"
        if self._direction and self._kind == _POSITION and not place:
            place = ", waits for the set point"
        return f"{self._joint['name']}: {self._speed:.3g} {self._unit}{place}, {doing}"


Driver = BaseDriver | JointDriver


def _joints(client: Client) -> dict[str, tuple[RobotInfoMsg, JointInfoMsg]]:
    """Full name of each moving joint -> robot and joint (slidectl/RobotInfo, slidectl/JointInfo)."""
    return {
        names.join(robot["namespace"], joint["name"]): (robot, joint)
        for robot in client.robots()
        for joint in robot["joints"]
        if joint["position"] is not None
    }


def _controller_of(client: Client, robot: RobotInfoMsg, joint: str) -> tuple[str, str]:
    """Name and kind of the running controller that moves this joint alone. Raises Refused."""
    listed = client.controllers(robot["namespace"]).controllers() if robot["kind"] == "robot" else []
    users = []
    for controller in listed:
        claimed = {one for claim in controller["claimed_resources"] for one in claim["resources"]}
        kind = controller["type"].rpartition("/")[2]
        if joint in claimed:
            users.append(f"{controller['name']} ({controller['type']}, {controller['state']})")
        if claimed == {joint} and controller["state"] in RUNNING and kind in (_POSITION, _VELOCITY, _EFFORT):
            return controller["name"], kind
    raise Refused(
        f"no running controller takes commands for {joint} alone",
        f"it takes one of {_POSITION}, {_VELOCITY}, {_EFFORT}; there is: {', '.join(users) or 'none'}",
    )
