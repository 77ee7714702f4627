"""The controllers and the hardware of docs/extending.md work as the page says."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from slidectl import Simulation, description
from slidectl.simulation.compiled import object_file

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def saved(file: Path, containing: str) -> Path:
    """The file, with the block of the page that has this in it."""
    blocks = BLOCK.findall((ROOT / "docs" / "extending.md").read_text(encoding="utf-8"))
    [text] = [block for block in blocks if containing in block]
    file.write_text(text, encoding="utf-8")
    return file


def moved_by(class_name: str, folder: Path, engine: str = "auto") -> tuple[Simulation, float]:
    """Where the slider is after the set point 0.5, driven by that class of the page."""
    file = saved(folder / "my_laws.py", f"class {class_name}(")
    simulation = Simulation(engine=engine)
    simulation.spawn(description.load("slider").xml, "slider")
    simulation.parameters.set("/slider/spring/joint", "joint1")
    request = {"robot": "slider", "name": "spring", "file": str(file), "class_name": class_name}
    assert simulation.call("/slidectl/load_controller_file", request)["ok"]
    switch = {"start_controllers": ["spring"], "strictness": 2}
    assert simulation.call("/slider/controller_manager/switch_controller", switch)["ok"]
    if engine == "compiled":
        simulation.engine.complete()
    simulation.publish("/slider/spring/command", {"data": 0.5})
    simulation.step(5000)
    [robot] = simulation.call("/slidectl/list_robots")["robots"]
    [position] = [joint["position"] for joint in robot["joints"] if joint["name"] == "joint1"]
    return simulation, position


def test_the_controller_of_the_page_moves_the_slider_to_its_set_point(tmp_path: Path) -> None:
    assert abs(moved_by("Spring", tmp_path)[1] - 0.5) < 0.05


@pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")
def test_the_compiled_controller_of_the_page_gives_the_same_bits(tmp_path: Path) -> None:
    _, plain = moved_by("QuickSpring", tmp_path, "plain")
    simulation, compiled = moved_by("QuickSpring", tmp_path, "compiled")
    assert plain == compiled
    assert abs(plain - 0.5) < 0.05
    cycles = simulation.engine.compiled
    assert cycles is not None
    [rows] = cycles._rows
    assert rows.fits()
    assert rows.interpreted == {}


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
