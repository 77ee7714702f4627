"""Fixtures of the description room: texts become robots, and files with folders around them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from slidectl.description import Robot, parse
from slidectl.errors import BadFile


@pytest.fixture(autouse=True)
def _no_package_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of whoever runs the tests finds no package for them."""
    for variable in ("SLIDECTL_PACKAGE_PATH", "ROS_PACKAGE_PATH"):
        monkeypatch.delenv(variable, raising=False)


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str, str], Path]:
    """Writes a text to a file below the test's own folder."""

    def write_file(name: str, text: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
        return path

    return write_file


@pytest.fixture
def refuse() -> Callable[[str], BadFile]:
    """Parses a text that must be refused, and gives the error."""

    def parse_refused(xml: str) -> BadFile:
        with pytest.raises(BadFile) as caught:
            parse(xml, "bot.urdf")
        return caught.value

    return parse_refused


@pytest.fixture
def notices() -> Callable[[str], list[str]]:
    """Parses a text and gives its report as lines."""

    def parse_report(xml: str) -> list[str]:
        robot: Robot = parse(xml, "bot.urdf")
        return [f"{notice.verdict} {notice}" for notice in robot.report]

    return parse_report
