"""The main loop of the page: reads the state of the world, shows it, and carries out what browsers request.

viser calls back on its own threads; these only queue actions for this thread. Without a connected browser only panels
that publish or step communicate with the daemon.
"""

from __future__ import annotations

import queue
import time
import traceback
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from html import escape
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

from viser import GuiButtonGroupHandle

from slidectl import names
from slidectl.client import Client, Subscription
from slidectl.errors import NoDaemon, Refused, SlidectlError, cut

if TYPE_CHECKING:
    from viser import ClientHandle, GuiFolderHandle, GuiTabHandle

    from slidectl.extensions.viewing.page.guarded_server import GuardedServer
    from slidectl.msgs.typed import ControllerStateMsg, RobotInfoMsg, StatusResponseMsg

FRAME_S = 1 / 35
"""Wall seconds between two updates of the link poses."""
_REFRESH_S = 0.1
_LOOK_S = 0.5
"""Wall seconds between two reads of robots, controllers and topics."""
_CONNECT_S = 0.5
_MOST_WANTED = 500
_NOTICE_S = 8.0
_MOST_TAKEN = 10_000
"""Limit of the objects read per turn without a browser: a fast world may send more than can be read."""
_LONGEST_NOTICE = 600
PADDING = "padding:0.2em 0.7em"
"""CSS of HTML in a panel, which aligns it with the inputs."""
_TABLE = "width:100%;font-size:0.8em;font-variant-numeric:tabular-nums;overflow-wrap:anywhere"
_LONGEST_WORD = 12
"""Cells up to this many letters are never wrapped."""
HIGHEST = "max-height:50vh;overflow:auto"
"""CSS of content that may be long."""
SCROLLED = f"{HIGHEST};{PADDING};font-size:0.8em;white-space:pre-wrap;overflow-wrap:anywhere"
"""CSS of text that may be long."""

Message = dict[str, Any]


class WorldState(NamedTuple):
    """The state of the world at one moment."""

    status: StatusResponseMsg
    """slidectl/Status."""
    robots: list[RobotInfoMsg]
    """slidectl/RobotInfo."""
    controllers: dict[str, list[ControllerStateMsg]]
    """Namespace -> its controller_manager_msgs/ControllerState."""
    topics: dict[str, str]
    """Name -> type."""


class Panel:
    """One tab of the page. All of its methods are called on the page's thread."""

    title = ""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.gui = page.server.gui
        self._subscriptions: list[Subscription] = []

    def shape(self, world: WorldState) -> Hashable:  # noqa: ARG002
        """A key of the panel's elements: when it changes, the panel is rebuilt."""
        return None

    def build(self, world: WorldState) -> None:
        """Create the elements in the entered container. Elements of an earlier `build` have been removed."""

    def refresh(self, world: WorldState) -> None:
        """Show the newest values, ten times per second with a browser connected. `world` may be half a second old."""

    def update(self) -> None:
        """Continue work that needs no browser; called ten times per second while there is a daemon."""

    def opened(self, query: Mapping[str, Sequence[str]]) -> None:
        """Handle a page opened with this query in its address."""

    def subscribe(self, topic: str, type_name: str | None = None, **options: Any) -> Subscription:
        """Subscribe as `Client.subscribe` does, until `leave`."""
        self._subscriptions.append(self.page.client.subscribe(topic, type_name, **options))
        return self._subscriptions[-1]

    def leave(self) -> None:
        """End subscriptions. Called before the panel is rebuilt, and when the daemon has ended."""
        for subscription in self._subscriptions:
            subscription.close()
        self._subscriptions.clear()


def html_table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """An HTML table. Floats are right-aligned with four decimals; None (NaN from the daemon) is a dash."""
    lines = [list(row) for row in rows]
    is_number = [bool(lines) and (one is None or isinstance(one, float)) for one in (*lines, columns)[0]]
    head = "".join(map(_cell, columns, is_number, ["th"] * len(columns)))
    body = "".join(f"<tr>{''.join(map(_cell, line, is_number, ['td'] * len(line)))}</tr>" for line in lines)
    text = f"<tr>{head}</tr>{body}"
    return f'<div style="{PADDING}"><table style="{_TABLE}">{text}</table></div>'


def _cell(value: object, is_number: bool, kind: str) -> str:
    text = "–" if value is None else f"{value:z.4f}" if isinstance(value, float) else str(value)
    wrap = "nowrap" if len(text) <= _LONGEST_WORD else "normal"
    style = f"text-align:{'right' if is_number else 'left'};white-space:{wrap}"
    return f'<{kind} style="{style}">{escape(text)}</{kind}>'


def offer(handle: Any, options: tuple[str, ...]) -> None:
    """Set the options of an input if they differ: viser would send equal ones again."""
    if handle.options != options:
        handle.options = options


