"""Fixtures of the control tests."""

from __future__ import annotations

import pytest
from fake_node import FakeGraph


@pytest.fixture
def graph() -> FakeGraph:
    """An empty graph in memory."""
    return FakeGraph()
