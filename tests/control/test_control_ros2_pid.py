"""ROS 2's PID law and `pid_controller/PidController`, held against equations written here with numpy."""

from __future__ import annotations

import numpy as np
import pytest

from slidectl.control.ros2_pid import Gains, LivePid, Pid
from slidectl.errors import Refused

DT = 0.01
INF = np.inf


def outputs(errors, *, p=0.0, i=0.0, d=0.0, u=(-INF, INF), clamp=(-INF, INF), strategy="none", tracking=0.0, dead=0.0):
    """The outputs of the law, from its description: contribution first, then clamp, then integration."""
    integral, last, found = 0.0, 0.0, []
    for error in errors:
        wanted = p * error + integral + d * (error - last) / DT
        last = error
        given = float(np.clip(wanted, *u))
        found.append(given)
        grows = i * error
        if strategy == "back_calculation":
            grows = grows + (given - wanted) / tracking if i else 0.0
        if strategy == "conditional_integration" and given != wanted and np.sign(error) == np.sign(wanted):
            grows = 0.0
        if abs(error) > dead:
            integral += DT * grows
        integral = float(np.clip(integral, *clamp))
    return found


def stepped(pid: Pid, errors) -> list[float]:
    return [pid.step(error, DT) for error in errors]


ERRORS = [float(value) for value in 2.0 * np.sin(np.linspace(0.0, 30.0, 400)) - 0.3]
BOUNDS = {"u_clamp_max": 3.0, "u_clamp_min": -2.0}


@pytest.mark.parametrize("strategy", ["none", "back_calculation", "conditional_integration"])
def test_the_outputs_are_those_of_the_equations_with_each_strategy(strategy):
    gains = Gains(2.0, 30.0, 0.02, **BOUNDS, antiwindup_strategy=strategy, tracking_time_constant=0.05)
    expected = outputs(ERRORS, p=2.0, i=30.0, d=0.02, u=(-2.0, 3.0), strategy=strategy, tracking=0.05)
    assert stepped(Pid(gains), ERRORS) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert {3.0, -2.0} <= set(expected)


def test_the_strategies_differ_in_how_long_the_output_stays_at_its_bound():
    """An error of 1 for a second, then of -1: the plain integral has grown to 30 and takes a second to come down."""
    errors = [1.0] * 100 + [-1.0] * 300
    at_bound = {}
    for strategy in ("none", "back_calculation", "conditional_integration"):
        gains = Gains(i=30.0, u_clamp_max=3.0, antiwindup_strategy=strategy, tracking_time_constant=0.02)
        at_bound[strategy] = stepped(Pid(gains), errors).count(3.0)
    # Integral 0.3 per step: none is at 3 from step 10 on, 90 steps up and 90 down from 30.
    assert at_bound["none"] == pytest.approx(180, abs=2)
    assert at_bound["conditional_integration"] == pytest.approx(91, abs=2)
    assert at_bound["back_calculation"] == pytest.approx(91, abs=2)


def test_the_integral_counts_one_step_late_and_is_clamped_after_it_was_added():
    pid = Pid(Gains(i=100.0, i_clamp_max=2.5, i_clamp_min=-1.0))
    assert stepped(pid, [1.0] * 5) == pytest.approx([0.0, 1.0, 2.0, 2.5, 2.5])
    assert stepped(pid, [-10.0] * 2) == pytest.approx([2.5, -1.0])


def test_an_error_in_the_dead_band_is_not_integrated():
    pid = Pid(Gains(p=1.0, i=100.0, error_deadband=0.5))
    assert stepped(pid, [0.5, 0.5, 0.6, 0.0]) == pytest.approx([0.5, 0.5, 0.6, 0.6])


def test_the_first_step_has_a_derivative_kick_and_a_given_rate_none():
    assert Pid(Gains(d=0.2)).step(1.0, DT) == pytest.approx(20.0)
    pid = Pid(Gains(d=0.2))
    assert pid.step_with_rate(1.0, 3.0, DT) == pytest.approx(0.6)
    assert pid.step(1.0, DT) == pytest.approx(20.0)  # the last error is still 0


def test_a_period_of_zero_repeats_the_output_and_a_negative_one_is_an_error():
    pid = Pid(Gains(p=2.0, i=1.0))
    pid.step(1.0, DT)
    assert pid.step(5.0, 0.0) == 2.0
    assert pid.step_with_rate(5.0, 1.0, 1e-16) == 2.0
    with pytest.raises(ValueError, match="must not be negative"):
        pid.step(1.0, -DT)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_an_error_that_is_not_finite_gives_nan_and_changes_no_integral(bad):
    pid = Pid(Gains(p=1.0, i=100.0))
    pid.step(1.0, DT)
    assert np.isnan(pid.step(bad, DT))
    assert np.isnan(pid.step_with_rate(1.0, bad, DT))
    assert pid.step(0.0, DT) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("gains", "constant"), [({"p": 3.0, "i": 2.0}, 1.5), ({"p": 3.0, "i": 2.0, "d": 8.0}, 2.0)]
)  # fmt: skip
def test_without_a_tracking_time_constant_it_follows_from_the_gains(gains, constant):
    found = Pid(Gains(**gains, u_clamp_max=1.0, antiwindup_strategy="back_calculation"))
    given = Pid(
        Gains(**gains, u_clamp_max=1.0, antiwindup_strategy="back_calculation", tracking_time_constant=constant)
    )
    assert stepped(found, ERRORS) == stepped(given, ERRORS)


