"""A connected app: its unsent frames, its subscriptions and its advertised channels.

An app that does not read does not delay others: its oldest messages are dropped and counted. When too many answers are
unread too, its connection is closed; when all apps together leave too much unread, that of the worst is.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple

from websockets.asyncio.server import broadcast

from slidectl.extensions.gateways.bounded_websocket import TRY_LATER
from slidectl.extensions.gateways.foxglove.foxglove_frames import ERROR, BadFrame, status_frame
from slidectl.extensions.gateways.ros1.ros1_types import Ros1Type
from slidectl.extensions.gateways.tasks import Tasks
from slidectl.extensions.gateways.websocket_listener import ListenerConnection
from slidectl.wire.bounds import HeldBytes

_MOST_MESSAGES, _MOST_MESSAGE_BYTES = 10_000, 16 * 1024 * 1024
"""Limits of the messages that wait for one app."""
_MOST_ANSWER_BYTES = 32 * 1024 * 1024
"""Limit of the answers that wait for one app. The last one may exceed it: a file."""
_MUCH_UNSENT = 4 * 1024 * 1024
_COPIES = 3
"""How often a frame is in memory while a task works on it: as it came, as values, and as a line to the daemon."""
_MOST_TASKS = 32
"""Limit of the calls and file requests of one app in progress."""


class AppTopic(NamedTuple):
    """A channel on which an app publishes."""

    topic: str
    type: Ros1Type
    encoding: str


class AppSocket(ListenerConnection):
    """A WebSocket that knows whether its write buffer is full."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.is_full = False
        self.on_room: Callable[[], None] = lambda: None
        """Called when the write buffer has room again."""

    def pause_writing(self) -> None:
        super().pause_writing()
        self.is_full = True

    def resume_writing(self) -> None:
        super().resume_writing()
        self.is_full = False
        self.on_room()


class AppConnection:
    """An app: queues of its frames, its subscriptions and its channels."""

    def __init__(self, socket: AppSocket, held: HeldBytes, unread: HeldBytes) -> None:
        """`held` counts what came from apps and is not handled, `unread` what they have not read."""
        self.subscriptions: dict[int, int] = {}
        """Id of a channel -> the id that the app gave to its subscription."""
        self.topics: dict[int, AppTopic] = {}
        """The app's id of a channel -> the topic that it publishes."""
        self.parameters: set[str] = set()
        """Names of the parameters that it subscribes."""
        self.wants_graph = False
        self.dropped = 0
        self.frame_bytes = 0
        """The size of the frame that is being handled: a task holds it until it ends."""
        self._task_bytes = 0
        self._in_tasks = held.share(self._give_up)
        self._unread = unread.share(self._give_up)
        self._socket = socket
        socket.on_room = self._flush
        self._answers: deque[bytes | str] = deque()
        self._answer_bytes = 0
        self._messages: deque[bytes] = deque()
        self._message_bytes = 0
        self._time: bytes | None = None
        self._has_room = asyncio.Event()
        self._has_room.set()
        self._tasks = Tasks()

    def send(self, frame: bytes | str) -> None:
        """Send a frame that must not be lost. An app with too many unread frames loses its connection."""
        if self._answer_bytes > _MOST_ANSWER_BYTES:
            self._socket.transport.abort()
            return
        self._answers.append(frame)
        self._answer_bytes += len(frame)
        if self._answer_bytes >= _MUCH_UNSENT:
            self._has_room.clear()
        self._flush()

    async def room(self) -> None:
        """Wait while many answers are unsent."""
        await self._has_room.wait()

    def send_message(self, frame: bytes) -> None:
        """Send a message; the oldest messages are dropped for a slow app."""
        messages = self._messages
        messages.append(frame)
        self._message_bytes += len(frame)
        while len(messages) > _MOST_MESSAGES or (self._message_bytes > _MOST_MESSAGE_BYTES and len(messages) > 1):
            self._message_bytes -= len(messages.popleft())
            self.dropped += 1
        self._flush()

    def send_time(self, frame: bytes) -> None:
        """Send the time; it replaces an unsent one."""
        self._time = frame
        self._flush()

    def fail(self, text: str) -> None:
        """Send an error text to the app."""
        self.send(status_frame(ERROR, text))

    def begin(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a task until the app disconnects. Raises BadFrame: too many tasks run already."""
        if len(self._tasks) >= _MOST_TASKS:
            work.close()
            raise BadFrame(f"{_MOST_TASKS} calls and files of this app are under way already")
        frame_bytes = _COPIES * self.frame_bytes

        def ended() -> None:
            self._task_bytes -= frame_bytes
            self._in_tasks.handled()
            self._in_tasks.set(self._task_bytes, self._task_bytes)

        self._tasks.begin(work, ended)
        self._task_bytes += frame_bytes
        self._in_tasks.set(self._task_bytes, self._task_bytes)

    def _give_up(self, reason: str) -> None:
        self._socket.end_at_once(TRY_LATER, reason)

    def _flush(self) -> None:
        """Write until the socket's buffer is full; `on_room` calls this again."""
        while not self._socket.is_full and (frame := self._next()) is not None:
            broadcast((self._socket,), frame)  # the library's way to send without waiting
        self._unread.set(self._answer_bytes + self._message_bytes)

    def _next(self) -> bytes | str | None:
        if self._answers:
            answer = self._answers.popleft()
            self._answer_bytes -= len(answer)
            if self._answer_bytes < _MUCH_UNSENT:
                self._has_room.set()
            return answer
        if self._time is not None:
            frame, self._time = self._time, None
            return frame
        if self._messages:
            message = self._messages.popleft()
            self._message_bytes -= len(message)
            return message
        return None

    def end(self) -> None:
        """Cancel the tasks of an app that has disconnected."""
        self._tasks.cancel()
        self._in_tasks.close()
        self._unread.close()
        self._answers.clear()
        self._messages.clear()
