"""The room is cheap to import, and plain robots never need what meshes and xacro need."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HEAVY = (
    "lxml",
    "xacro",
    "yaml",
    "numpy",
    "trimesh",
    "yourdfpy",
    "mujoco",
    "xml.dom.minidom",
    "urllib.request",
    "asyncio",
)

SCRIPT = f"""
import sys
from slidectl import description
description.parse('<robot name="a"><link name="world"/></robot>')
description.load('<robot name="a"><link name="world"/></robot>')
print([name for name in {HEAVY!r} if name in sys.modules])
"""


def test_reading_a_plain_robot_imports_nothing_heavy() -> None:
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout == "[]\n"