@pytest.mark.parametrize(
    ("gains", "text"),
    [
        ({"u_clamp_min": 1.0, "u_clamp_max": 1.0}, "u_clamp_min 1.0 must be below u_clamp_max 1.0"),
        ({"u_clamp_max": np.nan}, "u_clamp_max must be a number, not nan"),
        ({"i_clamp_min": 0.1}, "i_clamp_min must not be above 0"),
        ({"i_clamp_max": -0.1}, "i_clamp_max not below"),
        ({"p": INF}, "p must be a finite number, not inf"),
        ({"i": 1.0, "antiwindup_strategy": "back_calculation"}, "needs a tracking_time_constant above 0"),
        (
            {"i": 1.0, "antiwindup_strategy": "back_calculation", "tracking_time_constant": -1.0},
            "needs a tracking_time_constant above 0",
        ),
        (
            {"antiwindup_strategy": "legacy"},
            "must be none, back_calculation or conditional_integration, not 'legacy'",
        ),
    ],
)
def test_gains_that_cannot_be_used_are_refused_and_the_old_ones_stay(gains, text):
    pid = Pid(Gains(p=1.0))
    with pytest.raises(Refused, match=text):
        pid.set_gains(Gains(**gains))
    assert pid.gains.p == 1.0


@pytest.mark.parametrize(("keep", "output"), [(False, 0.0), (True, 1.0)])
def test_a_reset_keeps_the_integral_only_when_asked_to(keep, output):
    pid = Pid(Gains(i=100.0, d=1.0))
    pid.step(1.0, DT)
    pid.reset(keep_integral=keep)
    assert pid.step(0.0, DT) == pytest.approx(output)


class TestGainsThatAreParameters:
    @pytest.fixture
    def live(self, graph):
        graph.set("/bot/c/gains/joint1", {"p": 2, "i": 100.0, "u_clamp_max": 5.0})
        return LivePid(graph.node("/bot/c"), "gains/joint1", 0.0, "joint1/pid_state")

    def test_a_change_takes_effect_at_once_and_the_integral_stays(self, graph, live):
        live.pid.step(1.0, DT)
        graph.set("/bot/c/gains/joint1/p", 3.0)
        assert live.pid.step(1.0, DT) == pytest.approx(3.0 + 1.0)
        graph.delete("/bot/c/gains/joint1/p")
        assert live.pid.step(0.0, DT) == pytest.approx(2.0)

    @pytest.mark.parametrize(
        ("name", "value", "text"),
        [
            ("u_clamp_min", 6.0, "gains/joint1: u_clamp_min 6.0 must be below"),
            ("i", "1e3", "gains/joint1/i must be a number, not the string '1e3'"),
            ("antiwindup_strategy", "legacy", "must be none, back_calculation or conditional_integration"),
        ],
    )
    def test_a_change_that_cannot_be_used_is_refused(self, graph, live, name, value, text):
        with pytest.raises(Refused, match=text):
            graph.set(f"/bot/c/gains/joint1/{name}", value)
        assert live.pid.gains.u_clamp_min == -INF

    def test_bounds_count_unless_saturation_is_off(self, graph, live):
        assert live.pid.step(10.0, DT) == 5.0
        graph.set("/bot/c/gains/joint1/saturation", False)
        assert live.pid.step(10.0, DT) == pytest.approx(20.0 + 10.0)

    def test_the_state_is_published_only_while_it_is_activated(self, graph, live):
        live.pid.step(1.0, DT)
        live.publish(5_000_000, DT)
        assert "/bot/c/joint1/pid_state" not in graph.publishers
        graph.set("/bot/c/gains/joint1/activate_state_publisher", True)
        live.pid.step(1.0, DT)
        live.publish(5_000_000, DT)
        (message,) = graph.sent("/bot/c/joint1/pid_state")
        assert message.pop("header")["stamp"] == {"secs": 0, "nsecs": 5_000_000}
        assert message == {
            "timestep": {"secs": 0, "nsecs": 10_000_000},
            "error": 1.0,
            "error_dot": 0.0,
            "i_term": pytest.approx(2.0),
            "p_gain": 2.0,
            "i_gain": 100.0,
            "d_gain": 0.0,
            "output": pytest.approx(3.0),
        }
        graph.set("/bot/c/gains/joint1/activate_state_publisher", False)
        live.publish(6_000_000, DT)
        assert len(graph.sent("/bot/c/joint1/pid_state")) == 1
