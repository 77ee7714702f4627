"""Gains that live in the graph: read, written back, changed by service and by parameter while the PID runs."""

import pytest

from slidectl import msgs
from slidectl.control.params import BadParameter
from slidectl.control.pid import Gains, ReconfigurablePid
from slidectl.errors import Refused, UnknownName

NS = "/bot/controller/pid"


@pytest.fixture
def live(graph):
    """Makes the PID of these parameters."""

    def make(**parameters):
        graph.set(NS, parameters)
        return ReconfigurablePid(graph.node(NS))

    return make


def doubles(**values):
    return [{"name": name, "value": value} for name, value in values.items()]


def config(**changes):
    return {"config": {"bools": [], "ints": [], "strs": [], "doubles": [], "groups": [], **changes}}


class TestReading:
    def test_p_is_all_that_is_needed(self, live):
        assert live(p=100).pid.gains == Gains(100.0, 0.0, 0.0, 0.0, 0.0, False)

    @pytest.mark.parametrize("parameters", [{}, {"i": 1.0}, {"p": "100"}, {"p": True}])
    def test_without_a_number_for_p_there_is_no_pid(self, graph, live, parameters):
        with pytest.raises(BadParameter, match=f"{NS}/p"):
            live(**parameters)
        assert graph.services == graph.publishers == {}

    @pytest.mark.parametrize(
        ("clamps", "i_min", "i_max"),
        [
            ({"i_clamp": 5.0}, -5.0, 5.0),
            ({"i_clamp": -5.0}, -5.0, 5.0),
            ({"i_clamp_min": -2.0}, -2.0, 0.0),
            ({"i_clamp_max": -3.0}, 0.0, 3.0),
            ({"i_clamp": 5.0, "i_clamp_min": 2.0}, -2.0, 5.0),
            ({"i_clamp": 5.0, "i_clamp_min": -1.0, "i_clamp_max": 3.0}, -1.0, 3.0),
            ({}, 0.0, 0.0),
        ],
    )
    def test_clamps_are_read_each_for_itself_and_win_over_the_common_one(self, live, clamps, i_min, i_max):
        gains = live(p=1.0, **clamps).pid.gains
        assert (gains.i_min, gains.i_max) == (i_min, i_max)

    def test_antiwindup_is_a_boolean_and_nothing_else(self, graph, live):
        assert not live(p=1.0, antiwindup=1).pid.gains.antiwindup
        assert "antiwindup has no effect" in graph.lines("warn")
        assert graph.get(f"{NS}/antiwindup") is False
        graph.set(f"{NS}/antiwindup", True)
        with pytest.raises(Refused, match=f"{NS}/antiwindup must be true or false, not 1"):
            graph.set(f"{NS}/antiwindup", 1)
        assert graph.get(f"{NS}/antiwindup") is True

    def test_gains_beyond_the_ranges_are_taken_from_a_file_as_they_are(self, live):
        assert live(p=1e9, d=5000.0).pid.gains[:3] == (1e9, 0.0, 5000.0)

    @pytest.mark.parametrize(
        "parameters", [{"p": float("nan")}, {"p": 1.0, "d": float("inf")}, {"p": 1.0, "i_clamp": float("nan")}]
    )
    def test_gains_that_are_no_numbers_are_refused(self, live, parameters):
        with pytest.raises(Refused, match="must be a number"):
            live(**parameters)


class TestNotices:
    def test_an_integral_gain_without_a_clamp_has_no_effect_and_says_so(self, graph, live):
        live(p=100.0, i=0.01, d=10.0)
        assert graph.lines("warn") == f"{NS}: i = 0.01 has no effect without i_clamp"

    @pytest.mark.parametrize("parameters", [{"p": 1.0}, {"p": 1.0, "i": 0.1, "i_clamp": 1.0}])
    def test_gains_that_work_say_nothing(self, graph, live, parameters):
        live(**parameters)
        assert graph.log == []

    def test_a_negative_gain_is_taken_with_a_warning(self, graph, live):
        pid = live(p=1.0).pid
        graph.set(f"{NS}/p", -2)
        assert pid.gains.p == graph.get(f"{NS}/p") == -2.0
        assert graph.lines("warn") == f"{NS}: p = -2.0 drives away from the set point"


