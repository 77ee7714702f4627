"""What links weigh, and inertias that are refused."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from physics_robots import box_inertial, one_joint, tree

from slidectl.description.inertia import can_move, principal_moments, why_impossible
from slidectl.description.robot import Inertial, Joint, Link, Pose
from slidectl.errors import SlidectlError
from slidectl.physics import World

HALF_PI = 1.5707963267948966


def spin_up(inertial: Inertial, axis: tuple[float, float, float]) -> float:
    """Angular acceleration by 1 N·m about an axis through the link's origin, without gravity."""
    world = World(gravity=(0.0, 0.0, 0.0))
    world.attach(one_joint("continuous", axis, inertial=inertial), "one")
    world.add_joint_force("one", "joint1", 1.0)
    world.step()
    return world.joint_state("one", "joint1")[1] / world.timestep


def test_the_inertia_counts_about_the_axes_of_the_inertial_origin() -> None:
    moments = (0.02, 0.0, 0.0, 0.03, 0.0, 0.04)
    turned = Inertial(Pose(rpy=(0.0, 0.0, HALF_PI)), 1.0, moments)
    assert spin_up(turned, (1.0, 0.0, 0.0)) == pytest.approx(1 / 0.03)
    assert spin_up(turned, (0.0, 1.0, 0.0)) == pytest.approx(1 / 0.02)


def test_products_of_inertia_count() -> None:
    tensor = np.array([[0.03, 0.005, 0.002], [0.005, 0.04, -0.003], [0.002, -0.003, 0.05]])
    rpy = (0.3, -0.4, 0.5)
    inertial = Inertial(Pose(rpy=rpy), 1.0, (0.03, 0.005, 0.002, 0.04, -0.003, 0.05))
    turn = _rotation(rpy)
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    expected = axis @ turn @ tensor @ turn.T @ axis
    assert spin_up(inertial, (1.0, 2.0, 2.0)) == pytest.approx(1 / expected)


def test_a_centre_of_mass_off_the_axis_adds_its_share() -> None:
    inertial = Inertial(Pose((0.5, 0.0, 0.0)), 2.0, (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    assert spin_up(inertial, (0.0, 0.0, 1.0)) == pytest.approx(1 / (0.01 + 2.0 * 0.25))


def test_links_welded_together_move_as_one() -> None:
    links = [Link("frame"), Link("load", box_inertial(3.0, (0.1, 0.1, 0.1))), Link("tip")]
    joints = [
        Joint("slide", "prismatic", "world", "frame", axis=(1.0, 0.0, 0.0)),
        Joint("weld", "fixed", "frame", "load", Pose((0.0, 0.0, 0.2), (0.0, HALF_PI, 0.0))),
        Joint("tip_weld", "fixed", "load", "tip", Pose((0.0, 0.0, 0.1))),
    ]
    world = World(gravity=(0.0, 0.0, 0.0))
    world.attach(tree(links, joints), "robot")
    world.add_joint_force("robot", "slide", 6.0)
    for _ in range(1000):
        world.step()
    assert world.joint_state("robot", "slide")[1] == pytest.approx(2.0)
    assert world.link_pose("robot", "tip")[0] == pytest.approx((1.0 + 0.001 + 0.1, 0.0, 0.2))


@pytest.mark.parametrize(
    ("inertial", "trouble"),
    [
        (Inertial(Pose(), 0.0, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)), "mass 0 kg is not positive"),
        (Inertial(Pose(), -1.0, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)), "mass -1 kg is not positive"),
        (Inertial(Pose(), float("nan"), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)), "mass nan kg is not positive"),
        (
            Inertial(Pose(), 1.0, (1.0, 0.0, 0.0, 1.0, 0.0, 3.0)),
            "no body has its inertia: its principal moments are 1, 1, 3;",
        ),
        (
            Inertial(Pose(), 1.0, (1.0, 0.0, 0.0, 1.0, 0.0, -1.0)),
            "no body has its inertia: its principal moments are -1, 1, 1;",
        ),
        (Inertial(Pose(), 1.0, (1.0, 2.0, 0.0, 1.0, 0.0, 1.0)), "no body has its inertia"),
        (Inertial(Pose(), 1.0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)), "no body has its inertia"),
        (Inertial(Pose(), 1.0, (float("inf"), 0.0, 0.0, 1.0, 0.0, 1.0)), "its inertia is not finite"),
        (None, "it moves but has no inertia"),
    ],
)
def test_what_no_body_can_weigh_is_refused_by_link_and_robot(inertial: Inertial | None, trouble: str) -> None:
    robot = tree([Link("cart", inertial, line=12)], [Joint("joint1", "continuous", "world", "cart")])
    with pytest.raises(SlidectlError) as caught:
        World().attach(robot, "mine")
    assert str(caught.value).startswith(f"link 'cart' of robot 'mine' (line 12): {trouble}")


