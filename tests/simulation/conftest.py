"""Fixtures of the simulation's tests: a bare graph."""

from __future__ import annotations

import pytest

from slidectl.simulation.graph import Graph


@pytest.fixture
def graph() -> Graph:
    return Graph()
