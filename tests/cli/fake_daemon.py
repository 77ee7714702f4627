"""A daemon that only speaks the wire protocol: scripted answers, and a record of what it was asked.

For what a real daemon will not do on demand: never answer, die in the middle, send megabytes.
"""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import slidectl

Answer = dict[str, Any] | Callable[[dict[str, Any]], dict[str, Any]]
NEVER: dict[str, Any] = {"never": True}
DIE: dict[str, Any] = {"die": True}


class FakeDaemon:
    """Listens on `folder/slidectl/default/socket`. A service without an answer fails with "no service"."""

    def __init__(self, folder: Path) -> None:
        self.answers: dict[str, Answer] = {"/rosapi/get_time": {"time": {"secs": 0, "nsecs": 0}}}
        self.received: list[dict[str, Any]] = []
        self.asked = threading.Event()
        home = folder / "slidectl" / "default"
        home.mkdir(mode=0o700, parents=True)
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(home / "socket"))
        self._listener.listen()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def calls(self, service: str) -> list[dict[str, Any]]:
        """The arguments of every call of the service."""
        return [m["args"] for m in self.received if m.get("op") == "call_service" and m["service"] == service]

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._talk, args=(connection,), daemon=True).start()

    def _talk(self, connection: socket.socket) -> None:
        with connection, connection.makefile("r", encoding="utf-8") as lines:
            try:
                for line in lines:
                    message = json.loads(line)
                    self.received.append(message)
                    if message["op"] == "call_service" and not self._answer(message, connection):
                        return
            except OSError:
                return

    def _answer(self, message: dict[str, Any], connection: socket.socket) -> bool:
        service = message["service"]
        answer = self.answers.get(service)
        if callable(answer):
            answer = answer(message["args"])
        if answer is not NEVER and answer is not DIE:
            values: Any = answer if answer is not None else f"no service {service!r}"
            reply = {"op": "service_response", "id": message["id"], "service": service, "values": values}
            reply |= {"version": slidectl.__version__} if "version" in message else {}
            connection.sendall((json.dumps({**reply, "result": answer is not None}) + "\n").encode())
        self.asked.set()
        return answer is not DIE

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()
