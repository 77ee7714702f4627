"""Counterparts of ROS nodes in a real world: what their options do there, and what their end undoes."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
from command_line import CommandLine
from launch_runs import RUNS, Launched, kill_all
from waiting import eventually

MODEL = '<param name="robot_description" command="$(find xacro)/xacro $(find my_slider)/urdf/slider.xacro"/>'
YAML = '<rosparam file="$(find my_slider)/config/slider_control.yaml"/>'
BOTH = "joint_state_controller joint1_position_controller"


def node(kind: str, args: str = "", attributes: str = "", inside: str = "", name: str = "n") -> str:
    package, _, program = kind.partition("/")
    return f'<node pkg="{package}" type="{program}" name="{name}" args="{args}" {attributes}>{inside}</node>'


def spawn(options: str = "") -> str:
    args = f"-urdf -model slider -param robot_description {options}"
    return MODEL + node("gazebo_ros/spawn_model", args, name="urdf")


def control(args: str = BOTH, kind: str = "spawner", name: str = "control") -> str:
    return node(f"controller_manager/{kind}", args, 'ns="/slider"', name=name)


@pytest.fixture
def world(slidectl: CommandLine) -> Iterator[CommandLine]:
    """With a daemon that runs."""
    slidectl.ok("daemon", "start")
    yield slidectl
    slidectl("daemon", "stop")
    kill_all(slidectl.runtime)


@pytest.fixture
def slider(world: CommandLine) -> CommandLine:
    """With a slider in it, whose controllers have parameters and are not loaded."""
    world.ok("spawn", "slider", "--controllers", "config/slider_control.yaml")
    return world


class Write:
    """Writes launch files, each with another name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.count = 0

    def __call__(self, content: str) -> str:
        self.count += 1
        path = self.folder / f"test{self.count}.launch"
        path.write_text(f"<launch>{content}</launch>")
        return str(path)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    return Write(tmp_path)


def states(slidectl: CommandLine) -> dict[str, str]:
    return {
        row["name"]: row["state"] for row in map(json.loads, slidectl.ok("controller", "list", "--json").splitlines())
    }


# --- spawn_model ----------------------------------------------------------------------------------------------------


def test_a_robot_is_put_where_it_is_told_with_its_joints_as_told(world: CommandLine, write: Write) -> None:
    world.ok("sim", "pause")
    done = world("launch", write(spawn("-x 1 -y -2.5 -z 0.25 -R 0.1 -J joint1 0.75")))
    assert done.returncode == 0, done.stderr
    robot = json.loads(world.ok("robots", "slider", "--json"))
    assert robot["pose"][:3] == pytest.approx([1.0, -2.5, 0.25])
    joint = json.loads(world.ok("service", "call", "/gazebo/get_joint_properties", "joint_name: joint1", "--json"))
    assert joint["position"] == [pytest.approx(0.75)]
    assert json.loads(world.ok("sim", "status", "--json"))["paused"] is True
    done = world("launch", write(spawn().replace("model slider", "model other -robot_namespace b -unpause")))
    assert done.returncode == 0, done.stderr
    assert json.loads(world.ok("robots", "other", "--json"))["namespace"] == "/b"
    assert json.loads(world.ok("sim", "status", "--json"))["paused"] is False


def test_a_namespace_asked_of_spawn_model_is_taken_as_typed_inside_a_group(world: CommandLine, write: Write) -> None:
    inside = spawn("-robot_namespace champ") + control("joint_state_controller").replace("/slider", "/champ")
    path = write('<group ns="champ">' + YAML.replace("<rosparam", '<rosparam ns="/"') + inside + "</group>")
    text = Path(path).read_text().replace("$(find my_slider)/config/slider_control.yaml", "$(dirname)/c.yaml")
    Path(path).write_text(text)
    (Path(path).parent / "c.yaml").write_text(
        "champ: {joint_state_controller: {type: joint_state_controller/JointStateController, publish_rate: 50}}"
    )
    checked = world("check", path)
    assert "wrong" not in checked.stdout.replace("0 wrong", ""), checked.stdout
    launched = Launched(world, path)
    assert "slider spawned in /champ, joints" in launched.up()
    assert "/champ/joint_states" in world.ok("topic", "list")
    launched.interrupt()


