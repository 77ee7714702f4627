"""Robots come, go, fall and rest."""

from __future__ import annotations

import ctypes
from pathlib import Path

import pytest
from physics_robots import AT_ORIGIN, arm, at, block, box_inertial, one_joint, tree

from slidectl.description.robot import Joint, Link
from slidectl.errors import Refused, UnknownName
from slidectl.physics import World
from slidectl.physics.mujoco_library import address_of, struct_address


def test_a_free_robot_falls_to_the_ground_and_rests_there() -> None:
    world = World()
    world.attach(block(), "block", at(0.0, 0.0, 1.0))
    for _ in range(3000):
        world.step()
    (_, _, height), _ = world.link_pose("block", "base")
    assert height == pytest.approx(0.2, abs=1e-3)


def test_a_world_without_ground_lets_it_fall_for_ever() -> None:
    world = World(ground=False)
    world.attach(block(), "block", at(0.0, 0.0, 1.0))
    for _ in range(2000):
        world.step()
    assert world.link_pose("block", "base")[0][2] == pytest.approx(1.0 - 0.5 * 9.8 * 2.0**2, rel=1e-3)


def test_a_root_called_world_is_fixed_where_the_robot_was_put() -> None:
    world = World()
    world.attach(one_joint("continuous"), "one", at(1.0, 2.0, 3.0))
    for _ in range(100):
        world.step()
    assert world.link_pose("one", "world")[0] == (1.0, 2.0, 3.0)
    assert world.link_pose("one", "cart")[0] == (1.0, 2.0, 3.0)


def test_attitudes_are_x_y_z_w() -> None:
    world = World()
    quarter_turn_about_z = (0.0, 0.0, 0.5**0.5, 0.5**0.5)
    world.attach(arm(1), "arm", ((0.0, 0.0, 0.0), quarter_turn_about_z))
    position, attitude = world.link_pose("arm", "link0")
    assert position == pytest.approx((-0.06, 0.0, 1.0))
    assert attitude == pytest.approx(quarter_turn_about_z)


def test_robots_are_listed_in_the_order_of_their_coming() -> None:
    world = World()
    for name in ("b", "a", "c"):
        world.attach(one_joint(), name)
    world.detach("a")
    assert world.names() == ["b", "c"]


def test_a_name_is_taken_only_once() -> None:
    world = World()
    world.attach(one_joint(), "one")
    with pytest.raises(Refused, match="a robot named 'one' is in the world already"):
        world.attach(one_joint(), "one")


def test_names_that_do_not_exist_are_answered_with_those_that_do() -> None:
    world = World()
    world.attach(one_joint(), "one")
    with pytest.raises(UnknownName, match=r"no model 'on'. Did you mean 'one'\?"):
        world.detach("on")
    with pytest.raises(UnknownName, match=r"no link 'card' on robot 'one'. Did you mean 'cart'"):
        world.link_pose("one", "card")
    with pytest.raises(UnknownName, match=r"no moving joint 'joint' on robot 'one'. Did you mean 'joint1'"):
        world.joint_state("one", "joint")


def test_a_joint_may_have_the_name_of_the_root_link() -> None:
    links = [Link("base", box_inertial(1.0, (0.1, 0.1, 0.1))), Link("tip", box_inertial(1.0, (0.1, 0.1, 0.1)))]
    world = World()
    world.attach(tree(links, [Joint("base", "continuous", "base", "tip")], root="base"), "one")
    assert world.joint_state("one", "base")[0] == 0.0


def test_what_is_asked_of_the_world_must_be_finite() -> None:
    world = World()
    world.attach(block(), "block")
    nan = float("nan")
    with pytest.raises(Refused, match="nan is not a finite number"):
        world.set_pose("block", at(0.0, nan, 0.0))
    with pytest.raises(Refused, match="nan is not a finite number"):
        world.attach(block(), "other", at(nan, 0.0, 0.0))
    assert world.names() == ["block"]


