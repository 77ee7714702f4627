"""`/slidectl/wait`: exact in simulated time, and clear about what was missed."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from slidectl.errors import BadMessage, Refused, UnknownName
from slidectl.features import waits
from slidectl.msgs.field_path import NoElement
from slidectl.simulation.graph import Graph
from slidectl.simulation.pending import Pending

MS = 1_000_000


class Scene:
    """A graph whose joint moves by hand: `play` publishes one position every cycle of 100 ms."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        waits.advertise(graph)
        self.joints = graph.topics.advertise("/joint_states", "sensor_msgs/JointState", "/gazebo")
        self.light = graph.topics.advertise("/light", "std_msgs/String", "/gazebo", latch=True)

    def wait(self, **request: Any) -> Pending:
        wanted = {"topic": "/joint_states", "field": "position[0]", "condition": "near", "value": "1.0", **request}
        return self.graph.services.call("/slidectl/wait", wanted)

    def play(self, *positions: float | None) -> None:
        for position in positions:
            self.graph.clock.time_ns += 100 * MS
            if position is not None and self.joints.wanted:
                now = self.graph.clock.time_ns
                header = {"seq": 0, "stamp": {"secs": now // 10**9, "nsecs": now % 10**9}, "frame_id": ""}
                self.joints.publish(
                    {"header": header, "name": ["a"], "position": [position], "velocity": [], "effort": []}
                )
            if self.graph.clock.time_ns >= self.graph.timers.next_ns:
                self.graph.timers.fire()


@pytest.fixture
def scene(graph: Graph) -> Scene:
    return Scene(graph)


def test_it_is_answered_at_the_first_message_that_is_near_enough(scene: Scene) -> None:
    wait = scene.wait(tolerance=0.02)
    scene.play(0.5, 0.97)
    assert not wait.done
    scene.play(0.98)
    answer = wait.result()
    assert answer["success"]
    assert answer["time"] == 0.3
    assert json.loads(answer["last"]) == 0.98
    assert not scene.joints.wanted, "nobody listens any more"


def test_when_the_time_is_up_it_says_what_was_expected_the_last_and_the_closest(scene: Scene) -> None:
    wait = scene.wait(tolerance=0.02, within=0.4)
    scene.play(0.2, 0.413, 0.3)
    assert not wait.done
    scene.play(0.25)
    answer = wait.result()
    assert not answer["success"]
    assert answer["message"] == (
        "expected /joint_states/position[0] near 1 ± 0.02 within 0.4 s; last 0.25, closest 0.413"
    )
    assert (answer["last"], answer["closest"], answer["time"]) == ("0.25", "0.413", 0.4)


def test_a_message_at_the_very_end_still_counts(scene: Scene) -> None:
    wait = scene.wait(within=0.2)
    scene.play(0.0, 1.0)
    assert wait.result()["success"]


def test_the_time_runs_out_without_any_message_too(scene: Scene) -> None:
    wait = scene.wait(within=0.3)
    scene.play(None, None, None)
    assert wait.result()["message"].endswith("within 0.3 s; no message came")
    assert wait.result()["last"] == ""


def test_a_condition_must_hold_without_a_break(scene: Scene) -> None:
    wait = scene.wait(tolerance=0.1, hold=0.3)
    scene.play(1.0, 1.0, 2.0, 1.0, 1.0, 1.0)
    assert not wait.done
    scene.play(1.0)
    assert wait.result()["success"]
    assert wait.result()["time"] == pytest.approx(0.7)


def test_between_two_messages_the_last_value_counts(scene: Scene) -> None:
    wait = scene.wait(hold=0.2)
    scene.play(1.0, None, None)
    assert wait.result()["success"]
    assert wait.result()["time"] == pytest.approx(0.3)


def test_holding_that_is_complete_at_the_deadline_is_a_success(scene: Scene) -> None:
    held = scene.wait(hold=0.2, within=0.3)
    short = scene.wait(hold=0.3, within=0.3)
    scene.play(1.0, 1.0, 1.0)
    assert held.result()["success"]
    assert short.result()["message"] == (
        "expected /joint_states/position[0] near 1 ± 0 for 0.3 s within 0.3 s; last 1, closest 1"
    )


@pytest.mark.parametrize(
    ("condition", "misses", "hit", "closest"),
    [("above", (0.5, 1.0, 0.7), 1.001, 1.0), ("below", (1.5, 1.0, 1.2), 0.999, 1.0), ("equals", (0.9, 1.3), 1.0, 0.9)],
)
def test_above_below_and_equals(scene: Scene, condition: str, misses: Any, hit: float, closest: float) -> None:
    met = scene.wait(condition=condition)
    missed = scene.wait(condition=condition, within=0.1 * len(misses))
    scene.play(*misses)
    assert not met.done
    assert json.loads(missed.result()["closest"]) == closest
    scene.play(hit)
    assert met.result()["success"]


def test_a_latched_message_is_judged_at_once(scene: Scene) -> None:
    scene.light.publish({"data": "green"})
    assert scene.wait(topic="/light", field="", condition="equals", value='"green"').result()["success"]
    red = scene.wait(topic="/light", field="data", condition="equals", value='"red"', within=0.1)
    scene.play(None)
    assert red.result()["message"] == 'expected /light/data equals "red" within 0.1 s; last "green", closest "green"'


def test_times_count_in_seconds(scene: Scene) -> None:
    wait = scene.wait(field="header/stamp", condition="above", value="0.25")
    scene.play(0.0, 0.0)
    assert not wait.done
    scene.play(0.0)
    assert wait.result()["success"]


@pytest.mark.parametrize("condition", ["near", "above", "below", "equals"])
def test_nan_fulfils_nothing(scene: Scene, condition: str) -> None:
    wait = scene.wait(condition=condition, value="5", within=0.2)
    scene.play(float("nan"), float("nan"))
    assert not wait.result()["success"]


def test_bytes_are_numbers(scene: Scene) -> None:
    bytes_ = scene.graph.topics.advertise("/bytes", "std_msgs/UInt8MultiArray", "/gazebo", latch=True)
    bytes_.publish({"layout": {"dim": [], "data_offset": 0}, "data": "AQID"})
    assert scene.wait(topic="/bytes", field="data[-1]", condition="equals", value="3").result()["success"]


def test_when_nobody_publishes_any_more_that_is_said(scene: Scene) -> None:
    wait = scene.wait(within=0.3)
    scene.play(0.5)
    scene.joints.close()
    scene.graph.clock.time_ns = 300 * MS
    scene.graph.timers.fire()
    assert wait.result()["message"].endswith("last 0.5, closest 0.5; it has no publisher")


def test_numbers_of_any_size_can_be_compared(scene: Scene) -> None:
    huge = "1" + "0" * 400
    wait = scene.wait(condition="equals", value=huge, within=0.1)
    scene.play(0.5)
    assert not wait.result()["success"]


def test_what_does_not_exist_fails_at_once_and_names_what_does(scene: Scene) -> None:
    with pytest.raises(UnknownName, match=r"'/joint_state'.*Did you mean '/joint_states'"):
        scene.wait(topic="/joint_state").result()
    with pytest.raises(UnknownName, match="'positions' in sensor_msgs/JointState") as caught:
        scene.wait(field="positions[0]").result()
    assert "velocity" in str(caught.value)
    with pytest.raises(UnknownName, match="say which"):
        scene.wait(field="").result()
    with pytest.raises(UnknownName, match="'beside'"):
        scene.wait(condition="beside").result()
    assert not scene.joints.wanted


def test_an_element_that_is_not_there_fails_at_the_first_message(scene: Scene) -> None:
    wait = scene.wait(field="position[3]")
    scene.play(0.0)
    with pytest.raises(NoElement, match=r"position\[3\], but the message has 1 there"):
        wait.result()
    assert not scene.joints.wanted


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        ({"field": "name[0]"}, "is string, and near needs a number"),
        ({"field": "position"}, r"is float64\[\], and near needs a number"),
        ({"value": '"up"'}, "near needs a number"),
        ({"value": "up"}, "not JSON"),
        ({"tolerance": -1.0}, "tolerance"),
        ({"tolerance": math.nan}, "tolerance"),
        ({"value": "1e999"}, "near needs a number"),
        ({"value": "[" * 100_000}, "not JSON"),
    ],
)
def test_what_makes_no_sense_is_refused(scene: Scene, request_: Any, text: str) -> None:
    with pytest.raises(BadMessage, match=text):
        scene.wait(**request_).result()


