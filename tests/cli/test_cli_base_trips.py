"""What a command costs: round trips (how often it sends something after an answer), requests, calls of functions."""

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
trips, requests, waited = 0, 0, True
def send(link, line, deadline, real=SocketLink.send):
    global trips, requests, waited
    trips, requests, waited = trips + waited, requests + 1, False
    real(link, line, deadline)
def answer(client, call_id, timeout, real=Client._answer):
    global waited
    waited = True
    return real(client, call_id, timeout)
SocketLink.send, Client._answer = send, answer
def leave(code):
    with open(target, "w") as file:
        file.write(f"{code} {trips} {requests}")
    os._exit(0)
slidectl.cli.leave = leave
slidectl.cli.entry()
"""
WALK = """
import os, sys
import slidectl.cli
target = sys.argv.pop(1)
root = os.path.dirname(slidectl.__file__) + os.sep
calls, files, importing = 0, set(), 0
def note(frame, event, _):
    global calls, importing
    code = frame.f_code
    if not code.co_filename.startswith(root):
        return
    if code.co_name == "<module>":
        importing += {"call": 1, "return": -1}.get(event, 0)
    elif event == "call" and not importing and (code.co_name == "<lambda>" or code.co_name[0] != "<"):
        calls += 1
        files.add(code.co_filename)
def leave(code):
    sys.setprofile(None)
    with open(target, "w") as file:
        file.write(f"{code} {calls} {len(files)}")
    os._exit(0)
slidectl.cli.leave = leave
sys.setprofile(note)
slidectl.cli.entry()
"""
"""Counts the calls of functions of slidectl, and the files that they are in, without what runs when one is imported."""


def counted(code: str, world: CommandLine, tmp_path: Path, *words: str) -> tuple[int, int]:
    """The two numbers that the code counts while the command runs."""
    target = tmp_path / "counted"
    command = [sys.executable, "-c", code, str(target), *words]
    done = subprocess.run(command, env=world.environment, capture_output=True, text=True, timeout=60, check=False)
    left, first, second = map(int, target.read_text(encoding="utf-8").split())
    assert left == 0, done.stderr
    return first, second


def trips(world: CommandLine, tmp_path: Path, *words: str) -> int:
    return counted(COUNT, world, tmp_path, *words)[0]


@pytest.fixture(scope="module")
def slider(world: CommandLine, tmp_path_factory: pytest.TempPathFactory) -> CommandLine:
    controllers = ("joint_state_controller", "joint1_position_controller")
    words = ("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *controllers)
    round_trips, requests = counted(COUNT, world, tmp_path_factory.mktemp("spawn"), *words)
    assert round_trips <= 6
    assert requests <= 8
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


def test_pub_walks_through_few_functions_in_few_files(slider: CommandLine, tmp_path: Path) -> None:
    calls, files = counted(WALK, slider, tmp_path, "pub", "command", "1.0")
    assert calls <= 200
    assert files <= 19
