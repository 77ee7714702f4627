"""Collision shapes: sizes, places, friction, meshes."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import mujoco
import numpy as np
import pytest
from physics_robots import at, block, box_inertial, tree

from slidectl.description.robot import Box, Cylinder, Geometry, Joint, Link, Mesh, Pose, Robot, Shape, Sphere, Surface
from slidectl.errors import SlidectlError
from slidectl.physics import World

CUBE = [(x, y, z) for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.3, 0.3)]
FACES = [
    *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
    *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
]


def shaped(geometry: Geometry, origin: Pose = Pose(), surface: Surface = Surface()) -> Robot:  # noqa: B008 - frozen
    """A free link of 1 kg with this collision shape."""
    shape = Shape(geometry, origin, line=7)
    return tree([Link("base", box_inertial(1.0, (0.2, 0.2, 0.2)), collisions=(shape,), surface=surface)], [], "base")


def height_at_rest(robot: Robot) -> float:
    """Where the link's origin comes to rest above the ground."""
    world = World()
    world.attach(robot, "robot", at(0.0, 0.0, 0.6))
    for _ in range(4000):
        world.step()
    return world.link_pose("robot", "base")[0][2]


@pytest.mark.parametrize(
    ("geometry", "height"),
    [(Box((0.4, 0.4, 0.2)), 0.1), (Cylinder(0.2, 0.3), 0.15), (Sphere(0.25), 0.25)],
    ids=["box", "cylinder", "sphere"],
)
def test_a_shape_rests_at_half_its_height(geometry: Geometry, height: float) -> None:
    assert height_at_rest(shaped(geometry)) == pytest.approx(height, abs=2e-3)


def test_the_origin_of_a_shape_counts_with_its_attitude() -> None:
    lying = Pose((0.0, 0.0, -0.2), (1.5707963267948966, 0.0, 0.0))
    assert height_at_rest(shaped(Box((0.4, 0.1, 0.4)), lying)) == pytest.approx(0.2 + 0.05, abs=2e-3)


@pytest.mark.parametrize(
    ("geometry", "kind", "axis", "is_wheel"),
    [
        (Cylinder(0.2, 0.1), "continuous", (0.0, 1.0, 0.0), True),
        (Cylinder(0.2, 0.1), "revolute", (0.0, 1.0, 0.0), False),
        (Cylinder(0.2, 0.1), "continuous", (1.0, 0.0, 0.0), False),
        (Cylinder(0.05, 0.5), "continuous", (0.0, 1.0, 0.0), False),
        (Sphere(0.2), "continuous", (0.0, 1.0, 0.0), False),
    ],
    ids=["wheel", "with limits", "across", "long", "ball"],
)
def test_a_wheel_touches_at_the_middle_of_its_width(
    geometry: Geometry, kind: str, axis: tuple[float, float, float], is_wheel: bool
) -> None:
    lying = Pose((0.0, 0.03, 0.0), (1.5707963267948966, 0.0, 0.0))
    wheel = Link("wheel", box_inertial(1.0, (0.2, 0.2, 0.2)), collisions=(Shape(geometry, lying),))
    base = Link("base", box_inertial(1.0, (0.2, 0.2, 0.2)))
    world = World()
    world.attach(tree([base, wheel], [Joint("axle", kind, "base", "wheel", axis=axis)], "base"), "cart")
    assert (world.model.geom_type[-1] == mujoco.mjtGeom.mjGEOM_ELLIPSOID) == is_wheel
    if is_wheel:
        assert world.model.geom_size[-1].tolist() == [0.2, 0.2, 0.05]


@pytest.mark.parametrize(("sides", "is_wheel"), [(24, True), (6, False)])
def test_a_round_mesh_about_the_axle_is_a_wheel(tmp_path: Path, sides: int, is_wheel: bool) -> None:
    rim = [(0.2 * math.cos(turn), 0.2 * math.sin(turn)) for turn in (2 * math.pi * k / sides for k in range(sides))]
    places = [(x, y, z) for y in (0.03, 0.13) for x, z in rim]
    path = tmp_path / "wheel.obj"
    numbers = " ".join(str(k + 1) for k in range(sides)), " ".join(str(sides + k + 1) for k in range(sides))
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in places) + "".join(f"f {face}\n" for face in numbers))
    wheel = Link("wheel", box_inertial(1.0, (0.2, 0.2, 0.2)), collisions=(Shape(Mesh("wheel.obj", str(path))),))
    base = Link("base", box_inertial(1.0, (0.2, 0.2, 0.2)))
    world = World()
    world.attach(tree([base, wheel], [Joint("axle", "continuous", "base", "wheel", axis=(0, 1, 0))], "base"), "cart")
    assert (world.model.geom_type[-1] == mujoco.mjtGeom.mjGEOM_ELLIPSOID) == is_wheel
    if is_wheel:
        assert world.model.geom_size[-1] == pytest.approx([0.2, 0.2, 0.05], abs=1e-6)
        assert world.model.geom_pos[-1] == pytest.approx([0.0, 0.08, 0.0], abs=1e-6)
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, world.model.geom_quat[-1])
        assert turn.reshape(3, 3)[:, 2] == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)


