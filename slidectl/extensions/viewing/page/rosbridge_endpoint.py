"""The page's WebSocket for its panels: rosbridge, through the session of the WebSocket gateway, on the page's own port.

The services below `/slidectl_page/` are those of the page itself; all else goes to the daemon. Who may connect is for
the guard to judge, and what a browser may do for the daemon. It runs on viser's event loop.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from contextlib import suppress
from functools import partial
from itertools import count
from typing import Any

from websockets.asyncio.server import broadcast
from websockets.exceptions import ConnectionClosed

from slidectl.effects import Effect
from slidectl.errors import NoDaemon, SlidectlError
from slidectl.extensions.gateways.bounded_websocket import TRY_LATER, BoundedConnection, cut_reason
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.websocket.action_goals import ActionGoals
from slidectl.extensions.gateways.websocket.rosbridge_session import RosbridgeSession
from slidectl.paths import InstancePaths
from slidectl.wire.json_lines import LONGEST_LINE, BadLine, check_size, decode, encode

PATH = "/rosbridge"
_OWN = "/slidectl_page/"
_NODE = "/slidectl_page"
_RESTARTS, _FAILED = 1012, 1011

Message = dict[str, Any]
Answer = Callable[[bool, Any], None]
"""Takes whether a call succeeded, and its values or the reason."""


class PageConnection(BoundedConnection):
    """A connection of the page. While a browser does not read, its connection to the daemon is not read."""

    daemon: DaemonConnection | None = None
    """The connection of the panels to the daemon; None for viser's."""

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        if self.daemon is not None:
            self.daemon.close()

    def pause_writing(self) -> None:
        super().pause_writing()
        if self.daemon is not None:
            self.stop_reading("unread")
            self.daemon.pause()

    def resume_writing(self) -> None:
        super().resume_writing()
        if self.daemon is not None:
            self.go_on_reading("unread")
            self.daemon.resume()

    def write(self, frame: bytes, is_text: bool) -> None:
        """Send a frame without waiting: `pause_writing` is called when too much is unsent."""
        broadcast((self,), frame, text=is_text)

    def end_soon(self, code: int, reason: str) -> None:
        """Start closing the connection, from code that cannot await."""
        self._ending = self.loop.create_task(self.close(code, reason))


class RosbridgeEndpoint:
    """The sessions of all browsers."""

    def __init__(self, paths: InstancePaths, permitted: Collection[Effect]) -> None:
        self.serve: Callable[[str, Message, Answer], None] = lambda _name, _request, answer: answer(False, "not yet")
        """Carries out a service of the page, on another thread, and answers there."""
        self.browsers: set[PageConnection] = set()
        self._paths = paths
        self._permitted = permitted
        self._serial = count(1)
        self._shared: tuple[DaemonConnection, ActionGoals] | None = None

    async def handle(self, browser: PageConnection) -> None:
        """Serve one browser from its handshake to its end."""
        self.browsers.add(browser)
        try:
            with suppress(ConnectionClosed):
                await self._handle(browser)
        except NoDaemon as error:
            await browser.close(TRY_LATER if browser.daemon is None else _RESTARTS, cut_reason(error.message))
        except SlidectlError as error:
            await browser.close(_FAILED, cut_reason(error.message))
        finally:
            self.browsers.discard(browser)

    async def _handle(self, browser: PageConnection) -> None:
        lost = partial(browser.end_soon, _RESTARTS, "the daemon has gone")
        daemon = await DaemonConnection.open(self._paths, self._permitted, self._node(), lost)
        goals = (await self._common())[1]
        is_reader = Effect.WRITES not in self._permitted
        session = RosbridgeSession(daemon, goals, self._type_of, browser.write, LONGEST_LINE, is_reader)
        daemon.on_line = session.pass_on
        browser.daemon = daemon
        try:
            while True:
                frame = await browser.recv(decode=False)
                if not self._is_own(browser, frame):
                    await session.take(frame)
                    await daemon.drain()
        finally:
            session.close()

    def tell(self, level: str, text: str) -> None:
        """Send all browsers a status; callable from any thread."""
        line = encode({"op": "status", "level": level, "msg": text})[:-1]
        for browser in list(self.browsers):
            browser.loop.call_soon_threadsafe(browser.write, line, True)

    # --- the services of the page -------------------------------------------------------------------------------

    def _is_own(self, browser: PageConnection, frame: bytes) -> bool:
        """Carry out the call of a service of the page. False: the frame is something else."""
        if _OWN.encode() not in frame:
            return False
        try:
            check_size(frame)
            message = decode(frame)
        except BadLine:  # the daemon reports the error
            return False
        service = message.get("service")
        if message.get("op") != "call_service" or not isinstance(service, str) or not service.startswith(_OWN):
            return False
        args = message.get("args")
        about = {"op": "service_response", "service": service, "id": message.get("id")}

        def answer(result: bool, values: Any) -> None:
            line = encode({**about, "result": result, "values": values})[:-1]
            browser.loop.call_soon_threadsafe(browser.write, line, True)

        self.serve(service.removeprefix(_OWN), args if isinstance(args, dict) else {}, answer)
        return True

    # --- what all browsers share --------------------------------------------------------------------------------

    def _node(self) -> str:
        return f"{_NODE}_{os.getpid()}_{next(self._serial)}"

    async def _common(self) -> tuple[DaemonConnection, ActionGoals]:
        """A connection for goals of actions and for types; it is made anew after the daemon has ended."""
        if self._shared is None:
            effects = (Effect.READS, Effect.WRITES)
            daemon = await DaemonConnection.open(self._paths, effects, self._node(), self._forget)
            self._shared = daemon, ActionGoals(daemon)
        return self._shared

    def _forget(self) -> None:
        self._shared = None

    async def _type_of(self, topic: str) -> str:
        daemon, _ = await self._common()
        return str((await daemon.call("/rosapi/topic_type", {"topic": topic}))["type"])
