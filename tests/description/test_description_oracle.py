"""Our reading of a robot against yourdfpy's: the same places of all links for any angles of the joints."""

from __future__ import annotations

import io
import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from description_urdf_text import LIMIT, joint, link, robot
from hypothesis import given, settings
from hypothesis import strategies as st

from slidectl.description import Robot, load, parse
from slidectl.description.robot import Joint, Pose

BRANCHED = robot(
    link("base"),
    joint(
        "lift",
        "prismatic",
        "base",
        "mast",
        LIMIT + '<origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="0 0.6 0.8"/>',
    ),
    link("mast"),
    joint("turn", "revolute", "mast", "arm", LIMIT + '<origin xyz="0 0 1" rpy="1.5 0.2 -3"/><axis xyz="1 2 -3"/>'),
    link("arm"),
    joint("spin", "continuous", "mast", "wheel", '<origin rpy="0 1.5707963267948966 0.1"/><axis xyz="0 0 -1"/>'),
    link("wheel"),
    joint("follow", "revolute", "arm", "finger", LIMIT + '<mimic joint="turn" multiplier="-0.5" offset="0.2"/>'),
    link("finger"),
)


def rotation(axis: tuple[float, float, float], angle: float) -> Any:
    """Rodrigues' formula for a unit axis."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def matrix(turn: Any, xyz: tuple[float, float, float]) -> Any:
    result = np.eye(4)
    result[:3, :3] = turn
    result[:3, 3] = xyz
    return result


def of_pose(pose: Pose) -> Any:
    roll, pitch, yaw = pose.rpy
    return matrix(rotation((0, 0, 1), yaw) @ rotation((0, 1, 0), pitch) @ rotation((1, 0, 0), roll), pose.xyz)


def of_joint(joint: Joint, position: float) -> Any:
    if joint.type == "prismatic":
        return matrix(np.eye(3), tuple(position * part for part in joint.axis))
    return matrix(rotation(joint.axis, position), (0, 0, 0)) if joint.type != "fixed" else np.eye(4)


def places(bot: Robot, positions: dict[str, float]) -> dict[str, Any]:
    """The transform from the root to each link."""
    found = {bot.root: np.eye(4)}
    pending = [bot.root]
    while pending:
        parent = pending.pop()
        for below in bot.children_of(parent):
            position = positions.get(below.name, 0.0)
            if below.mimic is not None:
                position = below.mimic.multiplier * positions[below.mimic.joint] + below.mimic.offset
            found[below.child] = found[parent] @ of_pose(below.origin) @ of_joint(below, position)
            pending.append(below.child)
    return found


MODELS = {"slider": load("slider").xml, "rrbot": load("rrbot").xml, "branched": BRANCHED}


@cache
def oracle_of(name: str) -> Any:
    import yourdfpy  # heavy

    return yourdfpy.URDF.load(io.BytesIO(MODELS[name].encode()), load_meshes=False)


@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=20, deadline=None, derandomize=True)
@given(data=st.data())
def test_links_are_where_yourdfpy_has_them(name: str, data: st.DataObject) -> None:
    bot, oracle = parse(MODELS[name]), oracle_of(name)
    angles = st.floats(-1, 1, allow_nan=False)
    positions = {joint: data.draw(angles, joint) for joint in oracle.actuated_joint_names}
    oracle.update_cfg(positions)
    for link_name, place in places(bot, positions).items():
        np.testing.assert_allclose(place, oracle.get_transform(link_name, bot.root), atol=1e-8)


@pytest.mark.parametrize("name", MODELS)
def test_masses_and_limits_are_those_that_yourdfpy_reads(name: str) -> None:
    bot, oracle = parse(MODELS[name]), oracle_of(name).robot
    for theirs in oracle.links:
        ours = bot.links[theirs.name].inertial
        if theirs.inertial is None:
            assert ours is None
            continue
        assert ours is not None
        ixx, ixy, ixz, iyy, iyz, izz = ours.inertia
        assert ours.mass == theirs.inertial.mass
        np.testing.assert_array_equal([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]], theirs.inertial.inertia)
    for joint_read in oracle.joints:
        if joint_read.limit is not None:
            limit = bot.joints[joint_read.name].limit
            assert limit is not None
            assert (limit.lower, limit.upper) == (joint_read.limit.lower, joint_read.limit.upper)
