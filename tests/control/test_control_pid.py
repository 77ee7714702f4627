"""The PID law and its memory, by the cases that control_toolbox checks and the traps of its reset."""

from math import inf, isfinite, nan

import pytest

from slidectl.control.pid import Gains, Pid, next_command_from


def outputs(pid, *errors, dt=1.0):
    return [pid.compute_command(error, dt) for error in errors]


def test_bounds_the_wrong_way_round_give_finite_commands():
    pid = Pid(1.0, 1.0, 1.0, i_max=-1.0, i_min=1.0)
    assert all(isfinite(command) for command in outputs(pid, -1.0, -1.0))


def test_the_integral_term_stays_within_its_clamp():
    pid = Pid(0.0, 1.0, 0.0, i_max=1.0, i_min=-1.0)
    assert outputs(pid, -10.03, 30.0) == [-1.0, 1.0]


def test_without_a_clamp_there_is_no_integral_action():
    assert outputs(Pid(0.0, 5.0, 0.0), 1.0, 1.0) == [0.0, 0.0]


@pytest.mark.parametrize("antiwindup", [False, True])
def test_an_integral_gain_of_zero_gives_zero_whatever_the_clamp(antiwindup):
    pid = Pid(0.0, 0.0, 0.0, i_max=1.0, i_min=-1.0, antiwindup=antiwindup)
    assert outputs(pid, -1.0, -1.0) == [0.0, 0.0]


def test_antiwindup_bounds_the_integral_itself():
    pid = Pid(0.0, 2.0, 0.0, i_max=1.0, i_min=-1.0, antiwindup=True)
    assert outputs(pid, -1.0, -1.0, 0.5, -1.0) == [-1.0, -1.0, 0.0, -1.0]


def test_without_antiwindup_the_integral_winds_up_behind_its_clamp():
    pid = Pid(0.0, 1.0, 0.0, i_max=1.0, i_min=-1.0)
    assert outputs(pid, 10.0, -1.0) == [1.0, 1.0]
    assert pid.i_error == 9.0


def test_antiwindup_works_with_a_negative_integral_gain():
    pid = Pid(0.0, -2.5, 0.0, i_max=0.5, i_min=-0.2, antiwindup=True)
    assert outputs(pid, 0.1, 0.1, -0.05, 0.1) == pytest.approx([-0.2, -0.2, -0.075, -0.2])


def test_set_gains_leaves_antiwindup_off_unless_told():
    pid = Pid(antiwindup=True)
    pid.set_gains(Gains(1.0, 2.0, 3.0, 4.0, -4.0))
    assert pid.gains == Gains(1.0, 2.0, 3.0, 4.0, -4.0, False)


def test_other_gains_rescale_the_integral_term_and_keep_the_integral():
    pid = Pid(0.0, 1.0, 0.0, i_max=100.0, i_min=-100.0)
    outputs(pid, 2.0)
    pid.set_gains(Gains(0.0, 3.0, 0.0, 100.0, -100.0))
    assert outputs(pid, 0.0) == [6.0]


def test_proportional_action_alone_is_the_gain_times_the_error():
    assert outputs(Pid(1.0), -0.5, -0.5, -1.0, 0.5) == [-0.5, -0.5, -1.0, 0.5]


def test_integral_action_alone_sums_the_error():
    pid = Pid(0.0, 1.0, 0.0, i_max=5.0, i_min=-5.0)
    assert outputs(pid, -0.5, -0.5, 0.0, 0.0, 1.0) == [-0.5, -1.0, -1.0, -1.0, 0.0]


def test_derivative_action_alone_begins_with_a_kick():
    pid = Pid(0.0, 0.0, 1.0)
    assert outputs(pid, -0.5, -0.5) == [-0.5, 0.0]
    assert outputs(pid, -0.5, dt=0.1) == [0.0]
    assert outputs(pid, -1.0, -0.5) == [-0.5, 0.5]


def test_all_three_actions_add_up():
    pid = Pid(1.0, 1.0, 1.0, i_max=5.0, i_min=-5.0)
    assert outputs(pid, -0.5, -0.5, -1.0) == [-1.5, -1.5, -3.5]


@pytest.mark.parametrize(
    ("d_error", "i_error", "commands"), [(0.0, 0.0, [-1.0]), (1.0, 0.0, [0.0, -1.5]), (0.0, -1.0, [-2.0])]
)
def test_a_reset_to_given_errors_is_used_as_it_is(d_error, i_error, commands):
    pid = Pid(1.0, 1.0, 1.0, i_max=5.0, i_min=-5.0)
    pid.reset_to(d_error, i_error)
    assert outputs(pid, *[-0.5] * len(commands)) == commands


def test_a_reset_counts_the_last_error_as_zero_so_the_derivative_kicks():
    pid = Pid(0.0, 0.0, 10.0)
    pid.compute_command(0.5, 0.001)
    pid.reset()
    assert pid.compute_command(0.5, 0.001) == pytest.approx(5000.0)


@pytest.mark.parametrize("error", [nan, inf, -inf])
def test_an_error_that_is_no_number_gives_zero_and_changes_nothing(error):
    pid = Pid(1.0, 1.0, 1.0, i_max=5.0, i_min=-5.0)
    outputs(pid, 1.0)
    before = (pid.p_error, pid.i_error, pid.d_error, pid.command)
    assert pid.compute_command(error, 1.0) == 0.0
    assert (pid.p_error, pid.i_error, pid.d_error, pid.command) == before


def test_a_period_of_zero_gives_zero_and_changes_nothing():
    pid = Pid(1.0)
    assert pid.compute_command(1.0, 0.0) == 0.0
    assert pid.p_error == 0.0


def test_a_negative_period_keeps_the_old_derivative_and_integrates_backwards():
    pid = Pid(0.0, 1.0, 1.0, i_max=9.0, i_min=-9.0)
    outputs(pid, 1.0)
    assert pid.compute_command(5.0, -1.0) == pytest.approx((1.0 - 5.0) + 1.0)


def test_a_given_derivative_is_remembered_even_when_it_is_no_number():
    pid = Pid(1.0, 0.0, 1.0)
    assert next_command_from(pid, 1.0, 2.0, 1.0) == 3.0
    assert next_command_from(pid, 1.0, inf, 1.0) == 0.0
    assert pid.d_error == inf


def test_the_terms_add_up_to_the_command():
    for antiwindup in (False, True):
        pid = Pid(2.0, 3.0, 4.0, i_max=1.0, i_min=-1.0, antiwindup=antiwindup)
        command = pid.compute_command(0.7, 1.0)
        assert sum(pid.terms()) == pytest.approx(command)
        assert pid.terms()[1] == pytest.approx(1.0)


def test_an_observer_hears_of_each_command_that_was_computed():
    pid = Pid(1.0)
    periods = []
    pid.observer = periods.append
    pid.compute_command(1.0, 0.5)
    pid.compute_command(nan, 0.5)
    assert periods == [0.5]
