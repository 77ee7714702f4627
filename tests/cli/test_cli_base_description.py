"""The parameter `robot_description`: what any reader of URDF takes, while files and lines are still told."""

from __future__ import annotations

import io
import json
import re
import struct
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import mujoco
import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon
from lxml import etree

# A tetrahedron of 0.1 m in binary, the only form of STL that MuJoCo itself reads.
_CORNERS = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))
_FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
_FACETS = (struct.pack("<12fH", 0, 0, 0, *(x for corner in face for x in _CORNERS[corner]), 0) for face in _FACES)
STL = bytes(80) + struct.pack("<I", len(_FACES)) + b"".join(_FACETS)
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
ARM = f"""<?xml version="1.0"?>
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="world"/>
  <link name="beam">
    {INERTIAL}
    <visual><geometry><mesh filename="package://arm_parts/meshes/wheel.stl"/></geometry></visual>
    <collision><geometry><mesh filename="package://arm_parts/meshes/wheel.stl"/></geometry></collision>
    <frobnicate/>
  </link>
  <joint name="turn" type="continuous"><parent link="world"/><child link="beam"/><axis xyz="0 1 0"/></joint>
  <xacro:property name="unused" value="1"/>
</robot>
"""
FINDING = r"arm\.urdf\.xacro:8: ignored: <link name=\"beam\">/<frobnicate>"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package with a robot that has a mesh, and a launch file that spawns it from the parameter."""
    folder = tmp_path_factory.mktemp("parts") / "arm_parts"
    (folder / "meshes").mkdir(parents=True)
    (folder / "package.xml").write_text("<package><name>arm_parts</name></package>")
    (folder / "meshes" / "wheel.stl").write_bytes(STL)
    (folder / "arm.urdf.xacro").write_text(ARM)
    (folder / "arm.launch").write_text(
        '<launch><param name="robot_description" command="xacro $(find arm_parts)/arm.urdf.xacro"/>'
        '<node name="spawner" pkg="gazebo_ros" type="spawn_model" args="-urdf -param robot_description -model arm"/>'
        "</launch>"
    )
    return folder


@pytest.fixture
def world() -> Iterator[CommandLine]:
    with running_daemon(paused=True) as runtime:
        yield CommandLine(runtime.folder)


def description(world: CommandLine, name: str) -> str:
    text = json.loads(world.ok("param", "get", name, "--json"))["value"]
    assert isinstance(text, str)
    return text


def check_readable(text: str, assets: dict[str, bytes] | None = None) -> None:
    """Every reader of URDF takes it, and it ends with its root element."""
    import yourdfpy  # heavy

    assert mujoco.MjModel.from_xml_string(text, assets=assets or {}).njnt
    root = ET.fromstring(text)
    assert root.tag == "robot"
    assert yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False).num_actuated_joints
    tree = etree.fromstring(text.encode())
    assert tree.getnext() is None
    assert tree.getprevious() is None
    assert text.rstrip().endswith("</robot>")


@pytest.mark.parametrize("model", ["slider", "rrbot"])
def test_the_description_of_a_shipped_robot_is_plain_urdf(world: CommandLine, model: str) -> None:
    world.ok("spawn", model)
    text = description(world, f"/{model}/robot_description")
    check_readable(text)
    assert not re.search(rf'["\s>](file://)?/(?!{model}\b)\w+/', text)


def test_a_mesh_keeps_its_name_and_no_path_of_the_machine_is_told(world: CommandLine, package: Path) -> None:
    world.ok("spawn", str(package / "arm.urdf.xacro"))
    text = description(world, "/arm/robot_description")
    check_readable(text, {"wheel.stl": STL})
    assert text.count('filename="package://arm_parts/meshes/wheel.stl"') == 2
    assert str(package.parent) not in text
    # The mesh collides all the same: its file went beside the text.
    assert world("robots", "arm").returncode == 0


@pytest.mark.parametrize("form", ["text", "json"])
def test_a_description_spawned_again_tells_the_files_it_was_written_in(
    world: CommandLine, package: Path, form: str, tmp_path: Path
) -> None:
    first = world("spawn", str(package / "arm.urdf.xacro"), "-v")
    assert re.search(FINDING, first.stderr)
    if form == "json":
        text = description(world, "/arm/robot_description")
    else:
        text = world.ok("param", "get", "/arm/robot_description")
    world.ok("delete", "arm")
    again = world("spawn", "-", "-v", stdin=text, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert re.search(FINDING, again.stderr)
    assert world("check", "-", stdin=text, cwd=package).returncode in (0, 1)


def test_spawn_model_by_parameter_tells_the_files_and_leaves_the_parameter_plain(
    world: CommandLine, package: Path
) -> None:
    done = world("launch", str(package / "arm.launch"), "--detach", "-v")
    assert done.returncode == 0, done.stderr
    assert "arm.urdf.xacro:8: ignored: <link name" in done.stdout + done.stderr
    for name in ("/robot_description", "/arm/robot_description"):
        check_readable(description(world, name), {"wheel.stl": STL})


def test_spawn_model_of_another_launch_finds_files_by_the_parameter_alone(world: CommandLine, package: Path) -> None:
    world.ok("launch", str(package / "arm.launch"), "--detach")
    world.ok("delete", "arm")
    second = package / "second.launch"
    second.write_text(
        '<launch><node name="spawner" pkg="gazebo_ros" type="spawn_model" '
        'args="-urdf -param robot_description -model twin"/></launch>'
    )
    done = world("launch", str(second), "--detach", "-v")
    assert done.returncode == 0, done.stderr
    assert "arm.urdf.xacro:8: ignored: <link name" in done.stdout + done.stderr


def test_rosrun_xacro_prints_plain_urdf(world: CommandLine, package: Path) -> None:
    text = world.ok("ros", "rosrun", "xacro", "xacro", str(package / "arm.urdf.xacro"))
    check_readable(text, {"wheel.stl": STL})
    assert str(package) not in text


def test_dumped_parameters_of_a_launch_file_hold_plain_urdf(world: CommandLine, package: Path) -> None:
    text = world.ok("ros", "roslaunch", "--dump-params", str(package / "arm.launch"))
    assert "slidectl-source" not in text
    assert str(package) not in text
