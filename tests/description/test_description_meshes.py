"""Mesh files become triangles in metres."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from slidectl.description import meshes
from slidectl.errors import BadFile


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box of 1 x 2 x 3 units in every kind of file, with a folder's name that is no plain one."""
    import trimesh  # heavy

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
    import trimesh  # heavy

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
    import trimesh  # heavy

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
        ("missing.stl", None, "no such file"),
    ],
)
def test_what_is_no_mesh_is_refused_by_name(tmp_path: Path, name: str, content: str | None, reason: str) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(BadFile) as caught:
        meshes.load(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert reason in str(caught.value)


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "zero.stl").symlink_to("/dev/zero")
    (tmp_path / "folder.stl").mkdir()
    for name, kind in (("pipe.stl", "a pipe"), ("zero.stl", "a device"), ("folder.stl", "a folder")):
        with pytest.raises(meshes.BadMesh, match=f"{name}: is {kind}, and only regular files are read, of at most 128"):
            meshes.load(tmp_path / name)


def test_a_file_is_refused_by_its_size_before_it_is_read(tmp_path: Path) -> None:
    for name, most in (("a.stl", 128), ("a.dae", 64), ("a.obj", 64)):
        with (tmp_path / name).open("wb") as file:
            file.truncate((most + 1) * 2**20 if most == 64 else 40 * 2**30)
        with pytest.raises(meshes.BadMesh, match=rf"more than {most} MiB are refused|larger than {most} MiB"):
            meshes.load(tmp_path / name)


def test_an_stl_of_more_triangles_than_may_be_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import trimesh  # heavy

    box = trimesh.creation.box((1, 2, 3))
    for kind in ("stl", "stl_ascii", "obj", "dae"):
        path = tmp_path / f"{kind}.{kind[:3]}"
        exported = box.export(file_type=kind)
        path.write_bytes(exported if isinstance(exported, bytes) else exported.encode())
        assert len(meshes.load(path).faces) == 12
        with monkeypatch.context() as patch:
            patch.setattr(meshes, "_MOST_FACES", 11)
            with pytest.raises(meshes.BadMesh, match=r"12 triangles, and more than 11 are refused"):
                meshes.load(path)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "dae"])
def test_every_kind_is_read_as_trimesh_reads_it(tmp_path: Path, kind: str) -> None:
    """An independent reader: the same surface, by its volume, its area and its box."""
    import trimesh  # heavy

    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.vertices *= 1.0 + 0.3 * np.random.default_rng(1).random((len(ball.vertices), 1))
    exported = ball.export(file_type=kind)
    path = tmp_path / f"{kind}.{kind[:3]}"
    path.write_bytes(exported if isinstance(exported, bytes) else exported.encode())
    vertices, faces = meshes.load(path, (1.0, 2.0, 0.5))
    theirs = trimesh.load_scene(path).to_mesh()
    theirs.apply_scale((1.0, 2.0, 0.5))
    ours = trimesh.Trimesh(vertices, faces, process=False)
    assert (len(vertices), len(faces)) == (len(ball.vertices), len(ball.faces))
    assert ours.volume == pytest.approx(theirs.volume, rel=1e-6)
    assert ours.area == pytest.approx(theirs.area, rel=1e-6)
    np.testing.assert_allclose(ours.bounds, theirs.bounds, rtol=1e-6)


