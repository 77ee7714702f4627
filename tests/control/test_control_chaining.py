"""Chains of controllers: one writes the references that another exports, in the same cycle."""

# ruff: noqa: ARG002 - hooks have their arguments, wanted or not

from __future__ import annotations

from math import isnan, nan

import pytest
from fake_robot import Bench, FakeRobot, Recorder

from slidectl.control.controller_interface import Controller
from slidectl.control.hardware_interface import (
    JointHandle,
    JointStateHandle,
    JointStateInterface,
    PositionJointInterface,
    SwitchState,
)

BEST_EFFORT, STRICT = 1, 2
ORDER: list[str] = []
"""The names of the controllers that were updated in the last cycle."""


class Noting(Recorder):
    """Notes its updates, and fails on demand in hooks."""

    fails_in = ()

    def init(self, interface, node):
        super().init(interface, node)
        self.name = node.namespace.rpartition("/")[2]
        self.chained: list[bool] = []

    def starting(self, time_ns):
        self.chained.append(self.is_chained)
        super().starting(time_ns)
        self.check("starting")

    def update(self, time_ns, period_s):
        ORDER.append(self.name)
        super().update(time_ns, period_s)
        self.check("update")

    def check(self, hook):
        if f"{self.name} {hook}" in type(self).fails_in:
            raise ValueError("broken")


class Follower(Noting):
    """Chainable: effort of joint1 = its reference, of a position."""

    def init(self, interface, node):
        super().init(interface, node)
        self.reference = JointHandle("joint1", nan, nan, nan, nan)
        self.shown = JointStateHandle("joint1", 0.5)
        self.exported_references = [(PositionJointInterface, self.reference)]
        self.exported_states = [self.shown]


class Front(Noting):
    """Writes 7 to the reference `target`."""

    interface_type = PositionJointInterface

    def init(self, interface, node):
        super().init(interface, node)
        self.target = interface.get_handle(node.get_param("target", "low/joint1"))

    def update(self, time_ns, period_s):
        super().update(time_ns, period_s)
        self.target.command = 7.0


class Reader(Controller[JointStateInterface]):
    """Reads the exported state of `low`."""

    interface_type = JointStateInterface

    def init(self, interface, node):
        self.handle = interface.get_handle("low/joint1")
        self.names = interface.names()

    def update(self, time_ns, period_s):
        ORDER.append("reader")


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.setattr(Noting, "fails_in", ())
    ORDER.clear()
    controllers = {
        "low": {"type": "test/Follower", "joints": ["joint1"]},
        "front": {"type": "test/Front"},
        "front2": {"type": "test/Front"},
        "reader": {"type": "test/Reader"},
        "other": {"type": "test/Noting"},
    }
    classes = {"Follower": Follower, "Front": Front, "Noting": Noting, "Reader": Reader}
    return Bench(FakeRobot(["joint1"], ["effort", "position"]), controllers, **classes)


def chained(bench: Bench, name: str = "low") -> list[bool]:
    """Whether the controller was in chained mode at each of its starts."""
    return bench.manager.get(name).chained


def refusal(bench: Bench) -> str:
    return bench.graph.log[-1][1]


class TestInterfaces:
    def test_exported_handles_are_found_like_joints_and_are_nan_until_written(self, bench):
        bench.load("low", "front", "reader")
        low, front = bench.manager.get("low"), bench.manager.get("front")
        assert front.target is low.reference
        assert front.target.name == "low/joint1"
        assert isnan(front.target.command)
        assert bench.manager.get("reader").handle is low.shown
        claims = {entry["name"]: entry["claimed_resources"] for entry in bench.manager.list()}
        assert claims["front"] == [
            {"hardware_interface": "hardware_interface::PositionJointInterface", "resources": ["low/joint1"]}
        ]

    def test_they_are_none_of_the_robots_joints(self, bench):
        bench.load("low", "reader")
        assert bench.manager.get("reader").names == ["joint1"]
        assert bench.robot.get(PositionJointInterface).names() == ["joint1"]
        assert [handle.name for handle in bench.robot.get(JointStateInterface).handles()] == ["joint1"]

    def test_a_robot_without_the_interface_can_have_a_chain(self):
        bench = Bench(FakeRobot(), {"low": {"type": "test/Follower"}}, Follower=Follower)
        bench.load("low")
        assert bench.robot.get(PositionJointInterface).names() == []

    def test_a_controller_that_comes_too_early_says_what_to_load_first(self, bench):
        assert not bench.manager.load("front")
        assert "'low/joint1' is of controller 'low': load it first: slidectl controller load low" in refusal(bench)

    def test_a_name_that_is_not_exported_says_what_is(self, bench):
        bench.graph.set("/bot/front/target", "low/joint9")
        bench.load("low")
        assert not bench.manager.load("front")
        assert "controller 'low' exports: low/joint1" in refusal(bench)

    def test_they_go_when_their_controller_is_unloaded(self, bench):
        bench.load("low")
        assert bench.manager.unload("low")
        assert not bench.manager.load("front")
        bench.load("low", "front")

    def test_a_controller_whose_interfaces_are_in_use_cannot_be_unloaded(self, bench):
        bench.load("low", "front", "reader")
        assert not bench.manager.unload("low")
        assert refusal(bench) == (
            "cannot unload controller 'low': 'front', 'reader' have interfaces of it; "
            "unload before it: slidectl controller unload front reader"
        )
        assert bench.manager.unload("front")
        assert bench.manager.unload("reader")
        assert bench.manager.unload("low")

    def test_a_forced_reload_of_libraries_and_a_kill_unload_the_users_first(self, bench):
        bench.load("low")
        bench.load("front", "reader")
        assert bench.manager.reload_libraries(force_kill=True)
        assert bench.manager.names() == []
        bench.load("low", "front", "other")
        assert bench.manager.kill("low")
        assert bench.manager.names() == ["other"]

    def test_two_controllers_cannot_write_one_reference(self, bench):
        bench.load("low", "front", "front2")
        assert not bench.request(start=["low", "front", "front2"])
        assert "low/joint1/position is claimed by front and front2" in refusal(bench)


