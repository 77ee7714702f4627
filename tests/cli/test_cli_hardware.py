"""Robot hardware and transmissions from the command line: options, launch files, imports, and what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import ROOT, CommandLine

HARDWARE = """
from slidectl.physics import MujocoRobotHW

class Weak(MujocoRobotHW):
    def write(self, time_ns, period_s):
        super().write(time_ns, period_s)
        if time_ns > 50_000_000:
            raise OSError("the motor is off")
"""

LAUNCH = """<launch>
<param name="wrist/gazebo_ros_control/transmissions" value="real"/>
<param name="robot_description" command="$(find xacro)/xacro {model}"/>
<node name="spawn" pkg="gazebo_ros" type="spawn_model" args="-urdf -param robot_description -model wrist"/>
</launch>"""


@pytest.fixture
def started(slidectl: CommandLine, tmp_path: Path) -> Iterator[CommandLine]:
    """A paused daemon that has imported hardware."""
    (tmp_path / "my_hw.py").write_text(HARDWARE)
    slidectl.ok("daemon", "start", "--paused", "--import", str(tmp_path / "my_hw.py"))
    yield slidectl
    slidectl("daemon", "stop")


def topics(slidectl: CommandLine) -> str:
    return slidectl.ok("topic", "list")


def test_the_option_goes_before_the_model_and_the_parameter_fills_what_it_leaves_open(
    started: CommandLine, tmp_path: Path
) -> None:
    assert "/wrist/actuator_states" not in topics(started)
    done = started("spawn", "wrist", "--transmissions", "gazebo")
    assert done.returncode == 0
    assert "/wrist/actuator_states" not in topics(started)
    started.ok("delete", "wrist")
    started.ok("spawn", "wrist", "transmissions:=gazebo", "--transmissions", "real")
    assert "/wrist/actuator_states" in topics(started)
    started.ok("delete", "wrist")
    open_one = tmp_path / "open.xacro"
    text = (ROOT / "models" / "wrist.xacro").read_text()
    open_one.write_text(text.replace("<transmissions>$(arg transmissions)</transmissions>", ""))
    controllers = tmp_path / "wrist.yaml"
    controllers.write_text("wrist: {gazebo_ros_control: {transmissions: real}}")
    started.ok("spawn", str(open_one))
    assert "/wrist/actuator_states" not in topics(started)
    started.ok("delete", "wrist")
    started.ok("spawn", str(open_one), "--controllers", str(controllers))
    assert "/wrist/actuator_states" in topics(started)
    started.ok("delete", "wrist")
    launch = tmp_path / "wrist.launch"
    launch.write_text(LAUNCH.format(model=open_one))
    started.ok("launch", str(launch))
    assert "/wrist/actuator_states" in topics(started)
    with started.client() as client:
        client.delete("wrist")
        robot = client.spawn(str(open_one), transmissions="gazebo")
        assert [joint["hardware_interface"] for joint in robot["joints"] if joint["type"] == "revolute"] == ["", ""]


def test_hardware_of_an_import_is_named_by_the_model_and_its_faults_by_the_status(
    started: CommandLine, tmp_path: Path
) -> None:
    model = tmp_path / "slider.xacro"
    text = (ROOT / "models" / "slider.xacro").read_text()
    model.write_text(text.replace("gazebo_ros_control/DefaultRobotHWSim", "my_hw/Week"))
    done = started("spawn", str(model))
    assert done.returncode == 1
    assert "no robotSimType 'my_hw/Week'. Did you mean 'my_hw/Weak'?" in done.stderr
    assert "robotSimTypes: gazebo_ros_control/DefaultRobotHWSim, my_hw/Weak" in done.stderr
    model.write_text(model.read_text().replace("my_hw/Week", "my_hw/Weak"))
    started.ok("spawn", str(model))
    done = started("sim", "step", "100")
    assert done.returncode == 1
    status = started.ok("sim", "status")
    assert "Weak.write: OSError: the motor is off" in status
    assert "my_hw.py:8" in status


def test_check_and_spawn_agree_on_transmissions_that_cannot_be(started: CommandLine, tmp_path: Path) -> None:
    model = tmp_path / "wrist.xacro"
    text = (ROOT / "models" / "wrist.xacro").read_text()
    model.write_text(text.replace("<role>joint2</role>", "<role>joint1</role>"))
    assert started("check", str(model), "--transmissions", "gazebo").returncode == 0
    for words in (["check", str(model)], ["spawn", str(model)]):
        done = started(*words)
        assert done.returncode in (1, 2)
        assert "the joints need the roles joint1 and joint2, each once; given: joint1, joint1" in done.stderr
        assert "wrist.xacro:" in done.stderr
