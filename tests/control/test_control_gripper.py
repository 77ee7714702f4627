"""The gripper: goals that are reached, stalled, cancelled and refused, on positions and on efforts."""

from __future__ import annotations

from math import nan

import pytest
from fake_gripper import ACTION, Gripper

from slidectl.control.node_handle import GoalStatus

URDF = """<robot name="bot"><link name="world"/><link name="a"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="finger" type="prismatic"><parent link="world"/><child link="a"/>
    <limit lower="0" upper="1" effort="9" velocity="9"/></joint></robot>"""


class Hand(Gripper):
    def __init__(self, kind: str = "position", **parameters: object) -> None:
        type_name = f"{kind}_controllers/GripperActionController"
        super().__init__(kind, "control_msgs/GripperCommand", {"type": type_name, **parameters})
        self.graph.set("/bot/robot_description", URDF)

    def goal(self, position: float, max_effort: float = 1.0) -> str:
        return self.send({"position": position, "max_effort": max_effort})


@pytest.fixture
def hand() -> Hand:
    hand = Hand(stall_timeout=0.1)
    hand.start("hand")
    return hand


def test_a_goal_succeeds_near_its_position(hand: Hand) -> None:
    name = hand.goal(0.5, 3.0)
    hand.run(200)
    assert hand.results() == [(name, GoalStatus.SUCCEEDED, True, False)]
    result = hand.graph.sent(f"{ACTION}/result")[0]["result"]
    assert result["position"] == pytest.approx(0.5, abs=0.01)
    assert result["effort"] == 3.0
    assert hand.graph.sent(f"{ACTION}/feedback") == []


def test_a_goal_with_something_in_the_way_is_aborted_as_stalled(hand: Hand) -> None:
    hand.stop_at = 0.3
    name = hand.goal(0.5)
    hand.run(300)
    assert hand.results() == [(name, GoalStatus.ABORTED, False, True)]
    assert hand.finger.command == 0.5  # it goes on holding what it has


def test_a_cancelled_goal_stays_where_it_is(hand: Hand) -> None:
    name = hand.goal(0.5)
    hand.run(5)
    position = hand.finger.position
    hand.cancel(name)
    hand.run()
    assert hand.results() == [(name, GoalStatus.PREEMPTED, False, False)]
    assert hand.finger.command == position


def test_a_new_goal_preempts_the_old_one(hand: Hand) -> None:
    first = hand.goal(0.5)
    hand.run(5)
    second = hand.goal(0.1)
    hand.run(200)
    assert [result[:2] for result in hand.results()] == [(first, GoalStatus.PREEMPTED), (second, GoalStatus.SUCCEEDED)]


def test_a_goal_ends_when_its_controller_stops(hand: Hand) -> None:
    hand.goal(0.5)
    hand.request(stop=["hand"])
    hand.run()
    assert hand.results()[0][1] == GoalStatus.PREEMPTED


def test_a_goal_that_cannot_be_followed_is_rejected(hand: Hand) -> None:
    hand.goal(nan)
    assert hand.results()[0][1] == GoalStatus.REJECTED
    assert "must have finite numbers" in hand.graph.lines("error")
    hand.request(stop=["hand"])
    hand.run()
    hand.goal(0.5)
    assert hand.results()[1][1] == GoalStatus.REJECTED
    assert "not running" in hand.graph.lines("error")


class TestEfforts:
    @pytest.mark.parametrize(("max_effort", "expected"), [(2.0, 2.0), (-2.0, 2.0), (0.0, 0.0), (99.0, 50.0)])
    def test_the_pid_pushes_within_the_effort_of_the_goal(self, max_effort: float, expected: float) -> None:
        hand = Hand("effort", gains={"finger": {"p": 100.0}})
        hand.start("hand")
        hand.goal(0.5, max_effort)
        hand.run()
        assert hand.finger.command == expected

    def test_without_a_goal_it_holds_with_the_default_effort(self) -> None:
        hand = Hand("effort", gains={"finger": {"p": 100.0}}, max_effort=-1.5)
        hand.start("hand")
        hand.finger.position = 0.5
        hand.run()
        assert hand.finger.command == -1.5

    def test_without_gains_it_runs_and_pushes_nothing(self) -> None:
        hand = Hand("effort")
        hand.start("hand")
        hand.goal(0.5, 2.0)
        hand.run()
        assert hand.finger.command == 0.0
        assert "parameter /bot/hand/gains/finger/p is not set: the gripper has no effort" in hand.graph.lines("warn")


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"joint": 3}, "parameter /bot/hand/joint must be a string"),
        ({"joint": "thumb"}, "joint 'thumb'"),
        ({"action_monitor_rate": 0.0}, "action_monitor_rate must be a rate above 0"),
    ],
)
def test_it_is_not_loaded_with_parameters_that_it_cannot_follow(parameters: dict, text: str) -> None:
    hand = Hand(**parameters)
    assert not hand.manager.load("hand")
    assert text in hand.graph.lines("error")
    assert not hand.graph.subscribers


def test_it_is_not_loaded_without_a_robot_description() -> None:
    hand = Hand()
    hand.graph.delete("/bot/robot_description")
    assert not hand.manager.load("hand")
    assert "no parameter robot_description" in hand.graph.lines("error")
