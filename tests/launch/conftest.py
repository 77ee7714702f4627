"""A folder with a package and launch files in it, and plans made of texts."""

from __future__ import annotations

from pathlib import Path

import pytest
from launch_files import Workspace


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    """A package called `demo`; no search path leads anywhere else."""
    for variable in ("SLIDECTL_PACKAGE_PATH", "ROS_PACKAGE_PATH", "CMAKE_PREFIX_PATH", "GAZEBO_RESOURCE_PATH"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.chdir(tmp_path)
    return Workspace(tmp_path)
