"""Fixtures of the description room: texts become robots, and files with folders around them."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from slidectl.description import Robot, parse
from slidectl.errors import BadFile


@pytest.fixture(autouse=True)
def _alone(no_package_path: None) -> None:
    """Packages are those of the tests."""


@pytest.fixture
def refuse() -> Callable[[str], BadFile]:
    """Parses a text that must be refused, strictly, and gives the error."""

    def parse_refused(xml: str) -> BadFile:
        with pytest.raises(BadFile) as caught:
            parse(xml, "bot.urdf", strict=True)
        return caught.value

    return parse_refused


@pytest.fixture
def notices() -> Callable[[str], list[str]]:
    """Parses a text and gives its report as lines."""

    def parse_report(xml: str) -> list[str]:
        robot: Robot = parse(xml, "bot.urdf")
        return [f"{notice.verdict} {notice}" for notice in robot.report]

    return parse_report
