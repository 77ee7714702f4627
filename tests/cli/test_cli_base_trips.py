"""How many round trips a command takes: how often it sends something after it has waited for an answer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from command_line import CommandLine

COUNT = """
import os, sys
import slidectl.cli
from slidectl.client.link import SocketLink
from slidectl.client.client import Client
target = sys.argv.pop(1)
trips, waited = 0, True
def send(link, line, deadline, real=SocketLink.send):
    global trips, waited
    trips, waited = trips + waited, False
    real(link, line, deadline)
def answer(client, call_id, timeout, real=Client._answer):
    global waited
    waited = True
    return real(client, call_id, timeout)
SocketLink.send, Client._answer = send, answer
def leave(code):
    with open(target, "w") as file:
        file.write(f"{code} {trips}")
    os._exit(0)
slidectl.cli.leave = leave
slidectl.cli.entry()
"""


def trips(world: CommandLine, tmp_path: Path, *words: str) -> int:
    target = tmp_path / "trips"
    command = [sys.executable, "-c", COUNT, str(target), *words]
    done = subprocess.run(command, env=world.environment, capture_output=True, text=True, timeout=60, check=False)
    code, count = map(int, target.read_text(encoding="utf-8").split())
    assert code == 0, done.stderr
    return count


@pytest.fixture(scope="module")
def slider(world: CommandLine, tmp_path_factory: pytest.TempPathFactory) -> CommandLine:
    controllers = ("joint_state_controller", "joint1_position_controller")
    words = ("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *controllers)
    assert trips(world, tmp_path_factory.mktemp("spawn"), *words) <= 6
    return world


def test_spawning_a_controller_takes_few_round_trips_however_many_managers_there_are(
    slider: CommandLine, tmp_path: Path
) -> None:
    slider.ok("spawn", "rrbot", "--controllers", "config/rrbot_control.yaml")
    words = ("controller", "spawn", "joint_state_controller", "joint1_position_controller", "--cm", "/rrbot")
    assert trips(slider, tmp_path, *words[:3], "joint2_position_controller") <= 5
    assert trips(slider, tmp_path, *words) <= 5
    slider.ok("delete", "rrbot")
    slider.ok("param", "delete", "/rrbot")


@pytest.mark.parametrize(
    ("most", "words"),
    [
        (2, ("pub", "command", "1.0")),
        (2, ("service", "call", "list_controllers")),
        (1, ("service", "info", "list_controllers")),
        (2, ("param", "get", "pid")),
        (1, ("echo", "clock", "-n", "0")),
    ],
)
def test_a_command_takes_few_round_trips(
    slider: CommandLine, tmp_path: Path, most: int, words: tuple[str, ...]
) -> None:
    assert trips(slider, tmp_path, *words) <= most
