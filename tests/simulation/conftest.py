"""Fixtures of the simulation's tests: a graph that serves actions, and nothing else."""

from __future__ import annotations

import pytest

from slidectl.features.action_server import ActionServer
from slidectl.simulation.graph import Graph


@pytest.fixture
def graph() -> Graph:
    bare = Graph()
    bare.serve_actions(ActionServer)
    return bare
