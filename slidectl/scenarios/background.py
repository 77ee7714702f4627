"""Steps that go on in the background: threads of which only one runs at a time.

A background step runs until it waits for something; then the case goes on, and each time that what it waits for is
there, between two cycles, it has its turn. Who runs when depends on simulated time alone, so all stays repeatable.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Protocol

from slidectl.client import Client
from slidectl.client.link import ClientLink
from slidectl.daemon.in_process import InProcessLink, InProcessWorld

_TURN_EVERY_S = 0.1


class BackgroundStep:
    """Calls `action` with a client of its own, in a thread of its own. It begins at once, up to its first wait."""

    def __init__(
        self, link: Callable[[BackgroundStep], BackgroundLink], action: Callable[[Client], None], timeout: float
    ) -> None:
        self._link = link(self)
        self._client = Client(link=self._link, timeout=timeout)
        self._action = action
        self._mine, self._others = threading.Lock(), threading.Lock()  # each is released by who gives the turn
        self._mine.acquire()
        self._others.acquire()
        self._ending = False
        self._raised = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        self._switch()

    def _run(self) -> None:
        self._mine.acquire()
        try:
            self._action(self._client)
        finally:
            self._link.leave()
            self._client.close()
            self._others.release()

    def _switch(self) -> None:
        """It has its turn, until it waits or ends."""
        self._mine.release()
        self._others.acquire()

    def wait(self, deadline: float) -> None:
        """For its thread: the others have their turn, until something has come or the deadline has passed.

        Raises KeyboardInterrupt once when it is to end, as Ctrl-C would in a process of its own.
        """
        # A turn costs more than a cycle: messages of topics are taken many at a time.
        self._link.take_turn(self._switch, min(deadline, self._link.monotonic() + _TURN_EVERY_S))
        self._others.release()
        self._mine.acquire()
        if self._ending and not self._raised:
            self._raised = True
            raise KeyboardInterrupt

    @property
    def is_ending(self) -> bool:
        """True after its KeyboardInterrupt was raised: its waits run the world themselves."""
        return self._raised

    def end(self) -> None:
        """End it as Ctrl-C does, and wait for that."""
        if self._thread.is_alive():
            self._ending = True
            self._link.leave()  # it has no more turns
            self._switch()
        self._thread.join()


class BackgroundLink(ClientLink, Protocol):
    """A client's link whose waits give the turn to the others: to `BackgroundStep.wait`."""

    def take_turn(self, switch: Callable[[], None], due_s: float) -> None:
        """`switch` is to be called when something has come, or at a time of its clock."""

    def leave(self) -> None:
        """It is not called any more."""


class InProcessBackground(InProcessLink):
    """In a world in this process."""

    def __init__(self, world: InProcessWorld, step: BackgroundStep) -> None:
        super().__init__(world)
        self.connection.is_prompt = False
        self._step = step

    def take_turn(self, switch: Callable[[], None], due_s: float) -> None:
        """As BackgroundLink has it."""
        self.connection.on_lines, self.connection.due_s = switch, due_s

    def leave(self) -> None:
        """It is not called any more."""
        self.connection.on_lines = None

    def call_back(self, action: Callable[[], object] | None) -> bool:  # noqa: ARG002
        """It has its turn when something has come, which is as good."""
        return True

    def receive(self, deadline: float) -> dict[str, Any] | None:
        connection = self.connection
        while not self._step.is_ending and connection.open and not connection.has_lines and self.monotonic() < deadline:
            self._step.wait(deadline)
        return super().receive(deadline if self._step.is_ending else min(deadline, self.monotonic()))
