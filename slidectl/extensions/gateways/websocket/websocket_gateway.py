"""`slidectl gateway websocket`: rosbridge's server. Each browser has its own connection to the daemon.

While a browser does not read, the gateway reads neither from it nor from its daemon connection. The daemon then drops
the oldest messages of each topic and counts them. No queue grows in the gateway.
"""

from __future__ import annotations

import asyncio
import os
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any

from websockets.asyncio.server import ServerConnection, broadcast

from slidectl.effects import Effect
from slidectl.errors import NoDaemon, SlidectlError
from slidectl.extensions.gateways.bounded_websocket import TRY_LATER, cut_reason
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.gateway import Gateway
from slidectl.extensions.gateways.websocket.action_goals import ActionGoals
from slidectl.extensions.gateways.websocket.rosbridge_session import RosbridgeSession
from slidectl.extensions.gateways.websocket_listener import ListenerConnection, ListenerOptions, WebSocketListener
from slidectl.paths import InstancePaths
from slidectl.web_access import check_effects
from slidectl.wire.json_lines import LONGEST_LINE

_NODE = "/rosbridge_websocket"
_UNREAD = 256 * 1024
"""Unsent bytes to a browser at which sending stops."""
_PING_EVERY_S, _PONG_WITHIN_S = 20.0, 60.0
_GOING, _RESTARTS, _FAILED = 1001, 1012, 1011


@dataclass(frozen=True)
class WebSocketOptions(ListenerOptions):
    """Options of the gateway."""

    port: int = 9090
    read_only: bool = False
    """Allow browsers to subscribe and query only."""
    max_rate: int = 5000
    """Limit of frames per second from one browser; further frames are delayed."""
    max_size: int = LONGEST_LINE
    """Limit in bytes of a browser's frame, and of all its unfinished fragments."""
    compress: bool | None = None
    """Compress frames (permessage-deflate) for browsers that support it; by default if other machines may connect."""


