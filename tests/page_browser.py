"""A browser for the tests of the page: it speaks viser's protocol for the scene, and rosbridge as the panels do."""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any
from urllib.parse import urljoin

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from waiting import DEADLINE_S
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

sys.path.append(str(Path(__file__).parent / "cli"))
from command_line import CommandLine


def spawn_slider(command: CommandLine) -> None:
    """With its controller."""
    command.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", "joint_state_controller",
               "joint1_position_controller")  # fmt: skip


class PageBrowser:
    """One browser of a page: its connection to viser, and one of its panels, which speaks rosbridge.

    It takes in what the page sends whenever something is asked of it.
    """

    def __init__(self, url: str, **options: Any) -> None:
        """`url` is that which `slidectl view` prints; `options` are those of websockets' `connect`."""
        address = url.replace("http", "ws", 1)
        self._socket: ClientConnection = connect(
            address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, ping_interval=None, **options
        )
        self.panels: ClientConnection = connect(
            urljoin(address, "/rosbridge"),
            max_size=None,
            ping_interval=None,
            additional_headers=options.get("additional_headers"),
        )
        self.nodes: dict[str, dict[str, Any]] = {}
        """Name in the scene -> the newest properties, `position` and `wxyz` among them."""
        self.looks_at = (0.0, 0.0, 0.0)
        """Where the page pointed the camera, m."""
        self.told: list[str] = []
        """What the page told all browsers."""
        self.newest: dict[str, dict[str, Any]] = {}
        """Topic -> the newest message that the panels have got."""
        self._answers: dict[str, dict[str, Any]] = {}
        self._serial = count(1)
        looks = [0.1759199, -0.33985114, -0.82047324, 0.4247082]  # from there at the origin
        camera = {"wxyz": looks, "position": [3, 3, 3], "fov": 1.0, "near": 0.01, "far": 1000.0}
        more = {"image_height": 600, "image_width": 800, "look_at": [0, 0, 0], "up_direction": [0, 0, 1]}
        self._send({"type": "ViewerCameraMessage", **camera, **more})

    def _send(self, message: dict[str, Any]) -> None:
        self.send(msgspec.msgpack.encode(message))

    def send(self, frame: bytes | str) -> None:
        """Send viser whatever it is."""
        self._socket.send(frame)

    # --- the scene ----------------------------------------------------------------------------------------------

    def take(self, seconds: float = 0.0) -> None:
        """Take in what has come, and what comes within so many seconds."""
        self._take_panels()
        end = time.monotonic() + seconds
        while True:
            try:
                frame = self._socket.recv(timeout=max(0.0, end - time.monotonic()))
            except TimeoutError:
                return
            assert isinstance(frame, bytes)
            size = int.from_bytes(frame[8:16], "little")
            told = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(frame[16 : 16 + size]))
            buffers, place = [], 16 + size
            for length in told["binaryBufferLengths"]:
                place += -place % 8
                buffers.append(frame[place : place + length])
                place += length
            for message in told["messages"]:
                self._take(_with_arrays(message, buffers))

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "RemoveSceneNodeMessage":
            name = message["name"]
            self.nodes = {key: node for key, node in self.nodes.items() if f"{key}/".find(f"{name}/") != 0}
        elif kind == "SetPositionMessage":
            self.nodes.setdefault(message["name"], {})["position"] = message["position"]
        elif kind == "SetCameraLookAtMessage":
            self.looks_at = message["look_at"]
        elif kind == "SetOrientationMessage":
            self.nodes.setdefault(message["name"], {})["wxyz"] = message["wxyz"]
        elif kind == "SetSceneNodeVisibilityMessage":
            self.nodes.setdefault(message["name"], {})["visible"] = message["visible"]
        elif kind == "SceneNodeUpdateMessage":
            self.nodes.get(message["name"], {}).update(message["updates"])
        elif "name" in message and "props" in message:
            self.nodes.setdefault(message["name"], {}).update(message["props"])

    def drag(self, node: str, phase: str, start: tuple[float, ...], end: tuple[float, ...]) -> None:
        """Shift and drag on something in the scene: `start`, `update` or `end`."""
        message = {"name": node, "phase": phase, "start_position": start, "end_position": end, "instance_index": None}
        more = {"start_screen_pos": (0.5, 0.5), "end_screen_pos": (0.6, 0.5), "button": "left", "modifier": "shift"}
        self._send({"type": "SceneNodeDragMessage", **message, **more})

    # --- the panels ---------------------------------------------------------------------------------------------

    def _take_panels(self, timeout: float = 0.0) -> None:
        while True:
            try:
                message = json.loads(self.panels.recv(timeout=timeout))
            except TimeoutError:
                return
            except ConnectionClosed:  # the daemon has gone
                return
            if message["op"] == "service_response":
                self._answers[message["id"]] = message
                return
            if message["op"] == "publish":
                self.newest[message["topic"]] = message["msg"]
            elif message["op"] == "status":
                self.told.append(message["msg"])

    def ask(self, service: str, args: dict[str, Any] | None = None) -> dict[str, Any]:
        """The response of a service, as the panels call it."""
        name = f"t{next(self._serial)}"
        self.panels.send(json.dumps({"op": "call_service", "id": name, "service": service, "args": args or {}}))
        deadline = time.monotonic() + DEADLINE_S
        while name not in self._answers:
            assert time.monotonic() < deadline, f"{service} does not answer"
            self._take_panels(0.1)
        return self._answers.pop(name)

    def call(self, service: str, /, **args: Any) -> dict[str, Any]:
        """The answer of a service, which does not fail."""
        response = self.ask(service, args)
        assert response["result"], response["values"]
        found: dict[str, Any] = response["values"]
        return found

    def page(self, what: str, /, **args: Any) -> dict[str, Any]:
        """The answer of a service of the page itself."""
        return self.call(f"/slidectl_page/{what}", **args)

    def refusal(self, what: str, /, **args: Any) -> str:
        """Why a service of the page is refused."""
        response = self.ask(f"/slidectl_page/{what}", args)
        assert response["result"] is False
        return str(response["values"])

    def wait_for(self, condition: Callable[[], Any], what: str = "it did not come true") -> Any:
        """What the condition gives when it is true; the page is listened to meanwhile."""
        deadline = time.monotonic() + DEADLINE_S
        while not (found := condition()):
            assert time.monotonic() < deadline, f"{what}; the page told: {self.told}"
            self.take(0.02)
        return found

    def close(self) -> None:
        self._socket.close()
        self.panels.close()

    def __enter__(self) -> PageBrowser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _with_arrays(value: Any, buffers: list[bytes]) -> Any:
    """What viser sent, with flat arrays of numpy where it refers to one of the buffers."""
    if isinstance(value, dict):
        if "__binary_index" in value:
            return np.frombuffer(buffers[value["__binary_index"]], dtype=value["dtype"])
        return {key: _with_arrays(one, buffers) for key, one in value.items()}
    return value


@contextmanager
def served_page(command: CommandLine, *words: str) -> Iterator[str]:
    """`slidectl view` in a process of its own, on a port that is free; gives the address that it prints."""
    process = command.start("view", "--no-open", "--port", "0", *words)
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        url = process.stdout.readline().strip()
        assert url.startswith("http://"), process.stderr.read()
        yield url
        assert process.poll() is None, f"the page ended: {process.stderr.read()}"
    finally:
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=60)
        assert (process.returncode, told) == (0, ""), f"exit code {process.returncode}: {told}"
