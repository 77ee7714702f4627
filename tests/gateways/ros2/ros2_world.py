"""A world of slidectl with the gateway of ROS 2, and its domain."""

from __future__ import annotations

import json
import os
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from daemon_fixture import Runtime, running_daemon
from ros2_environment import free_domain
from ros2_node import running_node

from slidectl.client import Client

SPAWN = ["spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", "joint_state_controller",
         "joint1_position_controller"]  # fmt: skip


class World:
    """A daemon with the slider, the gateway, and the domain in which it is."""

    def __init__(self, runtime: Runtime, programs: Path, domain: int, packages: Path | None) -> None:
        self.runtime = runtime
        self.programs = programs
        self.domain = domain
        self.env = {**runtime.env, "ROS_DOMAIN_ID": str(domain)}
        if packages is not None:
            for variable in ("PYTHONPATH", "LD_LIBRARY_PATH"):
                self.env[variable] = os.pathsep.join(filter(None, [str(packages), self.env.get(variable)]))

    def run(self, *words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
        """slidectl of the environment with rclpy."""
        command = [str(self.programs / "slidectl"), *words]
        result = subprocess.run(command, env=self.env, capture_output=True, text=True, timeout=240)
        assert result.returncode == code, result.stdout + result.stderr
        return result

    def spawn(self) -> None:
        self.run(*SPAWN)

    def client(self) -> Client:
        return self.runtime.client(timeout=60)

    def status(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.run("gateway", "ros2", "status", "--json").stdout)
        return found

    @property
    def log(self) -> str:
        """The text of the gateway's log."""
        return (self.runtime.paths.folder / "gateway-ros2.log").read_text("utf-8")

    def node(self, name: str) -> Any:
        return running_node(self.programs, name, self.domain, self.env)


@contextmanager
def running_world(programs: Path, packages: Path | None = None, **options: Any) -> Iterator[World]:
    """A world with the slider; `packages` is a folder of further messages for the gateway and the nodes. `options`:
    of the daemon."""
    with running_daemon(rtf=1.0, **options) as runtime, free_domain() as domain:
        one = World(runtime, programs, domain, packages)
        one.spawn()
        one.run("gateway", "ros2", "start")
        yield one
        one.run("gateway", "ros2", "stop")


@contextmanager
def serving(client: Client) -> Iterator[None]:
    """Inside, the client answers calls of the services that it advertises."""
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            list(client.events(timeout=0.1))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
