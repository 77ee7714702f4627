"""The two tutorials, each line typed in bash after `eval "$(slidectl ros-commands)"`, in their order.

In several terminals, as a reader has them: what a line prints, and what it does to the robot.
"""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import ROOT, CommandLine

from slidectl.client import Client

PATIENCE_S = 60.0
STAYS = "publishing and latching message. Press ctrl-C to terminate\n"
ONCE = "publishing and latching message for 3.0 seconds\n"


class Terminal:
    """A terminal of the reader's: one bash, into which lines are typed. What stdout and stderr get comes together."""

    def __init__(self, environment: dict[str, str], folder: Path) -> None:
        pipe, joined = subprocess.PIPE, subprocess.STDOUT
        self._process = subprocess.Popen(
            ["bash"], stdin=pipe, stdout=pipe, stderr=joined, env=environment, cwd=folder, start_new_session=True
        )
        self._serial = 0
        self._is_busy = False

    def type(self, line: str) -> tuple[str, int]:
        """What the line prints, and its exit code."""
        self._begin(line)
        return self._end()

    def start(self, line: str, until: str) -> str:
        """A line that stays; what it prints until it has printed that."""
        self._begin(line)
        return self._read_until(re.compile(until + ".*\n"))

    def interrupt(self) -> tuple[str, int]:
        """Ctrl-C; what the line prints then, and its exit code."""
        os.killpg(self._process.pid, signal.SIGINT)
        return self._end()

    def close(self) -> None:
        if self._is_busy:
            self.interrupt()
        self._process.communicate(timeout=PATIENCE_S)

    def _begin(self, line: str) -> None:
        assert self._process.stdin is not None
        self._serial += 1
        self._is_busy = True
        self._process.stdin.write(f'{line} </dev/null\necho "{self._mark}$?>"\n'.encode())
        self._process.stdin.flush()

    def _end(self) -> tuple[str, int]:
        text = self._read_until(re.compile(re.escape(self._mark) + r"\d+>\n"))
        self._is_busy = False
        printed, _, rest = text.partition(self._mark)
        return printed, int(rest.rstrip(">\n"))

    @property
    def _mark(self) -> str:
        return f"<line {self._serial} ended with "

    def _read_until(self, end: re.Pattern[str]) -> str:
        assert self._process.stdout is not None
        text = ""
        while not end.search(text):
            assert select.select([self._process.stdout], [], [], PATIENCE_S)[0], f"nothing more came after: {text}"
            piece = os.read(self._process.stdout.fileno(), 65536).decode()
            assert piece, f"bash has ended: {text}"
            text += piece
        return text


@pytest.fixture
def slidectl(tmp_path: Path) -> CommandLine:
    return CommandLine(tmp_path)


@pytest.fixture
def terminals(slidectl: CommandLine, tmp_path: Path) -> Iterator[Iterator[Terminal]]:
    """As many terminals as are wanted, each with the ROS commands defined; `slidectl` is on the PATH."""
    folder = tmp_path / "bin"
    folder.mkdir()
    program = folder / "slidectl"
    program.write_text(f'#!/bin/sh\nexec {slidectl.argv()[0]} -m slidectl "$@"\n')
    program.chmod(0o755)
    environment = {**slidectl.environment, "PATH": f"{folder}:{os.environ['PATH']}", "SHELL": "/bin/bash"}
    opened: list[Terminal] = []

    def more() -> Iterator[Terminal]:
        while True:
            opened.append(Terminal(environment, tmp_path))
            assert opened[-1].type('eval "$(slidectl ros-commands)"') == ("", 0)
            yield opened[-1]

    yield more()
    for terminal in reversed(opened):
        terminal.close()


def await_field(client: Client, topic: str, field: str, wanted: float, tolerance: float) -> None:
    """Until the field has been near that value for half a simulated second; the test fails when it never is."""
    answer = client.call(
        "/slidectl/wait",
        {"topic": topic, "field": field, "condition": "near", "value": str(wanted), "tolerance": tolerance,
         "hold": 0.5, "within": 40.0},
        timeout=PATIENCE_S,
    )  # fmt: skip
    assert answer["success"], answer["message"]


def states(client: Client, namespace: str) -> dict[str, str]:
    answer = client.call(f"{namespace}/controller_manager/list_controllers")
    return {controller["name"]: controller["state"] for controller in answer["controller"]}


def test_the_sliding_block(terminals: Iterator[Terminal], slidectl: CommandLine) -> None:
    launch, terminal = next(terminals), next(terminals)
    printed = launch.start("roslaunch my_slider slider.launch", "everything runs")
    assert "/urdf_spawner: slider spawned in /slider, joints: joint1\n" in printed
    assert "joint_state_controller, joint1_position_controller running in /slider\n" in printed
    with slidectl.client() as client:
        client.call("/slidectl/set_speed", {"speed": 0.0})
        assert states(client, "/slider") == {
            "joint_state_controller": "running",
            "joint1_position_controller": "running",
        }
        for wanted in (1.0, 0.0, -1.0):
            line = f'rostopic pub /slider/joint1_position_controller/command std_msgs/Float64 "data: {wanted}"'
            printed, code = terminal.type(line)
            assert code == 0
            assert printed == f"{STAYS}received by /gazebo; -l keeps it latched until Ctrl-C\n"
            await_field(client, "/slider/joint_states", "position[0]", wanted, 0.02)
    printed, code = launch.interrupt()
    assert code == 130
    assert "joint1_position_controller, joint_state_controller stopped and unloaded\n" in printed
    assert terminal.type("rostopic list")[1] == 3


