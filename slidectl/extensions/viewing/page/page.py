"""The main loop of the page: draws the scene, and carries out what browsers request of the page itself.

viser and the panels call on other threads; these only queue actions for this thread. Without a connected browser only
publications and recordings communicate with the daemon.
"""

from __future__ import annotations

import queue
import time
import traceback
from collections.abc import Callable, Hashable
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING, Any

from slidectl.client import Client
from slidectl.errors import NoDaemon, Refused, SlidectlError, UnknownName
from slidectl.extensions.viewing.page import reports
from slidectl.extensions.viewing.page.form_messages import PagePublications, filled
from slidectl.extensions.viewing.page.page_recorder import PageRecorder
from slidectl.extensions.viewing.page.scene_view import SceneView

if TYPE_CHECKING:
    from slidectl.extensions.viewing.page.guarded_server import GuardedServer
    from slidectl.extensions.viewing.page.rosbridge_endpoint import Answer

FRAME_S = 1 / 35
"""Wall seconds between two updates of the link poses."""
_UPDATE_S = 0.1
_CONNECT_S = 0.5
_MOST_WANTED = 500
_MOST_TAKEN = 10_000
"""Limit of the objects read per turn without a browser: a fast world may send more than can be read."""

Message = dict[str, Any]


class Page:
    """The scene of one daemon, in all browsers that show the page, and the page's own services."""

    def __init__(
        self,
        server: GuardedServer,
        connect: Callable[[], Client],
        read_only: bool,
        tell: Callable[[str, str], None],
    ) -> None:
        """`connect` connects to the daemon or raises NoDaemon. `tell` shows browsers a text; its level comes first."""
        self.server = server
        self.read_only = read_only
        self.tell = tell
        self._connect = connect
        self._client: Client | None = None
        self._wanted: dict[Hashable, Callable[[], object]] = {}
        self._queue: queue.SimpleQueue[Hashable] = queue.SimpleQueue()
        self._faults: set[tuple[type[Exception], str]] = set()
        """Internal errors whose traceback has been printed."""
        self._due = dict.fromkeys(("frame", "update", "connect"), 0.0)
        self.scene = SceneView(self)
        self._recorder = PageRecorder(self)
        self._publications = PagePublications(self)
        reading, changing = self._reading_services(), self._changing_services()
        self._services = reading if read_only else reading | changing
        self._refused = set(changing) if read_only else set()

    # --- the services -------------------------------------------------------------------------------------------

    def _reading_services(self) -> dict[str, Callable[[Message], Message | None]]:
        """The services that change nothing in the world, and no file."""
        return {
            "state": self._state,
            "view": self.scene.choose,
            "sensor": self.scene.sensors.choose,
            "ghost": self.scene.show_ghost,
            "camera": self.scene.look_from,
            "fill": lambda request: filled(self.client, request),
            "graph": lambda request: reports.graph_picture(self.client, request),
            "gains_file": lambda request: reports.gains_file(self.client, request),
        }

    def _changing_services(self) -> dict[str, Callable[[Message], Message | None]]:
        return {
            "record": self._recorder.start,
            "stop_recording": lambda _: self._recorder.stop(),
            "publish": self._publications.begin,
            "stop_publishing": self._publications.end,
            "drive": self._publications.drive,
            "place": self.scene.choose_placed,
        }

    def _state(self, request: Message) -> Message:
        """What browsers show of the page, which read it each second."""
        self.scene.quality.seen(request)
        return {
            "read_only": self.read_only,
            "view": self.scene.options(),
            "recording": self._recorder.state(),
            "publications": self._publications.state(),
        }

    def serve(self, name: str, request: Message, answer: Answer) -> None:
        """Carry out a service of the page, on the page's thread; callable from any thread."""

        def carry_out() -> None:
            try:
                answer(True, self._carry_out(name, request) or {})
            except SlidectlError as error:
                answer(False, str(error))
                if isinstance(error, NoDaemon):
                    raise
            except Exception as error:
                answer(False, f"internal error of slidectl: {type(error).__name__}: {error}")
                raise

        if not self.do(carry_out):
            answer(False, "too much at once: some of what browsers asked for is left out")

    def _carry_out(self, name: str, request: Message) -> Message | None:
        if name in self._refused:
            raise Refused("this page is read-only: it was started with --read-only")
        service = self._services.get(name)
        if service is None:
            raise UnknownName("service of the page", name, list(self._services))
        try:
            return service(request)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise Refused(f"the request of {name} is not valid: {type(error).__name__}: {error}") from error

    # --- for the parts ------------------------------------------------------------------------------------------

    @property
    def client(self) -> Client:
        """The connection to the daemon, for the page's thread only. Raises NoDaemon without one."""
        if self._client is None:
            raise NoDaemon("the daemon is not there", "the page comes back with it")
        return self._client

    def call(self, service: str, request: Message | None = None) -> Message:
        """Call a service as `Client.call` does. Raises Refused also for a response with success false."""
        answer = self.client.call(service, request)
        if not answer.get("success", True):
            raise Refused(answer.get("status_message") or answer.get("message") or f"{service} refused")
        return answer

    def do(self, action: Callable[[], object], key: Hashable = None) -> bool:
        """Queue an action for the page's thread; callable from any thread. False: the queue is full.

        Of waiting actions with the same key only the newest is done, for example for a dragged link. Errors are shown
        in all browsers.
        """
        key = object() if key is None else key
        if self._queue.qsize() >= _MOST_WANTED:
            return False
        self._wanted[key] = action
        self._queue.put(key)
        return True

    def attempt(self, action: Callable[[], object]) -> None:
        """Do an action and show its errors in all browsers. Raises NoDaemon."""
        try:
            action()
        except NoDaemon:
            raise
        except SlidectlError as error:
            self.tell("error", str(error))
        except Exception as error:  # an internal error in one part must not end the page
            if (type(error), str(error)) not in self._faults:
                self._faults.add((type(error), str(error)))
                traceback.print_exc()
            self.tell("error", f"internal error of slidectl: {type(error).__name__}: {error}")

    # --- the loop -----------------------------------------------------------------------------------------------

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Run until interrupted, or until `until` returns True."""
        while not until():
            try:
                self._turn()
            except NoDaemon:
                self._lost()
            except SlidectlError as error:  # the daemon hangs
                self.tell("error", str(error))
            self._wait()

    def _turn(self) -> None:
        now = time.monotonic()
        if self._client is None:
            if self._is_due("connect", _CONNECT_S, now):
                self._client = self._connect()
            return
        if self._is_due("update", _UPDATE_S, now):
            self.attempt(self._publications.update)
            self.attempt(self._recorder.update)
        if not self.server.get_clients():
            self.scene.rest()
            for _ in islice(self._client.events(0.0), _MOST_TAKEN):  # also notices the end of the daemon
                pass
            return
        if self._is_due("frame", FRAME_S, now):
            self.attempt(self.scene.draw)

    def _is_due(self, what: str, period: float, now: float) -> bool:
        if now < self._due[what]:
            return False
        self._due[what] = max(self._due[what] + period, now + period / 2)  # missed turns are not repeated
        return True

    def _wait(self) -> None:
        """Do queued actions until the next turn."""
        idle = self._client is None or not self.server.get_clients()
        left = _UPDATE_S if idle else min(self._due["frame"] - time.monotonic(), FRAME_S)
        with suppress(queue.Empty):
            key = self._queue.get(timeout=max(left, 0.001))
            end = time.monotonic() + FRAME_S  # one browser's actions must not delay the others longer
            while True:
                action = self._wanted.pop(key, None)
                if action is not None:
                    try:
                        self.attempt(action)
                    except NoDaemon:
                        self._lost()
                if time.monotonic() > end:
                    break
                key = self._queue.get_nowait()

    def _lost(self) -> None:
        """Handle the end of the daemon: clear the scene, and try to reconnect."""
        self._leave()
        self._client = None
        self._due["connect"] = time.monotonic() + _CONNECT_S

    def _leave(self) -> None:
        for part in (self._publications, self.scene, self._recorder):  # first of all what moves is stopped
            with suppress(SlidectlError):
                part.leave()
        if self._client is not None:
            with suppress(SlidectlError):
                self._client.close()

    def close(self) -> None:
        """Disconnect from the daemon and stop the server."""
        self._leave()
        self.server.stop()