def test_joints_may_be_named_with_their_model(world: CommandLine, write: Write) -> None:
    world.ok("sim", "pause")
    world.ok("launch", write(spawn("-J slider::joint1 0.75")))
    request = "joint_name: 'slider::joint1'"
    asked = json.loads(world.ok("service", "call", "/gazebo/get_joint_properties", request, "--json"))
    assert asked["position"] == [pytest.approx(0.75)]
    request = "{model_name: slider, joint_names: ['slider::joint1'], joint_positions: [0.5]}"
    world.ok("service", "call", "/gazebo/set_model_configuration", request)
    asked = json.loads(world.ok("service", "call", "/gazebo/get_joint_properties", "joint_name: joint1", "--json"))
    assert asked["position"] == [pytest.approx(0.5)]
    world.ok("delete", "slider")
    done = world("launch", write(spawn("-J rrbot::joint1 0.75")))
    assert done.returncode == 0
    assert "-J rrbot::joint1 0.75 is skipped: no moving joint 'rrbot::joint1'" in done.stderr


def test_a_file_can_be_spawned_without_a_parameter(world: CommandLine, write: Write) -> None:
    args = "-urdf -model s -file '$(find my_slider)/urdf/slider.xacro' -robot_namespace /s -package_to_model"
    done = world("launch", write(node("gazebo_ros/spawn_model", args)))
    assert done.returncode == 0, done.stderr
    assert "/n: s spawned in /s" in done.stdout


def test_a_robot_stays_when_the_launch_that_spawned_it_ends_and_leaves_with_b(world: CommandLine, write: Write) -> None:
    assert world("launch", write(spawn())).returncode == 0
    assert "slider" in world.ok("robots")
    world.ok("delete", "slider")
    launched = Launched(world, write(spawn("-b")))
    launched.up()
    assert "slider" in world.ok("robots")
    assert launched.interrupt() == 130
    assert world.ok("robots", "--json") == ""


def test_a_robot_of_a_launch_that_fails_does_not_stay_and_others_do(world: CommandLine, write: Write) -> None:
    """Whether a node before the failure, in another include, or at the end spawned it; the daemon was there before."""
    world.ok("spawn", "rrbot", "-n", "mine")
    included = f'<include file="{write(spawn())}"/>'
    nodes = {
        "a spawn node": spawn() + control("no_such_controller"),
        "an include": included + control("no_such_controller"),
        "the last node": control("no_such_controller --timeout 60") + spawn(),
        "a robot that is there": spawn() + spawn().replace("slider -param", "mine -param").replace('"urdf"', '"other"'),
    }
    for name, content in nodes.items():
        done = world("launch", write(content))
        assert done.returncode == 1, (name, done.stdout, done.stderr)
        assert [json.loads(line)["name"] for line in world.ok("robots", "--json").splitlines()] == ["mine"], name
    assert "there is a robot 'mine' already" in done.stderr


def test_a_robot_that_a_program_of_a_failed_launch_spawned_does_not_stay_and_others_do(
    world: CommandLine, write: Write
) -> None:
    """By a script of the user's own, its child process, or a rosservice node; one of another terminal stays."""
    folder = Path(write("")).parent / "pkg"
    (folder / "scripts").mkdir(parents=True)
    (folder / "package.xml").write_text("<package><name>pkg</name></package>")
    script = folder / "scripts" / "spawns"
    command = f"{sys.executable} -P -m slidectl"
    script.write_text(f"#!/bin/sh\n{command} spawn rrbot -n own\n({command} spawn rrbot -n childs)\nread line < go\n")
    script.chmod(0o755)
    os.mkfifo(folder / "scripts" / "go")
    xml = "<robot name=''m''><link name=''world''/></robot>"  # quotes of YAML are doubled
    request = quoteattr(f"{{model_name: called, model_xml: '{xml}'}}")[1:-1].replace('"', "&quot;")
    dies = folder / "scripts" / "dies"
    dies.write_text("#!/bin/sh\nread line < die\nexit 3\n")
    dies.chmod(0o755)
    os.mkfifo(folder / "scripts" / "die")
    path = write(
        node("pkg/spawns", attributes='cwd="node"', name="spawns")
        + node("rosservice/rosservice", f"call --wait /gazebo/spawn_urdf_model &quot;{request}&quot;", name="calls")
        + node("pkg/dies", attributes='cwd="node" required="true"', name="dies")
    )
    world.ok("spawn", "rrbot", "-n", "before")
    launched = Launched(world, "--package", f"pkg={folder}", path)
    launched.up()
    for what in ("own: spawned", "childs: spawned", "spawned 'called'"):
        launched.until(what)
    world.ok("spawn", "rrbot", "-n", "after")
    (folder / "scripts" / "die").write_text("go\n")
    assert launched.end() == 1, launched.text
    assert "/spawns: own: deleted" in launched.text
    assert sorted(json.loads(line)["name"] for line in world.ok("robots", "--json").splitlines()) == ["after", "before"]


