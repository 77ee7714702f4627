"""`slidectl urdf`, models of packages, types of controllers without a daemon, and whose package of a name counts."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from command_line import CommandLine

MODEL = """<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">
<xacro:arg name="width" default="0.1"/>
<link name="world"/>
<link name="plate"><visual><geometry><box size="$(arg width) 1 1"/></geometry></visual>
<collision><geometry><mesh filename="package://arm_meshes/plate.stl"/></geometry></collision></link>
<joint name="j" type="fixed"><parent link="world"/><child link="plate"/></joint>
</robot>
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A workspace with the user's own package `my_slider`, whose name is that of a shipped one."""
    package = tmp_path / "ws" / "my_slider"
    (package / "urdf").mkdir(parents=True)
    (package / "launch").mkdir()
    (package / "package.xml").write_text("<package><name>my_slider</name></package>")
    (package / "urdf" / "slider.xacro").write_text(MODEL.replace("package://arm_meshes/plate.stl", "plate.stl"))
    (package / "urdf" / "arm.xacro").write_text(MODEL)
    (package / "launch" / "slider.launch").write_text('<launch><param name="own" value="1"/></launch>')
    return package


def test_what_xacro_makes_of_a_model_is_printed_as_urdf_that_others_read(slidectl: CommandLine, own: Path) -> None:
    text = slidectl.ok("urdf", str(own / "urdf" / "arm.xacro"), "width:=0.25")
    root = ElementTree.fromstring(text)
    assert [box.get("size") for box in root.iter("box")] == ["0.25 1 1"]
    assert [mesh.get("filename") for mesh in root.iter("mesh")] == ["package://arm_meshes/plate.stl"]
    assert text.rstrip().endswith("</robot>"), "nothing stands behind the root, which other parsers refuse"
    assert "<?slidectl" not in text


def test_a_model_of_a_package_and_one_on_standard_input_are_printed_too(slidectl: CommandLine, own: Path) -> None:
    named = f"my_slider={own}"
    assert 'size="0.5 1 1"' in slidectl.ok("urdf", "my_slider", "arm.xacro", "width:=0.5", "--package", named)
    slidectl.environment["SLIDECTL_PACKAGE_PATH"] = str(own.parent)
    assert 'size="0.1 1 1"' in slidectl.ok("urdf", "my_slider", "urdf/arm.xacro")
    done = slidectl("urdf", "-", "width:=0.75", stdin=MODEL)
    assert 'size="0.75 1 1"' in done.stdout


def test_the_urdf_goes_into_a_file_on_demand(slidectl: CommandLine, own: Path) -> None:
    target = own / "arm.urdf"
    slidectl.ok("urdf", str(own / "urdf" / "arm.xacro"), "-o", str(target))
    assert ElementTree.parse(target).getroot().get("name") == "arm"


def test_what_xacro_refuses_has_file_and_line(slidectl: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "bad.xacro"
    path.write_text(MODEL.replace("$(arg width)", "${nothing}"))
    done = slidectl("urdf", str(path))
    assert done.returncode == 2
    assert "bad.xacro:4: " in done.stderr
    assert done.stdout == ""


def test_a_model_of_a_package_is_spawned(slidectl: CommandLine, own: Path) -> None:
    slidectl.ok("daemon", "start", "--paused")
    try:
        slidectl.ok("spawn", "rrbot_description", "rrbot.xacro", "-n", "bot")
        (own / "urdf" / "arm.xacro").write_text(
            MODEL.replace("<mesh filename", '<box size="1 1 1"/><!-- mesh').replace('plate.stl"/>', "-->")
        )
        for environment in ("ROS_PACKAGE_PATH", "SLIDECTL_PACKAGE_PATH"):
            slidectl.environment[environment] = str(own.parent)
            slidectl.ok("spawn", "my_slider", "arm.xacro", "width:=0.5", "-n", environment.lower())
            del slidectl.environment[environment]
        slidectl.ok("spawn", "my_slider", "arm.xacro", "-n", "named", "--package", f"my_slider={own}")
        done = slidectl("spawn", "rrbot_description", "rbot.xacro")
        assert done.returncode == 1
        assert "Did you mean 'rrbot.xacro'?" in done.stderr
    finally:
        slidectl("daemon", "stop")


def test_the_types_of_controllers_are_listed_without_a_daemon(slidectl: CommandLine) -> None:
    assert "effort_controllers/JointPositionController" in slidectl.ok("controller", "types").splitlines()
    rows = [json.loads(line) for line in slidectl.ok("--json", "controller", "types").splitlines()]
    assert {"type", "base_class"} == set(rows[0])


@pytest.mark.parametrize("where", ["beside it", "in it", "above src"])
def test_the_users_package_goes_before_a_shipped_one_of_its_name(slidectl: CommandLine, own: Path, where: str) -> None:
    folder = {"beside it": own.parent, "in it": own, "above src": own.parent.parent}[where]
    if where == "above src":
        own.parent.rename(folder / "src")
        own = folder / "src" / "my_slider"
    said = f"using package my_slider of {own} (also shipped)"
    done = slidectl("launch", "my_slider", "slider.launch", "--dry-run", cwd=folder)
    assert "/own = 1" in done.stdout
    assert said in done.stderr
    for command in ("urdf", "check"):
        done = slidectl(command, "my_slider", "arm.xacro", cwd=folder)
        assert said in done.stderr
        assert "plate" in done.stdout
    path = folder / "find.launch"
    path.write_text('<launch><param name="p" value="$(find my_slider)"/></launch>')
    assert f"/p: {own}" in slidectl("launch", "find.launch", "--dump-params", cwd=folder).stdout
    done = slidectl("launch", "find.launch", "--dry-run", cwd=folder)
    assert said in done.stderr


def test_a_file_that_cannot_be_written_is_a_bad_file(slidectl: CommandLine) -> None:
    done = slidectl("urdf", "slider", "-o", "/dev/full")
    assert (done.returncode, done.stderr) == (2, "error: /dev/full: cannot be written: No space left on device\n")
