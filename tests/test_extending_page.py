"""The controller of docs/extending.md works as the page says."""

from __future__ import annotations

import re
from pathlib import Path

from slidectl import Simulation, description

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_the_controller_of_the_page_moves_the_slider_to_its_set_point(tmp_path: Path) -> None:
    [text] = BLOCK.findall((ROOT / "docs" / "extending.md").read_text(encoding="utf-8"))
    file = tmp_path / "my_laws.py"
    file.write_text(text, encoding="utf-8")
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