class Page:
    """Panels and scene of one daemon, in all browsers that show the page."""

    def __init__(
        self,
        server: GuardedServer,
        connect: Callable[[], Client],
        read_only: bool,
        opened: queue.SimpleQueue[Mapping[str, Sequence[str]]],
    ) -> None:
        """`connect` connects to the daemon or raises NoDaemon. `opened` has the queries of opened pages."""
        self.server = server
        self._opened = opened
        self.read_only = read_only
        self._connect = connect
        self._client: Client | None = None
        self._world: WorldState | None = None
        self._wanted: dict[Hashable, Callable[[], object]] = {}
        self._queue: queue.SimpleQueue[Hashable] = queue.SimpleQueue()
        self._is_flooded = False
        self._panels: list[tuple[Panel, GuiTabHandle]] = []
        self._built: dict[Panel, tuple[Hashable, GuiFolderHandle]] = {}
        self._frame: Callable[[], object] = lambda: None
        self._banner = server.gui.add_markdown("connecting ...", order=-1000)
        self._told: dict[tuple[str, str], float] = {}
        """Notification -> wall time until which it is shown."""
        self._faults: set[tuple[type[Exception], str]] = set()
        """Internal errors whose traceback has been printed."""
        self._due = dict.fromkeys(("frame", "update", "refresh", "look", "connect"), 0.0)

    # --- for panels -----------------------------------------------------------------------------------------------

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

    def add_panel(self, panel: Panel, tab: GuiTabHandle) -> None:
        """Show a panel in a tab."""
        self._panels.append((panel, tab))

    def each_frame(self, action: Callable[[], object]) -> None:
        """Set the function that updates the robots' poses."""
        self._frame = action

    def do(self, action: Callable[[], object], key: Hashable = None) -> None:
        """Queue an action for the page's thread; callable from any thread.

        Of waiting actions with the same key only the newest is done, for example for a dragged slider. Errors are shown
        in all browsers. When the queue is full the action is dropped, and the browsers are notified.
        """
        key = object() if key is None else key
        if self._queue.qsize() >= _MOST_WANTED:
            self._is_flooded = True
            return
        self._wanted[key] = action
        self._queue.put(key)

    def acting(self, handle: Any, action: Callable[[Any], object], coalesce: bool = False) -> None:
        """Call `action` with the value of an input or button when a user changes it.

        For actions that change the world: on a read-only page the input is disabled.
        """
        if self.read_only and isinstance(handle, GuiButtonGroupHandle):  # cannot be disabled
            handle.visible = False
        elif self.read_only:
            handle.disabled = True
        else:
            self.looking(handle, action, coalesce)

    def looking(self, handle: Any, action: Callable[[Any], object], coalesce: bool = False) -> None:
        """As `acting`, for actions that change only the page."""
        self.answering(handle, lambda value, _: action(value), coalesce)

    def answering(self, handle: Any, action: Callable[[Any, ClientHandle], object], coalesce: bool = False) -> None:
        """As `looking`; `action` also gets the requesting browser, for example to send it a file."""
        key = object() if coalesce else None  # a handle cannot be a key

        async def changed(event: Any) -> None:  # async: keeps the order of events
            if event.client is not None:  # else the page itself has set the value
                self.do(partial(action, event.target.value, event.client), key)

        register = getattr(handle, "on_click", None) or handle.on_update
        register(changed)

    def notify(self, title: str, text: str = "", color: str = "teal") -> None:
        """Show a notification in all browsers, unless it is still shown."""
        now = time.monotonic()
        self._told = {one: until for one, until in self._told.items() if until > now}
        if self._told.setdefault((title, text), now + _NOTICE_S) != now + _NOTICE_S:
            return
        for browser in list(self.server.get_clients().values()):
            browser.add_notification(title, cut(text, _LONGEST_NOTICE), auto_close_seconds=_NOTICE_S, color=color)  # type: ignore[call-overload]

    def attempt(self, action: Callable[[], object]) -> None:
        """Do an action and show its errors in all browsers. Raises NoDaemon."""
        try:
            action()
        except NoDaemon:
            raise
        except SlidectlError as error:
            self.notify(error.message, error.hint or "", "red")
        except Exception as error:  # an internal error in one panel must not end the page
            if (type(error), str(error)) not in self._faults:
                self._faults.add((type(error), str(error)))
                traceback.print_exc()
            self.notify("A fault of slidectl", f"{type(error).__name__}: {error}", "red")

    def look_again(self) -> None:
        """Read the robots, controllers and topics in the next turn, after a change."""
        self._due["look"] = 0.0

    # --- the loop -------------------------------------------------------------------------------------------------

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Run until interrupted, or until `until` returns True."""
        while not until():
            try:
                self._turn()
            except NoDaemon:
                self._lost()
            except SlidectlError as error:  # the daemon hangs
                self.notify(error.message, error.hint or "", "red")
            self._wait()

    def _turn(self) -> None:
        now = time.monotonic()
        if self._client is None:
            if self._is_due("connect", _CONNECT_S, now):
                self._client = self._connect()
                self._due["look"] = 0.0
            return
        while not self._opened.empty():
            query = self._opened.get()
            for panel, _ in self._panels:
                self.attempt(lambda panel=panel, query=query: panel.opened(query))  # type: ignore[misc]
        if self._is_due("update", _REFRESH_S, now):
            for panel in list(self._built):
                self.attempt(panel.update)
        if not self.server.get_clients():
            for _ in islice(self._client.events(0.0), _MOST_TAKEN):  # also notices the end of the daemon
                pass
            return
        if self._is_due("look", _LOOK_S, now):
            self._look(self._client)
        if self._is_due("frame", FRAME_S, now):
            self.attempt(self._frame)
        if self._world is not None and self._is_due("refresh", _REFRESH_S, now):
            for panel in list(self._built):
                self.attempt(lambda panel=panel: panel.refresh(self._world))  # type: ignore[misc]

    def _is_due(self, what: str, period: float, now: float) -> bool:
        if now < self._due[what]:
            return False
        self._due[what] = max(self._due[what] + period, now + period / 2)  # missed turns are not repeated
        return True

    def _wait(self) -> None:
        """Do queued actions until the next turn."""
        idle = self._client is None or not self.server.get_clients()
        left = _REFRESH_S if idle else min(self._due["frame"] - time.monotonic(), FRAME_S)
        with suppress(queue.Empty):
            key = self._queue.get(timeout=max(left, 0.001))
            end = time.monotonic() + FRAME_S  # one browser's actions must not delay the others longer
            while True:
                action = self._wanted.pop(key, None)
                if action is not None:
                    try:
                        self.attempt(action)
                    except NoDaemon as error:
                        self.notify(error.message, error.hint or "", "red")
                        self._lost()
                if time.monotonic() > end:
                    break
                key = self._queue.get_nowait()
        if self._is_flooded:
            self._is_flooded = False
            self.notify("Too much at once", "Some of what browsers asked for was left out.", "red")

    def _look(self, client: Client) -> None:
        """Read robots, controllers and topics, and rebuild the panels that changed."""
        robots = client.robots()
        answer = client.call("/rosapi/services_for_type", {"type": "controller_manager_msgs/ListControllers"})
        spaces = sorted(names.parent(names.parent(service)) for service in answer["services"])
        controllers = {}
        for space in spaces:
            with suppress(Refused):  # the robot was deleted meanwhile
                controllers[space] = client.controllers(space).controllers()
        self._world = world = WorldState(client.call("/slidectl/status"), robots, controllers, client.topics())
        self._say_state(world)
        for panel, tab in self._panels:
            self.attempt(partial(self._show, panel, tab, world))

    def _show(self, panel: Panel, tab: GuiTabHandle, world: WorldState) -> None:
        """Build a panel whose shape has changed, or that could not be built before."""
        shape = panel.shape(world)
        if panel in self._built and self._built[panel][0] == shape:
            return
        self._clear(panel)
        with tab:
            container = self.server.gui.add_folder(None)  # without a frame
        self._built[panel] = (object(), container)
        with container:
            panel.build(world)
        self._built[panel] = (shape, container)

    def _say_state(self, world: WorldState) -> None:
        status = world.status
        name = f"daemon **{status['instance']}**" + (" · only looking" if self.read_only else "")
        state = "paused" if status["paused"] else f"{status['speed_reached']:.2f} × real time"
        trouble = f" · {status['trouble']}" if status["trouble"] else ""
        self._banner.content = f"{name} · {state}{trouble}"

    def _clear(self, panel: Panel) -> None:
        if panel in self._built:
            _, container = self._built.pop(panel)
            try:
                self.attempt(panel.leave)
            finally:
                container.remove()

    def _lost(self) -> None:
        """Handle the end of the daemon: notify browsers, clear the panels, and try to reconnect."""
        if self._client is not None:
            with suppress(SlidectlError):
                self._client.close()
            self.notify("The daemon has gone", "The page comes back with it.", "red")
        self._client = self._world = None
        self._banner.content = "**the daemon has gone**: the page waits for it (`slidectl daemon start`)"
        for panel, _ in self._panels:
            with suppress(NoDaemon):
                self._clear(panel)
        self._due["connect"] = time.monotonic() + _CONNECT_S

    def close(self) -> None:
        """Disconnect from the daemon and stop the server."""
        for panel in self._built:
            with suppress(SlidectlError):
                panel.leave()
        if self._client is not None:
            with suppress(SlidectlError):
                self._client.close()
        self.server.stop()