def scene(nodes: str, primitive: str = "<triangles>{}<p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>") -> str:
    """A DAE with a tetrahedron of the volume 1/6 and these nodes."""
    entry = '<input semantic="VERTEX" source="#v" offset="0"/>'
    return f"""<COLLADA><library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="a">0 0 0 1 0 0 0 1 0 0 0 1</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{primitive.format(entry)}</mesh></geometry>
</library_geometries><library_controllers><controller id="c"><skin source="#g"/></controller></library_controllers>
<library_nodes><node id="n"><scale>2 1 1</scale><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@pytest.mark.parametrize(
    ("nodes", "low", "high", "volume"),
    [
        ('<node><instance_geometry url="#g"/></node>', (0, 0, 0), (1, 1, 1), 1 / 6),
        ('<node><instance_controller url="#c"/></node>', (0, 0, 0), (1, 1, 1), 1 / 6),
        ('<node><instance_node url="#n"/></node>', (0, 0, 0), (2, 1, 1), 1 / 3),
        ('<node><instance_node url="#n"/><instance_node url="#n"/></node>', (0, 0, 0), (2, 1, 1), 2 / 3),
        ('<node><scale>-1 1 1</scale><instance_geometry url="#g"/></node>', (-1, 0, 0), (0, 1, 1), 1 / 6),
        (
            '<node><translate>5 0 0</translate><rotate>0 0 2 90</rotate><node><instance_node url="#n"/></node></node>',
            (4, 0, 0),
            (5, 2, 1),
            1 / 3,
        ),
        (
            "<node><matrix>0 -1 0 5  1 0 0 0  0 0 1 0  0 0 0 1</matrix>"
            '<translate>1 0 0</translate><instance_geometry url="#g"/></node>',
            (4, 1, 0),
            (5, 2, 1),
            1 / 6,
        ),
        (
            '<node><lookat>0 0 3 0 0 0 0 1 0</lookat><instance_geometry url="#g"/></node>',
            (0, 0, 3),
            (1, 1, 4),
            1 / 6,
        ),
    ],
)
def test_the_nodes_of_a_scene_place_what_they_instance(
    tmp_path: Path, nodes: str, low: tuple[float, ...], high: tuple[float, ...], volume: float
) -> None:
    import trimesh  # heavy

    path = tmp_path / "a.dae"
    path.write_text(scene(nodes), "utf-8")
    vertices, faces = meshes.load(path)
    np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], [low, high], atol=1e-12)
    assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(volume)


@pytest.mark.parametrize(
    "primitive",
    [
        "<polylist>{}<vcount>3 3 3 3</vcount><p>0 2 1 0 1 3 0 3 2 1 2 3</p></polylist>",
        "<polygons>{}<p>0 2 1</p><p>0 1 3</p><p>0 3 2</p><p>1 2 3</p></polygons>",
        "<trifans>{}<p>0 2 1 3 2</p><p>1 2 3</p></trifans>",
        "<tristrips>{}<p>0 2 1 3 0 2</p></tristrips>",
        '<triangles>{}<input semantic="NORMAL" source="#x" offset="1"/>'
        "<p>0 9 2 9 1 9 0 9 1 9 3 9 0 9 3 9 2 9 1 9 2 9 3 9</p></triangles>",
    ],
)
def test_every_primitive_of_a_dae_makes_triangles(tmp_path: Path, primitive: str) -> None:
    import trimesh  # heavy

    path = tmp_path / "a.dae"
    path.write_text(scene('<node><instance_geometry url="#g"/></node>', primitive), "utf-8")
    vertices, faces = meshes.load(path)
    assert len(faces) == 4
    assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(1 / 6)


@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        ("#g", "#no", "names nothing in the file"),
        ("1 2 3</p>", "1 2 4</p>", "uses vertices that do not exist"),
        ("1 2 3</p>", "1 2 -1</p>", "uses vertices that do not exist"),
        ("1 2 3</p>", "1 2 x</p>", "cannot read the mesh"),
        ("0 0 0 1 0 0", "0 0 nan 1 0 0", "infinite coordinates"),
        ("0 0 0 1 0 0", "0 0 0 1e300 0 0", "more than 1e+12 m"),
        ("VERTEX", "NORMAL", "has no positions"),
        ("<COLLADA>", '<COLLADA><asset><unit meter="0"/></asset>', "a unit of 0 m"),
        ("<node>", "<node><matrix>1 2</matrix>", "has 2 numbers instead of 16"),
        ("<node>", f"<node><matrix>{'inf ' * 16}</matrix>", "infinite coordinates"),
        ('offset="0"', 'offset="99999999999"', "no triangle"),
        ('offset="0"', 'offset="-3"', "cannot read the mesh"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_what_is_wrong_in_a_dae_is_said(tmp_path: Path, before: str, after: str, reason: str) -> None:
    path = tmp_path / "a.dae"
    path.write_text(scene('<node><instance_geometry url="#g"/></node>').replace(before, after), "utf-8")
    with pytest.raises(meshes.BadMesh) as caught:
        meshes.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert reason in str(caught.value)


def test_long_lists_that_many_geometries_share_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slidectl.description.meshes._MOST_FACES", 10)
    triangles = "<triangles>{}<p>0 2 1</p></triangles>"
    nodes = "".join(f'<node><instance_geometry url="#g{k}"/></node>' for k in range(9))
    text = scene(nodes, triangles)
    begin, end = text.index("<vertices"), text.index("</mesh>")
    more = "".join(f'<geometry id="g{k}"><mesh>{text[begin:end]}</mesh></geometry>' for k in range(9))
    path = tmp_path / "a.dae"
    path.write_text(text.replace("</library_geometries>", f"{more}</library_geometries>"), "utf-8")
    with pytest.raises(meshes.BadMesh, match="more than 30 vertices"):
        meshes.load(path)


ACCESSOR = "<technique_common><accessor {}/></technique_common></source>"


@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        ('offset="0"', 'offset="-1"', "line 3 has an input of offset -1"),
        ("</source>", ACCESSOR.format('stride="2"'), "line 1 has points of 2 numbers"),
        ("</source>", ACCESSOR.format('stride="-1"'), "line 1 has points of -1 numbers"),
        ("</source>", ACCESSOR.format('stride="3" offset="-3"'), "line 1 has points of offset -3"),
    ],
)
def test_what_would_be_counted_backwards_or_too_short_is_refused(
    tmp_path: Path, before: str, after: str, reason: str
) -> None:
    path = tmp_path / "a.dae"
    path.write_text(scene('<node><instance_geometry url="#g"/></node>').replace(before, after), "utf-8")
    with pytest.raises(meshes.BadMesh, match=reason):
        meshes.load(path)
