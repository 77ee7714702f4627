"""The data of `slidectl top`: state, controllers, joints, topics with rates, and the last log lines.

It polls a daemon and stores the newest answers. Rates are in simulated time.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from slidectl import msgs, names
from slidectl.client.manager import RUNNING, Manager
from slidectl.client.rate_meter import RateMeter
from slidectl.errors import Refused
from slidectl.extensions.viewing.graph_drawing import read_graph
from slidectl.msgs.schema import nanoseconds

if TYPE_CHECKING:
    from slidectl.client import Client
    from slidectl.msgs.typed import ControllerStateMsg

Record = dict[str, Any]

_PATIENCE_S = 2.0
_GRAPH_EVERY = 4
"""Refreshes between two reads of the graph, which take one call per node."""
_RATE_WINDOW_NS = 5 * 10**9
_LOG_BYTES = 8192
_LOG_LINE = re.compile(r"\d{4}-\d\d-\d\d [\d:.]+ (?P<level>[a-z]+) +(?:\[(?P<time>\d+\.\d{3})\] )?(?P<message>.*)")
_UNMEASURED = {
    "rosgraph_msgs/Clock", "gazebo_msgs/LinkStates", "gazebo_msgs/ModelStates",
    "sensor_msgs/CameraInfo", "sensor_msgs/Image", "sensor_msgs/LaserScan", "tf2_msgs/TFMessage",
}  # fmt: skip
"""Types whose rate is not measured: frequent without a count, or produced at a cost only for subscribers."""


class WorldMonitor:
    """The world of a daemon, as of the last `refresh`.

    Attributes:
        status: the answer of /slidectl/status; times in s.
        controllers: manager, name (in full), state, type, claims (joints).
        joints: name (in full), position, velocity, effort (SI units), set_point (None if no controller publishes it).
        topics: topic, type, rate (Hz; None if it is not measured, or fewer than two messages came).
        log: time (simulated, s; None where the line has none), level, message, line (in full, with the date); the last
            ones of the daemon's log.
    """

    def __init__(self, client: Client, period_s: float) -> None:
        self.client = client
        self.status: Record = {}
        self.controllers: list[Record] = []
        self.joints: list[Record] = []
        self.topics: list[Record] = []
        self.log: list[Record] = []
        self._throttle_ms = round(1000 * period_s)
        self._refreshes = 0
        self._followed: dict[str, FollowedTopic] = {}

    def refresh(self) -> None:
        """Read the state again. Raises NoDaemon, and TimedOut if the daemon does not answer within 2 s."""
        client = self.client
        calls = [client.call_async(f"/slidectl/{service}") for service in ("status", "list_robots")]
        self.status, answer = (client.answer(call, timeout=_PATIENCE_S) for call in calls)
        robots = sorted(answer["robots"], key=lambda robot: str(robot["name"]))
        spaces = [robot["namespace"] for robot in robots if robot["kind"] == "robot"]
        managers = [Manager(client, space, limit_s=_PATIENCE_S) for space in spaces]
        asked = {manager: manager.ask_for_controllers() for manager in managers}
        self.controllers = []
        for manager, call in asked.items():
            with suppress(Refused):  # the robot has just been deleted
                self.controllers += (_controller(manager.namespace, one) for one in manager.controllers(call))
        if self._refreshes % _GRAPH_EVERY == 0:
            self._follow_topics()
        self._refreshes += 1
        now_ns = round(self.status["time"] * 1e9)
        for topic in self.topics:
            followed = self._followed.get(topic["topic"])
            topic["rate"] = followed.rate(now_ns) if followed else None
        set_points = self._set_points()
        self.joints = [
            {
                "name": (full := names.join(robot["namespace"], joint["name"])),
                **{key: joint[key] for key in ("position", "velocity", "effort")},
                "set_point": set_points.get(full),
            }
            for robot in robots
            for joint in robot["joints"]
            if joint["position"] is not None
        ]
        self.log = _last_lines(self.status["log"], f" answers on {client.paths.socket_text}")

    def _follow_topics(self) -> None:
        """Subscribe only topics with a publisher: the own subscription would keep other topics in existence."""
        found = read_graph(self.client, timeout=_PATIENCE_S).topics
        for gone in self._followed.keys() - {name for name, use in found.items() if use.publishers}:
            self._followed.pop(gone).subscription.close()
        for name, use in found.items():
            if use.publishers and use.type not in _UNMEASURED and name not in self._followed:
                counted = any(field.name == "header" for field in msgs.fields(use.type))
                self._followed[name] = FollowedTopic(self.client, name, self._throttle_ms if counted else 0, counted)
        self.topics = [{"topic": name, "type": use.type} for name, use in found.items()]

    def _set_points(self) -> dict[str, float]:
        """Joint's full name -> set point, from the topics with the states of the running controllers."""
        found: dict[str, float] = {}
        for controller in self.controllers:
            topics = [f"{controller['name']}/{name}" for name in ("state", "controller_state")]
            followed = next((self._followed[topic] for topic in topics if topic in self._followed), None)
            if followed is None or controller["state"] not in RUNNING:
                continue
            joints, values = controller["claims"], []
            message = followed.message
            if "desired" in message:  # control_msgs/JointTrajectoryControllerState
                joints, values = message["joint_names"], message["desired"]["positions"]
            elif "reference" in message and "joint_names" in message:  # slidectl/JointTrajectoryControllerState
                joints, values = message["joint_names"], message["reference"]["positions"]
            elif "set_point" in message:  # control_msgs/JointControllerState
                values = [message["set_point"]]
            if len(joints) == len(values):
                found |= {names.join(controller["manager"], joint): v for joint, v in zip(joints, values, strict=True)}
        return found


