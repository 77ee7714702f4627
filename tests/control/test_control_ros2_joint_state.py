"""joint_state_broadcaster: what is published, in which order, at which moments, and what is refused at the load."""

from __future__ import annotations

from math import isnan

import pytest
from fake_robot import STEP_NS, Bench, FakeRobot

from slidectl.errors import Refused

TOPIC = "/bot/joint_states"
JOINTS = {"wrist": "revolute", "arm": "prismatic", "base": "continuous", "flange": "fixed", "puck": "planar"}
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
URDF = (
    '<robot name="bot"><link name="world"/>'
    + "".join(
        f'<link name="of_{name}"/><joint name="{name}" type="{kind}"><parent link="world"/><child link="of_{name}"/>'
        f"{LIMIT}</joint>"
        for name, kind in JOINTS.items()
    )
    + "</robot>"
)


def bench_with(on_robot=("wrist", "arm", "base", "puck"), /, **parameters) -> Bench:
    values = {"type": "joint_state_broadcaster/JointStateBroadcaster", **parameters}
    bench = Bench(FakeRobot(on_robot), {"states": values})
    bench.graph.set("/bot/robot_description", URDF)
    for k, handle in enumerate(bench.robot.joints.values(), 1):
        handle.position, handle.velocity, handle.effort = 1.0 * k, 10.0 * k, 100.0 * k
    return bench


def message_of(bench: Bench, topic: str = TOPIC) -> dict:
    bench.start("states")
    bench.run()
    return bench.graph.sent(topic)[-1]


def stamps(bench: Bench) -> list[int]:
    """When messages were published, in cycles."""
    times = [message["header"]["stamp"] for message in bench.graph.sent(TOPIC)]
    return [(time["secs"] * 1_000_000_000 + time["nsecs"]) // STEP_NS for time in times]


# -- what ------------------------------------------------------------------------------------------------------------


def test_the_moving_joints_of_the_description_come_in_alphabetical_order() -> None:
    message = message_of(bench_with())
    assert message["name"] == ["arm", "base", "wrist"]
    assert message["position"] == [2.0, 3.0, 1.0]
    assert message["velocity"] == [20.0, 30.0, 10.0]
    assert message["effort"] == [200.0, 300.0, 100.0]
    assert message["header"]["frame_id"] == "base_link"


def test_without_the_filter_all_joints_of_the_hardware_are_published() -> None:
    assert message_of(bench_with(use_urdf_to_filter=False))["name"] == ["arm", "base", "puck", "wrist"]


def test_chosen_joints_have_the_chosen_states_and_nan_elsewhere() -> None:
    message = message_of(bench_with(joints=["wrist", "puck"], interfaces=["velocity"]))
    assert message["name"] == ["wrist", "puck"]
    assert message["velocity"] == [10.0, 40.0]
    assert all(map(isnan, message["position"] + message["effort"]))


def test_a_joint_that_is_chosen_twice_has_its_last_place() -> None:
    assert message_of(bench_with(joints=["arm", "base", "arm"], interfaces=["position"]))["name"] == ["base", "arm"]


@pytest.mark.parametrize("half", [{"joints": ["wrist"]}, {"interfaces": ["position"]}])
def test_joints_without_interfaces_choose_nothing_and_the_log_says_so(half: dict) -> None:
    bench = bench_with(**half)
    assert message_of(bench)["name"] == ["arm", "base", "wrist"]
    assert "joints and interfaces count only together" in bench.graph.lines("warn")


def test_extra_joints_come_last_with_zeros_unless_they_are_known() -> None:
    message = message_of(bench_with(extra_joints=["wheel", "arm"]))
    assert message["name"] == ["arm", "base", "wrist", "wheel"]
    assert [message[field][-1] for field in ("position", "velocity", "effort")] == [0.0, 0.0, 0.0]


def test_another_state_can_feed_a_field_unless_the_fields_own_one_is_chosen() -> None:
    swapped = {"map_interface_to_joint_state": {"effort": "velocity"}}
    message = message_of(bench_with(joints=["wrist"], interfaces=["velocity"], **swapped))
    assert (message["effort"], [*map(isnan, message["velocity"])]) == ([10.0], [True])
    bench = bench_with(joints=["wrist"], interfaces=["velocity", "effort"], **swapped)
    message = message_of(bench)
    assert (message["effort"], message["velocity"]) == ([100.0], [10.0])
    assert "map_interface_to_joint_state/effort has no effect" in bench.graph.lines("warn")


def test_a_field_that_is_fed_by_a_state_of_no_joint_is_nan() -> None:
    bench = bench_with(map_interface_to_joint_state={"effort": "torque"})
    message = message_of(bench)
    assert all(map(isnan, message["effort"]))
    assert message["position"] == [2.0, 3.0, 1.0]
    assert "is 'torque', which no joint has: effort is nan" in bench.graph.lines("warn")


def test_local_topics_are_below_the_controller() -> None:
    bench = bench_with(use_local_topics=True)
    assert message_of(bench, "/bot/states/joint_states")["name"] == ["arm", "base", "wrist"]
    assert TOPIC not in bench.graph.publishers


def test_an_empty_frame_is_reported() -> None:
    bench = bench_with(frame_id="")
    assert message_of(bench)["header"]["frame_id"] == ""
    assert "/bot/states/frame_id is empty" in bench.graph.lines("warn")


# -- when ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "first"),
    [
        (0, [2, 3, 4, 5]),
        (1000, [2, 3, 4, 5]),
        (250, [2, 6, 10, 14]),
        (300, [2, 5, 8, 11]),  # 1000 / 300 is 3.33
        (400, [2, 5, 8, 11]),  # 2.5 is rounded up
        (700, [2, 3, 4, 5]),  # 1.43
        (5000, [2, 3, 4, 5]),
    ],
)
def test_a_message_comes_with_each_update(rate: int, first: list[int]) -> None:
    bench = bench_with(update_rate=rate)
    bench.start("states")  # cycle 1
    bench.run(20)
    assert stamps(bench)[:4] == first
    is_exact = rate in (0, 1000, 250)
    assert bool(bench.graph.lines("warn")) is not is_exact


