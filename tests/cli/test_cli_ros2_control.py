"""`slidectl controller` for a robot of ROS 2."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import ROOT, CommandLine

STATES, POSITION = "joint_state_controller", "joint1_position_controller"
HARDWARE = """
from slidectl.physics import MujocoRobotHW

class Ros2(MujocoRobotHW):
    is_of_ros2 = True
"""


@pytest.fixture
def started(slidectl: CommandLine, tmp_path: Path) -> Iterator[CommandLine]:
    """A paused daemon with the slider as a robot of ROS 2."""
    (tmp_path / "my_hw.py").write_text(HARDWARE)
    model = tmp_path / "slider.xacro"
    text = (ROOT / "models" / "slider.xacro").read_text()
    model.write_text(text.replace("gazebo_ros_control/DefaultRobotHWSim", "my_hw/Ros2"))
    slidectl.ok("daemon", "start", "--paused", "--import", str(tmp_path / "my_hw.py"))
    slidectl.ok("spawn", str(model), "--controllers", str(ROOT / "config" / "slider_control.yaml"))
    yield slidectl
    slidectl("daemon", "stop")


def test_controllers_of_a_robot_of_ros_2_go_through_its_states(started: CommandLine) -> None:
    assert started.ok("controller", "load", POSITION) == f"{POSITION}: unconfigured (was unloaded)\n"
    assert "unconfigured" in started.ok("controller", "list")
    assert started.ok("controller", "configure", POSITION) == f"{POSITION}: inactive (was unconfigured)\n"
    assert started.ok("controller", "start", POSITION) == f"{POSITION}: active (was inactive)\n"
    done = started("controller", "cleanup", POSITION)
    assert done.returncode == 1
    assert f"it is active; deactivate it first: slidectl controller stop {POSITION}" in done.stderr
    assert started.ok("controller", "stop", POSITION) == f"{POSITION}: inactive (was active)\n"
    assert started.ok("controller", "cleanup", POSITION) == f"{POSITION}: unconfigured (was inactive)\n"
    assert started.ok("controller", "start", POSITION) == f"{POSITION}: active (was unconfigured)\n"
    assert started.ok("controller", "unspawn", POSITION) == f"{POSITION}: unloaded (was active)\n"
    shown = started.ok("controller", "spawn", POSITION, STATES)
    assert shown == f"{POSITION}: active (was unloaded)\n{STATES}: active (was unloaded)\n"
    started.ok("controller", "switch", "--stop", POSITION)
    assert started.ok("controller", "spawn", POSITION) == f"{POSITION}: active (was inactive)\n"
    started.ok("controller", "unspawn", STATES)
    assert "unconfigured" in started.ok("controller", "spawn", "--stopped", STATES)


def test_the_service_refuses_to_start_what_is_unconfigured(started: CommandLine) -> None:
    started.ok("controller", "load", POSITION)
    request = f"{{start_controllers: [{POSITION}], strictness: 2}}"
    done = started("service", "call", "/slider/controller_manager/switch_controller", request)
    assert done.returncode == 1
    assert f"slidectl controller configure {POSITION}" in done.stderr


def test_a_robot_of_ros_1_has_nothing_to_configure(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start", "--paused")
    try:
        slidectl.ok("spawn", "slider", "--controllers", str(ROOT / "config" / "slider_control.yaml"))
        slidectl.ok("controller", "load", POSITION)
        done = slidectl("controller", "configure", POSITION)
        assert done.returncode == 1
        assert "/slider is no robot of ROS 2" in done.stderr
    finally:
        slidectl("daemon", "stop")
