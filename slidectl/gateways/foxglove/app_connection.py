"""One app that is connected: what waits to be sent to it, and what it has subscribed and advertised.

An app that does not read costs nobody anything: of its messages the oldest go, and are counted; when it leaves answers
unread too, the connection ends.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple

from websockets.asyncio.server import broadcast

from slidectl.gateways.foxglove.foxglove_frames import ERROR, BadFrame, status_frame
from slidectl.gateways.ros1.ros1_types import Ros1Type
from slidectl.gateways.tasks import Tasks
from slidectl.gateways.websocket_listener import ListenerConnection

_MOST_MESSAGES, _MOST_MESSAGE_BYTES = 10_000, 16 * 1024 * 1024
"""Messages that wait for one app."""
_MOST_ANSWER_BYTES = 32 * 1024 * 1024
"""Answers that wait for one app. The one that comes last may be larger: a file."""
_MUCH_UNSENT = 4 * 1024 * 1024
_MOST_TASKS = 32
"""Calls and files of one app that are under way."""


class AppTopic(NamedTuple):
    """A channel on which an app publishes."""

    topic: str
    type: Ros1Type
    encoding: str


class AppSocket(ListenerConnection):
    """Knows whether it takes more."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.is_full = False
        self.on_room: Callable[[], None] = lambda: None
        """Called when it takes more again."""

    def pause_writing(self) -> None:
        super().pause_writing()
        self.is_full = True

    def resume_writing(self) -> None:
        super().resume_writing()
        self.is_full = False
        self.on_room()


class AppConnection:
    """The app at the other end of a WebSocket."""

    def __init__(self, socket: AppSocket) -> None:
        self.subscriptions: dict[int, int] = {}
        """Id of a channel -> the id that the app gave to its subscription."""
        self.topics: dict[int, AppTopic] = {}
        """What it publishes, by the app's ids."""
        self.parameters: set[str] = set()
        """Names of which it wants to hear."""
        self.wants_graph = False
        self.dropped = 0
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
        """Have a frame sent that must not be lost. An app that leaves too many unread loses its connection."""
        if self._answer_bytes > _MOST_ANSWER_BYTES:
            self._socket.transport.abort()
            return
        self._answers.append(frame)
        self._answer_bytes += len(frame)
        if self._answer_bytes >= _MUCH_UNSENT:
            self._has_room.clear()
        self._flush()

    async def room(self) -> None:
        """Wait while much that was asked for is not sent yet."""
        await self._has_room.wait()

    def send_message(self, frame: bytes) -> None:
        """Have a message sent; the oldest go where it does not keep up."""
        messages = self._messages
        messages.append(frame)
        self._message_bytes += len(frame)
        while len(messages) > _MOST_MESSAGES or (self._message_bytes > _MOST_MESSAGE_BYTES and len(messages) > 1):
            self._message_bytes -= len(messages.popleft())
            self.dropped += 1
        self._flush()

    def send_time(self, frame: bytes) -> None:
        """Have the time sent, in place of one that is not sent yet."""
        self._time = frame
        self._flush()

    def fail(self, text: str) -> None:
        """Tell the app of an error."""
        self.send(status_frame(ERROR, text))

    def begin(self, work: Coroutine[Any, Any, None]) -> None:
        """Carry it out beside what else goes on, until the app goes. Raises BadFrame: too much goes on already."""
        if len(self._tasks) >= _MOST_TASKS:
            work.close()
            raise BadFrame(f"{_MOST_TASKS} calls and files of this app are under way already")
        self._tasks.begin(work)

    def _flush(self) -> None:
        """Write what the socket takes; the rest follows when it takes more."""
        while not self._socket.is_full and (frame := self._next()) is not None:
            broadcast((self._socket,), frame)  # the library's way to send without waiting

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
        """It has gone: nobody waits for what is under way."""
        self._tasks.cancel()