def test_a_robot_of_a_launch_that_is_interrupted_before_it_is_up_does_not_stay(
    world: CommandLine, write: Write
) -> None:
    waits = node("controller_manager/spawner", "joint_state_controller", 'ns="/nowhere"')
    launched = Launched(world, write(spawn() + waits))
    launched.until("waits for")
    assert "slider" in world.ok("robots")
    assert launched.interrupt() == 130
    assert "/urdf: slider: deleted" in launched.text
    assert world.ok("robots", "--json") == ""


def test_a_robot_stays_with_a_program_that_dies_and_not_with_a_required_one(world: CommandLine, write: Write) -> None:
    folder = Path(write("")).parent / "pkg"
    (folder / "scripts").mkdir(parents=True)
    (folder / "package.xml").write_text("<package><name>pkg</name></package>")
    script = folder / "scripts" / "die"
    script.write_text("#!/bin/sh\nread line < go\nexit 3\n")
    script.chmod(0o755)
    for attributes, stays in (("", True), ('required="true"', False)):
        os.mkfifo(folder / "scripts" / "go")
        path = write(spawn() + node("pkg/die", attributes=f'{attributes} cwd="node"'))
        launched = Launched(world, "--package", f"pkg={folder}", path)
        launched.up()
        (folder / "scripts" / "go").write_text("go\n")
        assert launched.end() == 1, launched.text
        assert ("slider" in world.ok("robots")) is stays
        (folder / "scripts" / "go").unlink()
        if stays:
            world.ok("delete", "slider")


def test_a_launch_tells_of_masses_that_are_mended_and_refuses_them_when_strict(
    world: CommandLine, write: Write
) -> None:
    folder = Path(write("")).parent
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'
    urdf = f'<robot name="m">\n<link name="l"><inertial><mass value="1"/>{inertia}</inertial></link></robot>'
    (folder / "plate.urdf").write_text(urdf)
    spawning = node("gazebo_ros/spawn_model", "-urdf -param d -model m", name="s")
    path = write(f'<param name="d" textfile="{folder}/plate.urdf"/>{spawning}')
    strict = world("launch", path, "--strict")
    assert strict.returncode == 1
    assert f"{folder}/plate.urdf:2: link 'l' has an inertia that no body can have" in strict.stderr
    assert world.ok("robots", "--json") == ""
    done = world("launch", path)
    assert done.returncode == 0, done.stderr
    assert f"{folder}/plate.urdf:2: converted: link 'l'/<inertial>/<inertia>: has an inertia that" in done.stderr
    assert "instead of 1 0 0 0.1 0 0.1 kg·m²" in done.stderr


def test_spawning_can_wait_for_another_robot(world: CommandLine, write: Write) -> None:
    launched = Launched(world, write(spawn("-wait first -x 2 -robot_namespace /s")))
    launched.until("/urdf: waits for the model first")
    world.ok("spawn", "rrbot", "-n", "first")
    launched.until("slider spawned in /s")
    assert launched.end() == 0


def test_tags_without_effect_are_counted_and_shown_with_v(world: CommandLine, write: Write, tmp_path: Path) -> None:
    model = tmp_path / "extra.urdf"
    tag = '<gazebo reference="link2"><sensor type="sonar" name="s"/></gazebo></robot>'
    model.write_text(world.ok("urdf", "slider").replace("</robot>", tag))
    path = write(node("gazebo_ros/spawn_model", f"-urdf -model slider -file {model}"))
    done = world("launch", path)
    assert "without effect, -v shows them" in done.stdout
    world.ok("delete", "slider")
    done = world("launch", path, "-v")
    assert "extra.urdf:" in done.stderr
    assert "<sensor" in done.stderr


