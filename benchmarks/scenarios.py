"""Scenarios a second on two cores: the slider up, to the middle and down, 30 simulated seconds each, start included."""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from pathlib import Path

from benchmarks.harness import ENVIRONMENT, SLIDECTL, Row

CASES = 100
SCENARIO = """
cases: {cases}
setup:
  - spawn: slider --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller
steps:
  - {{pub: command 1.0}}
  - {{wait: "joint_states/position[0] --near 1.0 --tol 0.02", within: 15}}
  - {{at: 11.0, pub: command 0.5}}
  - {{wait: "joint_states/position[0] --near 0.5 --tol 0.02", within: 10}}
  - {{at: 20.0, pub: command -0.2}}
  - {{wait: "joint_states/position[0] --near -0.2 --tol 0.02", within: 10}}
  - at: 30.0
"""


def measure() -> list[Row]:
    """Rows of this module."""
    with tempfile.TemporaryDirectory(prefix="slidectl-bench-", dir="/tmp") as folder:
        file = Path(folder) / "slide.yaml"
        file.write_text(SCENARIO.format(cases=json.dumps([{"number": number} for number in range(CASES)])), "utf-8")
        one, every = min(_seconds(f"{file}::0") for _ in range(3)), min(_seconds(str(file)) for _ in range(3))
    rate = "scenarios: slider up, middle, down in 30 simulated s, -n 2"
    return [
        Row(rate, CASES / every, "1/s", 10, "higher", f"{CASES} of them, start-up included"),
        Row("slidectl test of one of them", one, "s", None, "lower"),
    ]


def _seconds(words: str) -> float:
    began = time.perf_counter()
    subprocess.run([SLIDECTL, "-q", "test", words, "-n", "2"], env=ENVIRONMENT, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began
