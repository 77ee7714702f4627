"""A browser for the tests of the page: it speaks viser's protocol, and knows the page's elements by their labels."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec.msgpack
import viser
import zstandard
from waiting import DEADLINE_S
from websockets.sync.client import ClientConnection, connect

sys.path.append(str(Path(__file__).parent / "cli"))
from command_line import CommandLine


def spawn_slider(command: CommandLine) -> None:
    """With its controller."""
    command.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", "joint_state_controller",
               "joint1_position_controller")  # fmt: skip


class PageBrowser:
    """One connection to a page. It takes in what the page sends whenever something is asked of it."""

    def __init__(self, url: str, **options: Any) -> None:
        """`url` is that which `slidectl view` prints; `options` are those of websockets' `connect`."""
        self._socket: ClientConnection = connect(
            url.replace("http", "ws", 1), subprotocols=[f"viser-v{viser.__version__}"], max_size=None, **options
        )
        self.elements: dict[str, dict[str, Any]] = {}
        """uuid -> the properties of a GUI element; `type`, `value` and `container` among them."""
        self.nodes: dict[str, dict[str, Any]] = {}
        """Name in the scene -> the newest properties, `position` and `wxyz` among them."""
        self.notifications: list[str] = []
        self.downloads: dict[str, bytes] = {}
        """File -> what came of it."""
        self._transfers: dict[str, str] = {}
        camera = {"wxyz": [1, 0, 0, 0], "position": [3, 3, 3], "fov": 1.0, "near": 0.01, "far": 1000.0}
        more = {"image_height": 600, "image_width": 800, "look_at": [0, 0, 0], "up_direction": [0, 0, 1]}
        self._send({"type": "ViewerCameraMessage", **camera, **more})

    def _send(self, message: dict[str, Any]) -> None:
        self.send(msgspec.msgpack.encode(message))

    def send(self, frame: bytes | str) -> None:
        """Whatever it is."""
        self._socket.send(frame)

    def take(self, seconds: float = 0.0) -> None:
        """Take in what has come, and what comes within so many seconds."""
        end = time.monotonic() + seconds
        while True:
            try:
                frame = self._socket.recv(timeout=max(0.0, end - time.monotonic()))
            except TimeoutError:
                return
            assert isinstance(frame, bytes)
            size = int.from_bytes(frame[8:16], "little")
            told = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(frame[16 : 16 + size]))
            for message in told["messages"]:
                self._take(message)

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "NotificationShowMessage":
            self.notifications.append(f"{message['props']['title']}\n{message['props']['body']}")
        elif kind == "FileTransferStartDownload":
            self._transfers[message["transfer_uuid"]] = message["filename"]
            self.downloads[message["filename"]] = b""
        elif kind == "FileTransferPart":
            self.downloads[self._transfers[message["transfer_uuid"]]] += message["content"]
        elif kind == "GuiRemoveMessage":
            self._forget(message["uuid"])
        elif kind == "GuiUpdateMessage":
            self.elements.get(message["uuid"], {}).update(message["updates"])
        elif kind == "RemoveSceneNodeMessage":
            name = message["name"]
            self.nodes = {key: node for key, node in self.nodes.items() if f"{key}/".find(f"{name}/") != 0}
        elif kind == "SetPositionMessage":
            self.nodes.setdefault(message["name"], {})["position"] = message["position"]
        elif kind == "SetOrientationMessage":
            self.nodes.setdefault(message["name"], {})["wxyz"] = message["wxyz"]
        elif kind == "SetSceneNodeVisibilityMessage":
            self.nodes.setdefault(message["name"], {})["visible"] = message["visible"]
        elif kind == "SceneNodeUpdateMessage":
            self.nodes.get(message["name"], {}).update(message["updates"])
        elif "uuid" in message and "props" in message:
            more = {"type": kind, "value": message.get("value"), "container": message.get("container_uuid")}
            self.elements[message["uuid"]] = {**message["props"], **more}
        elif "name" in message and "props" in message:
            self.nodes.setdefault(message["name"], {}).update(message["props"])

    def _forget(self, uuid: str) -> None:
        self.elements.pop(uuid, None)
        for child in [key for key, one in self.elements.items() if one["container"] == uuid]:
            self._forget(child)

    def find(self, label: str, kind: str = "") -> tuple[str, dict[str, Any]] | None:
        """The newest element with a label, or whose text has it, and that is of a kind: Button, Slider, ..."""
        for uuid, one in reversed(self.elements.items()):
            texts = (one.get("label"), one.get("_markdown"), one.get("content"))
            if f"Gui{kind}" in one["type"] and (texts[0] == label or any(label in (text or "") for text in texts[1:])):
                return uuid, one
        return None

    def wait_for(self, condition: Callable[[], Any], what: str = "it did not come true") -> Any:
        """What the condition gives when it is true; the page is listened to meanwhile."""
        deadline = time.monotonic() + DEADLINE_S
        while not (found := condition()):
            assert time.monotonic() < deadline, f"{what}; the page told: {self.notifications}"
            self.take(0.02)
        return found

    def element(self, label: str, kind: str = "") -> dict[str, Any]:
        """The properties of an element, which may still be to come."""
        found: dict[str, Any] = self.wait_for(lambda: self.find(label, kind), f"no element {label!r}")[1]
        return found

    def set(self, label: str, value: Any, kind: str = "") -> None:
        """Change an input as a user does."""
        uuid, one = self.wait_for(lambda: self.find(label, kind), f"no element {label!r}")
        assert not one.get("disabled"), f"{label} is disabled"
        one["value"] = value
        self._send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    def click(self, label: str) -> None:
        """Press a button."""
        self.set(label, True, "Button")

    def trigger(self, label: str) -> None:
        """Press the key of a command."""
        self.wait_for(lambda: any(one.get("label") == label for one in self.elements.values()))
        uuid = next(uuid for uuid, one in self.elements.items() if one.get("label") == label)
        self._send({"type": "CommandTriggerMessage", "uuid": uuid})

    def drag(self, node: str, phase: str, start: tuple[float, ...], end: tuple[float, ...]) -> None:
        """Shift and drag on something in the scene: `start`, `update` or `end`."""
        message = {"name": node, "phase": phase, "start_position": start, "end_position": end, "instance_index": None}
        more = {"start_screen_pos": (0.5, 0.5), "end_screen_pos": (0.6, 0.5), "button": "left", "modifier": "shift"}
        self._send({"type": "SceneNodeDragMessage", **message, **more})

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> PageBrowser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


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