# --- controllers ----------------------------------------------------------------------------------------------------


def test_a_spawner_may_stand_before_the_robot_that_it_waits_for(world: CommandLine, write: Write) -> None:
    launched = Launched(world, write(YAML + control() + spawn()))
    launched.up()
    assert states(world) == dict.fromkeys(BOTH.split(), "running")
    launched.interrupt()


def test_a_spawner_can_load_without_starting(slider: CommandLine, write: Write) -> None:
    launched = Launched(slider, write(control(f"--stopped {BOTH}")))
    launched.up()
    assert states(slider) == dict.fromkeys(BOTH.split(), "initialized")
    assert launched.interrupt() == 130
    assert states(slider) == {}


def test_a_spawner_takes_files_of_controllers(slider: CommandLine, write: Write, tmp_path: Path) -> None:
    file = tmp_path / "my controllers.yaml"
    file.write_text("extra: {type: joint_state_controller/JointStateController, publish_rate: 10}\n")
    args = f"'{file}' joint1_position_controller"
    launched = Launched(slider, write(control(args)))
    launched.up()
    assert states(slider) == {"extra": "running", "joint1_position_controller": "running"}
    assert slider.ok("param", "get", "/slider/extra/publish_rate").strip() == "10"
    launched.interrupt()


def test_a_spawner_can_wait_for_a_topic_to_say_true(slider: CommandLine, write: Write) -> None:
    launched = Launched(slider, write(control(f"--wait-for go {BOTH}")))
    launched.until("waits for true on /slider/go")
    slider.ok("pub", "/slider/go", "false")
    slider.ok("pub", "/slider/go", "true")
    launched.up()
    assert set(states(slider).values()) == {"running"}
    launched.interrupt()


def test_a_spawner_goes_on_waiting_for_its_topic_with_a_warning(slider: CommandLine, write: Write) -> None:
    launched = Launched(slider, write(control(f"--timeout 0.2 --wait-for go {BOTH}")))
    launched.until("no true message on /slider/go within 0.2 s; it goes on waiting")
    slider.ok("pub", "/slider/go", "true")
    launched.up()
    assert set(states(slider).values()) == {"running"}
    launched.interrupt()


@pytest.mark.parametrize("script", ["spawner", "controller_manager"])
def test_the_scripts_go_on_without_a_controller_that_has_no_parameters(
    slider: CommandLine, write: Write, script: str
) -> None:
    verb = "spawn " if script == "controller_manager" else ""
    node = control(f"{verb}joint_state_controller joint2_position_controller joint1_position_controller")
    launched = Launched(slider, write(node.replace('"spawner"', f'"{script}"')))
    launched.up()
    assert states(slider) == dict.fromkeys(BOTH.split(), "running")
    assert "no controller 'joint2_position_controller' in the parameters of /slider" in launched.text
    assert "the controller joint2_position_controller is left out" in launched.text
    launched.interrupt()
    strict = slider("launch", "--strict", write(node.replace('"spawner"', f'"{script}"')))
    assert strict.returncode == 1
    assert "no controller 'joint2_position_controller'" in strict.stderr


def test_a_spawner_that_finds_a_controller_loaded_fails_and_leaves_it_alone(slider: CommandLine, write: Write) -> None:
    slider.ok("controller", "spawn", "joint_state_controller")
    done = slider("launch", write(control("joint1_position_controller joint_state_controller")))
    assert done.returncode == 1
    assert "cannot load joint_state_controller" in done.stderr
    assert states(slider) == {"joint_state_controller": "running"}


def test_the_end_of_a_spawner_unloads_what_it_can(slider: CommandLine, write: Write) -> None:
    launched = Launched(slider, write(control()))
    launched.up()
    slider.ok("controller", "stop", "joint_state_controller")
    assert launched.interrupt() == 130
    assert "cannot stop joint_state_controller, joint1_position_controller" in launched.text
    assert states(slider) == {"joint1_position_controller": "running"}


