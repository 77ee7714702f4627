"""Which launch files the words of a command line mean, and packages with all kinds of paths."""

from __future__ import annotations

import io
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from launch_files import Workspace

from slidectl import description, paths
from slidectl.description import meshes
from slidectl.description.packages import Packages, UnknownPackage
from slidectl.description.robot import Mesh
from slidectl.errors import BadFile, SlidectlError, UnknownName, UsageError
from slidectl.extensions.launch import files
from slidectl.extensions.launch.nodes.spawn_model import SpawnModel

AWKWARD = ["with blanks", "größe-Ω", 'it\'s "quoted"', "back\\slash", "$(arg x)", "a,b;c&d", "line\nend"]


def found(workspace: Workspace, *words: str) -> list[Path]:
    return [source.path for source in files.find(words, workspace.packages)]


def test_a_file_a_package_and_its_file_and_a_shipped_name(workspace: Workspace) -> None:
    path = workspace.launch_file("", "a.launch")
    assert found(workspace, str(path)) == [path]
    assert found(workspace, "demo/launch/a.launch") == [path]
    assert found(workspace, "demo", "a.launch") == [path]
    assert found(workspace, "demo", "launch/a.launch") == [path]
    [shipped] = found(workspace, "slider")
    assert shipped.parts[-3:] == ("my_slider", "launch", "slider.launch")
    assert found(workspace, "my_slider") == found(workspace, "my_slider", "slider.launch") == [shipped]
    assert found(workspace, str(path), "demo/launch/a.launch") == [path, path]


def test_a_package_alone_is_answered_with_its_launch_files(workspace: Workspace) -> None:
    workspace.launch_file("", "arm.launch")
    with pytest.raises(UsageError) as caught:
        found(workspace, "demo")
    assert caught.value.hint == "launch files: arm.launch\nslidectl launch demo arm.launch"


def test_a_file_is_found_wherever_it_is_in_its_package(workspace: Workspace) -> None:
    deep = workspace.write("some/where/b.launch", "<launch/>")
    assert found(workspace, "demo", "b.launch") == [deep]
    workspace.write("else/where/b.launch", "<launch/>")
    with pytest.raises(
        UsageError, match=r"package demo has several b.launch: else/where/b.launch, some/where/b.launch"
    ):
        found(workspace, "demo", "b.launch")
    assert found(workspace, "demo", "some/where/b.launch") == [deep]


def test_a_name_that_is_in_the_launch_folder_and_elsewhere_is_not_guessed_at(workspace: Workspace) -> None:
    workspace.launch_file("", "c.launch")
    workspace.write("test/c.launch", "<launch/>")
    with pytest.raises(UsageError, match=r"has several c\.launch"):
        found(workspace, "demo", "c.launch")


def test_more_files_may_follow_one_of_a_package(workspace: Workspace) -> None:
    first, second = workspace.launch_file("", "a.launch"), workspace.launch_file("", "b.launch")
    assert found(workspace, "demo", "a.launch", str(second)) == [first, second]


def test_a_package_of_the_users_goes_before_one_that_is_shipped(workspace: Workspace) -> None:
    own = workspace.folder / "my_slider"
    own.mkdir()
    (own / "package.xml").write_text("<package><name>my_slider</name></package>")
    (own / "slider.launch").write_text("<launch/>")
    assert found(workspace, "my_slider", "slider.launch") == [own / "slider.launch"]
    (own / "slider.launch").unlink()
    assert "launch/my_slider/launch/slider.launch" in str(found(workspace, "my_slider", "slider.launch")[0])


@pytest.mark.parametrize(
    ("words", "error", "reason"),
    [
        ([], UsageError, "which launch file"),
        (["nofile.launch"], BadFile, "nofile.launch: no such launch file"),
        (["."], BadFile, ".: a folder, not a launch file"),
        (["slidr"], UnknownName, r"no shipped launch file 'slidr' .* Did you mean 'slider'\?"),
        (["nopkg", "x.launch"], UnknownPackage, "no package 'nopkg'"),
        (["demo", "b.launch"], UnknownName, r"no launch file 'b.launch' in the package demo \(demo\)"),
        (["-", "-"], UsageError, "can be read only once"),
        (["demo"], UsageError, "'demo' is a package: which launch file of it"),
    ],
)
def test_words_that_mean_nothing_are_an_error_that_says_what_there_is(
    workspace: Workspace, words: list[str], error: type[SlidectlError], reason: str
) -> None:
    with pytest.raises(error, match=reason):
        found(workspace, *words)


def test_a_dash_is_standard_input(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    text = b'<launch><param name="x" value="$(dirname)"/></launch>'
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(text)))
    [source] = files.find(["-"], workspace.packages)
    assert source.shown == "<stdin>"
    assert source.text == text


def test_a_fifo_is_refused_instead_of_waited_for(workspace: Workspace) -> None:
    path = workspace.package / "pipe.launch"
    os.mkfifo(path)
    with pytest.raises(BadFile, match=r"pipe\.launch: is a pipe, and only regular files are read"):
        found(workspace, str(path))