class TestOrder:
    def test_a_controller_runs_before_those_whose_references_it_writes(self, bench):
        bench.load("other", "low", "front")
        bench.request(start=["other", "low", "front"])
        bench.run()
        assert [entry["name"] for entry in bench.manager.list()] == ["other", "front", "low"]
        assert bench.manager.names() == ["other", "low", "front"]
        bench.run()
        assert ORDER == ["other", "front", "low"]
        assert bench.manager.get("low").reference.command == 7.0

    def test_a_chain_of_three_runs_from_the_front(self, bench):
        bench.graph.set("/bot/middle", {"type": "test/Middle"})
        bench.graph.set("/bot/front/target", "middle/joint1")

        class Link(Front):
            def init(self, interface, node):
                super().init(interface, node)
                self.exported_references = [(PositionJointInterface, JointHandle("joint1"))]

        bench.register(Middle=Link)
        bench.load("low", "middle", "front")
        assert bench.request(start=["front", "low", "middle"])
        bench.run(2)
        assert ORDER == ["front", "middle", "low"]
        assert bench.manager.get("low").chained == [True]

    def test_a_reset_restarts_a_chain_from_its_end(self, bench):
        bench.load("low", "front")
        bench.request(start=["low", "front"])
        bench.run()
        bench.run(reset_controllers=True)
        assert bench.states() == {"front": "running", "low": "running"}
        assert chained(bench) == [True, True]


class TestSwitching:
    def test_a_start_without_the_following_one_is_refused(self, bench):
        bench.load("low", "front")
        assert not bench.request(start=["front"])
        assert refusal(bench) == (
            "cannot switch controllers: cannot start controller 'front': it writes the references of 'low', which does "
            "not run; start both: slidectl controller switch --start low front"
        )
        assert not bench.manager.switching

    def test_with_best_effort_the_rest_of_the_request_goes_on(self, bench):
        bench.load("low", "front", "other")
        assert bench.request(start=["front", "other"], strictness=BEST_EFFORT)
        assert "cannot start controller 'front'" in bench.graph.lines("warn")
        bench.run()
        assert bench.states() == {"front": "initialized", "low": "initialized", "other": "running"}

    @pytest.mark.parametrize("names", [["front", "low"], ["low", "front"]])
    @pytest.mark.parametrize("asap", [False, True])
    def test_both_start_in_one_switch_in_any_order(self, bench, names, asap):
        bench.load("low", "front")
        assert bench.request(start=names, asap=asap)
        bench.run()
        assert bench.states() == {"front": "running", "low": "running"}
        assert chained(bench) == [True]
        assert bench.answers == [True]

    def test_a_running_one_is_restarted_into_chained_mode_and_out_of_it(self, bench):
        bench.start("low", "other")
        bench.start("front")
        assert bench.calls("low")[-2:] == ["stopping", "starting"]
        assert chained(bench) == [False, True]
        assert bench.request(stop=["front"])
        bench.run()
        assert bench.states() == {"front": "stopped", "low": "running", "other": "running"}
        assert chained(bench) == [False, True, False]
        assert bench.calls("other").count("starting") == 1

    def test_a_following_one_cannot_stop_alone(self, bench):
        bench.load("low", "front")
        bench.request(start=["low", "front"])
        bench.run()
        assert not bench.request(stop=["low"])
        assert refusal(bench) == (
            "cannot switch controllers: cannot stop controller 'low': 'front', which writes its references, goes on; "
            "stop both: slidectl controller switch --stop front low"
        )
        assert bench.request(stop=["low"], strictness=BEST_EFFORT)
        bench.run()
        assert bench.states() == {"front": "running", "low": "running"}
        assert bench.request(stop=["low", "front"])
        bench.run()
        assert bench.states() == {"front": "stopped", "low": "stopped"}

    def test_a_start_is_refused_when_the_same_switch_stops_the_following_one(self, bench):
        bench.start("low")
        bench.load("front")
        assert not bench.request(start=["front"], stop=["low"])
        assert "it writes the references of 'low', which this switch stops" in refusal(bench)

    def test_one_preceding_controller_takes_over_from_another_without_a_restart(self, bench):
        bench.load("low", "front", "front2")
        bench.request(start=["low", "front"])
        bench.run()
        assert bench.request(start=["front2"], stop=["front"])
        bench.run()
        assert bench.states() == {"front2": "running", "front": "stopped", "low": "running"}
        assert chained(bench) == [True]

    def test_a_reader_of_exported_states_needs_the_controller_but_does_not_chain_it(self, bench):
        bench.load("low", "reader")
        assert not bench.request(start=["reader"])
        assert "it reads the states of 'low', which does not run" in refusal(bench)
        assert bench.request(start=["reader", "low"])
        bench.run()
        assert chained(bench) == [False]
        assert not bench.request(stop=["low"])
        assert "'reader', which reads its states, goes on" in refusal(bench)

    def test_a_chain_waits_for_the_hardware_and_starts_from_its_end(self, bench):
        bench.robot.results = [SwitchState.ONGOING] * 3 + [SwitchState.DONE]
        bench.load("low", "front")
        assert bench.request(start=["front", "low"], asap=True)
        bench.run(5)
        assert bench.states() == {"front": "running", "low": "running"}
        assert bench.calls("low").count("starting") == bench.calls("front").count("starting") == 1


