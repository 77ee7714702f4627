"""Meshes that are fixed to the world collide as their faces: their hollows stay hollow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from physics_robots import at, box_inertial, tree

from slidectl.description.meshes import Triangles
from slidectl.description.rigid_bodies import surroundings
from slidectl.description.robot import Joint, Link, Mesh, Robot, Shape, Sphere
from slidectl.extensions.journal.journal import mesh_entry, mesh_of
from slidectl.physics import World, hulls, surfaces
from slidectl.simulation import Simulation

Corners = list[tuple[float, float, float]]
RADIUS = 0.05


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Corners:
    """The triangles of a box, seen from outside."""
    places = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return [places[k] for a, b, c, d in quads for k in (a, b, c, a, c, d)]


def quad(*places: tuple[float, float, float]) -> Corners:
    """The two triangles of a flat quadrangle."""
    a, b, c, d = places
    return [a, b, c, a, c, d]


def corner_of_a_room() -> Corners:
    """One solid: the floor and two walls of a step, 0.1 m thick, made of an L and its two ends."""
    outline = [(-0.5, 0.0), (0.5, 0.0), (0.5, 0.1), (-0.4, 0.1), (-0.4, 0.6), (-0.5, 0.6)]  # x, z
    front, back = ([(x, y, z) for x, z in outline] for y in (-0.5, 0.5))
    sides = [quad(front[k], front[k - 1], back[k - 1], back[k]) for k in range(6)]
    ends = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = [corner for side in sides for corner in side]
    faces += [front[k] for end in ends for k in end] + [back[k] for end in ends for k in reversed(end)]
    return faces


TABLE = box((-0.5, -0.5, 0.5), (0.5, 0.5, 0.55)) + [
    corner for x in (-0.5, 0.45) for y in (-0.5, 0.45) for corner in box((x, y, 0.0), (x + 0.05, y + 0.05, 0.5))
]
TRAY = [
    *quad((-0.3, -0.3, 0.2), (0.3, -0.3, 0.2), (0.3, 0.3, 0.2), (-0.3, 0.3, 0.2)),
    *quad((-0.3, -0.3, 0.2), (-0.3, -0.3, 0.5), (0.3, -0.3, 0.5), (0.3, -0.3, 0.2)),
    *quad((-0.3, 0.3, 0.2), (-0.3, 0.3, 0.5), (0.3, 0.3, 0.5), (0.3, 0.3, 0.2)),
]
SHEET = quad((-0.3, -0.3, 0.4), (0.3, -0.3, 0.4), (0.3, 0.3, 0.4), (-0.3, 0.3, 0.4))


def written(folder: Path, corners: Corners) -> Mesh:
    """A mesh file with these triangles."""
    path = folder / "mesh.stl"
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners[k : k + 3])
        + "endloop\nendfacet\n"
        for k in range(0, len(corners), 3)
    )
    path.write_text(f"solid m\n{facets}endsolid m\n")
    return Mesh("mesh.stl", str(path))


def fixed(mesh: Mesh) -> Robot:
    """A model without moving parts."""
    return tree([Link("world", collisions=(Shape(mesh),))], [], "world")


def ball() -> Robot:
    shape = Shape(Sphere(RADIUS))
    return tree([Link("ball", box_inertial(0.2, (0.1, 0.1, 0.1)), collisions=(shape,))], [], "ball")


def at_rest(mesh: Mesh, x: float, z: float) -> tuple[float, float, float]:
    """Where a ball that begins there, beside the mesh, comes to rest."""
    world = World()
    world.attach(fixed(mesh), "scene", at(0.0, 0.0, 0.0))
    world.attach(ball(), "ball", at(x, 0.0, z))
    for _ in range(1500):
        world.step()
    return world.link_pose("ball", "ball")[0]


@pytest.mark.parametrize(
    ("corners", "x", "start", "rest"),
    [
        (TABLE, 0.0, 0.7, 0.55),
        (TABLE, 0.0, 0.2, 0.0),
        (TRAY, 0.0, 0.45, 0.2 + surfaces.THICKNESS_OF_SHEETS / 2),
        (TRAY, 0.0, 0.1, 0.0),
        (SHEET, 0.0, 0.5, 0.4 + surfaces.THICKNESS_OF_SHEETS / 2),
        (corner_of_a_room(), 0.0, 0.3, 0.1),
    ],
    ids=["on a table", "below a table", "in a tray", "below a tray", "on a sheet", "in the corner of a room"],
)
def test_a_ball_rests_where_the_faces_let_it(
    tmp_path: Path, corners: Corners, x: float, start: float, rest: float
) -> None:
    place = at_rest(written(tmp_path, corners), x, start)
    assert place == pytest.approx((x, 0.0, rest + RADIUS), abs=1e-3)


def test_faces_that_are_seen_from_inside_are_turned() -> None:
    places = np.array(corner_of_a_room())
    faces = np.arange(len(places)).reshape(-1, 3)
    volumes = []
    for turned in (faces, faces[:, ::-1]):
        pieces = surfaces.split(Triangles(places, turned.astype(np.int32)))
        assert pieces is not None
        volumes.append(sorted(_volume(piece) for piece in pieces))
    assert volumes[0] == pytest.approx(volumes[1])
    assert min(volumes[0]) > 0.0


def _volume(piece: Any) -> float:
    return float(np.einsum("ij,ij->", piece[:, 0], np.cross(piece[:, 1], piece[:, 2]))) / 6.0


def test_a_solid_is_one_piece_and_its_faces_are_as_thick_as_it_is(tmp_path: Path) -> None:
    table = hulls.read(hulls.MeshSource(written(tmp_path, TABLE).path or "", (1.0, 1.0, 1.0), is_surface=True))
    assert isinstance(table, hulls.Hull)
    assert len(table.parts) == 5
    thin = [(x, y, z * 0.01) for x, y, z in corner_of_a_room()]
    pieces = surfaces.split(Triangles(np.array(thin), np.arange(len(thin), dtype=np.int32).reshape(-1, 3)))
    assert pieces is not None
    assert max(float(np.ptp(piece[:, :, 2])) for piece in pieces) <= 0.006 + 1e-9


def test_a_convex_mesh_is_the_hull_that_it_always_was(tmp_path: Path) -> None:
    path = written(tmp_path, box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))).path or ""
    hull, surface = (hulls.read(hulls.MeshSource(path, (1.0, 1.0, 1.0), asked)) for asked in (False, True))
    assert hull == surface


def test_a_mesh_with_too_many_faces_is_its_hull_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surfaces, "MOST_PIECES", 4)
    mesh = written(tmp_path, TABLE)
    assert at_rest(mesh, 0.7, 0.3)[2] == pytest.approx(RADIUS, abs=1e-3)
    surface = hulls.read(hulls.source_of(mesh, is_surface=True))
    assert isinstance(surface, hulls.Hull)
    assert surface.fills_hollows
    assert surface.parts == [surface]


def test_what_is_fixed_to_the_world_and_weighs_nothing_is_no_part_of_a_machine() -> None:
    joints = [Joint("f", "fixed", "world", "table"), Joint("g", "fixed", "table", "base")]
    arm = Joint("turn", "continuous", "base", "arm", axis=(0.0, 0.0, 1.0))
    weight = box_inertial(1.0, (0.1, 0.1, 0.1))
    links = [Link("world"), Link("table"), Link("base", weight)]
    assert surroundings(tree(links, joints, "world")) == {"world", "table", "base"}
    assert surroundings(tree([*links, Link("arm", weight)], [*joints, arm], "world")) == {"world", "table"}
    assert surroundings(ball()) == set()


def test_a_surface_can_be_taken_out_and_put_back(tmp_path: Path) -> None:
    world = World()
    table = fixed(written(tmp_path, TABLE))
    world.attach(ball(), "ball", at(0.0, 0.0, 0.7))
    world.attach(table, "table", at(0.0, 0.0, 0.0))
    world.detach("table")
    assert world.model.nmesh == 0
    world.attach(table, "table", at(0.0, 0.0, 0.0))
    for _ in range(1000):
        world.step()
    assert world.link_pose("ball", "ball")[0][2] == pytest.approx(0.55 + RADIUS, abs=1e-3)
    assert {one.link for one in world.overlaps("table", 0.0)} <= {"world"}


def test_a_journal_keeps_a_surface(tmp_path: Path) -> None:
    source = hulls.source_of(written(tmp_path, TABLE), is_surface=True)
    surface = hulls.read(source)
    assert mesh_of(mesh_entry(source, surface)) == (source, surface)


def test_the_spawn_warns_of_a_mesh_whose_hollows_are_filled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation()
    collision = f'<collision><geometry><mesh filename="file://{written(tmp_path, TABLE).path}"/></geometry></collision>'
    table = f'<robot name="table"><link name="world">{collision}</link></robot>'
    assert simulation.spawn(table, "table").warnings == []
    monkeypatch.setattr(surfaces, "MOST_PIECES", 4)
    (warning,) = simulation.spawn(table, "again").warnings
    assert "mesh.stl has too many faces to collide as they are" in warning