class TestOffers:
    def test_all_six_parameters_are_written_back(self, graph, live):
        live(p=100, i=1, i_clamp=5)
        written = graph.get(NS)
        assert {name: written[name] for name in ("p", "i", "d", "i_clamp_min", "i_clamp_max", "antiwindup")} == {
            "p": 100.0,
            "i": 1.0,
            "d": 0.0,
            "i_clamp_min": -5.0,
            "i_clamp_max": 5.0,
            "antiwindup": False,
        }
        assert written["i_clamp"] == 5.0

    def test_a_reload_finds_what_was_written_back(self, graph):
        graph.set(NS, {"p": 1.0, "i": 1.0, "i_clamp": 5.0})
        node = graph.node(NS)
        ReconfigurablePid(node)
        node.shutdown()
        graph.set(f"{NS}/i_clamp", 9.0)
        assert ReconfigurablePid(graph.node(NS)).pid.gains.i_max == 5.0
        assert graph.get(f"{NS}/i_clamp") == 5.0

    def test_the_gains_and_their_ranges_are_published_for_whoever_comes_later(self, graph, live):
        live(p=3.0, i_clamp=2.0)
        updates, descriptions = (
            graph.publishers[f"{NS}/parameter_updates"],
            graph.publishers[f"{NS}/parameter_descriptions"],
        )
        assert updates.latch
        assert descriptions.latch
        assert updates.messages[-1]["doubles"] == doubles(p=3.0, i=0.0, d=0.0, i_clamp_min=-2.0, i_clamp_max=2.0)
        assert updates.messages[-1]["bools"] == [{"name": "antiwindup", "value": False}]
        description = descriptions.messages[-1]
        assert [entry["name"] for entry in description["groups"][0]["parameters"]] == [
            "p",
            "i",
            "d",
            "i_clamp_min",
            "i_clamp_max",
            "antiwindup",
        ]
        assert description["min"]["doubles"] == doubles(
            p=-100000.0, i=-100000.0, d=-1000.0, i_clamp_min=-100000.0, i_clamp_max=0.0
        )
        assert description["max"]["doubles"] == doubles(
            p=100000.0, i=100000.0, d=1000.0, i_clamp_min=0.0, i_clamp_max=100000.0
        )

    def test_what_is_published_fits_its_type(self, graph, live):
        live(p=3.0, publish_state=True).pid.compute_command(1.0, 0.001)
        for publisher in graph.publishers.values():
            for message in publisher.messages:
                assert msgs.check(publisher.type_name, message) == message


class TestService:
    def test_gains_change_without_a_reset(self, graph, live):
        pid = live(p=1.0, i=1.0, i_clamp=100.0).pid
        pid.compute_command(2.0, 1.0)
        answer = graph.call(f"{NS}/set_parameters", config(doubles=doubles(i=3.0)))
        assert pid.compute_command(0.0, 1.0) == 6.0
        assert answer["config"]["doubles"] == doubles(p=1.0, i=3.0, d=0.0, i_clamp_min=-100.0, i_clamp_max=100.0)
        assert graph.get(f"{NS}/i") == 3.0
        assert graph.sent(f"{NS}/parameter_updates")[-1] == answer["config"]

    def test_antiwindup_changes_too(self, graph, live):
        pid = live(p=1.0).pid
        graph.call(f"{NS}/set_parameters", config(bools=[{"name": "antiwindup", "value": True}]))
        assert pid.gains.antiwindup

    def test_the_whole_configuration_is_brought_into_the_ranges(self, graph, live):
        pid = live(p=1e9).pid
        graph.call(f"{NS}/set_parameters", config(doubles=doubles(d=-5000.0, i_clamp_max=-1.0, i_clamp_min=1.0)))
        assert pid.gains == Gains(p=100000.0, i=0.0, d=-1000.0, i_max=0.0, i_min=0.0)

    @pytest.mark.parametrize(
        ("changes", "reason"),
        [
            ({"doubles": doubles(kp=1.0)}, "no double 'kp'"),
            ({"bools": [{"name": "windup", "value": True}]}, "no bool 'windup'"),
            ({"ints": [{"name": "p", "value": 1}]}, "only doubles and bools can be set"),
            ({"doubles": doubles(d=1.0, p=float("nan"))}, "p must be a number"),
        ],
    )
    def test_a_bad_entry_refuses_the_call_and_changes_nothing(self, graph, live, changes, reason):
        pid = live(p=1.0).pid
        with pytest.raises((Refused, UnknownName), match=reason):
            graph.call(f"{NS}/set_parameters", config(**changes))
        assert pid.gains == Gains(p=1.0)


