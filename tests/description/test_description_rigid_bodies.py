"""Links on fixed joints weigh as one body, and a body that cannot be simulated gets the nearest inertia that can."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from description_urdf_text import INERTIAL, cart, joint, link, robot
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from slidectl.description import parse
from slidectl.description.inertia import (
    SMALLEST_MASS,
    Tensor,
    densest_ball,
    nearest_possible,
    principal_moments,
    why_impossible,
)
from slidectl.description.robot import Inertial
from slidectl.errors import BadFile

Notices = Callable[[str], list[str]]


def inertial(mass: str, moments: str, origin: str = "0 0 0") -> str:
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    inertia = " ".join(f'{name}="{value}"' for name, value in zip(names, moments.split(), strict=True))
    return f'<inertial><origin xyz="{origin}"/><mass value="{mass}"/>\n<inertia {inertia}/></inertial>'


def weight(xml: str, name: str = "cart") -> Inertial | None:
    return parse(xml, "bot.urdf").links[name].inertial


IMPOSSIBLE = [
    (inertial("1", "1 0 0 1 0 3"), "bot.urdf:4", "1.33333 0 0 1.33333 0 2.66667 instead of 1 0 0 1 0 3 kg·m²"),
    (inertial("1", "1 0 0 1 0 2.06"), "bot.urdf:4", "1.02 0 0 1.02 0 2.04 instead of 1 0 0 1 0 2.06"),
    (inertial("1", "-1 0 0 1 0 1"), "bot.urdf:4", "0.00019263 0 0 1 0 1 instead of -1 0 0 1 0 1"),
    (inertial("1", "0 0 0 0 0 0"), "bot.urdf:4", "0.00019263 0 0 0.00019263 0 0.00019263 instead of 0 0 0 0 0 0"),
    (inertial("0", "1 0 0 1 0 1"), "bot.urdf:3", "a mass of 0.001 instead of 0 kg"),
    (inertial("-2", "0 0 0 0 0 0"), "bot.urdf:3", "a mass of 0.001 instead of -2 kg and ixx ixy ixz"),
    (inertial("1e-320", "1 0 0 1 0 1"), "bot.urdf:3", "a mass of 0.001 instead of 9.99989e-321 kg"),
]


@pytest.mark.parametrize(("inside", "place", "change"), IMPOSSIBLE)
def test_an_inertia_that_no_body_has_becomes_the_nearest_with_old_and_new_values(
    notices: Notices, inside: str, place: str, change: str
) -> None:
    (notice,) = notices(cart(link_inside=inside))
    assert notice.startswith(f"converted {place}: link 'cart'/<inertial>")
    assert change in notice
    mended = weight(cart(link_inside=inside))
    assert mended is not None
    assert mended.mass > 0
    assert why_impossible(mended.inertia) is None


@pytest.mark.parametrize("inside", [inside for inside, _, _ in IMPOSSIBLE])
def test_strict_reading_refuses_what_would_be_mended(inside: str) -> None:
    with pytest.raises(BadFile, match="link 'cart'"):
        parse(cart(link_inside=inside), strict=True)


def arm_with(tip: str) -> str:
    """The cart, and a link fixed to it."""
    turned = '<origin xyz="0 0 2" rpy="0 1.5707963267948966 0"/>'
    return cart(link("tip", tip), joint("weld", "fixed", "cart", "tip", turned))


def test_a_link_on_a_fixed_joint_may_be_impossible_as_long_as_the_whole_is_not(notices: Notices) -> None:
    xml = arm_with(inertial("0", "0 0 0 0 0 0"))
    (notice,) = notices(xml)
    assert notice.startswith("converted bot.urdf:5: link 'tip'/<inertial>/<mass>: has a mass of 0 kg")
    assert "fixed to one another, cart, tip are one body of 1 kg" in notice
    assert weight(xml, "tip") is None
    assert weight(xml) == Inertial(weight(cart()).origin, 1.0, (0.01, 0.0, 0.0, 0.01, 0.0, 0.01), 3, mended=True)  # type: ignore[union-attr]


def test_what_is_lumped_is_the_sum_about_the_common_centre_of_mass() -> None:
    xml = arm_with(inertial("3", "0.1 0 0 0.1 0 0.205", "1 0 0"))
    found = weight(xml)
    assert found is not None
    # Turned by 90 degrees about y, the tip's x is the cart's -z: its centre of mass lies at z = 2 - 1.
    assert found.mass == 4.0
    assert found.origin.xyz == pytest.approx((0.0, 0.0, 0.75))
    steiner = 1 * 0.75**2 + 3 * 0.25**2
    expected = (0.01 + 0.205 + steiner, 0.0, 0.0, 0.01 + 0.1 + steiner, 0.0, 0.01 + 0.1)
    assert found.inertia == pytest.approx(expected, abs=1e-15)


def test_a_body_that_is_impossible_as_a_whole_is_mended_as_a_whole(notices: Notices) -> None:
    xml = arm_with(inertial("0", "0 0 0 0 0 9"))
    (notice,) = notices(xml)
    assert "fixed to one another, cart, tip are simulated with ixx" in notice
    found = weight(xml)
    assert found is not None
    assert why_impossible(found.inertia) is None


def test_possible_bodies_are_left_as_they_are_written(notices: Notices) -> None:
    assert notices(arm_with(INERTIAL)) == []
    before, after = weight(arm_with(INERTIAL)), weight(arm_with(""))
    assert before == after
    assert before is not None
    assert not before.mended


def test_what_is_fixed_to_the_world_weighs_nothing_there(notices: Notices) -> None:
    xml = robot(link("world", ""), link("base", inertial("0", "0 0 0 0 0 0")), joint("w", "fixed", "world", "base", ""))
    (notice,) = notices(xml)
    assert "it is fixed to the world, where nothing has a weight" in notice
    assert weight(xml, "base") is None


def test_what_moves_and_has_no_inertial_at_all_is_wrong_and_gets_a_gram(notices: Notices) -> None:
    xml = cart(link_inside="")
    (notice,) = notices(xml)
    assert notice.startswith("wrong bot.urdf:3: link 'cart': moved by joint 'slide', has no <inertial>")
    assert "0.001 kg and principal moments 1e-06, 1e-06, 1e-06" in notice
    found = weight(xml)
    assert found is not None
    assert found.mass == SMALLEST_MASS


def test_numbers_whose_sums_are_none_are_refused_by_link() -> None:
    xml = cart(link_inside=inertial("1e308", "1e308 0 0 1e308 0 -1e308"))
    with pytest.raises(BadFile, match="link 'cart': its masses or inertias are too large"):
        parse(xml)


EMPTY = [
    "",
    "<geometry/>",
    '<geometry><box size="1 0 1"/></geometry>',
    '<geometry><sphere radius="0"/></geometry>',
    '<geometry><sphere radius="5e-324"/></geometry>',
    '<geometry><cylinder radius="1" length="1e-324"/></geometry>',
    '<geometry><mesh filename="a.stl" scale="1 0 1"/></geometry>',
    '<geometry><mesh filename=""/></geometry>',
]


@pytest.mark.parametrize("tag", ["visual", "collision"])
@pytest.mark.parametrize("inside", EMPTY)
def test_a_shape_without_a_size_is_left_out_and_the_robot_is_not(notices: Notices, tag: str, inside: str) -> None:
    ball = '<collision><geometry><sphere radius="1"/></geometry></collision>'
    xml = cart(link_inside=f"{INERTIAL}<{tag}>{inside}</{tag}>{ball}")
    (notice,) = notices(xml)
    assert notice.startswith("converted bot.urdf:3: link 'cart'/<")
    assert notice.endswith("the shape is left out")
    found = parse(xml).links["cart"]
    assert (len(found.visuals), len(found.collisions)) == (0, 1)


FLOATS = st.floats(-1e3, 1e3)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(tensor=st.tuples(FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS), mass=st.floats(-1, 100))
def test_the_nearest_inertia_is_possible_keeps_its_axes_and_is_none_other_than_a_possible_one(
    tensor: Tensor, mass: float
) -> None:
    new_mass, new = nearest_possible(mass, tensor)
    assert new_mass > 0
    assert why_impossible(new) is None
    assert nearest_possible(new_mass, new) == (new_mass, new)
    assume(max(map(abs, tensor)) > 1e-6)
    before, after = _matrix(tensor), _matrix(new)
    assert np.allclose(before @ after, after @ before, atol=1e-9 * np.abs(before).max() * np.abs(after).max())


@settings(max_examples=200, deadline=None, derandomize=True)
@given(moments=st.tuples(FLOATS, FLOATS, FLOATS), others=st.lists(st.tuples(FLOATS, FLOATS, FLOATS), max_size=20))
def test_no_possible_inertia_about_the_same_axes_is_nearer(
    moments: tuple[float, float, float], others: list[tuple[float, float, float]]
) -> None:
    x, y, z = moments
    _, new = nearest_possible(1.0, (x, 0.0, 0.0, y, 0.0, z))
    floor = max(densest_ball(1.0), 1e-6 * principal_moments(new)[2])
    distance = np.linalg.norm(np.subtract((new[0], new[3], new[5]), moments))
    for a, b, c in others:
        if why_impossible((abs(a), 0.0, 0.0, abs(b), 0.0, abs(c))) is None:
            nearer = np.linalg.norm(np.subtract((abs(a), abs(b), abs(c)), moments))
            # Raised to the floor, and allowed the digits that files lose, which makes no more difference than these.
            assert distance <= nearer + 2 * floor + 2e-3 * max(map(abs, moments))


@settings(max_examples=300, deadline=None, derandomize=True)
@given(tensor=st.tuples(FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS))
def test_principal_moments_are_the_eigenvalues(tensor: Tensor) -> None:
    expected = np.linalg.eigvalsh(_matrix(tensor))
    assert principal_moments(tensor) == pytest.approx(tuple(expected), abs=1e-12 * max(1e-300, *map(abs, tensor)))


def _matrix(tensor: Tensor) -> np.ndarray:
    ixx, ixy, ixz, iyy, iyz, izz = tensor
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
