"""A daemon with a node beside it that publishes, subscribes and serves what the recorded sessions of the ROS tools had.

The node's values stand still, so that what is printed can be compared to the letter.
"""

from __future__ import annotations

import select
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from command_line import ROOT, CommandLine, Done
from daemon_fixture import Runtime, running_daemon, send

from slidectl.client import Client

STAMP = {"secs": 1795219417, "nsecs": 52549076}
PERIOD_S = 0.02

POSITION = {"x": 1.25, "y": 0.0, "z": 0.0}
IDENTITY = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
TOPICS: dict[str, tuple[str, dict[str, Any]]] = {
    "/slide/joint_states": (
        "sensor_msgs/JointState",
        {
            "header": {"stamp": STAMP, "frame_id": ""},
            "name": ["slide", "latch"],
            "position": [-0.009203153466526904, 0.25],
            "velocity": [-0.49991529479129915, 0.0],
            "effort": [1.5, -2.0],
        },
    ),
    "/slide/position": ("std_msgs/Float64", {"data": 0.0}),
    "/slide/status": ("std_msgs/String", {"data": 'ok: "moving"'}),
    "/slide/forces": (
        "std_msgs/Float64MultiArray",
        {
            "layout": {"dim": [{"label": "f", "size": 3, "stride": 3}], "data_offset": 0},
            "data": [1.0, -2.5, 1e-9],
        },
    ),
    "/slide/poses": (
        "geometry_msgs/PoseArray",
        {
            "header": {"stamp": STAMP, "frame_id": "base"},
            "poses": [
                {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": IDENTITY},
                {"position": {"x": 4.0, "y": 5.0, "z": 6.0}, "orientation": IDENTITY},
            ],
        },
    ),
    "/slide/pose": (
        "geometry_msgs/PoseStamped",
        {"header": {"stamp": STAMP, "frame_id": "base"}, "pose": {"position": POSITION, "orientation": IDENTITY}},
    ),
    "/slide/raw": ("std_msgs/UInt8MultiArray", {"data": [0, 65, 255]}),
}
DESCRIPTION = '<robot name="slide">\n  <link name="base"/>\n</robot>'
SINKS = {
    "/slide/command": "std_msgs/Float64", "/f": "std_msgs/Float64", "/s": "std_msgs/String", "/e": "std_msgs/Empty",
    "/pt": "geometry_msgs/Point", "/tw": "geometry_msgs/Twist", "/b": "std_msgs/Bool", "/i": "std_msgs/Int32",
    "/u8": "std_msgs/UInt8", "/u8a": "std_msgs/UInt8MultiArray", "/j": "sensor_msgs/JointState",
    "/p": "geometry_msgs/PoseStamped", "/h": "std_msgs/Header", "/tm": "std_msgs/Time",
    "/a": "std_msgs/Float64MultiArray",
}  # fmt: skip


class ServiceError(Exception):
    """What a service of the node fails with."""


def _boom(_request: dict[str, Any]) -> dict[str, Any]:
    raise ServiceError("motor is on fire")


def _answer(success: bool, message: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda _request: {"success": success, "message": message}


LOGGERS = [{"name": "rosgraph.network", "level": "INFO"}, {"name": "rospy", "level": "DEBUG"}]
SERVICES: dict[str, tuple[str, Callable[[dict[str, Any]], dict[str, Any]]]] = {
    "/slide/reset": ("std_srvs/Trigger", _answer(True, "reset done")),
    "/slide/refuse": ("std_srvs/Trigger", _answer(False, "limit switch is active")),
    "/slide/boom": ("std_srvs/Trigger", _boom),
    "/slide/stop": ("std_srvs/Empty", lambda _request: {}),
    "/slide/enable": (
        "std_srvs/SetBool",
        lambda request: {"success": request["data"], "message": "enabled" if request["data"] else "disabled"},
    ),
    "/sim/get_loggers": ("roscpp/GetLoggers", lambda _request: {"loggers": LOGGERS}),
    "/sim/set_logger_level": ("roscpp/SetLoggerLevel", lambda _request: {}),
}


class SlideNode:
    """The node: a thread with a connection of its own. `name` is what the daemon calls it."""

    def __init__(self, daemon: Runtime) -> None:
        self._client = daemon.client()
        self._done = threading.Event()
        before = set(self._client.call("/rosapi/nodes")["nodes"])
        for topic, (kind, _) in TOPICS.items():
            self._client.advertise(topic, kind)
        self._client.publish("/slide/description", {"data": DESCRIPTION}, "std_msgs/String", latch=True)
        self._client.subscribe("/slide/command", "std_msgs/Float64")
        for service, (kind, _) in SERVICES.items():
            send(self._client, op="advertise_service", service=service, type=kind)
        (self.name,) = set(self._client.call("/rosapi/nodes")["nodes"]) - before
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._done.set()
        self._thread.join()
        self._client.close()

    def _run(self) -> None:
        while not self._done.is_set():
            for topic, (_, message) in TOPICS.items():
                self._client.publish(topic, message)
            self._serve()

    def _serve(self) -> None:
        """Answer what comes in for a while."""
        select.select([self._client], [], [], PERIOD_S)
        for wire in self._client.events(0.0):
            if wire.get("op") == "call_service":
                answer: dict[str, Any] = {"result": True}
                try:
                    answer["values"] = SERVICES[wire["service"]][1](wire["args"])
                except ServiceError as error:
                    answer = {"result": False, "values": str(error)}
                send(self._client, op="service_response", id=wire["id"], service=wire["service"], **answer)


class SlideWorld:
    """The daemon, the node, and the ROS commands typed at them."""

    def __init__(self, daemon: Runtime, node: SlideNode, client: Client) -> None:
        self.daemon = daemon
        self.node = node
        self.client = client
        self.shell = Shell(CommandLine(daemon.folder))
        self.uri = f"unix://{daemon.paths.socket_text}"

    def __call__(self, line: str, stdin: str = "", cwd: Path = ROOT, **environment: str) -> Done:
        """Type a line in bash after `eval "$(slidectl ros-commands)"`."""
        return self.shell.run(line, stdin, cwd, **environment)


class Shell:
    """bash with the ROS commands defined, in the runtime folder of a command line."""

    def __init__(self, slidectl: CommandLine) -> None:
        self.slidectl = slidectl
        self.functions = slidectl.ok("ros-commands", SHELL="/bin/bash")

    def run(self, line: str, stdin: str = "", cwd: Path = ROOT, **environment: str) -> Done:
        """The line, with its standard streams as pipes."""
        return subprocess.run(
            ["bash", "-c", f"{self.functions}\n{line}"],
            input=stdin,
            capture_output=True,
            text=True,
            timeout=60,
            cwd=cwd,
            env={**self.slidectl.environment, **environment},
            check=False,
        )

    def start(self, line: str) -> subprocess.Popen[str]:
        """The same, without waiting for its end."""
        return subprocess.Popen(
            ["bash", "-c", f"{self.functions}\n{line}"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.slidectl.environment,
        )


@contextmanager
def slide_world() -> Iterator[SlideWorld]:
    """A world with the node in it, time running."""
    with running_daemon() as daemon, daemon.client() as client:
        node = SlideNode(daemon)
        try:
            yield SlideWorld(daemon, node, client)
        finally:
            node.close()


# --- recorded sessions ------------------------------------------------------------------------------------------------


class Session(NamedTuple):
    """A line, what it prints, and its exit code. `stdin` is what is piped into it."""

    line: str
    stdout: str = ""
    stderr: str = ""
    code: int = 0
    stdin: str = ""


def usage(line: str, text: str, complaint: str) -> Session:
    """Wrong usage, as optparse says it."""
    tool = line.split()[0]
    return Session(line, "", f"Usage: {text}\n\n{tool}: error: {complaint}\n", 2)