class FollowedTopic:
    """The last message of a topic, and the rate.

    A header holds the daemon's count of messages, so few messages are enough; other messages are counted one by one.
    """

    def __init__(self, client: Client, topic: str, throttle_ms: int, is_counted: bool) -> None:
        """`is_counted`: the messages have a header."""
        self.message: Record = {}
        """Empty before the first message."""
        self._meter = RateMeter(span_ns=_RATE_WINDOW_NS)
        self._is_counted = is_counted
        self._looks = 0
        """Calls of `rate` since the last message."""
        self.subscription = client.subscribe(topic, throttle_rate=throttle_ms, take=self._take, wait=False)

    def _take(self, published: Record) -> None:
        self.message = published["msg"]
        count = self.message["header"]["seq"] if self._is_counted else None
        self._meter.add(nanoseconds(published["time"]), count)
        self._looks = 0

    def rate(self, now_ns: int) -> float | None:
        """The rate in Hz over the last seconds, or the last two messages; None while unknown.

        0 when no message came for longer than both, and since the call before the last one: wall time passes between
        calls, and in fast worlds much simulated time.
        """
        self._looks += 1
        return 0.0 if self._looks > 2 and self._meter.is_silent(now_ns) else self._meter.rate


def _controller(space: str, listed: ControllerStateMsg) -> Record:
    claims = dict.fromkeys(joint for claim in listed["claimed_resources"] for joint in claim["resources"])
    name = names.join(space, listed["name"])
    return {"manager": space, "name": name, "state": listed["state"], "type": listed["type"], "claims": list(claims)}


def _last_lines(log: str, begin: str) -> list[Record]:
    """The last lines of a log file, which may not exist. `begin` is the end of a daemon's first line in it."""
    with suppress(OSError), open(log, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _LOG_BYTES))
        lines = file.read().decode("utf-8", "replace").splitlines()
        lines = lines[size > _LOG_BYTES :]
        first = max((number for number, line in enumerate(lines) if line.endswith(begin)), default=0)
        return [log_record(line) for line in lines[first:]]
    return []


def log_record(line: str) -> Record:
    """A line of the log in parts. A line of another form, as of a traceback, is a message."""
    found = _LOG_LINE.fullmatch(line)
    time, level, message = ("", "", line) if found is None else found.group("time", "level", "message")
    return {"time": float(time) if time else None, "level": level, "message": message, "line": line}
