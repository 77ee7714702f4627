"""The controller and the hardware of docs/extending.md work as the page says."""

from __future__ import annotations

import math
import re
from pathlib import Path

from slidectl import Simulation, description

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def saved(file: Path, containing: str) -> Path:
    """The file, with the block of the page that has this in it."""
    blocks = BLOCK.findall((ROOT / "docs" / "extending.md").read_text(encoding="utf-8"))
    [text] = [block for block in blocks if containing in block]
    file.write_text(text, encoding="utf-8")
    return file


def test_the_controller_of_the_page_moves_the_slider_to_its_set_point(tmp_path: Path) -> None:
    file = saved(tmp_path / "my_laws.py", "class Spring")
    simulation = Simulation()
    simulation.spawn(description.load("slider").xml, "slider")
    simulation.parameters.set("/slider/spring/joint", "joint1")
    request = {"robot": "slider", "name": "spring", "file": str(file), "class_name": "Spring"}
    assert simulation.call("/slidectl/load_controller_file", request)["ok"]
    switch = {"start_controllers": ["spring"], "strictness": 2}
    assert simulation.call("/slider/controller_manager/switch_controller", switch)["ok"]
    simulation.publish("/slider/spring/command", {"data": 0.5})
    simulation.step(5000)
    [robot] = simulation.call("/slidectl/list_robots")["robots"]
    [position] = [joint["position"] for joint in robot["joints"] if joint["name"] == "joint1"]
    assert abs(position - 0.5) < 0.05


def test_the_hardware_of_the_page_lets_efforts_follow_with_its_time_constant(tmp_path: Path) -> None:
    file = saved(tmp_path / "my_hardware.py", "class SlowMotors")
    simulation = Simulation(imports=[str(file)])
    xml = description.load("slider").xml.replace("gazebo_ros_control/DefaultRobotHWSim", "my_hardware/SlowMotors")
    effort = {"type": "effort_controllers/JointEffortController", "joint": "joint1"}
    simulation.parameters.set("/slider", {"motor_time_constant": 0.1, "push": effort})
    simulation.spawn(xml, "slider")
    assert simulation.call("/slider/controller_manager/load_controller", {"name": "push"})["ok"]
    switch = {"start_controllers": ["push"], "strictness": 2}
    assert simulation.call("/slider/controller_manager/switch_controller", switch)["ok"]
    simulation.publish("/slider/push/command", {"data": 10.0})
    for seconds in (0.1, 0.2):
        simulation.step(100)
        effort = simulation.world.joint_state("slider", "joint1")[2]
        assert abs(effort - 10.0 * (1.0 - math.exp(-seconds / 0.1))) < 0.1
    simulation.reset_world()
    simulation.step(1)
    assert simulation.world.joint_state("slider", "joint1")[2] < 0.2
