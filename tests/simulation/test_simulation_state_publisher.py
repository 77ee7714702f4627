"""The state publisher of a robot does what its node's parameters say, as soon as they say it."""

from __future__ import annotations

from typing import Any

import pytest
from sim_robots import cart

from slidectl.simulation import Simulation

FREQUENCY = "/cart/robot_state_publisher/publish_frequency"
PREFIX = "/cart/robot_state_publisher/tf_prefix"


@pytest.fixture
def simulation() -> Simulation:
    simulation = Simulation()
    simulation.spawn(cart(), "cart")
    return simulation


def frames(simulation: Simulation, topic: str, cycles: int) -> list[list[str]]:
    """The child frames of each message that comes on the topic meanwhile."""
    found: list[list[str]] = []

    def take(message: dict[str, Any]) -> None:
        found.append([transform["child_frame_id"] for transform in message["transforms"]])

    subscription = simulation.subscribe(topic, take)
    simulation.step(cycles)
    subscription.close()
    return found


def test_frames_come_fifty_times_a_second_unless_somebody_says_otherwise(simulation: Simulation) -> None:
    assert len(frames(simulation, "/tf", 1000)) == 50
    simulation.parameters.set(FREQUENCY, 10.0)
    assert len(frames(simulation, "/tf", 1000)) == 10
    simulation.parameters.delete(FREQUENCY)
    assert len(frames(simulation, "/tf", 1000)) == 50


def test_a_change_takes_effect_for_those_who_listen_already(simulation: Simulation) -> None:
    count = 0

    def take(_message: dict[str, Any]) -> None:
        nonlocal count
        count += 1

    simulation.subscribe("/tf", take)
    simulation.parameters.set(FREQUENCY, 100)
    simulation.step(1000)
    assert count == 100


def test_frames_come_at_most_once_a_cycle(simulation: Simulation) -> None:
    simulation.parameters.set(FREQUENCY, 1e8)
    assert len(frames(simulation, "/tf", 100)) == 100


def test_of_a_tiny_frequency_no_frame_is_due(simulation: Simulation) -> None:
    simulation.parameters.set(FREQUENCY, 1e-300)
    assert frames(simulation, "/tf", 100) == []


@pytest.mark.parametrize("value", [0, -5.0, "often", True, 1e30, [1]])
def test_a_frequency_that_is_none_is_pointed_out_and_changes_nothing(simulation: Simulation, value: Any) -> None:
    warnings: list[str] = []
    simulation.subscribe("/rosout", lambda line: warnings.append(line["msg"]))
    simulation.parameters.set(FREQUENCY, value)
    assert "publish_frequency" in warnings[0]
    assert len(frames(simulation, "/tf", 1000)) == 50


def test_a_prefix_of_the_node_renames_moving_and_fixed_frames(simulation: Simulation) -> None:
    plain = frames(simulation, "/tf", 20)[0]
    simulation.parameters.set(PREFIX, "mine")
    assert frames(simulation, "/tf", 20)[0] == [f"mine/{frame}" for frame in plain]
    fixed = frames(simulation, "/tf_static", 0)
    assert all(frame.startswith("mine/") for frame in fixed[0]) if fixed else True


def test_parameters_that_are_there_before_the_robot_count_too() -> None:
    simulation = Simulation()
    simulation.parameters.set(FREQUENCY, 20)
    simulation.parameters.set(PREFIX, "early")
    simulation.spawn(cart(), "cart")
    found = frames(simulation, "/tf", 1000)
    assert len(found) == 20
    assert found[0][0].startswith("early/")


def test_a_deleted_robot_listens_to_its_parameters_no_more(simulation: Simulation) -> None:
    simulation.delete("cart")
    simulation.parameters.set(FREQUENCY, 10)
    assert not simulation.graph.topics.exists("/tf")


def test_a_state_publisher_can_be_taken_out_of_the_graph_and_put_back(simulation: Simulation) -> None:
    enabled = "/cart/robot_state_publisher/enabled"
    listeners = simulation.graph.topics
    simulation.parameters.set(enabled, False)
    assert listeners.publishers("/tf") == listeners.publishers("/tf_static") == []
    simulation.parameters.set(PREFIX, "left")
    simulation.parameters.delete(enabled)
    assert listeners.publishers("/tf") == ["/cart/robot_state_publisher"]
    assert all(name.startswith("left/") for names in frames(simulation, "/tf", 20) for name in names)


def parents(simulation: Simulation) -> set[str]:
    """The frames that others hang on."""
    found: set[str] = set()
    for topic in ("/tf", "/tf_static"):
        subscription = simulation.subscribe(
            topic, lambda message: found.update(each["header"]["frame_id"] for each in message["transforms"])
        )
        simulation.step(50)
        subscription.close()
    return found


def test_a_prefix_that_was_asked_for_goes_before_the_world_too_and_a_chosen_one_does_not() -> None:
    simulation = Simulation()
    simulation.spawn(cart(), "one", "/one")
    simulation.spawn(cart(), "two", "/two")
    assert "world" in parents(simulation)
    assert not {"one/world", "two/world"} & parents(simulation)
    simulation.parameters.set("/one/robot_state_publisher/tf_prefix", "first")
    assert "first/world" in parents(simulation)
    simulation.parameters.set("/two/robot_state_publisher/tf_prefix", "second")
    assert {"first/world", "second/world"} <= parents(simulation)
    assert "world" not in parents(simulation)


def test_the_prefix_chosen_for_a_robot_in_the_root_is_not_that_of_others() -> None:
    simulation = Simulation()
    simulation.spawn(cart(), "one", "/one")
    simulation.spawn(cart(), "two", "/")
    simulation.spawn(cart(), "three", "/three")
    found = {frame.partition("/")[0] for names in frames(simulation, "/tf", 20) for frame in names if "/" in frame}
    assert found == {"two", "three"}
