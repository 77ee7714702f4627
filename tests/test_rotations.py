"""Rotations: from angles, one after another, and back."""

from __future__ import annotations

import math

import pytest

from slidectl.rotations import IDENTITY, conjugate, from_rpy, message, multiply, normalized

HALF = math.sqrt(0.5)


def test_angles_turn_about_x_then_y_then_z() -> None:
    assert from_rpy((math.pi / 2, 0, 0)) == pytest.approx((HALF, 0, 0, HALF))
    assert from_rpy((0, math.pi / 2, 0)) == pytest.approx((0, HALF, 0, HALF))
    assert from_rpy((math.pi / 2, math.pi / 2, math.pi / 2)) == pytest.approx((0, HALF, 0, HALF))


def test_a_product_does_its_second_factor_first() -> None:
    roll, pitch, yaw = from_rpy((0.1, 0, 0)), from_rpy((0, 0.2, 0)), from_rpy((0, 0, 0.3))
    assert multiply(yaw, multiply(pitch, roll)) == pytest.approx(from_rpy((0.1, 0.2, 0.3)))


def test_a_rotation_and_its_inverse_are_none() -> None:
    turn = from_rpy((0.1, -0.2, 0.3))
    assert multiply(turn, conjugate(turn)) == pytest.approx(IDENTITY)


def test_all_zeros_are_no_rotation_and_others_get_the_length_one() -> None:
    assert normalized((0.0, 0.0, 0.0, 0.0)) == IDENTITY
    assert normalized((0.0, 0.0, 3.0, 4.0)) == (0.0, 0.0, 0.6, 0.8)
    assert message(IDENTITY) == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