def test_digits_lost_in_a_file_are_forgiven() -> None:
    rod = Inertial(Pose(), 1.0, (0.0833333, 0.0, 0.0, 0.0833334, 0.0, 1e-7))
    assert spin_up(rod, (1.0, 0.0, 0.0)) == pytest.approx(1 / 0.0833333, rel=1e-5)
    skew = Inertial(Pose(rpy=(0.1, 0.2, 0.3)), 1.0, (0.05, 1e-9, 0.0, 0.05, 0.0, 0.10001))
    assert spin_up(skew, (0.0, 0.0, 1.0)) > 0.0


def test_a_refused_robot_leaves_the_world_as_it_was() -> None:
    world = World()
    world.attach(one_joint(), "one")
    for _ in range(10):
        world.step()
    model, before = world.model, world.joint_state("one", "joint1")
    broken = tree([Link("cart")], [Joint("joint1", "continuous", "world", "cart")])
    with pytest.raises(SlidectlError):
        world.attach(broken, "two")
    assert world.names() == ["one"]
    assert world.model is model
    assert world.joint_state("one", "joint1") == before


def _rotation(rpy: tuple[float, float, float]) -> np.ndarray:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    sides=st.tuples(st.floats(0.001, 10.0), st.floats(0.001, 10.0)),
    density=st.floats(1e-6, 1e4),
    turn=st.tuples(*[st.floats(-3.2, 3.2)] * 3),
    tilt=st.tuples(*[st.floats(-3.2, 3.2)] * 3),
    digits=st.sampled_from([3, 6, 9, 17]),
)
def test_a_thin_plate_is_spawned_however_it_lies_and_whatever_digits_its_file_keeps(
    sides: tuple[float, float], density: float, turn: tuple[float, ...], tilt: tuple[float, ...], digits: int
) -> None:
    x, y = sides
    mass = density * x * y
    axes = _rotation(turn)  # type: ignore[arg-type]
    tensor = axes @ np.diag([mass * y * y / 12, mass * x * x / 12, mass * (x * x + y * y) / 12]) @ axes.T
    ixx, ixy, ixz, iyy, iyz, izz = (
        float(f"{tensor[i, j]:.{digits}g}") for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    inertial = Inertial(Pose(rpy=tilt), mass, (ixx, ixy, ixz, iyy, iyz, izz))  # type: ignore[arg-type]
    assume(why_impossible(inertial.inertia) is None)
    assume(can_move(mass, inertial.inertia))
    world = World(gravity=(0.0, 0.0, 0.0))
    world.attach(tree([Link("plate", inertial)], [], "plate"), "plate")
    moments = world.model.body_inertia[world.robot("plate").links["plate"].body]
    # MuJoCo's own turning of a tensor leaves off what is below 1e-12 kg·m².
    assert sorted(moments) == pytest.approx(principal_moments(inertial.inertia), rel=2e-3, abs=1e-12)


def test_the_plate_whose_digits_miss_the_rule_by_one_is_spawned() -> None:
    flat = Inertial(Pose(), 1.0, (0.195728, 0.0, 0.0, 0.332102, 0.0, 0.527831))
    assert spin_up(flat, (0.0, 0.0, 1.0)) == pytest.approx(1 / 0.52783)


def test_a_plate_that_mujoco_takes_is_left_to_it_to_the_last_bit() -> None:
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    tensor = _rotation((0.3, 0.0, 0.0)) @ np.diag([1.0, 2.0, 2.9999999]) @ _rotation((0.3, 0.0, 0.0)).T
    row = [float(tensor[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    spec.worldbody.add_body(mass=1.0, explicitinertial=True, ipos=[0.0, 0.0, 0.0], fullinertia=row)
    model = spec.compile()
    ixx, iyy, izz, ixy, ixz, iyz = row
    world = World()
    world.attach(tree([Link("plate", Inertial(Pose(), 1.0, (ixx, ixy, ixz, iyy, iyz, izz)))], [], "plate"), "plate")
    assert (world.model.body_inertia[1] == model.body_inertia[1]).all()
    assert (world.model.body_iquat[1] == model.body_iquat[1]).all()


def test_a_mass_below_the_least_of_the_physics_is_refused_by_link() -> None:
    faint = Inertial(Pose(), 1e-16, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
    with pytest.raises(SlidectlError, match="link 'base' of robot 'one': it moves, and its mass or a moment of it"):
        World().attach(tree([Link("base", faint)], [], "base"), "one")