def test_gravity_and_time_step_can_be_changed_and_stay_when_robots_come() -> None:
    world = World()
    world.attach(block(), "block", at(0.0, 0.0, 5.0))
    world.set_gravity((0.0, 0.0, 1.0))
    world.set_timestep(0.002)
    world.attach(block(), "other", at(2.0, 0.0, 5.0))
    for _ in range(500):
        world.step()
    assert world.link_twist("block", "base")[0] == pytest.approx((0.0, 0.0, 1.0))
    assert world.timestep == 0.002
    assert world.gravity == (0.0, 0.0, 1.0)


def test_a_robot_can_be_put_elsewhere_with_a_twist_in_the_axes_of_the_world() -> None:
    world = World(gravity=(0.0, 0.0, 0.0))
    world.attach(block((0.2, 0.2, 0.2)), "block")
    turned = (0.5, 0.5, 0.5, 0.5)
    world.set_pose("block", ((1.0, 2.0, 3.0), turned), ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)))
    linear, angular = world.link_twist("block", "base")
    assert world.link_pose("block", "base") == ((1.0, 2.0, 3.0), turned)
    assert linear == pytest.approx((0.1, 0.2, 0.3))
    assert angular == pytest.approx((0.4, 0.5, 0.6))
    for _ in range(1000):
        world.step()
    assert world.link_pose("block", "base")[0] == pytest.approx((1.1, 2.2, 3.3))


def test_a_fixed_robot_can_be_put_elsewhere_and_stays_there_when_others_come() -> None:
    world = World()
    world.attach(one_joint("continuous"), "one")
    world.set_pose("one", at(4.0, 5.0, 6.0), ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    world.attach(block(), "block", at(0.0, 0.0, 1.0))
    for _ in range(10):
        world.step()
    assert world.link_pose("one", "cart")[0] == (4.0, 5.0, 6.0)
    world.reset()
    assert world.link_pose("one", "cart")[0] == (0.0, 0.0, 0.0)


def test_joints_can_be_put_anywhere() -> None:
    world = World(gravity=(0.0, 0.0, 0.0))
    world.attach(one_joint(), "one")
    world.set_joint("one", "joint1", 0.5, velocity=0.25)
    assert world.joint_state("one", "joint1") == (0.5, 0.25, 0.0)
    assert world.link_pose("one", "cart")[0] == (0.0, 0.0, 0.5)
    assert world.link_twist("one", "cart")[0] == (0.0, 0.0, 0.25)
    world.set_joint("one", "joint1", 1.0)
    assert world.joint_state("one", "joint1") == (1.0, 0.25, 0.0)


def test_those_who_hold_the_model_are_told_when_it_is_replaced() -> None:
    world, told = World(), []
    world.on_rebuild(lambda: told.append(world.names()))
    world.attach(one_joint(), "one")
    world.attach(block(), "two", at(0.0, 0.0, 1.0))
    world.detach("one")
    assert told == [["one"], ["one", "two"], ["two"]]


def test_two_hundred_robots_that_came_and_went_leave_nothing_behind() -> None:
    world = World()
    world.attach(arm(reach=1.0), "stays", AT_ORIGIN)
    before = _sizes(world)
    memory = 0
    for round_ in range(200):
        world.attach(arm(2, free=True, reach=1.0), "guest", at(3.0, 0.0, 1.0))
        for _ in range(2):
            world.step()
        world.link_pose("guest", "base")
        world.detach("guest")
        if round_ == 50:
            memory = _resident_pages()
    assert _sizes(world) == before
    assert _resident_pages() - memory < 5000, "pages of 4 KiB"


def _sizes(world: World) -> tuple[int, ...]:
    model = world.model
    counts = (model.nbody, model.njnt, model.ngeom, model.neq, model.nexclude, model.nmesh, model.nnames)
    return tuple(int(count) for count in counts)


def _resident_pages() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])


def test_the_addresses_of_model_and_data_are_those_that_the_library_steps() -> None:
    world = World()
    world.attach(block(), "block", AT_ORIGIN)
    step = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(address_of("mj_step"))
    step(struct_address(world.model), struct_address(world.data))
    assert world.data.time == world.model.opt.timestep
