"""Switching controllers: what is refused, in which cycle what happens, and hardware that takes its time."""

# ruff: noqa: ARG002, ARG005 - hooks have their arguments, wanted or not

import pytest
from fake_robot import Bench, FakeRobot, Recorder

from slidectl.control.hardware_interface import SwitchState

BEST_EFFORT, STRICT = 1, 2
DONE, ONGOING, ERROR = SwitchState.DONE, SwitchState.ONGOING, SwitchState.ERROR


@pytest.fixture
def robot():
    return FakeRobot(["joint1", "joint2", "joint3"], ["effort", "velocity"])


@pytest.fixture
def bench(robot):
    """`one` and `two` have joints of their own, `rival` wants the joint of `one`; all are loaded."""
    bench = Bench(
        robot, {"one": {"joints": ["joint1"]}, "two": {"joints": ["joint2"]}, "rival": {"joints": ["joint1"]}}
    )
    bench.load("one", "two", "rival")
    return bench


class TestTheCycleOfASwitch:
    def test_a_started_controller_has_its_first_update_one_cycle_later(self, bench):
        assert bench.request(start=["one"])
        assert bench.answers == []
        bench.run()
        assert bench.calls("one") == ["starting"]
        assert bench.answers == [True]
        bench.run()
        assert bench.calls("one") == ["starting", "update"]

    def test_a_stopped_controller_has_its_last_update_in_the_cycle_of_the_switch(self, bench):
        bench.request(start=["one"])
        bench.run()
        bench.request(stop=["one"])
        bench.run(3)
        assert bench.calls("one") == ["starting", "update", "stopping"]

    def test_all_stops_come_before_all_starts(self, bench):
        order = []
        bench.request(start=["one"])
        bench.run()
        bench.manager.get("one").stopping = lambda time_ns: order.append("one stops")
        bench.manager.get("rival").starting = lambda time_ns: order.append("rival starts")
        assert bench.request(start=["rival"], stop=["one"])
        bench.run()
        assert order == ["one stops", "rival starts"]
        assert bench.states() == {"one": "stopped", "two": "initialized", "rival": "running"}

    def test_starts_are_in_the_order_of_the_request(self, bench):
        order = []
        for name in ("one", "two"):
            bench.manager.get(name).starting = lambda time_ns, name=name: order.append(name)
        bench.request(start=["two", "one"])
        bench.run()
        assert order == ["two", "one"]

    def test_a_world_that_stands_still_can_finish_a_switch_too(self, bench):
        bench.request(start=["one"])
        assert bench.manager.switching
        bench.manager.manage_switch(0)
        assert not bench.manager.switching
        assert bench.answers == [True]
        bench.manager.manage_switch(0)
        assert bench.calls("one") == ["starting"]

    def test_the_answer_may_ask_for_the_next_switch(self, bench):
        manager = bench.manager
        manager.request_switch(["one"], [], STRICT, on_done=lambda ok: bench.request(start=["two"]))
        bench.run(2)
        assert bench.states()["two"] == "running"
        assert bench.answers == [True]

    def test_without_a_request_the_hardware_hears_nothing(self, bench, robot):
        bench.run(5)
        assert robot.switches == []
        assert robot.asked == []

    @pytest.mark.parametrize("strictness", [BEST_EFFORT, STRICT])
    def test_an_empty_switch_takes_one_cycle(self, bench, robot, strictness):
        assert bench.request(strictness=strictness)
        bench.run()
        assert robot.switches == [([], [])]
        assert robot.asked == [None]
        assert bench.answers == [True]

    def test_the_hardware_hears_only_of_genuine_starts_and_stops(self, bench, robot):
        bench.request(start=["one"])
        bench.run()
        bench.request(start=["one", "two"], stop=["rival"], strictness=BEST_EFFORT)
        bench.run()
        assert robot.switches == [(["one"], []), (["two"], [])]

    def test_one_switch_at_a_time(self, bench):
        bench.request(start=["one"])
        assert not bench.request(start=["two"])
        assert "another switch is in progress" in bench.graph.lines("error")
        assert not bench.manager.unload("two")
        bench.run()
        assert bench.states() == {"one": "running", "two": "initialized", "rival": "initialized"}


