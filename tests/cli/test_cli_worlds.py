"""Worlds and SDF files from the command line and from launch files, in real daemons."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
from command_line import CommandLine
from launch_runs import Launched, kill_all

from slidectl.errors import UsageError

SHAPE = '<collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision>'
CRATE = f'<sdf version="1.6"><model name="crate"><link name="l">{SHAPE}</link></model></sdf>'
WORLD = f"""<sdf version="1.6"><world name="w"><include><uri>model://ground_plane</uri></include>
<include><uri>model://crate</uri><pose>4 0 0.5 0 0 0</pose></include>
<include><uri>model://gone</uri></include>
<model name="wall"><static>1</static><link name="l"><pose>0 3 0.5 0 0 0</pose>{SHAPE}</link></model></world></sdf>"""
LAUNCH = """<launch><node pkg="gazebo_ros" type="gzserver" name="gazebo" args="$(dirname)/hall.world"/>
<node pkg="gazebo_ros" type="spawn_model" name="s" args="-sdf -database crate -model extra -x 8 -z 0.5"/></launch>"""


@pytest.fixture
def hall(tmp_path: Path) -> Path:
    """A world with a free model, a static one, and one that is not there."""
    (tmp_path / "models" / "crate").mkdir(parents=True)
    (tmp_path / "models" / "crate" / "model.sdf").write_text(CRATE)
    (tmp_path / "hall.launch").write_text(LAUNCH)
    path = tmp_path / "hall.world"
    path.write_text(WORLD)
    return path


@pytest.fixture
def ends(slidectl: CommandLine) -> Iterator[CommandLine]:
    yield slidectl
    slidectl("daemon", "stop")
    kill_all(slidectl.runtime)


def test_a_world_is_spawned_checked_and_deleted(ends: CommandLine, hall: Path) -> None:
    ends.ok("daemon", "start", "--paused")
    refused = ends("spawn", str(hall))
    assert refused.returncode == 2
    assert "model 'gone' is not there" in refused.stderr
    done = ends("spawn", str(hall), "--keep-going", "--at", "1", "0", "0")
    assert done.stdout.splitlines() == [
        "crate: model, spawned at 5 0 0.5, joints: none",
        "wall: static, spawned at 1 0 0, joints: none",
    ]
    assert "the model is left out" in done.stderr
    records = [json.loads(line) for line in ends.ok("robots", "--json").splitlines()]
    assert [(one["name"], one["kind"]) for one in records] == [("crate", "model"), ("wall", "static")]
    assert "no controllers" in ends("controller", "list").stderr + ends("controller", "list").stdout
    assert "already in the world: 'crate', 'wall'" in ends("spawn", str(hall), "--keep-going").stderr
    assert "a name goes with one model" in ends("spawn", str(hall), "--keep-going", "-n", "x").stderr
    ends.ok("delete", "crate", "wall")
    crate = str(hall.parent / "models")
    assert "box: model" in ends.ok("spawn", "model://crate", "-n", "box", GAZEBO_MODEL_PATH=crate)
    checked = ends("check", str(hall), "--keep-going").stdout
    assert "model 'wall': static" in checked
    assert "model 'gone' is not there" in checked


def test_a_single_model_is_printed_as_urdf(slidectl: CommandLine, hall: Path) -> None:
    root = ElementTree.fromstring(slidectl.ok("urdf", str(hall.parent / "models" / "crate" / "model.sdf")))
    assert (root.tag, root.get("name")) == ("robot", "crate")
    assert slidectl("urdf", str(hall)).returncode == 2


def test_the_models_of_a_launchs_world_come_and_leave_with_it(ends: CommandLine, hall: Path) -> None:
    path = str(hall.parent / "hall.launch")
    refused = ends("launch", path, "--strict")
    assert refused.returncode == 2
    assert "model 'gone' is not there" in refused.stderr
    ends.ok("daemon", "start")
    launched = Launched(ends, path, "--keep-going", GAZEBO_MODEL_PATH=str(hall.parent / "models"))
    text = launched.until("runs without 1 thing")
    assert "2 models of the world spawned: crate, wall" in text
    assert "/s: extra spawned, model, joints: none" in text
    assert json.loads(ends.ok("sim", "status", "--json"))["robots"] == ["crate", "wall", "extra"]
    launched.interrupt()
    assert json.loads(ends.ok("sim", "status", "--json"))["robots"] == []


def test_a_node_spawns_one_model_and_a_ground_plane_is_there_already(ends: CommandLine, tmp_path: Path) -> None:
    two = CRATE.replace("</sdf>", CRATE.partition(">")[2].replace("crate", "chest"))
    ground = '<sdf version="1.6"><include><uri>model://ground_plane</uri></include></sdf>'
    gone = ground.replace("ground_plane", "gone")
    path = tmp_path / "spawn.launch"
    path.write_text(
        '<launch><node pkg="gazebo_ros" type="spawn_model" name="s" args="-sdf -file $(dirname)/a.sdf -model gp"/>'
        "</launch>"
    )
    ends.ok("daemon", "start", "--paused")
    for content, code, text in (
        (two, 2, f"-model names one model, and file {tmp_path}/a.sdf has 2: chest, crate"),
        (ground, 0, f"file {tmp_path}/a.sdf is a ground plane, which is the world's own"),
        (gone, 1, f"no model is left in file {tmp_path}/a.sdf; the node is left out"),
    ):
        (tmp_path / "a.sdf").write_text(content)
        done = ends("launch", str(path), "--keep-going")
        assert (done.returncode, text in done.stdout + done.stderr) == (code, True), done.stdout + done.stderr
        assert json.loads(ends.ok("sim", "status", "--json"))["robots"] == []
    (tmp_path / "a.sdf").write_text(two)
    assert "-model names one model" in ends("check", str(path)).stderr


def test_options_that_models_of_sdf_do_not_have_are_refused(ends: CommandLine, hall: Path) -> None:
    ends.ok("daemon", "start", "--paused")
    crate = str(hall.parent / "models" / "crate" / "model.sdf")
    done = ends("spawn", crate, "--transmissions", "real")
    assert (done.returncode, "SDF models have no transmissions" in done.stderr) == (2, True)
    with ends.client() as client, pytest.raises(UsageError, match="have no transmissions"):
        client.spawn(crate, transmissions="bogus")