@pytest.mark.parametrize("name", AWKWARD)
def test_a_path_of_any_letters_stays_one_word_through_arguments_includes_and_commands(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).mkdir()
    workspace = Workspace(tmp_path / name)
    workspace.write("data.txt", "here")
    workspace.launch_file(
        '<arg name="file"/><param name="x" command="cat $(arg file)"/><param name="p" value="$(arg file)"/>'
        '<param name="q" command="cat \'$(arg file)\'" unless="$(eval &quot;\'&quot; in file)"/>'
        '<param name="t" textfile="$(arg file)"/><rosparam file="$(find demo)/tree.yaml"/>'
        '<node pkg="gazebo_ros" type="spawn_model" name="n" args="-urdf -model m -file $(arg file)"/>',
        "inner.launch",
    )
    workspace.write("tree.yaml", "tree: 1")
    plan = workspace.plan(
        '<arg name="folder" default="$(find demo)"/><include file="$(find demo)/launch/inner.launch">'
        '<arg name="file" value="$(arg folder)/data.txt"/></include>'
        "<param name=\"e\" value=\"$(eval arg('folder') + '/x')\"/>"
    )
    values = {key: value for key, (value, _) in plan.parameters().items()}
    assert values["/x"] == values["/t"] == "here"
    assert values["/p"] == str(workspace.package / "data.txt")
    assert values["/e"] == f"{workspace.package}/x"
    assert values["/tree"] == 1
    task = SpawnModel(plan.nodes[0], plan)
    assert task.words.one("-file") == str(workspace.package / "data.txt")


def test_an_argument_with_several_words_is_several_words(workspace: Workspace) -> None:
    node = workspace.node(
        '<arg name="controllers" default="one two"/>'
        '<node pkg="rviz" type="rviz" name="s" args="$(arg controllers) $(optenv NOT_SET three four)"/>'
    )
    assert node.words == ["one", "two", "three", "four"]


def test_shipped_counterparts_are_found_last_and_only_where_they_are_meant(workspace: Workspace) -> None:
    assert Packages().find("gazebo_ros").name == "gazebo_ros"
    assert (Packages().find("gazebo_ros") / "launch" / "empty_world.launch").is_file()
    assert Packages().find("xacro").name == "xacro"
    with pytest.raises(UnknownPackage, match="no package 'rviz'"):
        Packages().find("rviz")
    own = workspace.folder / "gazebo_ros"
    own.mkdir()
    (own / "package.xml").write_text("<package><name>gazebo_ros</name></package>")
    assert workspace.packages.find("gazebo_ros") == own


def test_every_shipped_launch_file_makes_a_plan_without_a_complaint() -> None:
    from slidectl.extensions.launch import loader, node_kinds

    for path in set(files.shipped().values()):
        plan = loader.load(files.find([str(path)], Packages()), {}, Packages())
        node_kinds.tasks(plan, Packages())
        plan.parameters()
        assert [notice for notice in plan.notices if notice.verdict == "wrong"] == []


@pytest.mark.parametrize(
    ("sample", "shipped"),
    [
        ("my_slider/urdf/slider.xacro", "models/slider.xacro"),
        ("my_slider/config/slider_control.yaml", "config/slider_control.yaml"),
        ("rrbot_description/urdf/rrbot.xacro", "models/rrbot.xacro"),
        ("rrbot_control/config/rrbot_control.yaml", "config/rrbot_control.yaml"),
    ],
)
def test_the_samples_hold_the_models_and_configurations_that_are_shipped(sample: str, shipped: str) -> None:
    kind, name = shipped.split("/")
    assert (paths.share("launch") / sample).read_text() == (paths.share(kind) / name).read_text()


OTHERS_MODEL = """<robot name="other" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:include filename="$(find rrbot_description)/urdf/rrbot.gazebo"/>
<xacro:include filename="$(find rrbot_description)/urdf/materials.xacro"/>
<link name="world"/><link name="camera_link"/>
<joint name="c" type="fixed"><parent link="world"/><child link="camera_link"/></joint>
<link name="hokuyo_link"><visual><geometry><mesh filename="package://rrbot_description/meshes/hokuyo.dae"/></geometry>
<material name="white"/></visual></link>
<joint name="h" type="fixed"><parent link="world"/><child link="hokuyo_link"/></joint></robot>"""


def test_other_packages_find_the_files_of_rrbot_description(workspace: Workspace) -> None:
    document = description.load(workspace.write("urdf/other.urdf.xacro", OTHERS_MODEL), {}, workspace.packages)
    robot = description.parse(document.xml)
    assert [sensor.name for sensor in robot.sensors] == ["head_hokuyo_sensor", "camera1"]
    [shape] = robot.links["hokuyo_link"].visuals
    assert isinstance(shape.geometry, Mesh)
    assert shape.geometry.path is not None
    assert meshes.load(shape.geometry.path, shape.geometry.scale).vertices.max() == pytest.approx(0.035)


def test_the_gazebo_tags_of_rrbot_are_the_same_in_both_files() -> None:
    folder = paths.share("launch") / "rrbot_description"
    included = (folder / "urdf" / "rrbot.gazebo").read_text().partition("/>\n\n")[2]
    assert included in (folder / "urdf" / "rrbot.xacro").read_text()
    assert (folder / "launch" / "rrbot.rviz").read_text() == (folder / "rviz" / "rrbot.rviz").read_text()
