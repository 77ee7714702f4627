"""A client that sends bytes and reads objects, for what a well-behaved client never does."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

LIMIT_S = 20.0


class Wire:
    """A raw connection. Everything that waits gives up after 20 s."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(LIMIT_S)
        self.socket.connect(str(path))
        self._lines = self.socket.makefile("rb")

    def send(self, **message: Any) -> None:
        """One object as one line."""
        self.raw(json.dumps(message).encode() + b"\n")

    def raw(self, data: bytes) -> None:
        """These bytes."""
        self.socket.sendall(data)

    def receive(self) -> dict[str, Any]:
        """The next object; EOFError when the daemon has closed the connection."""
        line = self._lines.readline()
        if not line:
            raise EOFError
        message: dict[str, Any] = json.loads(line)
        return message

    def rest(self) -> list[dict[str, Any]]:
        """All objects until the daemon closes the connection. They are taken before any is looked at."""
        return [json.loads(line) for line in self._lines.readlines()]

    def until(self, op: str, **keys: Any) -> dict[str, Any]:
        """The next object of this op with these keys; the others are skipped."""
        while True:
            message = self.receive()
            if message["op"] == op and keys.items() <= message.items():
                return message

    def call(self, service: str, **args: Any) -> dict[str, Any]:
        """Call a service and give the whole response object."""
        self.send(op="call_service", id="call", service=service, args=args)
        return self.until("service_response", id="call")

    def close(self) -> None:
        """Hang up."""
        self._lines.close()
        self.socket.close()

    def __enter__(self) -> Wire:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
