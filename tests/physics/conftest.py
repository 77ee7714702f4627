"""Fixtures of the physics tests."""

from __future__ import annotations

import pytest
from physics_hardware import Bench


@pytest.fixture
def bench() -> Bench:
    """A world without ground and weight, and a graph, for one robot."""
    return Bench()