def test_a_rate_that_cannot_be_met_is_reported_with_the_one_that_counts() -> None:
    bench = bench_with(update_rate=300)
    bench.start("states")
    bench.run(20)
    expected = "/bot/states/update_rate is 300, which does not divide the rate of the control cycle, 1000: "
    assert bench.graph.lines("warn") == expected + "the controller is updated 333.333 times per second"
    faster = bench_with(update_rate=2000)
    faster.start("states")
    faster.run(3)
    assert "the control cycle runs 1000 times per second: the controller is updated in each" in faster.graph.lines()


def test_a_new_start_begins_a_new_period() -> None:
    bench = bench_with(update_rate=100)
    bench.start("states")
    bench.run(4)
    assert bench.request(stop=["states"])
    bench.run()
    assert bench.request(start=["states"])
    bench.run(2)
    assert stamps(bench) == [2, 8]


def test_no_message_is_built_while_nobody_subscribes() -> None:
    bench = bench_with()
    bench.start("states")
    bench.graph.publishers[TOPIC].wanted = False
    bench.run(5)
    assert bench.graph.sent(TOPIC) == []
    assert bench.graph.publishers[TOPIC].sequence == 5


# -- refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"joints": ["elbow"], "interfaces": ["position"]}, "no joint 'elbow'"),
        ({"joints": ["arm"], "interfaces": ["torque"]}, "the state interfaces of a joint are effort, position, vel"),
        ({"update_rate": -1}, "parameter /bot/states/update_rate must be 0 or above, not -1"),
    ],
)
def test_what_does_not_exist_is_not_loaded(parameters: dict, text: str) -> None:
    bench = bench_with(**parameters)
    assert not bench.manager.load("states")
    assert text in bench.graph.lines("error")
    assert not bench.graph.publishers


def test_without_a_description_or_a_joint_of_it_nothing_is_loaded() -> None:
    bench = bench_with(("puck",))
    assert not bench.manager.load("states")
    assert "/bot/states has no state of a joint to publish" in bench.graph.lines("error")
    bench = bench_with()
    bench.graph.delete("/bot/robot_description")
    assert not bench.manager.load("states")
    assert "parameter /bot/robot_description is not set" in bench.graph.lines("error")


def test_a_parameter_is_fixed_when_the_controller_is_loaded() -> None:
    bench = bench_with()
    bench.load("states")
    with pytest.raises(Refused, match="/bot/states/frame_id is fixed when the controller is loaded") as refusal:
        bench.graph.set("/bot/states/frame_id", "map")
    assert refusal.value.hint == "unload it first: slidectl controller unload states"
    assert bench.manager.unload("states")
    bench.graph.set("/bot/states/frame_id", "map")
