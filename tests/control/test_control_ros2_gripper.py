"""The parallel gripper of ROS 2: goals that are reached, stalled, allowed to stall, cancelled, replaced and refused."""

from __future__ import annotations

from math import nan

import pytest
from fake_gripper import ACTION, Gripper

from slidectl.control.node_handle import GoalStatus

TYPE = "parallel_gripper_action_controller/GripperActionController"


class Hand(Gripper):
    def __init__(self, **parameters: object) -> None:
        super().__init__("position", "control_msgs/ParallelGripperCommand", {"type": TYPE, **parameters})

    def goal(self, *position: float) -> str:
        return self.send({"position": list(position)})


@pytest.fixture
def hand() -> Hand:
    hand = Hand(stall_timeout=0.1)
    hand.start("hand")
    return hand


def test_a_goal_succeeds_near_its_position(hand: Hand) -> None:
    name = hand.goal(0.5)
    hand.run(200)
    assert hand.results() == [(name, GoalStatus.SUCCEEDED, True, False)]
    state = hand.graph.sent(f"{ACTION}/result")[0]["result"]["state"]
    assert state["position"] == [pytest.approx(0.5, abs=0.01)]
    assert state["effort"] == [0.0]
    assert hand.graph.sent(f"{ACTION}/feedback") == []


def test_a_goal_that_is_met_already_succeeds_without_motion(hand: Hand) -> None:
    name = hand.goal(0.005)
    hand.run(100)
    assert hand.results() == [(name, GoalStatus.SUCCEEDED, True, False)]


@pytest.mark.parametrize("allowed", [False, True])
def test_something_in_the_way_stalls_a_goal_and_the_gripper_goes_on_holding_it(allowed: bool) -> None:
    hand = Hand(stall_timeout=0.1, allow_stalling=allowed)
    hand.start("hand")
    hand.stop_at = 0.3
    name = hand.goal(0.5)
    hand.run(300)
    status = GoalStatus.SUCCEEDED if allowed else GoalStatus.ABORTED
    assert hand.results() == [(name, status, False, True)]
    assert hand.graph.sent(f"{ACTION}/result")[0]["result"]["state"]["position"] == [0.3]
    assert hand.finger.command == 0.5


def test_a_cancelled_goal_stays_where_it_is_and_a_new_one_replaces_the_old(hand: Hand) -> None:
    first = hand.goal(0.5)
    hand.run(5)
    position = hand.finger.position
    hand.cancel(first)
    hand.run()
    assert hand.finger.command == position
    second = hand.goal(0.8)
    hand.run(5)
    third = hand.goal(0.1)
    hand.run(200)
    assert [result[:2] for result in hand.results()] == [
        (first, GoalStatus.PREEMPTED), (second, GoalStatus.PREEMPTED), (third, GoalStatus.SUCCEEDED)
    ]  # fmt: skip


def test_a_goal_that_cannot_be_followed_is_rejected(hand: Hand) -> None:
    for positions, reason in (((), "one position, not 0"), ((0.1, 0.2), "one position, not 2"), ((nan,), "finite")):
        hand.goal(*positions)
        assert hand.results()[-1][1] == GoalStatus.REJECTED
        assert reason in hand.graph.lines("error")
    hand.goal(0.5)
    hand.request(stop=["hand"])
    hand.run()
    assert hand.results()[-1][1] == GoalStatus.PREEMPTED
    hand.goal(0.5)
    assert hand.results()[-1][1] == GoalStatus.REJECTED
    assert "not running" in hand.graph.lines("error")


def test_an_update_rate_slows_it_and_a_start_holds_the_measured_position() -> None:
    slow = Hand(update_rate=10)
    slow.finger.position = 0.25
    slow.start("hand")
    slow.run(50)
    assert slow.finger.command == 0.25
    name = slow.goal(0.26)
    slow.run(300)
    assert slow.results() == [(name, GoalStatus.SUCCEEDED, True, False)]


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"state_interfaces": ["position"]}, "state_interfaces lacks velocity"),
        ({"goal_tolerance": -1.0}, "goal_tolerance must be a number of 0 or more, not -1"),
        ({"action_monitor_rate": 0.0}, "action_monitor_rate must be a number of 0.1 or more, not 0"),
        ({"action_monitor_rate": 1e12}, "action_monitor_rate must be a rate above 0, not 1e+12"),
        ({"stall_timeout": "soon"}, "stall_timeout must be a number, not the string 'soon'"),
    ],
)
def test_wrong_parameters_are_refused(parameters: dict[str, object], reason: str) -> None:
    hand = Hand(**parameters)
    assert not hand.manager.load("hand")
    assert reason in hand.graph.lines("error")


def test_interfaces_that_only_a_real_gripper_has_are_reported() -> None:
    hand = Hand(max_effort_interface="finger/set_gripper_max_effort", max_effort=50.0)
    hand.start("hand")
    assert "max_effort_interface has no effect: the simulated gripper has no interface" in hand.graph.lines("warn")