class TestStrict:
    @pytest.mark.parametrize(
        ("request_", "reason"),
        [
            ({"start": ["one", "oen"]}, "no controller 'oen' to start. Did you mean 'one'?"),
            ({"start": ["one"], "stop": ["nobody"]}, "no controller 'nobody' to stop"),
            ({"start": ["one"], "stop": ["two"]}, "cannot stop controller 'two': it is not running"),
            ({"start": ["one"], "stop": ["one"]}, "cannot stop controller 'one': it is not running"),
        ],
    )
    def test_one_bad_name_refuses_all_of_it(self, bench, robot, request_, reason):
        assert not bench.request(**request_)
        assert reason in bench.graph.lines("error")
        bench.run()
        assert set(bench.states().values()) == {"initialized"}
        assert robot.switches == []
        assert bench.answers == []

    def test_a_running_controller_cannot_be_started(self, bench):
        bench.request(start=["one"])
        bench.run()
        assert not bench.request(start=["one"])
        assert "cannot start controller 'one': it is running already" in bench.graph.lines("error")


class TestBestEffort:
    def test_unknown_names_are_passed_over_with_a_word(self, bench):
        assert bench.request(start=["nobody", "one"], stop=["noone"], strictness=BEST_EFFORT)
        bench.run()
        assert bench.states()["one"] == "running"
        assert "no controller 'nobody' to start" in bench.graph.lines("warn")
        assert "no controller 'noone' to stop" in bench.graph.lines("warn")

    def test_nothing_but_unknown_names_is_an_empty_switch(self, bench):
        assert bench.request(start=["nobody"], strictness=BEST_EFFORT)
        bench.run()
        assert bench.answers == [True]

    def test_starting_a_running_controller_starts_it_again_without_a_stop(self, bench):
        bench.request(start=["one"])
        bench.run()
        assert bench.request(start=["one"], strictness=BEST_EFFORT)
        bench.run()
        assert bench.calls("one") == ["starting", "update", "starting"]

    def test_stopping_what_does_not_run_does_nothing(self, bench):
        assert bench.request(stop=["one"], strictness=BEST_EFFORT)
        bench.run()
        assert bench.calls("one") == []
        assert bench.states()["one"] == "initialized"

    def test_what_does_not_run_and_is_in_both_lists_is_started(self, bench):
        assert bench.request(start=["one"], stop=["one"], strictness=BEST_EFFORT)
        bench.run()
        assert bench.calls("one") == ["starting"]

    @pytest.mark.parametrize("strictness", [0, 3, -1])
    def test_any_other_strictness_is_best_effort_and_is_remarked_on(self, bench, strictness):
        assert bench.request(start=["nobody"], strictness=strictness)
        assert "strictness" in bench.graph.lines("warn")

    def test_names_may_repeat_and_so_do_the_calls(self, bench):
        assert bench.request(start=["one", "one"], strictness=BEST_EFFORT)
        bench.run()
        assert bench.calls("one") == ["starting", "starting"]


@pytest.mark.parametrize("strictness", [BEST_EFFORT, STRICT])
class TestAnyStrictness:
    def test_a_running_controller_cannot_be_started_and_stopped_in_one_switch(self, bench, strictness):
        bench.request(start=["one"])
        bench.run()
        assert not bench.request(start=["one"], stop=["one"], strictness=strictness)
        assert "cannot be started and stopped in one switch" in bench.graph.lines("error")
        bench.run()
        assert bench.calls("one") == ["starting", "update"]

    def test_a_joint_that_another_has_claimed_is_a_conflict(self, bench, strictness):
        bench.request(start=["one"])
        bench.run()
        assert not bench.request(start=["two", "rival"], strictness=strictness)
        assert "joint1 is claimed by one and rival" in bench.graph.lines("error")
        assert "joint1 is claimed by one and rival" in bench.graph.lines("warn")
        bench.run()
        assert bench.states() == {"one": "running", "two": "initialized", "rival": "initialized"}

    def test_two_new_ones_may_conflict_with_each_other(self, bench, strictness):
        assert not bench.request(start=["one", "rival"], strictness=strictness)

    def test_hardware_that_disagrees_refuses_the_switch(self, bench, robot, strictness):
        robot.agrees = False
        assert not bench.request(start=["one"], strictness=strictness)
        assert "hardware cannot run this combination" in bench.graph.lines("error")
        assert robot.switches == []


