"""Background steps: threads of which only one runs at a time.

A background step runs until it waits for something; then the case continues. Between two cycles it runs again when what
it waits for is there. The order depends on simulated time alone, so that every run is repeatable.
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
    """Runs `action` with its own client in its own thread. It starts at once, and runs to its first wait."""

    def __init__(
        self, link: Callable[[BackgroundStep], BackgroundLink], action: Callable[[Client], None], timeout: float
    ) -> None:
        self._link = link(self)
        self._client = Client(link=self._link, timeout=timeout)
        self._action = action
        self._mine, self._others = threading.Lock(), threading.Lock()  # released to let that side run
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
        """Let the step run until it waits or ends."""
        self._mine.release()
        self._others.acquire()

    def wait(self, deadline: float) -> None:
        """Called in the step's thread: let the others run until something is received or the deadline has passed.

        Raises KeyboardInterrupt once when the step is to end, like Ctrl-C in a separate process.
        """
        # A switch costs more than a cycle: so messages of topics are handled many at a time.
        self._link.switch_when_due(self._switch, min(deadline, self._link.monotonic() + _TURN_EVERY_S))
        self._others.release()
        self._mine.acquire()
        if self._ending and not self._raised:
            self._raised = True
            raise KeyboardInterrupt

    @property
    def is_ending(self) -> bool:
        """True after KeyboardInterrupt was raised: from then on the step's waits run the world themselves."""
        return self._raised

    def end(self) -> None:
        """End the step as Ctrl-C does, and wait for it."""
        if self._thread.is_alive():
            self._ending = True
            self._link.leave()  # it is not switched to any more
            self._switch()
        self._thread.join()


class BackgroundLink(ClientLink, Protocol):
    """A client's link that lets the others run while it waits, by calling `BackgroundStep.wait`."""

    def switch_when_due(self, switch: Callable[[], None], due_s: float) -> None:
        """Set `switch` to be called when something is received, or at a time of its clock."""

    def leave(self) -> None:
        """Cancel the call of `switch`."""


class InProcessBackground(InProcessLink):
    """The link to a world in this process."""

    def __init__(self, world: InProcessWorld, step: BackgroundStep) -> None:
        super().__init__(world)
        self.connection.is_prompt = False
        self._step = step

    def switch_when_due(self, switch: Callable[[], None], due_s: float) -> None:
        """As BackgroundLink.switch_when_due."""
        self.connection.on_lines, self.connection.due_s = switch, due_s

    def leave(self) -> None:
        """Cancel the call of `switch`."""
        self.connection.on_lines = None

    def call_back(self, action: Callable[[], object] | None) -> bool:  # noqa: ARG002
        """Do nothing: the step runs anyway when something is received."""
        return True

    def receive(self, deadline: float) -> dict[str, Any] | None:
        connection = self.connection
        while not self._step.is_ending and connection.open and not connection.has_lines and self.monotonic() < deadline:
            self._step.wait(deadline)
        return super().receive(deadline if self._step.is_ending else min(deadline, self.monotonic()))