CONTROLLERS = ("joint_state_controller", "joint1_position_controller", "joint2_position_controller")
NAMES = "['joint1_position_controller','joint2_position_controller']"
MANAGER = "rosservice call /rrbot/controller_manager"


def switch(start: str, stop: str) -> str:
    return f'{MANAGER}/switch_controller "{{start_controllers: {start}, stop_controllers: {stop}, strictness: 2}}"'


def command(joint: int, value: float) -> str:
    return f'rostopic pub -1 /rrbot/joint{joint}_position_controller/command std_msgs/Float64 "data: {value}"'


def test_rrbot(terminals: Iterator[Terminal], slidectl: CommandLine) -> None:
    world, control, terminal = next(terminals), next(terminals), next(terminals)
    printed = world.start("roslaunch rrbot_gazebo rrbot_world.launch", "everything runs")
    assert "rrbot spawned in /rrbot, joints: joint1 joint2" in printed
    printed = control.start("roslaunch rrbot_control rrbot_control.launch", "everything runs")
    assert f"{', '.join(CONTROLLERS)} running in /rrbot\n" in printed
    with slidectl.client() as client:
        client.call("/slidectl/set_speed", {"speed": 0.0})
        assert states(client, "/rrbot") == dict.fromkeys(CONTROLLERS, "running")

        # The launch file has loaded and started them: ros_control says no to a second time.
        for name in CONTROLLERS[1:]:
            printed, code = terminal.type(f"{MANAGER}/load_controller \"name: '{name}'\"")
            assert printed.startswith("ok: False\n")
            assert (f"'{name}'" in printed, code) == (True, 1)
        printed, code = terminal.type(switch(NAMES, "[]"))
        assert (printed.partition("\n")[0], code) == ("ok: False", 1)
        assert terminal.type(switch("[]", NAMES)) == ("ok: True\n", 0)
        assert set(states(client, "/rrbot").values()) == {"running", "stopped"}
        assert terminal.type(switch(NAMES, "[]")) == ("ok: True\n", 0)
        assert states(client, "/rrbot") == dict.fromkeys(CONTROLLERS, "running")

        assert terminal.type(command(1, 1.5)) == (ONCE, 0)
        assert terminal.type(command(2, 1.0)) == (ONCE, 0)
        # With the tutorial's gains nothing integrates, so gravity holds the arm away from where it is asked to be.
        for joint, wanted in ((1, 1.5), (2, 1.0)):
            await_field(client, f"/rrbot/joint{joint}_position_controller/state", "set_point", wanted, 0.0)
            await_field(client, f"/rrbot/joint{joint}_position_controller/state", "error", 0.0, 0.25)

        for line in ("rosrun rqt_gui rqt_gui", "rosrun rviz rviz", "rqt", "rosrun rqt_plot", "gzclient"):
            printed, code = terminal.type(line)
            assert ("no windows here" in printed, code) == (True, 1)
        printed, code = terminal.type("roslaunch rrbot_control rrbot_rqt.launch")
        assert ("no windows here" in printed, code) == (True, 0)
    assert control.interrupt()[1] == 130
    assert world.interrupt()[1] == 130
    assert terminal.type("rostopic list")[1] == 3


def test_rrbot_with_its_controllers_loaded_by_hand(terminals: Iterator[Terminal], slidectl: CommandLine) -> None:
    """As the tutorial shows it without the launch file of the controllers: load, start, move, stop."""
    core, world, terminal = next(terminals), next(terminals), next(terminals)
    core.start("roscore", "started core service")
    assert terminal.type("rosnode list") == ("/gazebo\n/rosapi\n/slidectl\n", 0)
    world.start("roslaunch rrbot_gazebo rrbot_world.launch", "everything runs")
    with slidectl.client() as client:
        client.call("/slidectl/set_speed", {"speed": 0.0})
        printed, code = terminal.type("rostopic pub -1 /rrbot/joint2_position_controller/command std_msgs/Float64 1.0")
        assert ("no topic '/rrbot/joint2_position_controller/command'" in printed, code) == (True, 1)
        file = ROOT / "launch" / "rrbot_control" / "config" / "rrbot_control.yaml"
        assert terminal.type(f"rosparam load '{file}'") == ("", 0)
        for name in CONTROLLERS:
            printed, code = terminal.type(f"{MANAGER}/load_controller \"name: '{name}'\"")
            assert (printed.partition("\n")[0], code) == ("ok: True", 0)
        every = str(list(CONTROLLERS)).replace(" ", "")
        assert terminal.type(switch(every, "[]")) == ("ok: True\n", 0)
        assert terminal.type(command(2, -0.9)) == (ONCE, 0)
        await_field(client, "/rrbot/joint2_position_controller/state", "error", 0.0, 0.25)
        printed, code = terminal.type("rqt_plot '/rrbot/joint_states/position[1]'")
        assert ("type: slidectl plot '/rrbot/joint_states/position[1]'\n" in printed, code) == (True, 1)
        assert terminal.type("rosparam set /rrbot/joint2_position_controller/pid/p 300") == ("", 0)
        await_field(client, "/rrbot/joint2_position_controller/state", "error", 0.0, 0.1)
        assert terminal.type("rostopic echo -n 1 /rrbot/joint_states/name") == ("\n- joint1\n- joint2\n---\n", 0)
        printed, _ = terminal.type(f"{MANAGER}/list_controllers")
        assert printed.count('state: "running"') == 3
        assert terminal.type(switch("[]", NAMES)) == ("ok: True\n", 0)
        assert set(states(client, "/rrbot").values()) == {"running", "stopped"}