class TestHardwareThatTakesItsTime:
    def test_controllers_wait_until_the_hardware_is_ready(self, bench, robot):
        robot.results = [ONGOING] * 10 + [DONE]
        bench.request(start=["one"])
        bench.run(5)
        assert bench.states()["one"] == "waiting"
        assert bench.answers == []
        bench.run(2)
        assert bench.calls("one") == ["waiting"] * 5 + ["starting", "update"]
        assert len(robot.asked) == 11
        assert len(robot.switches) == 1

    def test_hardware_that_fails_aborts_the_starts_and_the_call_is_still_good(self, bench, robot):
        robot.results = [ERROR]
        bench.request(start=["one", "two"])
        bench.run(2)
        assert bench.calls("one") == bench.calls("two") == ["aborting"]
        assert bench.states() == {"one": "aborted", "two": "aborted", "rival": "initialized"}
        assert bench.answers == [True]
        assert len(robot.asked) == 2

    def test_hardware_that_is_late_aborts_the_starts_after_the_timeout(self, bench, robot):
        robot.results = [ONGOING]
        bench.request(start=["one"], timeout=0.005)
        bench.run(5)
        assert bench.states()["one"] == "waiting"
        bench.run()
        assert bench.calls("one") == ["waiting"] * 5 + ["aborting"]
        assert bench.answers == [True]

    @pytest.mark.parametrize("timeout", [0.0, -1.0])
    def test_without_a_timeout_they_wait_for_ever(self, bench, robot, timeout):
        robot.results = [ONGOING]
        bench.request(start=["one"], timeout=timeout)
        bench.run(2000)
        assert bench.states()["one"] == "waiting"

    def test_a_stop_does_not_wait(self, bench, robot):
        bench.request(start=["one"])
        bench.run()
        robot.results = [ONGOING]
        bench.request(start=["two"], stop=["one"])
        bench.run(3)
        assert bench.states() == {"one": "stopped", "two": "waiting", "rival": "initialized"}


class PartlyReady(FakeRobot):
    """Is ready for controller `one` at once, and for the others when a test says so."""

    others = ONGOING

    def switch_result(self, info=None):
        self.asked.append(info.name if info else None)
        return DONE if info is not None and info.name == "one" else self.others


class TestStartingAsSoonAsPossible:
    @pytest.fixture
    def robot(self):
        return PartlyReady(["joint1", "joint2", "joint3"])

    def test_each_controller_starts_when_its_own_hardware_is_ready(self, bench, robot):
        bench.request(start=["one", "two"], asap=True)
        bench.run(5)
        assert bench.calls("one") == ["starting"] + ["update"] * 4
        assert bench.calls("two") == ["waiting"] * 5
        assert bench.answers == []
        robot.others = DONE
        bench.run()
        assert bench.states() == {"one": "running", "two": "running", "rival": "initialized"}
        assert bench.answers == [True]
        assert None not in robot.asked

    def test_a_failure_aborts_only_its_controller(self, bench, robot):
        bench.request(start=["one", "two"], asap=True)
        bench.run(5)
        robot.others = ERROR
        bench.run()
        assert bench.states() == {"one": "running", "two": "aborted", "rival": "initialized"}
        assert bench.answers == [True]

    def test_a_timeout_aborts_only_what_still_waits(self, bench):
        bench.request(start=["one", "two"], asap=True, timeout=0.003)
        bench.run(4)
        assert bench.states() == {"one": "running", "two": "aborted", "rival": "initialized"}
        assert bench.answers == [True]

    def test_an_empty_start_list_is_finished_at_once(self, bench):
        bench.request(asap=True)
        bench.run()
        assert bench.answers == [True]


def test_a_controller_that_fails_in_starting_does_not_hold_the_switch_up(robot):
    class Failing(Recorder):
        def starting(self, time_ns):
            raise RuntimeError("no")

    bench = Bench(robot, {"bad": {"type": "test/Failing"}, "good": {"joints": ["joint2"]}}, Failing=Failing)
    bench.load("bad", "good")
    bench.request(start=["bad", "good"], asap=True)
    bench.run()
    assert bench.states() == {"bad": "aborted", "good": "running"}
    assert bench.answers == [True]
