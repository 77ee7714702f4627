"""A slider for the tests of the gateway."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from daemon_fixture import Runtime, running_daemon


@pytest.fixture(scope="module")
def world() -> Iterator[Runtime]:
    """A paused slider that tells of its joint."""
    with running_daemon(paused=True) as runtime, runtime.client() as client:
        client.spawn("slider", controllers="config/slider_control.yaml", start=["joint_state_controller"])
        yield runtime