class TestParameters:
    def test_a_parameter_takes_effect_without_a_reset(self, graph, live):
        pid = live(p=1.0, d=1.0).pid
        pid.compute_command(1.0, 1.0)
        graph.set(f"{NS}/p", 10)
        assert pid.compute_command(1.0, 1.0) == 10.0
        assert graph.sent(f"{NS}/parameter_updates")[-1]["doubles"][0] == {"name": "p", "value": 10.0}

    @pytest.mark.parametrize(
        ("name", "value", "gains"),
        [
            ("i", 2.0, Gains(p=1.0, i=2.0, i_max=5.0, i_min=-5.0)),
            ("d", 2.0, Gains(p=1.0, d=2.0, i_max=5.0, i_min=-5.0)),
            ("i_clamp_min", 2.0, Gains(p=1.0, i_max=5.0, i_min=-2.0)),
            ("i_clamp_max", 2.0, Gains(p=1.0, i_max=2.0, i_min=-5.0)),
            ("antiwindup", True, Gains(p=1.0, i_max=5.0, i_min=-5.0, antiwindup=True)),
        ],
    )
    def test_each_of_the_six_can_be_set(self, graph, live, name, value, gains):
        pid = live(p=1.0, i_clamp=5.0).pid
        graph.set(f"{NS}/{name}", value)
        assert pid.gains == gains

    def test_a_whole_namespace_can_be_set_at_once(self, graph, live):
        pid = live(p=1.0).pid
        graph.set("/bot/controller", {"pid": {"p": 2.0, "i": 3.0, "i_clamp": 4.0}})
        assert pid.gains == Gains(p=2.0, i=3.0, i_max=4.0, i_min=-4.0)

    @pytest.mark.parametrize("value", ["fast", True, 10**400, [1.0], {"a": 1.0}, {}])
    def test_what_is_no_number_is_refused(self, graph, live, value):
        pid = live(p=1.0).pid
        with pytest.raises(Refused, match=f"parameter {NS}/p must be a number"):
            graph.set(f"{NS}/p", value)
        assert pid.gains.p == graph.get(f"{NS}/p") == 1.0

    @pytest.mark.parametrize(("name", "value"), [(NS, 5), ("/bot/controller", "text"), ("/bot", [])])
    def test_a_namespace_of_gains_cannot_become_a_value(self, graph, live, name, value):
        live(p=1.0)
        with pytest.raises(Refused, match=f"{NS} is a namespace of parameters"):
            graph.set(name, value)
        assert graph.get(f"{NS}/p") == 1.0

    @pytest.mark.parametrize("name", [f"{NS}/p", f"{NS}/antiwindup", NS, "/bot"])
    def test_gains_in_use_cannot_be_deleted(self, graph, live, name):
        pid = live(p=1.0, d=2.0).pid
        with pytest.raises(Refused, match="is a gain of a loaded controller"):
            graph.delete(name)
        assert pid.gains == Gains(p=1.0, d=2.0)
        assert graph.get(f"{NS}/d") == 2.0

    def test_gains_that_a_mapping_leaves_out_are_written_back(self, graph, live):
        live(p=1.0, d=2.0)
        graph.set(NS, {"p": 3})
        assert graph.get(NS) == {
            "p": 3.0, "i": 0.0, "d": 2.0, "i_clamp_min": 0.0, "i_clamp_max": 0.0, "antiwindup": False,
        }  # fmt: skip

    @pytest.mark.parametrize(
        ("name", "value", "bounds"),
        [
            ("i_clamp", 7, (-7.0, 7.0)),
            ("i_clamp", -7.0, (-7.0, 7.0)),
            ("i_clamp_min", 3.0, (-3.0, 5.0)),
            ("i_clamp_max", -3.0, (-5.0, 3.0)),
            ("i_clamp_max", -5.0, (-5.0, 5.0)),
        ],
    )
    def test_clamps_are_written_back_as_they_were_taken(self, graph, live, name, value, bounds):
        pid = live(p=1.0, i=1.0, i_clamp=5.0).pid
        graph.set(f"{NS}/{name}", value)
        assert (pid.gains.i_min, pid.gains.i_max) == bounds
        assert (graph.get(f"{NS}/i_clamp_min"), graph.get(f"{NS}/i_clamp_max")) == bounds
        assert graph.get(f"{NS}/i_clamp") == bounds[1]
        graph.set(f"{NS}/i_clamp", 5.0)
        assert (pid.gains.i_min, pid.gains.i_max) == (-5.0, 5.0) if bounds[1] != 5.0 else bounds

    def test_after_its_node_is_shut_down_a_pid_does_not_listen(self, graph):
        graph.set(NS, {"p": 1.0})
        node = graph.node(NS)
        pid = ReconfigurablePid(node).pid
        node.shutdown()
        graph.set(f"{NS}/p", 2.0)
        assert pid.gains.p == 1.0
        assert graph.services == graph.publishers == {}


class TestState:
    def test_the_state_is_published_when_it_is_wanted(self, graph, live):
        graph.time_ns = 3_000_000_004
        pid = live(p=2.0, i=1.0, i_clamp=0.5, d=1.0, publish_state=True).pid
        pid.compute_command(1.0, 0.5)
        (state,) = graph.sent(f"{NS}/state")
        assert state["header"]["stamp"] == {"secs": 3, "nsecs": 4}
        assert state["timestep"] == {"secs": 0, "nsecs": 500_000_000}
        assert (state["error"], state["error_dot"]) == (1.0, 2.0)
        assert (state["p_error"], state["i_error"], state["d_error"]) == (1.0, 0.5, 2.0)
        assert (state["p_term"], state["i_term"], state["d_term"]) == (2.0, 0.5, 2.0)
        assert (state["i_max"], state["i_min"], state["output"]) == (0.5, -0.5, 4.5)

    def test_nobody_listening_costs_no_message(self, graph, live):
        pid = live(p=2.0, publish_state=True).pid
        graph.publishers[f"{NS}/state"].wanted = False
        pid.compute_command(1.0, 0.5)
        assert graph.sent(f"{NS}/state") == []

    def test_without_being_asked_for_there_is_no_state_topic(self, graph, live):
        live(p=2.0)
        assert f"{NS}/state" not in graph.publishers