def test_a_turntable_is_no_wheel() -> None:
    disc = Link("disc", box_inertial(1.0, (0.2, 0.2, 0.2)), collisions=(Shape(Cylinder(0.3, 0.02)),))
    base = Link("base", box_inertial(1.0, (0.2, 0.2, 0.2)))
    world = World()
    turns = Joint("turn", "continuous", "base", "disc", axis=(0.0, 0.0, 1.0))
    world.attach(tree([base, disc], [turns], "base"), "table")
    assert world.model.geom_type[-1] == mujoco.mjtGeom.mjGEOM_CYLINDER


def test_meshes_are_read_with_their_scale(tmp_path: Path) -> None:
    for path in (_obj(tmp_path), _binary_stl(tmp_path), _text_stl(tmp_path)):
        mesh = Mesh(f"file://{path}", str(path), (1.0, 1.0, 0.5))
        assert height_at_rest(shaped(mesh)) == pytest.approx(0.15, abs=2e-3), path.name


def test_a_mesh_that_is_no_mesh_is_refused_by_link_and_line(tmp_path: Path) -> None:
    broken = tmp_path / "broken.stl"
    broken.write_bytes(b"solid nothing\nendsolid\n")
    for path in (str(broken), str(tmp_path / "missing.obj"), str(tmp_path / "missing.stl"), None):
        with pytest.raises(SlidectlError, match=r"robot 'robot'") as caught:
            World().attach(shaped(Mesh("package://some/mesh", path)), "robot")
        assert "base" in str(caught.value)


@pytest.mark.parametrize("geometry", [Box((0.1, 0.0, 0.1)), Cylinder(-1.0, 1.0), Sphere(float("nan"))], ids=str)
def test_sizes_must_be_above_zero(geometry: Geometry) -> None:
    with pytest.raises(SlidectlError, match=r"link 'base' of robot 'robot': collision shape \(line 7\): .* above 0"):
        World().attach(shaped(geometry), "robot")


def test_a_slippery_link_slides_down_where_a_rough_one_stays() -> None:
    travelled = {}
    for name, surface in {"rough": Surface(), "slippery": Surface(mu1=0.05), "only mu2": Surface(mu2=0.05)}.items():
        world = World(gravity=(2.0, 0.0, -9.0))
        world.attach(block(surface=surface), "block", at(0.0, 0.0, 0.2))
        for _ in range(1000):
            world.step()
        travelled[name] = world.link_pose("block", "base")[0][0]
    assert travelled["rough"] < 0.01
    assert travelled["slippery"] == pytest.approx(0.5 * (2.0 - 0.05 * 9.0), rel=0.05)
    assert travelled["only mu2"] == pytest.approx(travelled["slippery"])


def test_gravity_can_be_turned_off_for_a_link() -> None:
    world = World()
    world.attach(block(surface=Surface(turn_gravity_off=True)), "block", at(0.0, 0.0, 1.0))
    for _ in range(1000):
        world.step()
    assert world.link_pose("block", "base")[0] == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)


def _obj(folder: Path) -> Path:
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    path = folder / "cube.obj"
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def _binary_stl(folder: Path) -> Path:
    triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *CUBE[a], *CUBE[b], *CUBE[c], 0) for a, b, c in FACES)
    path = folder / "cube.stl"
    path.write_bytes(b"solid, but binary".ljust(80) + struct.pack("<I", len(FACES)) + triangles)
    return path


def _text_stl(folder: Path) -> Path:
    lines = ["solid cube"]
    for face in FACES:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex {} {} {}".format(*CUBE[corner]) for corner in face]
        lines += ["endloop", "endfacet"]
    path = folder / "text.stl"
    path.write_text("\n".join([*lines, "endsolid cube"]) + "\n", encoding="ascii")
    return path
