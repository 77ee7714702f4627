"""Nodes of the real rclpy with the message packages that its wheels lack, beside a world of slidectl."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from message_packages import message_packages
from ros2_environment import DISTRIBUTIONS, folder_of
from ros2_node import Ros2Node
from ros2_world import World, running_world


@pytest.fixture(scope="module", params=list(DISTRIBUTIONS))
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    programs = folder_of(request.param)
    with running_world(programs, message_packages(programs)) as one:
        yield one


@pytest.fixture(scope="module")
def node(world: World) -> Iterator[Ros2Node]:
    with world.node("/test/listener") as one:
        yield one


def test_the_status_names_these_packages_no_longer(world: World, node: Ros2Node) -> None:
    left_out = {name.partition("/")[0] for name in world.status()["left_out"].split(", ")}
    assert not left_out & {"tf2_msgs", "control_msgs"}
    assert node.round_trips()["differ"] == []
