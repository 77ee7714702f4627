"""The samples and files like them, launched as a user does it: what runs, what is said, what is left."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import CommandLine
from launch_runs import Launched, kill_all, nothing_is_left
from terminal import Terminal

POSITION = "/slider/joint1_position_controller"


@pytest.fixture(autouse=True)
def clean(slidectl: CommandLine) -> Iterator[None]:
    yield
    kill_all(slidectl.runtime)


def write(folder: Path, name: str, content: str) -> str:
    path = folder / name
    path.write_text(f"<launch>{content}</launch>")
    return str(path)


def controllers(slidectl: CommandLine) -> dict[str, str]:
    rows = [json.loads(line) for line in slidectl.ok("controller", "list", "--json").splitlines()]
    return {f"{row['manager']}/{row['name']}": row["state"] for row in rows}


SPAWN = (
    '<param name="robot_description" command="$(find xacro)/xacro $(find my_slider)/urdf/slider.xacro"/>'
    '<node name="urdf" pkg="gazebo_ros" type="spawn_model" args="-urdf -model slider -param robot_description {}"/>'
)
CONTROL = (
    '<rosparam file="$(find my_slider)/config/slider_control.yaml"/>'
    '<node name="control" pkg="controller_manager" type="spawner" ns="/slider"'
    ' args="joint_state_controller joint1_position_controller"/>'
)


def test_the_slider_runs_from_nothing_and_everything_ends_with_it(slidectl: CommandLine, tmp_path: Path) -> None:
    launched = Launched(slidectl, "my_slider", "slider.launch", cwd=tmp_path)
    text = launched.up()
    assert "/urdf_spawner: slider spawned in /slider, joints: joint1" in text
    assert "everything runs (4 nodes, 2 controllers running); Ctrl-C ends it" in text
    assert "has no publisher" not in text
    assert set(controllers(slidectl).values()) == {"running"}
    slidectl.ok("pub", "command", "1.0")
    slidectl.ok("wait", "joint_states/position[0]", "--above", "0.05", "--within", "5")
    assert launched.interrupt() == 130
    assert "joint1_position_controller, joint_state_controller stopped and unloaded" in launched.text
    nothing_is_left(slidectl.runtime)


def test_a_daemon_that_runs_is_used_and_stays_without_what_the_launch_brought(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start")
    for _ in range(2):
        launched = Launched(slidectl, "slider")
        launched.up()
        assert set(controllers(slidectl).values()) == {"running"}
        assert launched.interrupt() == 130
        assert "/gazebo: slider: deleted" in launched.text
    assert slidectl.ok("robots", "--json") == ""
    assert slidectl("daemon", "status").returncode == 0
    slidectl.ok("daemon", "stop")


def test_rrbot_takes_two_launches_one_for_the_world_and_one_for_its_controllers(
    slidectl: CommandLine, tmp_path: Path
) -> None:
    world = Launched(slidectl, "rrbot_gazebo", "rrbot_world.launch", cwd=tmp_path)
    world.up()
    control = Launched(slidectl, "rrbot_control", "rrbot_control.launch", cwd=tmp_path)
    assert "3 controllers running" in control.up()
    assert "publishes the frames of rrbot at 50 Hz" in control.text
    assert len(controllers(slidectl)) == 3
    assert control.interrupt() == 130
    assert controllers(slidectl) == {}
    assert world.interrupt() == 130
    nothing_is_left(slidectl.runtime)


def test_the_order_of_two_launches_does_not_matter(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start")
    control = Launched(slidectl, "rrbot_control", "rrbot_control.launch")
    control.until("/rrbot/controller_spawner: waits for /rrbot/controller_manager (no robot is in /rrbot yet)")
    world = Launched(slidectl, "rrbot_world")
    world.up()
    control.up()
    assert set(controllers(slidectl).values()) == {"running"}
    assert control.interrupt() == 130
    assert world.interrupt() == 130
    slidectl.ok("daemon", "stop")


def test_the_tutorials_slip_is_pointed_out_with_its_line(slidectl: CommandLine, tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "slip.launch",
        SPAWN.format("") + CONTROL + '\n<node name="rsp" pkg="robot_state_publisher" type="robot_state_publisher">'
        '\n<remap from="/joint_states" to="/rrbot/joint_states"/></node>',
    )
    launched = Launched(slidectl, path)
    text = launched.up()
    mistake = "slip.launch:3: /rsp: /joint_states is remapped to /rrbot/joint_states, which has no publisher"
    assert f"{mistake}; did you mean /slider/joint_states?" in text
    assert "/rsp: the simulation publishes the frames of slider at 50 Hz" in text
    assert launched.interrupt() == 130


def test_two_robots_in_nested_namespaces_are_two_robots(slidectl: CommandLine, tmp_path: Path) -> None:
    one = """
      <arg name="name"/><arg name="y"/>
      <group ns="$(arg name)">
        <param name="robot_description"
               command="$(find xacro)/xacro $(find my_slider)/urdf/slider.xacro namespace:=/row/$(arg name)"/>
        <node name="urdf" pkg="gazebo_ros" type="spawn_model"
              args="-urdf -model $(arg name) -param robot_description -y $(arg y) -z 0.5 -Y 1.5708"/>
        <rosparam>
          joint_state_controller: {type: joint_state_controller/JointStateController, publish_rate: 50}
        </rosparam>
        <node name="control" pkg="controller_manager" type="spawner" args="joint_state_controller"/>
        <node name="robot_state_publisher" pkg="robot_state_publisher" type="robot_state_publisher">
          <param name="publish_frequency" value="20.0"/><param name="tf_prefix" value="$(arg name)_frames"/></node>
      </group>"""
    write(tmp_path, "one.launch", one)
    both = "".join(
        f'<include file="$(dirname)/one.launch" ns="row"><arg name="name" value="{name}"/>'
        f'<arg name="y" value="{y}"/></include>'
        for name, y in (("left", -1), ("right", 1.5))
    )
    launched = Launched(slidectl, write(tmp_path, "both.launch", both))
    text = launched.up()
    assert "/row/left/robot_state_publisher: the simulation publishes the frames of left at 20 Hz" in text
    assert controllers(slidectl) == {
        "/row/left/joint_state_controller": "running",
        "/row/right/joint_state_controller": "running",
    }
    pose = json.loads(slidectl.ok("robots", "right", "--json"))["pose"]
    assert pose[:3] == pytest.approx([0.0, 1.5, 0.5])
    assert pose[5:] == pytest.approx([2**-0.5, 2**-0.5], abs=1e-4)
    frames = slidectl.ok("tf", "list")
    assert "left_frames/link2" in frames
    assert "right_frames/link2" in frames
    assert launched.interrupt() == 130
    nothing_is_left(slidectl.runtime)


@pytest.mark.parametrize("order", [("one", "two"), ("two", "one")])
def test_state_publishers_belong_each_to_its_own_robot_whichever_was_spawned_first(
    slidectl: CommandLine, tmp_path: Path, order: tuple[str, str]
) -> None:
    """The robots are alike, and live elsewhere than the groups that spawn them; one publisher has no parameter."""
    publisher = """<group ns="{0}"><node name="rsp" pkg="robot_state_publisher" type="robot_state_publisher">
      <param name="publish_frequency" value="{1}"/></node></group>"""
    spawn = """<group ns="{0}"><param name="tf_prefix" value="{0}_frames"/>
      <param name="robot_description" command="$(find xacro)/xacro $(find my_slider)/urdf/slider.xacro"/>
      <node name="urdf" pkg="gazebo_ros" type="spawn_model"
            args="-urdf -model model_{0} -param robot_description -robot_namespace home_{0}"/></group>"""
    content = publisher.format("two", 20.0) + spawn.format(order[0]) + publisher.format("one", 30.0)
    launched = Launched(slidectl, write(tmp_path, "two.launch", content + spawn.format(order[1])))
    text = launched.up()
    assert "/one/rsp: the simulation publishes the frames of model_one at 30 Hz" in text
    assert "/two/rsp: the simulation publishes the frames of model_two at 20 Hz" in text
    frames = slidectl.ok("tf", "list")
    assert "one_frames/link2" in frames
    assert "two_frames/link2" in frames
    for name in ("one", "two"):
        prefix = slidectl.ok("param", "get", f"/home_{name}/robot_state_publisher/tf_prefix")
        assert prefix.strip() == f"{name}_frames"
    assert launched.interrupt() == 130
    nothing_is_left(slidectl.runtime)


def test_options_of_the_daemon_go_before_a_world_file(slidectl: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "moon.world").write_text(
        '<sdf version="1.6"><world name="moon"><gravity>0 0 -1.62</gravity><physics type="ode">'
        "<max_step_size>0.002</max_step_size><real_time_update_rate>500</real_time_update_rate></physics></world></sdf>"
    )
    node = '<node pkg="gazebo_ros" type="gzserver" name="gazebo" args="{}"/>'
    path = write(tmp_path, "moon.launch", node.format(tmp_path / "moon.world"))

    def physics() -> tuple[float, float, float]:
        answer = json.loads(slidectl.ok("service", "call", "/gazebo/get_physics_properties", "--json"))
        return answer["max_update_rate"] * answer["time_step"], answer["time_step"], answer["gravity"]["z"]

    slidectl.ok("daemon", "start", "--rtf", "max")
    done = slidectl("launch", path, "--detach")
    assert "moon.world sets speed; what was chosen for the running world is kept" in done.stderr
    assert physics() == (0.0, 0.002, -1.62)
    slidectl.ok("daemon", "restart", "--gravity", "0", "0", "-3", "--timestep", "0.004")
    done = slidectl("launch", path, "--detach")
    assert "sets gravity and speed and timestep; what was chosen" in done.stderr
    assert physics() == (0.0, 0.004, -3)
    slidectl.ok("daemon", "stop")
    slidectl.ok("daemon", "start")
    slidectl.ok("launch", path, "--detach")
    assert physics() == pytest.approx((1.0, 0.002, -1.62))
    slidectl.ok("sim", "speed", "max")
    slidectl.ok("launch", path, "--detach")
    assert physics() == (0.0, 0.002, -1.62)
    slidectl.ok("daemon", "stop")
    nothing_is_left(slidectl.runtime)


def test_a_world_file_makes_the_world_that_is_started_for_it(slidectl: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "moon.world").write_text(
        '<sdf version="1.6"><world name="moon"><gravity>0 0 -1.62</gravity><physics type="ode">'
        "<max_step_size>0.002</max_step_size><real_time_update_rate>1000</real_time_update_rate></physics>"
        '\n<model name="rock"><pose>0 0 1 0 0 0</pose><static>1</static><link name="l"><collision name="c"><geometry>'
        "<sphere><radius>1</radius></sphere></geometry></collision></link></model></world></sdf>"
    )
    path = write(
        tmp_path,
        "moon.launch",
        '<include file="$(find gazebo_ros)/launch/empty_world.launch"><arg name="gui" value="false"/>'
        f'<arg name="world_name" value="{tmp_path}/moon.world"/></include>',
    )
    launched = Launched(slidectl, path)
    text = launched.up()
    assert "1 model of the world spawned: rock" in text
    assert slidectl.ok("robots").splitlines()[1].split() == ["rock", "/rock", "static", "yes", "-", "-"]
    physics = slidectl.ok("service", "call", "/gazebo/get_physics_properties", "--json")
    answer = json.loads(physics)
    assert answer["time_step"] == pytest.approx(0.002)
    assert answer["gravity"]["z"] == pytest.approx(-1.62)
    assert answer["max_update_rate"] == pytest.approx(1000)
    assert launched.interrupt() == 130
    slidectl.ok("daemon", "start")
    launched = Launched(slidectl, path)
    text = launched.up()
    assert "moon.world has no ground plane, but the running world keeps its own" in text
    answer = json.loads(slidectl.ok("service", "call", "/gazebo/get_physics_properties", "--json"))
    assert answer["gravity"]["z"] == pytest.approx(-1.62)
    assert answer["time_step"] == pytest.approx(0.002)
    assert launched.interrupt() == 130
    slidectl.ok("daemon", "stop")


def test_detach_returns_when_everything_runs_and_leaves_it_running(slidectl: CommandLine) -> None:
    done = slidectl("launch", "slider", "--detach")
    assert done.returncode == 0, done.stderr
    assert "everything runs (4 nodes, 2 controllers running); slidectl daemon stop ends it" in done.stdout
    assert set(controllers(slidectl).values()) == {"running"}
    slidectl.ok("daemon", "stop")
    nothing_is_left(slidectl.runtime)


def test_a_step_that_fails_ends_the_launch_and_names_its_place(slidectl: CommandLine, tmp_path: Path) -> None:
    path = write(tmp_path, "twice.launch", SPAWN.format("") + "\n" + SPAWN.format("").replace('"urdf"', '"again"'))
    done = slidectl("launch", path)
    assert done.returncode == 1
    assert f"{path}:2: node /again (gazebo_ros/spawn_model): there is a robot 'slider' already" in done.stderr
    nothing_is_left(slidectl.runtime)
    slidectl.ok("daemon", "start")
    assert slidectl("launch", path).returncode == 1
    assert slidectl("daemon", "status").returncode == 0
    slidectl.ok("daemon", "stop")


FAILURES = {
    "a controller that cannot be loaded": (
        SPAWN.format("") + CONTROL + '<param name="/slider/joint1_position_controller/joint" value="nix"/>',
        "cannot load joint1_position_controller",
    ),
    "a description that is not set": (
        SPAWN.format("").replace("-param robot", "-param rebot"),
        "node /urdf (gazebo_ros/spawn_model): the parameter /rebot_description is not set",
    ),
    "a robot that cannot be": (
        '<param name="robot_description" value="&lt;robot name=\'r\'&gt;"/>' + SPAWN.format("").partition("/>")[2],
        "not well-formed XML",
    ),
    "no manager in time": (
        CONTROL.replace('args="', 'args="--timeout 0.3 '),
        "there was no /slider/controller_manager (no robot is in /slider yet) within 0.3 s",
    ),
    "a parameter that no service takes": (
        '<rosparam param="/a b">1</rosparam>',
        "'/a b' is not a legal name",
    ),
}


@pytest.mark.parametrize("name", FAILURES)
def test_whatever_fails_leaves_nothing_behind(slidectl: CommandLine, tmp_path: Path, name: str) -> None:
    content, text = FAILURES[name]
    path = write(tmp_path, "bad.launch", content)
    done = slidectl("launch", path)
    assert "cannot stop" not in done.stderr
    assert done.returncode in (1, 2)
    assert text in done.stderr
    assert "bad.launch:1" in done.stderr
    assert "Traceback" not in done.stderr
    nothing_is_left(slidectl.runtime)


def test_a_daemon_that_goes_away_ends_the_launch_with_3(slidectl: CommandLine) -> None:
    launched = Launched(slidectl, "slider")
    launched.up()
    slidectl.ok("daemon", "stop")
    assert launched.end() == 3
    assert "the daemon went away" in launched.text
    nothing_is_left(slidectl.runtime)


def test_wait_waits_for_a_daemon_and_starts_none(slidectl: CommandLine) -> None:
    launched = Launched(slidectl, "slider", "--wait")
    launched.until("no daemon runs yet: waiting for one")
    slidectl.ok("daemon", "start")
    launched.up()
    assert launched.interrupt() == 130
    slidectl.ok("daemon", "stop")
    done = slidectl("launch", "slider", "--wait", "--timeout", "0.2")
    assert done.returncode == 4
    assert "no daemon within 0.2 s" in done.stderr


def test_parameters_are_deleted_and_dumped_then_cleared_then_set(slidectl: CommandLine, tmp_path: Path) -> None:
    slidectl.ok("daemon", "start")
    for name in ("/c/old", "/zap", "/keep"):
        slidectl.ok("param", "set", name, "1")
    content = (
        '<group ns="c" clear_params="true"><param name="x" value="1"/></group><rosparam command="delete" param="/zap"/>'
        f'<rosparam command="delete" param="/never"/><rosparam command="dump" file="{tmp_path}/d.yaml" ns="/"/>'
    )
    done = slidectl("launch", write(tmp_path, "p.launch", content))
    assert done.returncode == 0, done.stderr
    assert "<rosparam>: /never is not set" in done.stderr
    assert slidectl.ok("param", "get", "/c").strip() == "x: 1"
    assert slidectl("param", "get", "/zap").returncode == 1
    dumped = (tmp_path / "d.yaml").read_text()
    assert "keep: 1" in dumped
    assert "old: 1" in dumped
    assert "zap" not in dumped
    slidectl.ok("daemon", "stop")


def test_parameters_alone_are_nothing_to_stay_for_but_a_daemon_of_ones_own_is(
    slidectl: CommandLine, tmp_path: Path
) -> None:
    path = write(tmp_path, "p.launch", '<param name="x" value="1"/>')
    slidectl.ok("daemon", "start")
    done = slidectl("launch", path)
    assert done.returncode == 0
    assert slidectl.ok("param", "get", "/x").strip() == "1"
    slidectl.ok("daemon", "stop")
    launched = Launched(slidectl, path)
    launched.up()
    assert slidectl.ok("param", "get", "/x").strip() == "1"
    assert launched.interrupt() == 130


def test_standard_input_is_a_launch_file_too(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start")
    done = slidectl("launch", "-", "v:=7", stdin='<launch><arg name="v"/><param name="x" value="$(arg v)"/></launch>')
    assert done.returncode == 0, done.stderr
    assert slidectl.ok("param", "get", "/x").strip() == "7"
    slidectl.ok("daemon", "stop")


def test_the_process_id_is_written_and_removed(slidectl: CommandLine, tmp_path: Path) -> None:
    launched = Launched(slidectl, "slider", "--pid", str(tmp_path / "pid"))
    launched.up()
    assert (tmp_path / "pid").read_text() == f"{launched.pid}\n"
    launched.interrupt()
    assert not (tmp_path / "pid").exists()


def test_json_tells_every_step_in_a_line(slidectl: CommandLine) -> None:
    launched = Launched(slidectl, "slider", "--json", "-q")
    launched.until('"event": "running"')
    launched.interrupt()
    records: list[dict[str, Any]] = [json.loads(line) for line in launched.text.splitlines() if line.startswith("{")]
    events = [(record["event"], record.get("kind")) for record in records]
    assert events[:6] == [
        ("parameters", None), ("node", "world"), ("node", "robot"), ("node", "controllers"), ("node", "frames"),
        ("running", None),
    ]  # fmt: skip
    assert records[3]["controllers"] == ["joint_state_controller", "joint1_position_controller"]
    assert records[3]["node"] == "/slider/controller_spawner"
    assert records[3]["line"] == 21


def test_on_a_terminal_a_line_at_the_bottom_shows_how_things_stand(slidectl: CommandLine) -> None:
    with Terminal(slidectl, "launch", "slider") as terminal:
        terminal.says("everything runs", "robots: slider, 2 of 2 controllers run")
        terminal.press("\x03")
        assert terminal.ended() == 130


def test_meshes_of_a_plain_urdf_are_found_from_the_launch_files_folder(slidectl: CommandLine, tmp_path: Path) -> None:
    package = tmp_path / "ws" / "bot"
    (package / "meshes").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>bot</name></package>")
    tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (package / "meshes" / "t.obj").write_text(tetrahedron)
    (package / "bot.urdf").write_text(
        '<robot name="bot"><link name="a"><inertial><mass value="1"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial><collision><geometry>'
        '<mesh filename="package://bot/meshes/t.obj"/></geometry></collision></link></robot>'
    )
    path = write(
        package,
        "bot.launch",
        '<param name="robot_description" textfile="$(dirname)/bot.urdf"/>'
        '<node name="urdf" pkg="gazebo_ros" type="spawn_model" args="-urdf -model bot -param robot_description"/>',
    )
    slidectl.ok("daemon", "start")
    done = slidectl("launch", path, cwd=Path("/"))
    assert done.returncode == 0, done.stderr
    assert "bot spawned in /bot" in done.stdout
    slidectl.ok("daemon", "stop")


def test_two_launches_at_once_share_one_daemon(slidectl: CommandLine) -> None:
    world = Launched(slidectl, "rrbot_world")
    slider = Launched(slidectl, "slider")
    world.up()
    slider.up()
    assert slidectl.ok("robots", "--json").count('"name": "slider"') == 1
    slider_ended, world_ended = slider.interrupt(), world.interrupt()
    # Whoever began the daemon ends it; the other one has then lost it.
    assert {slider_ended, world_ended} <= {130, 3}
    nothing_is_left(slidectl.runtime)


def test_what_never_ends_is_refused_with_its_place_by_every_command(slidectl: CommandLine, tmp_path: Path) -> None:
    macros = "".join(
        f"\n<xacro:macro name='m{n}'><xacro:m{n - 1}/><xacro:m{n - 1}/></xacro:macro>" for n in range(1, 30)
    )
    model = tmp_path / "bomb.xacro"
    model.write_text(
        f"<robot name='a' xmlns:xacro='x'><xacro:macro name='m0'><z/></xacro:macro>{macros}<xacro:m29/></robot>"
    )
    levels = "".join(f'\n<arg name="a{n}" value="{f"$(arg a{n - 1})" * 10}"/>' for n in range(1, 12))
    text = write(tmp_path, "text.launch", f'<arg name="a0" value="xxxxxxxxxx"/>{levels}')
    os.mkfifo(tmp_path / "pipe.launch")
    pipe = write(tmp_path, "pipe_inside.launch", f'\n<include file="{tmp_path}/pipe.launch"/>')
    slidectl.ok("daemon", "start")
    for words, reason in (
        (("check", str(model)), "bomb.xacro:"),
        (("spawn", str(model)), "bomb.xacro:"),
        (("check", text), "text.launch:7: <arg>: value: comes to more than 4096 KiB of text"),
        (("launch", text), "text.launch:7: <arg>: value: comes to more than 4096 KiB of text"),
        (("check", pipe), "pipe.launch: is a pipe, and only regular files are read"),
        (("launch", pipe), "pipe.launch: is a pipe, and only regular files are read"),
        (("param", "load", "/dev/zero"), "/dev/zero: is a device, and only regular files are read, of at most 64 MiB"),
    ):
        done = slidectl(*words)
        assert done.returncode == 2, (words, done.stderr)
        assert reason in done.stderr, (words, done.stderr)
        assert "a bug in slidectl" not in done.stderr
    slidectl.ok("daemon", "stop")