class TestFailures:
    @pytest.fixture
    def running(self, bench):
        bench.load("low", "front", "other")
        bench.request(start=["low", "front", "other"])
        bench.run()
        ORDER.clear()
        return bench

    def test_a_failing_preceding_controller_ends_the_chain_in_the_same_cycle(self, running, monkeypatch):
        monkeypatch.setattr(Noting, "fails_in", ("front update",))
        running.run()
        assert running.states() == {"front": "aborted", "low": "aborted", "other": "running"}
        assert ORDER == ["front", "other"]
        fatal = running.graph.lines("fatal")
        assert "controller 'front' failed in update and is aborted: ValueError: broken" in fatal
        assert "controller 'low' is aborted: 'front', which is in its chain, is aborted" in fatal
        assert running.manager.failure_of("low") == fatal.splitlines()[-1]

    def test_so_does_a_failing_following_one(self, running, monkeypatch):
        monkeypatch.setattr(Noting, "fails_in", ("low update",))
        running.run(2)
        assert running.states() == {"front": "aborted", "low": "aborted", "other": "running"}
        assert ORDER == ["front", "low", "other", "other"]

    def test_so_does_one_whose_command_is_not_finite(self, running):
        running.robot.joints["joint1"].command = nan
        running.run()
        assert running.states() == {"front": "aborted", "low": "aborted", "other": "running"}

    def test_so_does_a_fault(self, running):
        assert running.manager.fail("low", ValueError("fault"))
        assert running.states()["front"] == "aborted"

    def test_a_reference_that_is_nan_is_no_failure(self, bench, monkeypatch):
        monkeypatch.setattr(Front, "update", Noting.update)
        bench.load("low", "front")
        bench.request(start=["low", "front"])
        bench.run(3)
        assert bench.states() == {"front": "running", "low": "running"}

    def test_a_chain_whose_end_fails_to_start_does_not_start(self, bench, monkeypatch):
        monkeypatch.setattr(Noting, "fails_in", ("low starting",))
        bench.load("low", "front")
        bench.request(start=["low", "front"])
        bench.run()
        assert bench.states() == {"front": "aborted", "low": "aborted"}
        assert bench.calls("front") == ["aborting"]

    def test_a_chain_whose_front_fails_to_start_is_aborted(self, bench, monkeypatch):
        bench.start("low")
        bench.load("front")
        monkeypatch.setattr(Noting, "fails_in", ("front starting",))
        bench.request(start=["front"])
        bench.run()
        assert bench.states() == {"front": "aborted", "low": "aborted"}

    def test_a_failing_reader_ends_no_chain_but_ends_with_it(self, running):
        running.start("reader")
        assert running.manager.fail("reader", ValueError("fault"))
        assert running.states()["low"] == "running"
        assert running.request(start=["reader"])
        running.run()
        running.manager.fail("front", ValueError("fault"))
        assert running.states() == {"front": "aborted", "low": "aborted", "other": "running", "reader": "aborted"}

    def test_an_aborted_chain_can_be_started_again(self, running):
        running.manager.fail("front", ValueError("fault"))
        assert running.request(start=["low"])
        running.run()
        assert chained(running) == [True, False]
        assert running.request(start=["front"])
        running.run()
        assert chained(running) == [True, False, True]
