"""What a model may be called, and what reaches the daemon of it."""

from __future__ import annotations

import io
import os
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest
from description_urdf_text import INERTIAL, cart, link, robot

from slidectl.description import load, parse
from slidectl.description.robot import Mesh
from slidectl.errors import EXIT_REFUSED, EXIT_USAGE, BadFile, UnknownName

Write = Callable[[str, str], Path]


def test_a_urdf_file_is_loaded_by_its_path(write: Write) -> None:
    path = write("mit leerzeichen/räder.urdf", cart())
    document = load(str(path))
    assert document.file == str(path)
    assert parse(document.xml).links["cart"].line == 3
    assert parse(document.xml).links["cart"].file == str(path)


def test_standard_input_is_a_dash(monkeypatch: pytest.MonkeyPatch) -> None:
    class Stdin:
        buffer = io.BytesIO(cart().encode())

    monkeypatch.setattr("sys.stdin", Stdin)
    document = load("-")
    assert document.file == "<stdin>"
    assert parse(document.xml).root == "world"


def test_an_unknown_model_lists_the_shipped_ones() -> None:
    with pytest.raises(UnknownName, match=r"no shipped model 'slidr'.*Did you mean 'slider'") as caught:
        load("slidr")
    assert "rrbot, slider" in str(caught.value)
    assert caught.value.exit_code == EXIT_REFUSED


@pytest.mark.parametrize("name", ["./nothing", "nothing.urdf", "some/where", "~/nothing.xacro", "~nobody-here/a"])
def test_what_looks_like_a_path_is_a_missing_file(name: str) -> None:
    with pytest.raises(BadFile, match="no such file") as caught:
        load(name)
    assert caught.value.exit_code == EXIT_USAGE


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000])
def test_names_that_no_file_can_have_are_unknown_models(name: str) -> None:
    with pytest.raises(UnknownName):
        load(name)


def test_a_shipped_model_with_a_suffix_gets_a_hint(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadFile, match="goes by its name alone: slider"):
        load("slider.xacro")


def test_a_file_without_suffix_is_found_when_no_model_has_its_name(
    write: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    write("mine", cart())
    monkeypatch.chdir(tmp_path)
    assert parse(load("mine").xml).root == "world"


def test_a_folder_is_no_model_and_is_not_left_open(tmp_path: Path) -> None:
    before = os.listdir("/proc/self/fd")
    with pytest.raises(BadFile, match="is a folder, and only regular files are read, of at most 16 MiB"):
        load(tmp_path)
    assert os.listdir("/proc/self/fd") == before


def test_arguments_for_plain_urdf_are_reported(write: Write) -> None:
    (notice,) = load(write("a.urdf", cart()), {"mass": "1"}).report
    assert "takes no arguments" in notice.text


def test_a_mesh_is_found_by_package_file_or_relative_path(write: Write) -> None:
    write("robots/package.xml", "<package><name>bots</name></package>")
    mesh = write("robots/meshes/wheel (ü).STL", "solid")
    uris = ["package://bots/meshes/wheel (ü).STL", mesh.as_uri(), "../meshes/wheel (ü).STL", str(mesh)]
    shapes = "".join(f'<collision><geometry><mesh filename="{uri}"/></geometry></collision>' for uri in uris)
    path = write("robots/urdf/bot.urdf", robot(link("a", INERTIAL + shapes)))
    document = load(path)
    assert [element.get("filename") for element in ET.fromstring(document.urdf).iter("mesh")] == uris
    meshes = [shape.geometry for shape in parse(document.xml).links["a"].collisions]
    assert all(isinstance(found, Mesh) and mesh.samefile(str(found.path)) for found in meshes)


def test_a_relative_mesh_of_an_included_file_lies_beside_that_file(write: Write) -> None:
    mesh = write("parts/wheel.stl", "solid")
    shape = '<collision><geometry><mesh filename="wheel.stl"/></geometry></collision>'
    write("parts/wheel.xacro", f"<robot>{link('wheel', INERTIAL + shape)}</robot>")
    include = '<xacro:include filename="parts/wheel.xacro"/>'
    path = write("bot.xacro", f'<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">{include}</robot>')
    (shape,) = parse(load(path).xml).links["wheel"].collisions
    assert isinstance(shape.geometry, Mesh)
    assert mesh.samefile(str(shape.geometry.path))


@pytest.mark.parametrize(
    ("uri", "reason"),
    [
        ("meshes/no.stl", "looked for"),
        ("package://nowhere/a.stl", "no package 'nowhere'"),
        ("file:///no/such.dae", "/no/such.dae"),
        ("http://example.org/a.stl", "begins with package://"),
    ],
)
def test_a_mesh_that_collides_and_is_not_there_is_an_error(write: Write, uri: str, reason: str) -> None:
    shape = f'<collision><geometry><mesh filename="{uri}"/></geometry></collision>'
    path = write("bot.urdf", robot(link("a", INERTIAL + shape)))
    with pytest.raises(BadFile, match=r"bot.urdf:2: mesh ") as caught:
        load(path)
    assert reason in str(caught.value)


def test_a_mesh_of_another_kind_is_an_error_when_it_collides(write: Write) -> None:
    write("a.ply", "ply")
    shape = '<collision><geometry><mesh filename="a.ply"/></geometry></collision>'
    with pytest.raises(BadFile, match=r"known: .stl, .obj, .dae"):
        parse(load(write("bot.urdf", robot(link("a", INERTIAL + shape)))).xml)


def test_special_characters_survive_the_way_to_the_daemon(write: Write) -> None:
    name = "a&lt;b&gt;&amp;&quot;c&#10;d"
    bot = parse(load(write("bot.urdf", robot(link(name)))).xml)
    assert bot.root == 'a<b>&"c\nd'


def test_a_note_of_sources_that_does_not_fit_is_left_alone(write: Write) -> None:
    xml = load(write("bot.urdf", cart())).xml
    edited = xml.replace('<link name="world"/>', '<link name="world"/>\n<x/>')
    assert parse(edited, "edited").links["cart"].file == "edited"


@pytest.mark.parametrize(
    "note",
    [
        "",
        "{}",
        '{"files":["a\\u0000"],"lines":[[0,1]]}',
        "[1]",
        '{"files":["a"],"lines":[[9,1]]}',
        '{"files":["a"],"lines":[["x"]]}',
    ],
)
def test_a_broken_note_of_sources_does_no_harm(note: str) -> None:
    assert parse(f"{cart()}<?slidectl-source {note}?>", "bot.urdf").links["cart"].file == "bot.urdf"