class WebSocketGateway(Gateway):
    """Accepts browsers and runs a session for each."""

    Options = WebSocketOptions

    def __init__(self, options: WebSocketOptions) -> None:
        """Raises UsageError, Refused: options that contradict each other, or files that cannot be read."""
        super().__init__()
        self._options = options
        self._permitted = check_effects(options.read_only, options.allow)
        self._listener = WebSocketListener(options)
        self._daemon: DaemonConnection | None = None
        self._goals: ActionGoals | None = None
        self._paths: InstancePaths | None = None
        self._browsers: dict[BrowserConnection, RosbridgeSession] = {}
        self._serial = count(1)
        self._dropped = 0
        """Messages dropped for browsers that have disconnected."""

    # --- Gateway ------------------------------------------------------------------------------------------------

    async def open(self) -> str:
        options = self._options
        is_packed = not self._listener.is_local() if options.compress is None else options.compress
        return await self._listener.open(
            self._serve,
            BrowserConnection,
            compression="deflate" if is_packed else None,
            ping_interval=_PING_EVERY_S,
            ping_timeout=_PONG_WITHIN_S,
            max_size=min(options.max_size, LONGEST_LINE),
            write_limit=_UNREAD,
        )

    async def attach(self, paths: InstancePaths) -> None:
        node = f"{_NODE}_{os.getpid()}_0"
        self._daemon = await DaemonConnection.open(paths, (Effect.READS, Effect.WRITES), node, self.lost.set)
        self._goals = ActionGoals(self._daemon)
        self._paths = paths

    async def detach(self) -> None:
        """Disconnect the browsers with the code for a restart: roslib then reconnects."""
        self._paths = None
        if self._daemon is not None:
            self._daemon.close()
        await self._let_go(_RESTARTS, "the daemon has gone")

    async def close(self) -> None:
        self._paths = None
        await self._let_go(_GOING, "the gateway ends")
        if self._daemon is not None:
            self._daemon.close()
        await self._listener.close(_GOING, "the gateway ends")

    def status(self) -> dict[str, Any]:
        dropped = self._dropped + sum(session.dropped for session in self._browsers.values())
        return {"connections": len(self._browsers), "dropped": dropped, "refused": self._listener.refused}

    # --- browsers -----------------------------------------------------------------------------------------------

    async def _let_go(self, code: int, reason: str) -> None:
        if self._browsers:
            await asyncio.wait([asyncio.ensure_future(browser.close(code, reason)) for browser in self._browsers])

    async def _serve(self, browser: ServerConnection) -> None:
        """Serve one browser from its handshake to its end."""
        assert isinstance(browser, BrowserConnection)
        try:
            await self._serve_open(browser)
        except NoDaemon as error:
            await browser.close(TRY_LATER if browser.daemon is None else _RESTARTS, cut_reason(error.message))
        except SlidectlError as error:
            await browser.close(_FAILED, cut_reason(error.message))

    async def _serve_open(self, browser: BrowserConnection) -> None:
        if self._paths is None or self._goals is None:
            raise NoDaemon("there is no daemon at the moment")
        node = f"{_NODE}_{os.getpid()}_{next(self._serial)}"
        lost = partial(browser.end_soon, _RESTARTS, "the daemon has gone")
        daemon = await DaemonConnection.open(self._paths, self._permitted, node, lost)
        options = self._options
        fragments = self._listener.bounds.held.share(partial(browser.end_at_once, TRY_LATER))
        session = RosbridgeSession(
            daemon, self._goals, self._type_of, browser.write, options.max_size, options.read_only, fragments.set
        )
        self._browsers[browser] = session
        daemon.on_line = session.pass_on
        browser.daemon = daemon
        try:
            await browser.read(session, daemon, options.max_rate)
        finally:
            fragments.close()
            session.close()
            del self._browsers[browser]
            self._dropped += session.dropped

    async def _type_of(self, topic: str) -> str:
        if self._daemon is None:
            raise NoDaemon("there is no daemon at the moment")
        return str((await self._daemon.call("/rosapi/topic_type", {"topic": topic}))["type"])


class BrowserConnection(ListenerConnection):
    """A browser's connection. While it does not read, neither it nor its daemon connection is read."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.daemon: DaemonConnection | None = None
        self._may_write = asyncio.Event()
        self._may_write.set()
        self._ending: asyncio.Future[None] | None = None

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._may_write.set()
        if self.daemon is not None:  # `read` may be waiting in `drain`
            self.daemon.close()

    def pause_writing(self) -> None:
        super().pause_writing()
        self._may_write.clear()
        self.stop_reading("unread")  # stops pings too: answers to them would add to the unsent data
        if self.daemon is not None:
            self.daemon.pause()

    def resume_writing(self) -> None:
        super().resume_writing()
        self._may_write.set()
        self.go_on_reading("unread")
        if self.daemon is not None:
            self.daemon.resume()

    def write(self, frame: bytes, is_text: bool) -> None:
        """Send a frame without waiting: `pause_writing` is called when too much is unsent."""
        broadcast((self,), frame, text=is_text)

    async def read(self, session: RosbridgeSession, daemon: DaemonConnection, most_a_second: int) -> None:
        """Process the browser's frames until it disconnects. Raises ConnectionClosed, NoDaemon."""
        second_ends, taken = 0.0, 0
        while True:
            await self._may_write.wait()
            frame = await self.recv(decode=False)
            if taken >= most_a_second:
                await asyncio.sleep(second_ends - self.loop.time())
            if self.loop.time() >= second_ends:
                second_ends, taken = self.loop.time() + 1.0, 0
            taken += 1
            await session.take(frame)
            del frame  # it may be long, and the next one may come late
            await daemon.drain()

    def end_soon(self, code: int, reason: str) -> None:
        """Start closing the connection, from code that cannot await."""
        self._ending = asyncio.ensure_future(self.close(code, reason))
