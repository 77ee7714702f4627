"""The scenarios of docs/scenarios.md run as they stand, and the page names every key."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

from slidectl.extensions.scenarios.scenario_file import BASELINE_KEYS, SCENARIO_KEYS, STEP_KEYS, WORLD_KEYS

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```yaml\n# (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_every_scenario_of_the_page_ends_as_it_says(tmp_path: Path) -> None:
    for name, text in BLOCK.findall(PAGE):
        (tmp_path / name).write_text(text, "utf-8")
    words = [sys.executable, "-m", "slidectl", "test", str(tmp_path), "--json", "-n", "2"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=300)
    results = [json.loads(line) for line in done.stdout.splitlines()]
    assert [result["message"] for result in results if result["verdict"] not in ("passed", "xfailed")] == [], (
        done.stderr
    )
    assert len(results) == 8
    assert [result["id"] for result in results if result["verdict"] == "xfailed"] == [
        f"{tmp_path}/goals.yaml::beyond the end"
    ]


def test_the_page_names_every_key() -> None:
    for key in (*SCENARIO_KEYS, *STEP_KEYS, *WORLD_KEYS, *BASELINE_KEYS):
        assert re.search(rf"`{key}[`:]", PAGE), key
