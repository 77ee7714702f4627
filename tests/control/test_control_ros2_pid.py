"""ROS 2's PID law and `pid_controller/PidController`, held against equations written here with numpy."""

from __future__ import annotations

import numpy as np
import pytest
from fake_robot import Bench, FakeRobot

from slidectl.control.hardware_interface import JointStateInterface
from slidectl.control.ros2_pid import LivePid, Ros2Gains, Ros2Pid
from slidectl.errors import MessageRefused, Refused

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


def stepped(pid: Ros2Pid, errors) -> list[float]:
    return [pid.step(error, DT) for error in errors]


ERRORS = [float(value) for value in 2.0 * np.sin(np.linspace(0.0, 30.0, 400)) - 0.3]
BOUNDS = {"u_clamp_max": 3.0, "u_clamp_min": -2.0}


@pytest.mark.parametrize("strategy", ["none", "back_calculation", "conditional_integration"])
def test_the_outputs_are_those_of_the_equations_with_each_strategy(strategy):
    gains = Ros2Gains(2.0, 30.0, 0.02, **BOUNDS, antiwindup_strategy=strategy, tracking_time_constant=0.05)
    expected = outputs(ERRORS, p=2.0, i=30.0, d=0.02, u=(-2.0, 3.0), strategy=strategy, tracking=0.05)
    assert stepped(Ros2Pid(gains), ERRORS) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert {3.0, -2.0} <= set(expected)


def test_the_strategies_differ_in_how_long_the_output_stays_at_its_bound():
    """An error of 1 for a second, then of -1: the plain integral has grown to 30 and takes a second to come down."""
    errors = [1.0] * 100 + [-1.0] * 300
    at_bound = {}
    for strategy in ("none", "back_calculation", "conditional_integration"):
        gains = Ros2Gains(i=30.0, u_clamp_max=3.0, antiwindup_strategy=strategy, tracking_time_constant=0.02)
        at_bound[strategy] = stepped(Ros2Pid(gains), errors).count(3.0)
    # Integral 0.3 per step: none is at 3 from step 10 on, 90 steps up and 90 down from 30.
    assert at_bound["none"] == pytest.approx(180, abs=2)
    assert at_bound["conditional_integration"] == pytest.approx(91, abs=2)
    assert at_bound["back_calculation"] == pytest.approx(91, abs=2)


def test_the_integral_counts_one_step_late_and_is_clamped_after_it_was_added():
    pid = Ros2Pid(Ros2Gains(i=100.0, i_clamp_max=2.5, i_clamp_min=-1.0))
    assert stepped(pid, [1.0] * 5) == pytest.approx([0.0, 1.0, 2.0, 2.5, 2.5])
    assert stepped(pid, [-10.0] * 2) == pytest.approx([2.5, -1.0])


def test_an_error_in_the_dead_band_is_not_integrated():
    pid = Ros2Pid(Ros2Gains(p=1.0, i=100.0, error_deadband=0.5))
    assert stepped(pid, [0.5, 0.5, 0.6, 0.0]) == pytest.approx([0.5, 0.5, 0.6, 0.6])


def test_the_first_step_has_a_derivative_kick_and_a_given_rate_none():
    assert Ros2Pid(Ros2Gains(d=0.2)).step(1.0, DT) == pytest.approx(20.0)
    pid = Ros2Pid(Ros2Gains(d=0.2))
    assert pid.step_with_rate(1.0, 3.0, DT) == pytest.approx(0.6)
    assert pid.step(1.0, DT) == pytest.approx(20.0)  # the last error is still 0


