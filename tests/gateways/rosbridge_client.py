"""A client of rosbridge that shows each frame as it came."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from waiting import DEADLINE_S
from websockets.sync.client import ClientConnection, connect

sys.path.append(str(Path(__file__).parent.parent / "cli"))

Message = dict[str, Any]


class RosbridgeClient:
    """One connection. Frames that nobody asked for yet are kept."""

    def __init__(self, url: str, **options: Any) -> None:
        self.socket: ClientConnection = connect(url, max_size=None, open_timeout=DEADLINE_S, **options)
        self.frames: list[str | bytes] = []

    def send(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def frame(self, wanted: Callable[[Any], object]) -> Any:
        """The first frame for which `wanted` is true, of those kept and those to come; text is read as JSON."""
        deadline = time.monotonic() + DEADLINE_S
        place = 0
        while True:
            if place == len(self.frames):
                self.frames.append(self.socket.recv(timeout=max(0.0, deadline - time.monotonic())))
            frame = self.frames[place]
            read = json.loads(frame) if isinstance(frame, str) else frame
            if wanted(read):
                del self.frames[place]
                return read
            place += 1

    def op(self, op: str, **fields: Any) -> Message:
        """The next message of this op that has these fields."""
        wanted = {"op": op, **fields}
        found: Message = self.frame(lambda read: isinstance(read, dict) and wanted.items() <= read.items())
        return found

    def call(self, service: str, **request: Any) -> Message:
        """The whole answer of a service."""
        self.send(op="call_service", id="a call", service=service, args=request)
        return self.op("service_response", id="a call")

    def close(self) -> None:
        self.socket.close()

    def __enter__(self) -> RosbridgeClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
