"""Fixtures of the check room: files are written, checked, and their findings come back as lines."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from check_texts import Check, Lines

from slidectl.check.dispatch import check
from slidectl.description import Packages


@pytest.fixture(autouse=True)
def _alone(no_package_path: None) -> None:
    """Packages are those of the tests."""


@pytest.fixture
def model(write: Callable[[str, str], Path]) -> Check:
    """Checks a text as a model, with controllers if any are given."""

    def check_model(xml: str, controllers: str = "", name: str = "bot.urdf", **arguments: str) -> Lines:
        files = [write("control.yaml", controllers)] if controllers else []
        return Lines(check([str(write(name, xml))], arguments, Packages(), files))

    return check_model


@pytest.fixture
def controllers(write: Callable[[str, str], Path]) -> Check:
    """Checks a text as a file of controllers."""

    def check_controllers(yaml: str) -> Lines:
        return Lines(check([str(write("control.yaml", yaml))], {}, Packages()))

    return check_controllers
