"""The controllers of docs/extending.md work as the page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from slidectl import Simulation, description
from slidectl.simulation.compiled import object_file

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def moved_by(class_name: str, folder: Path, engine: str = "auto") -> tuple[Simulation, float]:
    """Where the slider is after the set point 0.5, driven by that class of the page."""
    blocks = BLOCK.findall((ROOT / "docs" / "extending.md").read_text(encoding="utf-8"))
    [text] = [text for text in blocks if f"class {class_name}(Controller)" in text]
    file = folder / "my_laws.py"
    file.write_text(text, encoding="utf-8")
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
