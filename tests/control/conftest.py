"""Fixtures of the control tests."""

from __future__ import annotations

import pytest
from fake_node import FakeGraph

from slidectl.control import registry


@pytest.fixture(autouse=True)
def _own_types(monkeypatch: pytest.MonkeyPatch) -> None:
    """Types that a test registers are gone after it."""
    registry.common.types()  # imports the shipped ones
    monkeypatch.setattr(registry, "_shared", dict(registry._shared))


@pytest.fixture
def graph() -> FakeGraph:
    """An empty graph in memory."""
    return FakeGraph()
