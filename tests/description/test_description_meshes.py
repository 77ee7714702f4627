"""Mesh files become triangles in metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from slidectl.description import meshes
from slidectl.errors import BadFile


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box of 1 x 2 x 3 units in every kind of file, with a folder's name that is no plain one."""
    folder = tmp_path_factory.mktemp("netze für alle")
    box = trimesh.creation.box((1, 2, 3))
    box.export(folder / "box.STL", file_type="stl")
    box.export(folder / "box.obj")
    (folder / "ascii.stl").write_text(trimesh.exchange.stl.export_stl_ascii(box))
    dae = trimesh.exchange.dae.export_collada(box).decode()
    (folder / "box.dae").write_text(dae)
    (folder / "cm.Dae").write_text(dae.replace("<up_axis>", '<unit name="cm" meter="0.01"/><up_axis>'))
    moved = dae.replace("<instance_geometry", "<translate>10 0 0</translate><instance_geometry")
    (folder / "moved.dae").write_text(moved)
    (folder / "quads.obj").write_text("mtllib no.mtl\nusemtl red\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    return folder


@pytest.mark.parametrize("name", ["box.STL", "ascii.stl", "box.obj", "box.dae"])
def test_a_box_has_its_corners_and_its_volume(folder: Path, name: str) -> None:
    vertices, faces = meshes.load(folder / name)
    assert (vertices.dtype, faces.dtype) == (np.float64, np.int32)
    np.testing.assert_allclose([vertices.min(0), vertices.max(0)], [[-0.5, -1, -1.5], [0.5, 1, 1.5]])
    assert len(faces) == 12
    assert trimesh.Trimesh(vertices, faces).volume == pytest.approx(6.0)


def test_the_unit_of_a_dae_file_counts(folder: Path) -> None:
    np.testing.assert_allclose(meshes.load(folder / "cm.Dae").vertices.max(0), [0.005, 0.01, 0.015])


def test_the_nodes_of_a_dae_file_are_put_in_their_places(folder: Path) -> None:
    assert meshes.load(folder / "moved.dae").vertices[:, 0].min() == pytest.approx(9.5)


def test_polygons_are_cut_into_triangles_and_missing_materials_do_no_harm(folder: Path) -> None:
    assert meshes.load(folder / "quads.obj").faces.shape == (2, 3)


def test_a_mirrored_mesh_is_not_turned_inside_out(folder: Path) -> None:
    vertices, faces = meshes.load(folder / "box.STL", (1.0, 1.0, -2.0))
    assert vertices[:, 2].max() == pytest.approx(3.0)
    assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(12.0)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("bad.stl", "hello", "no triangle"),
        ("empty.stl", "", "no triangle"),
        ("bad.dae", "<a/>", "cannot read the mesh"),
        ("broken.dae", "<a", "cannot read the mesh"),
        ("bad.obj", "v 1 2", "the mesh"),
        ("a.ply", "ply", "known: .stl, .obj, .dae"),
        ("missing.stl", None, "No such file"),
    ],
)
def test_what_is_no_mesh_is_refused_by_name(tmp_path: Path, name: str, content: str | None, reason: str) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(BadFile) as caught:
        meshes.load(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert reason in str(caught.value)