def test_a_period_of_zero_repeats_the_output_and_a_negative_one_is_an_error():
    pid = Ros2Pid(Ros2Gains(p=2.0, i=1.0))
    pid.step(1.0, DT)
    assert pid.step(5.0, 0.0) == 2.0
    assert pid.step_with_rate(5.0, 1.0, 1e-16) == 2.0
    with pytest.raises(ValueError, match="must not be negative"):
        pid.step(1.0, -DT)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_an_error_that_is_not_finite_gives_nan_and_changes_no_integral(bad):
    pid = Ros2Pid(Ros2Gains(p=1.0, i=100.0))
    pid.step(1.0, DT)
    assert np.isnan(pid.step(bad, DT))
    assert np.isnan(pid.step_with_rate(1.0, bad, DT))
    assert pid.step(0.0, DT) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("gains", "constant"), [({"p": 3.0, "i": 2.0}, 1.5), ({"p": 3.0, "i": 2.0, "d": 8.0}, 2.0)]
)  # fmt: skip
def test_without_a_tracking_time_constant_it_follows_from_the_gains(gains, constant):
    found = Ros2Pid(Ros2Gains(**gains, u_clamp_max=1.0, antiwindup_strategy="back_calculation"))
    given = Ros2Pid(
        Ros2Gains(**gains, u_clamp_max=1.0, antiwindup_strategy="back_calculation", tracking_time_constant=constant)
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
    pid = Ros2Pid(Ros2Gains(p=1.0))
    with pytest.raises(Refused, match=text):
        pid.set_gains(Ros2Gains(**gains))
    assert pid.gains.p == 1.0


@pytest.mark.parametrize(("keep", "output"), [(False, 0.0), (True, 1.0)])
def test_a_reset_keeps_the_integral_only_when_asked_to(keep, output):
    pid = Ros2Pid(Ros2Gains(i=100.0, d=1.0))
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


# --- the controller --------------------------------------------------------------------------------------------------

C = "/bot/c"
GAINS = {"p": 20.0, "i": 5.0, "d": 0.5}
STEP = 0.001


def made(gains=GAINS, joints=("joint1",), commands=("effort", "velocity", "position"), **values) -> Bench:
    """A bench with a loaded and started PidController `c`."""
    own = {
        "type": "pid_controller/PidController",
        "dof_names": list(joints),
        "command_interface": "effort",
        "reference_and_state_interfaces": ["position"],
        "gains": {joint: dict(gains) for joint in joints},
    }
    bench = Bench(FakeRobot(joints, commands), {"c": {**own, **values}})
    bench.load("c")
    return bench


def started(*arguments, **values) -> Bench:
    bench = made(*arguments, **values)
    assert bench.request(start=["c"])
    bench.run()
    return bench


def send(bench: Bench, values, names=(), rates=(), topic="reference") -> None:
    bench.graph.send(f"{C}/{topic}", {"dof_names": list(names), "values": list(values), "values_dot": list(rates)})


def commands(bench: Bench, cycles: int, joint: str = "joint1") -> list[float]:
    found = []
    for _ in range(cycles):
        bench.run()
        found.append(bench.robot.joints[joint].command)
    return found


def law(errors, rates=None, *, p=20.0, i=5.0, d=0.5):
    """The outputs of an unbounded PID, by sums; without rates by differences of the errors."""
    errors = np.asarray(errors, float)
    rates = np.diff(errors, prepend=0.0) / STEP if rates is None else np.asarray(rates, float)
    return list(p * errors + i * STEP * (np.cumsum(errors) - errors) + d * rates)


def test_it_holds_the_position_of_its_start_and_follows_a_message_until_the_next():
    bench = made()
    joint = bench.robot.joints["joint1"]
    joint.position = 0.25
    bench.request(start=["c"])
    bench.run()
    joint.position = 0.2
    assert commands(bench, 2) == pytest.approx(law([0.05, 0.05]))
    send(bench, [1.2], ["joint1"])
    assert commands(bench, 3) == pytest.approx(law([0.05, 0.05, 1.0, 1.0, 1.0])[2:])


def test_without_the_first_set_point_the_command_is_left_alone_until_a_message_comes():
    bench = started(set_current_state_as_first_setpoint=False)
    bench.robot.joints["joint1"].command = 3.0
    assert commands(bench, 2) == [3.0, 3.0]
    send(bench, [1.0], ["joint1"])
    assert commands(bench, 1) == pytest.approx(law([1.0]))


def test_a_message_while_it_is_inactive_acts_on_the_first_update():
    bench = made()
    send(bench, [0.5], ["joint1"])
    bench.request(start=["c"])
    bench.run()
    assert commands(bench, 2) == pytest.approx(law([0.5, 0.5]))


def test_two_interfaces_give_the_rate_of_the_error_and_the_feed_forward():
    bench = started({**GAINS, "feedforward_gain": 2.0}, reference_and_state_interfaces=["position", "velocity"])
    joint = bench.robot.joints["joint1"]
    joint.position, joint.velocity = 0.1, -0.4
    send(bench, [0.6], ["joint1"], [1.5])
    expected = [2.0 * 1.5 + one for one in law([0.5] * 4, [1.9] * 4)]
    assert commands(bench, 4) == pytest.approx(expected)
    send(bench, [0.6], ["joint1"])  # no rate: that of before stays
    assert commands(bench, 1) == pytest.approx([2.0 * 1.5 + law([0.5] * 5, [1.9] * 5)[4]])


def test_with_one_interface_the_feed_forward_is_of_the_reference_and_outside_the_bounds():
    bench = started({"p": 100.0, "u_clamp_max": 3.0, "feedforward_gain": 2.0})
    send(bench, [4.0], ["joint1"])
    assert commands(bench, 1) == [3.0 + 8.0]


@pytest.mark.parametrize(("wraps", "error"), [(False, 6.0), (True, 6.0 - 2 * np.pi)])
def test_the_error_of_an_angle_is_the_shortest_turn_when_it_wraps_around(wraps, error):
    bench = started({"p": 1.0, "angle_wraparound": wraps})
    bench.robot.joints["joint1"].position = -3.0
    send(bench, [3.0], ["joint1"])
    assert commands(bench, 1) == pytest.approx([error])
    assert bench.graph.sent(f"{C}/controller_state")[-1]["dof_states"][0]["error"] == pytest.approx(error)


@pytest.mark.parametrize("interface", ["position", "velocity", "effort"])
def test_it_commands_the_chosen_interface_and_claims_that_alone(interface):
    bench = started(command_interface=interface)
    kind = f"hardware_interface::{interface.title()}JointInterface"
    assert bench.manager.list()[0]["claimed_resources"] == [{"hardware_interface": kind, "resources": ["joint1"]}]


def test_values_are_matched_by_their_names():
    bench = started({"p": 1.0}, joints=("joint1", "joint2"))
    send(bench, [2.0, 1.0], ["joint2", "joint1"])
    bench.run()
    assert [joint.command for joint in bench.robot.joints.values()] == [1.0, 2.0]
    send(bench, [np.nan, 5.0], ["joint1", "joint2"])
    bench.run()
    assert [joint.command for joint in bench.robot.joints.values()] == [1.0, 5.0]


def test_values_without_names_are_taken_in_order_with_a_warning():
    bench = started({"p": 1.0}, joints=("joint1", "joint2"))
    send(bench, [1.0, 2.0])
    bench.run()
    assert [joint.command for joint in bench.robot.joints.values()] == [1.0, 2.0]
    assert "a message on reference has no dof_names" in bench.graph.lines("warn")


@pytest.mark.parametrize(
    ("values", "names", "rates", "text"),
    [
        ([1.0], ["joint1", "joint2"], [], "it has 1 values"),
        ([1.0, 2.0], ["joint1", "joint9"], [], "it names joint1, joint9"),
        ([1.0, 2.0, 3.0], [], [], "it has 3 values"),
        ([1.0, np.inf], [], [], "a value is infinite"),
        ([1.0, 2.0], [], [1.0], "it has 1 values_dot"),
    ],
)
def test_a_message_that_does_not_fit_is_refused(values, names, rates, text):
    bench = started(joints=("joint1", "joint2"), reference_and_state_interfaces=["position", "velocity"])
    with pytest.raises(MessageRefused, match=f"takes a finite value for each of joint1, joint2, and {text}"):
        send(bench, values, names, rates)


def test_states_can_be_those_of_other_joints():
    bench = started(
        {"p": 1.0}, joints=("joint1", "joint2"), dof_names=["joint1"], reference_and_state_dof_names=["joint2"]
    )
    bench.robot.joints["joint2"].position = 0.25
    send(bench, [1.0], ["joint2"])
    assert commands(bench, 1) == [0.75]


def test_states_can_come_from_a_topic():
    bench = started({"p": 1.0}, use_external_measured_states=True)
    send(bench, [1.0], ["joint1"])
    assert commands(bench, 1) == [0.0]  # no state yet
    send(bench, [0.25], ["joint1"], topic="measured_state")
    assert commands(bench, 2) == [0.75, 0.75]


@pytest.mark.parametrize(("keeps", "integral"), [(True, 5.0 * STEP * 3), (False, 0.0)])
def test_a_start_keeps_the_integral_when_asked_to(keeps, integral):
    bench = started({"i": 5.0, "save_i_term": keeps})
    send(bench, [1.0], ["joint1"])
    bench.run(3)
    bench.request(stop=["c"])
    bench.run()
    # The cycle of the stop had an update of its own.
    integral = integral and integral + 5.0 * STEP
    bench.request(start=["c"])
    bench.run()
    assert commands(bench, 1) == pytest.approx([integral])


def test_a_stop_leaves_the_last_command():
    bench = started({"p": 1.0})
    send(bench, [2.0], ["joint1"])
    bench.run()
    bench.request(stop=["c"])
    bench.run(2)
    assert bench.robot.joints["joint1"].command == 2.0


def test_the_state_is_published_in_each_update_and_not_built_for_nobody():
    bench = started({"p": 2.0}, reference_and_state_interfaces=["position", "velocity"])
    joint = bench.robot.joints["joint1"]
    joint.position, joint.velocity = 0.25, 0.5
    send(bench, [1.0], ["joint1"], [2.0])
    bench.run()
    message = bench.graph.sent(f"{C}/controller_state")[-1]
    assert message["header"]["stamp"] == {"secs": 0, "nsecs": bench.graph.time_ns}
    assert message["dof_states"] == [
        {
            "name": "joint1",
            "reference": 1.0,
            "feedback": 0.25,
            "feedback_dot": 0.5,
            "error": 0.75,
            "error_dot": 1.5,
            "time_step": STEP,
            "output": 1.5,
        }
    ]
    count = len(bench.graph.sent(f"{C}/controller_state"))
    bench.graph.publishers[f"{C}/controller_state"].wanted = False
    bench.run(3)
    assert len(bench.graph.sent(f"{C}/controller_state")) == count


def test_the_state_of_a_pid_is_published_when_it_is_activated():
    bench = started({"p": 2.0, "activate_state_publisher": True})
    bench.run()
    assert bench.graph.publishers[f"{C}/joint1/pid_state"].type_name == "slidectl/PidState"
    assert len(bench.graph.sent(f"{C}/joint1/pid_state")) == 1


def test_gains_and_options_change_at_once_and_the_names_of_joints_do_not():
    bench = started({"p": 1.0})
    send(bench, [1.0], ["joint1"])
    bench.graph.set(f"{C}/gains/joint1/p", 4.0)
    bench.graph.set(f"{C}/gains/joint1/feedforward_gain", 0.5)
    bench.graph.set(f"{C}/dof_names", ["joint9"])
    assert commands(bench, 1) == [4.5]
    assert "/bot/c/dof_names takes effect when the controller is loaded again" in bench.graph.lines("warn")


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"dof_names": []}, "/bot/c/dof_names must name joints"),
        ({"dof_names": ["joint1", "joint1"]}, "/bot/c/dof_names must name joints, none of them twice"),
        ({"dof_names": ["joint9"]}, "joint9"),
        ({"reference_and_state_dof_names": ["a", "b"]}, "has 2 entries, and dof_names has 1"),
        ({"command_interface": "torque"}, "command_interface must be position, velocity or effort"),
        ({"reference_and_state_interfaces": []}, "must be a list of one or two of position, velocity and effort"),
        ({"reference_and_state_interfaces": ["position", "acceleration"]}, "must be a list of one or two of"),
        ({"gains": {"joint1": {"u_clamp_max": 0.0, "u_clamp_min": 1.0}}}, "gains/joint1: u_clamp_min 1.0 must be"),
    ],
)
def test_parameters_that_cannot_be_used_are_refused_at_the_load(values, text):
    own = {"dof_names": ["joint1"], "command_interface": "effort", "reference_and_state_interfaces": ["position"]}
    bench = Bench(FakeRobot(), {"c": {"type": "pid_controller/PidController", **own, **values}})
    assert not bench.manager.load("c")
    assert text in bench.graph.lines("error")


