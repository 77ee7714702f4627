"""Nodes of ROS 1 as a master sees them, without ROS: a name, a slave API that notes its calls, and calls."""

from __future__ import annotations

import threading
from typing import Any
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCServer

from waiting import eventually


class ForeignNode:
    """`node.registerPublisher(topic, type, node.uri)` calls the master; `calls` are those of its own API."""

    def __init__(self, master_uri: str, name: str, answer: Any = (1, "", 0)) -> None:
        self.name = name
        self.calls: list[list[Any]] = []
        self.answer = list(answer)
        self._master_uri = master_uri
        self._server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        self._server.register_instance(self)
        self.uri = f"http://127.0.0.1:{self._server.server_address[1]}/"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        self._thread.start()

    def _dispatch(self, method: str, arguments: tuple[Any, ...]) -> Any:
        self.calls.append([method, *arguments])
        return self.answer

    def __getattr__(self, method: str) -> Any:
        def call(*arguments: Any) -> Any:
            with ServerProxy(self._master_uri, allow_none=True) as master:
                return getattr(master, method)(self.name, *arguments)

        return call

    def value(self, method: str, *arguments: Any) -> Any:
        """What the call gives; it must succeed."""
        code, message, value = getattr(self, method)(*arguments)
        assert code == 1, message
        return value

    def hears(self, *call: Any) -> None:
        """Wait until its own API was called so."""
        eventually(lambda: list(call) in self.calls, f"{self.name} was not called with {call}", 20)

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def __enter__(self) -> ForeignNode:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
