"""The server of an action on a graph: states of goals, cancellations, results, the list of states."""

from __future__ import annotations

from typing import Any

import pytest

from slidectl.control.node_handle import GoalHandle, GoalStatus
from slidectl.simulation.graph import Graph

ACTION = "/arm/gripper_cmd"
SECOND = 1_000_000_000


class Server:
    """An action server that accepts goals, unless it is told otherwise, and the topics as a client sees them."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.goals: list[GoalHandle] = []
        self.cancelled: list[GoalHandle] = []
        self.accepts = True
        self.seen: dict[str, list[dict[str, Any]]] = {"status": [], "result": [], "feedback": []}
        self.node = graph.node("/arm")
        self.node.advertise_action("gripper_cmd", "control_msgs/GripperCommand", self._on_goal, self.cancelled.append)
        for topic, messages in self.seen.items():
            graph.topics.subscribe(f"{ACTION}/{topic}", None, "/client", messages.append)

    def _on_goal(self, goal: GoalHandle) -> None:
        self.goals.append(goal)
        if self.accepts:
            goal.accept()

    def send(self, name: str = "g", stamp: int = 0) -> None:
        goal_id = {"id": name, "stamp": {"secs": stamp, "nsecs": 0}}
        message = {"goal_id": goal_id, "goal": {"command": {"position": 0.5}}}
        self.graph.topics.publish(f"{ACTION}/goal", None, message, "/client")

    def cancel(self, name: str = "", stamp: int = 0) -> None:
        message = {"id": name, "stamp": {"secs": stamp, "nsecs": 0}}
        self.graph.topics.publish(f"{ACTION}/cancel", None, message, "/client")

    def states(self) -> dict[str, GoalStatus]:
        """Of the last list."""
        return {entry["goal_id"]["id"]: GoalStatus(entry["status"]) for entry in self.seen["status"][-1]["status_list"]}

    def results(self) -> list[tuple[str, GoalStatus]]:
        return [(m["status"]["goal_id"]["id"], GoalStatus(m["status"]["status"])) for m in self.seen["result"]]

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            self.graph.clock.time_ns += SECOND // 10
            self.graph.timers.fire()


@pytest.fixture
def server(graph: Graph) -> Server:
    graph.clock.time_ns = 100 * SECOND
    return Server(graph)


def test_it_offers_the_five_topics_of_actionlib(server: Server) -> None:
    types = server.graph.topics.types()
    assert {name: types[f"{ACTION}/{name}"] for name in ("goal", "cancel", "status", "feedback", "result")} == {
        "goal": "control_msgs/GripperCommandActionGoal",
        "cancel": "actionlib_msgs/GoalID",
        "status": "actionlib_msgs/GoalStatusArray",
        "feedback": "control_msgs/GripperCommandActionFeedback",
        "result": "control_msgs/GripperCommandActionResult",
    }


def test_a_goal_is_accepted_and_succeeds(server: Server) -> None:
    server.send("g", stamp=99)
    assert server.goals[0].goal["command"]["position"] == 0.5
    assert server.states() == {"g": GoalStatus.ACTIVE}
    server.goals[0].succeed({"position": 0.5, "effort": 1.0, "stalled": False, "reached_goal": True})
    assert server.results() == [("g", GoalStatus.SUCCEEDED)]
    result = server.seen["result"][0]
    assert result["result"]["reached_goal"] is True
    assert result["header"]["stamp"] == {"secs": 100, "nsecs": 0}
    assert result["status"]["goal_id"]["stamp"] == {"secs": 99, "nsecs": 0}
    assert server.states() == {"g": GoalStatus.SUCCEEDED}


def test_feedback_names_its_goal(server: Server) -> None:
    server.send()
    server.goals[0].publish_feedback({"position": 0.1, "effort": 0.0, "stalled": False, "reached_goal": False})
    message = server.seen["feedback"][0]
    assert (message["status"]["goal_id"]["id"], message["feedback"]["position"]) == ("g", 0.1)


@pytest.mark.parametrize(
    ("method", "before", "after"),
    [
        ("reject", GoalStatus.PENDING, GoalStatus.REJECTED),
        ("cancel", GoalStatus.PENDING, GoalStatus.RECALLED),
        ("cancel", GoalStatus.ACTIVE, GoalStatus.PREEMPTED),
        ("abort", GoalStatus.ACTIVE, GoalStatus.ABORTED),
        ("succeed", GoalStatus.ACTIVE, GoalStatus.SUCCEEDED),
    ],
)
def test_each_end_has_its_state_and_a_default_result(
    server: Server, method: str, before: GoalStatus, after: GoalStatus
) -> None:
    server.accepts = before is GoalStatus.ACTIVE
    server.send()
    assert server.goals[0].status is before
    getattr(server.goals[0], method)()
    assert server.results() == [("g", after)]
    assert server.seen["result"][0]["result"]["reached_goal"] is False


@pytest.mark.parametrize(("method", "accepts"), [("succeed", False), ("abort", False), ("reject", True)])
def test_a_change_that_actionlib_does_not_know_is_an_error_and_changes_nothing(
    server: Server, method: str, accepts: bool
) -> None:
    server.accepts = accepts
    lines: list[str] = []
    server.graph.log.sink = lambda severity, node, text, time_ns: lines.append(text)  # noqa: ARG005
    server.send()
    getattr(server.goals[0], method)()
    assert server.results() == []
    assert "cannot become" in lines[0]


def test_a_goal_that_has_ended_does_not_end_again(server: Server) -> None:
    server.send()
    server.goals[0].succeed()
    server.goals[0].abort()
    assert server.results() == [("g", GoalStatus.SUCCEEDED)]


def test_a_cancellation_reaches_the_goal_of_its_id_and_no_other(server: Server) -> None:
    server.send("a")
    server.send("b")
    server.cancel("b")
    assert [goal.goal is server.goals[1].goal for goal in server.cancelled] == [True]
    assert server.states() == {"a": GoalStatus.ACTIVE, "b": GoalStatus.PREEMPTING}


def test_a_cancellation_without_id_and_stamp_is_for_all(server: Server) -> None:
    server.send("a")
    server.send("b")
    server.cancel()
    assert set(server.states().values()) == {GoalStatus.PREEMPTING}


def test_a_cancellation_with_a_stamp_is_for_all_up_to_it_also_those_to_come(server: Server) -> None:
    server.send("old", stamp=50)
    server.send("new", stamp=90)
    server.cancel(stamp=60)
    assert server.states() == {"old": GoalStatus.PREEMPTING, "new": GoalStatus.ACTIVE}
    server.send("late", stamp=55)
    assert server.results() == [("late", GoalStatus.RECALLED)]
    assert "timestamp is before" in server.seen["result"][0]["status"]["text"]
    assert len(server.goals) == 2


def test_after_a_reset_an_old_cancellation_hits_no_new_goal(server: Server) -> None:
    server.cancel(stamp=90)
    server.graph.clock.time_ns = SECOND
    server.send("new", stamp=1)
    assert server.states() == {"new": GoalStatus.ACTIVE}


def test_a_goal_that_was_cancelled_before_it_came_is_recalled(server: Server) -> None:
    server.cancel("early")
    assert server.cancelled == []
    server.send("early")
    assert server.goals == []
    assert server.results() == [("early", GoalStatus.RECALLED)]


def test_a_goal_that_comes_twice_is_one(server: Server) -> None:
    server.send("g")
    server.send("g")
    assert len(server.goals) == 1


def test_a_goal_without_an_id_gets_one_and_one_without_a_stamp_the_time(server: Server) -> None:
    server.send("")
    server.send("")
    entries = server.seen["status"][-1]["status_list"]
    assert len({entry["goal_id"]["id"] for entry in entries}) == 2
    assert all(entry["goal_id"]["id"] for entry in entries)
    assert entries[0]["goal_id"]["stamp"] == {"secs": 100, "nsecs": 0}


def test_states_are_published_five_times_a_second_and_ended_goals_leave_after_five(server: Server) -> None:
    server.send("a")
    server.send("b")
    server.goals[0].succeed()
    before = len(server.seen["status"])
    server.pass_time(1.0)
    assert len(server.seen["status"]) == before + 5
    assert set(server.states()) == {"a", "b"}
    server.pass_time(4.6)
    assert set(server.states()) == {"b"}


def test_a_goal_that_nobody_works_on_leaves_the_list_too(server: Server) -> None:
    server.send()
    server.goals[0].release()
    server.pass_time(5.6)
    assert server.states() == {}
    assert server.results() == []


def test_a_client_that_comes_late_gets_the_last_list(server: Server) -> None:
    server.send()
    late: list[dict[str, Any]] = []
    server.graph.topics.subscribe(f"{ACTION}/status", None, "/late", late.append)
    assert late[0]["status_list"][0]["goal_id"]["id"] == "g"


def test_everything_ends_with_the_node(server: Server) -> None:
    server.node.shutdown()
    count = len(server.seen["status"])
    server.pass_time(1.0)
    assert len(server.seen["status"]) == count
    assert server.graph.topics.publishers(f"{ACTION}/status") == []