def test_an_interface_that_the_robot_lacks_is_refused():
    own = {"dof_names": ["joint1"], "command_interface": "velocity", "reference_and_state_interfaces": ["position"]}
    bench = Bench(FakeRobot(), {"c": {"type": "pid_controller/PidController", **own}})
    assert not bench.manager.load("c")
    assert "needs hardware_interface::VelocityJointInterface" in bench.graph.lines("error")


class TestChained:
    """position_controllers/JointGroupPositionController before it."""

    @pytest.fixture
    def chain(self):
        bench = made({"p": 10.0}, reference_and_state_interfaces=["position", "velocity"])
        bench.graph.set(
            "/bot/front", {"type": "position_controllers/JointGroupPositionController", "joints": ["c/joint1"]}
        )
        bench.robot.joints["joint1"].position = 0.5
        bench.load("front")
        assert bench.request(start=["front", "c"])
        bench.run()
        return bench

    def test_the_preceding_controller_begins_with_the_measured_position(self, chain):
        assert commands(chain, 2) == [0.0, 0.0]

    def test_its_commands_are_references_in_the_same_cycle(self, chain):
        chain.graph.send("/bot/front/command", {"data": [0.75]})
        assert commands(chain, 1) == [2.5]

    def test_messages_on_its_own_topic_have_no_effect_also_not_later(self, chain):
        send(chain, [3.0], ["joint1"])
        assert commands(chain, 1) == [0.0]
        assert "/bot/c: other controllers write its references: the message has no effect" in chain.graph.lines("warn")
        assert chain.request(stop=["front"])
        chain.run()
        assert commands(chain, 1) == [0.0]
        send(chain, [0.6], ["joint1"])
        assert commands(chain, 1) == pytest.approx([1.0])

    def test_the_exported_states_are_the_measured_ones(self, chain):
        joint = chain.robot.joints["joint1"]
        joint.position, joint.velocity, joint.effort = 0.1, 0.2, 0.3
        chain.run()
        (shown,) = chain.robot.get(JointStateInterface).exported()
        assert (shown.name, shown.position, shown.velocity, shown.effort) == ("c/joint1", 0.1, 0.2, 0.3)

    def test_a_second_pid_can_precede_it(self):
        bench = made({"p": 10.0}, reference_and_state_interfaces=["velocity"])
        outer = {
            "type": "pid_controller/PidController",
            "dof_names": ["c/joint1"],
            "reference_and_state_dof_names": ["joint1"],
            "command_interface": "velocity",
            "reference_and_state_interfaces": ["position"],
            "gains": {"c": {"joint1": {"p": 4.0}}},
        }
        bench.graph.set("/bot/outer", outer)
        bench.load("outer")
        assert bench.request(start=["outer", "c"])
        bench.run()
        bench.graph.send("/bot/outer/reference", {"dof_names": [], "values": [0.5], "values_dot": []})
        bench.robot.joints["joint1"].velocity = 0.75
        assert commands(bench, 1) == [10.0 * (4.0 * 0.5 - 0.75)]
