"""A daemon with the slider and its two controllers running, for tests that type commands at it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from command_line import CommandLine
from daemon_fixture import Runtime, running_daemon

from slidectl.client import Client

CONTROLLERS = ("joint_state_controller", "joint1_position_controller")
COMMAND = "/slider/joint1_position_controller/command"
JOINT_STATES = "/slider/joint_states"


class World:
    """The daemon, the command line that reaches it, and a client for what a test does or sees beside it."""

    def __init__(self, daemon: Runtime, client: Client) -> None:
        self.daemon = daemon
        self.slidectl = CommandLine(daemon.folder)
        self.client = client

    def spawn(self, name: str = "slider") -> None:
        """A slider in a namespace of its name, with its controllers running."""
        self.slidectl.ok(
            "spawn", "slider", "-n", name, "--controllers", "config/slider_control.yaml", "--start", *CONTROLLERS
        )

    @contextmanager
    def running(self, *words: str) -> Iterator[subprocess.Popen[str]]:
        """A command that goes on until it is ended; killed when the test is over."""
        with self.slidectl.start(*words) as process:
            try:
                yield process
            finally:
                process.kill()

    def latch(self, topic: str, type_name: str, message: dict[str, Any]) -> None:
        """Publish a message that stays for those who come later."""
        self.client.publish(topic, message, type_name, latch=True)
        self.client.flush()

    def has_subscriber(self, topic: str) -> bool:
        """True when somebody subscribes to the topic."""
        return bool(self.client.call("/rosapi/subscribers", {"topic": topic})["subscribers"])


@contextmanager
def slider_world(**options: Any) -> Iterator[World]:
    """A world with one slider."""
    with running_daemon(**options) as daemon, daemon.client() as client:
        world = World(daemon, client)
        world.spawn()
        yield world