def test_an_unspawner_keeps_controllers_stopped_and_starts_them_again_at_its_end(
    slider: CommandLine, write: Write
) -> None:
    slider.ok("controller", "spawn", *BOTH.split())
    launched = Launched(slider, write(control("joint1_position_controller", "unspawner")))
    launched.up()
    assert states(slider)["joint1_position_controller"] == "stopped"
    slider.ok("controller", "start", "joint1_position_controller")
    launched.until("stopped joint1_position_controller again")
    assert launched.interrupt() == 130
    assert states(slider) == dict.fromkeys(BOTH.split(), "running")


def test_the_controller_manager_script_does_one_thing_and_is_gone(slider: CommandLine, write: Write) -> None:
    done = slider("launch", write(control(f"spawn {BOTH}", "controller_manager")))
    assert done.returncode == 0, done.stderr
    assert "Loaded 'joint_state_controller'" in done.stdout
    assert states(slider) == dict.fromkeys(BOTH.split(), "running")
    done = slider("launch", write(control("list", "controller_manager")))
    assert "'joint_state_controller'" in done.stdout
    assert "( running )" in done.stdout
    done = slider("launch", write(control(f"kill {BOTH}", "controller_manager")))
    assert states(slider) == {}
    done = slider("launch", write(control("load nothing", "controller_manager")))
    assert done.returncode == 1


def test_controller_groups_are_switched_as_wholes(slider: CommandLine, write: Write) -> None:
    groups = '<rosparam ns="/slider">controller_groups: {all: [%s], one: [%s]}</rosparam>'
    groups %= (BOTH.replace(" ", ", "), "joint_state_controller")
    done = slider("launch", write(groups + control("spawn all", "controller_group")))
    assert done.returncode == 0, done.stderr
    assert states(slider) == dict.fromkeys(BOTH.split(), "running")
    done = slider("launch", write(control("switch one", "controller_group")))
    assert done.returncode == 0, done.stderr
    assert states(slider) == {"joint_state_controller": "running", "joint1_position_controller": "stopped"}
    done = slider("launch", write(control("list", "controller_group")))
    assert "Number of groups: 2" in done.stdout
    done = slider("launch", write(control("switch none", "controller_group")))
    assert done.returncode == 1
    assert "no controller group 'none'" in done.stderr


# --- frames ---------------------------------------------------------------------------------------------------------


def test_a_state_publisher_without_a_robot_waits_for_one_while_the_launch_runs(
    world: CommandLine, write: Write
) -> None:
    content = node("robot_state_publisher/state_publisher", inside='<param name="publish_frequency" value="25"/>')
    launched = Launched(world, write(content))
    launched.up()
    world.ok("spawn", "slider")
    launched.until("/n: the simulation publishes the frames of slider at 25 Hz")
    assert world.ok("param", "get", "/slider/robot_state_publisher/publish_frequency").strip() == "25"
    assert launched.interrupt() == 130
    assert world("param", "get", "/slider/robot_state_publisher/publish_frequency").returncode == 1


@pytest.mark.parametrize(
    ("kind", "args"),
    [
        ("tf/static_transform_publisher", "0 0 1 1.5707963 0 0 world cam 100"),
        ("tf2_ros/static_transform_publisher", "0 0 1 0 0 0.7071068 0.7071068 /world cam"),
    ],
)
def test_a_static_transform_is_there_as_long_as_its_node(
    world: CommandLine, write: Write, kind: str, args: str
) -> None:
    other = node("tf2_ros/static_transform_publisher", "1 0 0 0 0 0 cam lens", name="other")
    launched = Launched(world, write(node(kind, args) + other))
    launched.up()
    found = json.loads(world.ok("tf", "echo", "world", "lens", "--json"))
    assert found["translation"] == pytest.approx([0.0, 1.0, 1.0], abs=1e-6)
    assert launched.interrupt() == 130
    assert world("tf", "echo", "world", "cam").returncode == 1


# --- tools ---------------------------------------------------------------------------------------------------------


def test_a_remap_renames_what_rostopic_publishes(slider: CommandLine, write: Write) -> None:
    slider.ok("controller", "spawn", *BOTH.split())
    there = '<remap from="goal" to="joint1_position_controller/command"/>'
    tool = node("rostopic/rostopic", "pub -1 goal std_msgs/Float64 0.25", 'ns="/slider"', there)
    assert slider("launch", write(tool)).returncode == 0
    assert slider.ok("echo", "/slider/joint1_position_controller/state/set_point", "-n", "1") == "0.25\n---\n"


