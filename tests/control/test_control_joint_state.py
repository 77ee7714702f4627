"""joint_states: what is published, in which order, and at which moments."""

import pytest
from fake_robot import STEP_NS, Bench, FakeRobot

from slidectl import msgs

TYPE = {"type": "joint_state_controller/JointStateController"}
TOPIC = "/bot/joint_states"


def bench_with(on_robot=("joint2", "joint1"), /, **parameters):
    return Bench(FakeRobot(on_robot), {"states": {**TYPE, **parameters}})


def stamps(bench):
    """When messages were published, in ms."""
    return [
        (message["header"]["stamp"]["secs"] * 1_000_000_000 + message["header"]["stamp"]["nsecs"]) // STEP_NS
        for message in bench.graph.sent(TOPIC)
    ]


class TestLoading:
    def test_a_rate_is_all_it_needs_and_it_claims_nothing(self):
        bench = bench_with(publish_rate=50)
        bench.load("states")
        assert bench.manager.list()[0]["claimed_resources"] == [
            {"hardware_interface": "hardware_interface::JointStateInterface", "resources": []}
        ]

    @pytest.mark.parametrize("parameters", [{}, {"publish_rate": "50"}, {"publish_rate": True}])
    def test_without_a_rate_it_does_not_load(self, parameters):
        bench = bench_with(**parameters)
        assert not bench.manager.load("states")
        assert "/bot/states/publish_rate" in bench.graph.lines("error")

    @pytest.mark.parametrize("rate", [float("nan"), 1e-12])
    def test_a_rate_that_makes_no_period_does_not_load(self, rate):
        assert not bench_with(publish_rate=rate).manager.load("states")

    @pytest.mark.parametrize("rate", [0, -1.0])
    def test_a_rate_that_is_not_above_0_publishes_nothing_and_says_so(self, rate):
        bench = bench_with(publish_rate=rate)
        bench.start("states")
        bench.run(100)
        assert bench.graph.sent(TOPIC) == []
        assert bench.graph.lines("warn") == "/bot/states/publish_rate is not above 0: nothing is published"

    def test_an_unknown_joint_does_not_load(self):
        bench = bench_with(publish_rate=50, joints=["joint1", "joint7"])
        assert not bench.manager.load("states")
        assert "no joint 'joint7'" in bench.graph.lines("error")


class TestContents:
    def message(self, bench):
        bench.start("states")
        bench.run(40)
        return bench.graph.sent(TOPIC)[-1]

    def test_all_joints_are_published_in_alphabetical_order(self):
        bench = bench_with(publish_rate=50)
        joint = bench.robot.joints["joint2"]
        joint.position, joint.velocity, joint.effort = 1.0, 2.0, 3.0
        message = self.message(bench)
        assert message["name"] == ["joint1", "joint2"]
        assert message["position"] == [0.0, 1.0]
        assert message["velocity"] == [0.0, 2.0]
        assert message["effort"] == [0.0, 3.0]
        assert message["header"]["frame_id"] == ""

    def test_chosen_joints_are_published_in_their_order(self):
        bench = bench_with(("a", "b", "c"), publish_rate=50, joints=["c", "a"])
        assert self.message(bench)["name"] == ["c", "a"]

    def test_extra_joints_follow_with_a_state_that_never_changes(self):
        extra = [
            {"name": "extra1", "position": 10.0, "velocity": 20.0, "effort": 30.0},
            {"name": "extra2", "position": -10.0},
            {"name": "extra3"},
        ]
        message = self.message(bench_with(("joint1",), publish_rate=50, extra_joints=extra))
        assert message["name"] == ["joint1", "extra1", "extra2", "extra3"]
        assert message["position"] == [0.0, 10.0, -10.0, 0.0]
        assert message["velocity"] == [0.0, 20.0, 0.0, 0.0]
        assert message["effort"] == [0.0, 30.0, 0.0, 0.0]

    @pytest.mark.parametrize(
        ("entry", "reason"),
        [
            ("extra1", "must be a mapping with a name"),
            ({"position": 1.0}, "must be a mapping with a name"),
            ({"name": 5}, "must be a mapping with a name"),
            ({"name": "extra1", "position": 0}, "position of 'extra1' must be a float, such as 0.0"),
            ({"name": "extra1", "velocity": "0.0"}, "velocity of 'extra1' must be a float, such as 0.0"),
            ({"name": "extra1", "effort": True}, "effort of 'extra1' must be a float, such as 0.0"),
            ({"name": "joint1"}, "'joint1' exists already"),
            ({"name": "good"}, "'good' exists already"),
        ],
    )
    def test_a_bad_extra_joint_is_skipped_and_pointed_out(self, entry, reason):
        bench = bench_with(("joint1",), publish_rate=50, extra_joints=[{"name": "good"}, entry])
        assert self.message(bench)["name"] == ["joint1", "good"]
        assert reason in bench.graph.lines("error", "warn")

    def test_extra_joints_that_are_no_list_are_ignored(self):
        bench = bench_with(("joint1",), publish_rate=50, extra_joints={"name": "extra1"})
        assert self.message(bench)["name"] == ["joint1"]
        assert "must be a list" in bench.graph.lines("error")

    def test_the_message_fits_its_type(self):
        message = self.message(bench_with(publish_rate=50))
        assert msgs.check("sensor_msgs/JointState", message) == message


class TestRhythm:
    def started_at(self, milliseconds, **parameters):
        bench = bench_with(**{"publish_rate": 50, **parameters})
        bench.load("states")
        bench.graph.time_ns = (milliseconds - 1) * STEP_NS
        bench.request(["states"])
        bench.run()
        return bench

    def test_the_first_message_follows_at_once_and_the_others_on_multiples(self):
        bench = self.started_at(500)
        bench.run(100)
        assert stamps(bench) == [501, 520, 540, 560, 580, 600]

    def test_near_time_zero_the_first_message_waits_a_whole_period(self):
        bench = self.started_at(1)
        bench.run(80)
        assert stamps(bench) == [21, 41, 61, 81]

    @pytest.mark.parametrize("rate", [0, 0.0, -50])
    def test_a_rate_that_is_not_positive_publishes_nothing(self, rate):
        bench = self.started_at(500, publish_rate=rate)
        bench.run(200)
        assert stamps(bench) == []

    def test_after_a_pause_it_catches_up_with_a_message_per_cycle(self):
        bench = self.started_at(500)
        bench.run(5)
        bench.request(stop=["states"])
        bench.run(96)
        bench.request(["states"])
        bench.run(10)
        # Due at 520 to 600 while it was stopped; they come one a cycle from the first update on.
        assert stamps(bench) == [501, 603, 604, 605, 606, 607]

    def test_the_rhythm_is_the_same_whether_anybody_listens(self):
        bench = self.started_at(500)
        bench.graph.publishers[TOPIC].wanted = False
        bench.run(30)
        bench.graph.publishers[TOPIC].wanted = True
        bench.run(30)
        assert stamps(bench) == [540, 560]

    def test_time_that_was_put_back_starts_the_rhythm_anew(self):
        bench = self.started_at(5000)
        bench.run(30)
        bench.graph.time_ns = 0
        bench.manager.restart_running(0)
        bench.graph.sent(TOPIC).clear()
        bench.run(50)
        assert stamps(bench) == [21, 41]

    def test_two_of_them_may_run_at_once(self):
        bench = Bench(FakeRobot(), {name: {**TYPE, "publish_rate": 50} for name in ("a", "b")})
        bench.start("a", "b")
        assert set(bench.states().values()) == {"running"}
