"""tf2_msgs, control_msgs and controller_manager_msgs, which rclpy's wheels lack, built from their sources in msgs/."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

from ros2_environment import lacks, made_once, run

HERE = Path(__file__).parent
SOURCES, BUILDER = HERE / "msgs", HERE / "build_messages.py"


def message_packages(programs: Path) -> Path:
    """A folder for PYTHONPATH and LD_LIBRARY_PATH, for this environment with rclpy; made once for all runs.

    Without a compiler for C++ the test is skipped, and fails where CI is set.
    """
    if shutil.which("g++") is None:
        lacks("g++, which compiles messages of ROS 2")
    environment = programs.parent
    digest = hashlib.sha256((environment / ".installed").read_bytes())
    for path in (BUILDER, *sorted(path for path in SOURCES.rglob("*") if path.is_file())):
        digest.update(str(path.relative_to(HERE)).encode() + path.read_bytes())
    made = environment.with_name(f"{environment.name}-messages")
    return made_once(
        made, digest.hexdigest(), lambda: run(str(programs / "python"), str(BUILDER), str(SOURCES), str(made))
    )