# --- windows, and others that are not ------------------------------------------------------------------------------


def test_windows_are_a_line_that_names_what_shows_the_same(world: CommandLine, write: Write) -> None:
    done = world("launch", write(node("rviz/rviz") + node("rqt_plot/rqt_plot", name="p")))
    assert done.returncode == 0
    assert "everything runs" not in done.stdout
    assert "runs without 2 things, listed below" in done.stdout
    assert "/n: left out: there are no windows here; slidectl view" in done.stderr
    assert "/p: left out: there are no windows here; slidectl view" in done.stderr
    assert world("launch", "rrbot_control", "rrbot_rqt.launch").returncode == 0


def test_a_joint_state_publisher_beside_a_robot_is_left_out_with_a_warning(world: CommandLine, write: Write) -> None:
    done = world("launch", write(spawn() + node("joint_state_publisher/joint_state_publisher")))
    assert done.returncode == 0
    assert "/n: left out: the joints of a simulated robot are where the world has them" in done.stderr
    assert "slider" in world.ok("robots")


def test_a_required_node_that_is_done_at_once_ends_the_launch(slidectl: CommandLine, write: Write) -> None:
    done = slidectl("launch", write(spawn().replace('name="urdf"', 'name="urdf" required="true"')))
    assert done.returncode == 0
    eventually(lambda: slidectl("daemon", "status").returncode == 3, "the daemon is still there")


def test_the_launch_of_the_world_prints_the_warnings_of_the_world(slidectl: CommandLine, write: Write) -> None:
    launched = Launched(
        slidectl,
        write(node("gazebo_ros/gazebo", name="gazebo") + spawn() + YAML + control()),
    )
    launched.up()
    slidectl("pub", "/slider/joint1_position_controller/command", ".nan")
    launched.until("warning: /slider/joint1_position_controller")
    launched.interrupt()


def test_a_launch_prints_nothing_of_what_another_client_is_refused(slider: CommandLine, write: Write) -> None:
    slider.ok("param", "set", "/slider/broken/type", "effort_controllers/JointPositionController")
    command = slider.argv("launch", write(control()), "--detach")
    launched = subprocess.Popen(
        command, env=slider.environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    while launched.poll() is None:
        assert slider("controller", "load", "broken").returncode == 1
    output = launched.communicate()[0]
    assert RUNS in output
    assert "broken" not in output


# --- the page in place of windows ------------------------------------------------------------------------------------


def address_of(text: str) -> str:
    found = re.search(r"the page is open: (http://\S+:\d+/)", text)
    assert found is not None, text
    return found[1]


def is_served(address: str) -> bool:
    try:
        with urllib.request.urlopen(address, timeout=20.0) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


@pytest.mark.parametrize("words", [("gui:=true",), ("--view",)], ids=" ".join)
def test_a_launch_opens_the_page_and_ends_it(slidectl: CommandLine, words: tuple[str, ...]) -> None:
    pytest.importorskip("viser")
    launched = Launched(slidectl, "my_slider", "slider.launch", *words)
    address = address_of(launched.until("everything runs"))
    assert is_served(address)
    done = slidectl("ros", "rosrun", "rviz", "rviz")
    assert f"is open: {address}" in done.stderr
    assert launched.interrupt() == 130
    assert not is_served(address)
    assert "is open" not in slidectl("ros", "rosrun", "rviz", "rviz").stderr


def test_a_launch_without_gui_opens_no_page(slidectl: CommandLine) -> None:
    for words in ((), ("gui:=false",)):
        done = slidectl("launch", "my_slider", "slider.launch", *words, "--dry-run")
        assert done.returncode == 0
        assert "open the page" not in done.stdout
    listed = slidectl.ok("launch", "my_slider", "slider.launch", "gui:=true", "--dry-run")
    assert "open the page: slidectl view" in listed


def test_a_file_that_asks_for_a_window_by_itself_opens_none(slidectl: CommandLine, write: Write) -> None:
    source = write('<include file="$(find gazebo_ros)/launch/empty_world.launch"/>')
    assert "open the page" not in slidectl.ok("launch", source, "--dry-run")