@pytest.mark.parametrize("value", [math.inf, math.nan, 1e300])
@pytest.mark.parametrize("name", ["hold", "within"])
def test_a_time_that_no_clock_can_measure_is_refused(scene: Scene, name: str, value: float) -> None:
    with pytest.raises(Refused, match=f"{name} is a number of seconds"):
        scene.wait(**{name: value}).result()


def test_who_goes_leaves_nothing_behind(scene: Scene) -> None:
    wait = scene.wait(within=10.0, hold=1.0)
    scene.play(1.0)
    wait.cancel()
    assert not scene.joints.wanted
    scene.play(*[None] * 110)
    assert wait.cancelled


def test_large_integers_are_compared_exactly(scene: Scene) -> None:
    count = scene.graph.topics.advertise("/count", "std_msgs/UInt64", "/gazebo", latch=True)
    count.publish({"data": 2**60 + 1})
    assert not scene.wait(topic="/count", field="", condition="equals", value=str(2**60)).done
    assert scene.wait(topic="/count", field="", condition="equals", value=str(2**60 + 1)).done


def test_true_is_not_1(scene: Scene) -> None:
    flag = scene.graph.topics.advertise("/flag", "std_msgs/Bool", "/gazebo", latch=True)
    flag.publish({"data": True})
    assert scene.wait(topic="/flag", field="", condition="equals", value="true").result()["success"]
    assert not scene.wait(topic="/flag", field="", condition="equals", value="1").done


def test_when_the_clock_is_set_back_what_is_left_of_the_time_counts(scene: Scene) -> None:
    wait = scene.wait(within=0.5)
    scene.play(0.0, 0.0, 0.0)
    scene.graph.timers.rebase(scene.graph.clock.time_ns, 0)
    scene.graph.clock.time_ns = 0
    scene.play(0.0)
    assert not wait.done
    scene.play(0.0)
    assert wait.result()["time"] == 0.2
