"""`slidectl spawn`, `robots` and `delete` in a real daemon. Its world is shared by the tests, so each cleans up."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine

from slidectl.client import spawning
from slidectl.errors import UsageError

CONTROLLERS = "config/slider_control.yaml"
BOX = """<?xml version="1.0"?>
<robot name="box">
  <link name="base">
    <inertial><mass value="{mass}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <collision><geometry><box size="1 1 1"/></geometry></collision>
  </link>
  {more}
</robot>
"""


@pytest.fixture(autouse=True)
def _empty_again(world: CommandLine) -> Iterator[None]:
    yield
    names = [json.loads(line)["name"] for line in world.ok("robots", "--json").splitlines()]
    if names:
        world.ok("delete", *names)


def robot(world: CommandLine, name: str) -> dict[str, object]:
    record: dict[str, object] = json.loads(world.ok("robots", name, "--json"))
    return record


def box(tmp_path: Path, mass: float = 1.0, more: str = "") -> str:
    file = tmp_path / "box.urdf"
    file.write_text(BOX.format(mass=mass, more=more))
    return str(file)


def test_a_shipped_model_is_there_when_spawn_returns(world: CommandLine) -> None:
    assert world.ok("spawn", "slider") == "slider: spawned in /slider at 0 0 0, joints: joint1\n"
    listed = world.ok("robots").splitlines()
    assert listed[0].split() == ["NAME", "NAMESPACE", "KIND", "FIXED", "JOINTS", "CONTROLLERS"]
    assert listed[1].split() == ["slider", "/slider", "robot", "yes", "joint1", "-"]


def test_spawn_in_json_has_the_keys_of_robots(world: CommandLine) -> None:
    spawned = json.loads(world.ok("spawn", "rrbot", "--json"))
    assert spawned == robot(world, "rrbot")
    assert list(spawned) == [
        "name", "namespace", "kind", "fixed", "pose", "links", "joints", "controllers", "estop", "frozen", "report",
    ]  # fmt: skip
    joint = next(joint for joint in spawned["joints"] if joint["name"] == "joint1")
    assert list(joint) == [
        "name", "type", "interface", "position", "velocity", "effort", "lower", "upper", "max_velocity", "max_effort",
    ]  # fmt: skip


def test_one_robot_is_shown_with_its_joints_in_every_format(world: CommandLine) -> None:
    world.ok("spawn", "slider")
    text = world.ok("robots", "slider")
    assert "fixed to the world" in text
    assert "EffortJointInterface" in text
    assert world.ok("robots", "slider", "-o", "yaml").startswith("name: slider\nnamespace: /slider\n")
    header, *rows = world.ok("robots", "slider", "-o", "csv").splitlines()
    assert header.startswith("name,type,interface,position,velocity,effort")
    assert any(row.startswith("joint1,prismatic,hardware_interface/EffortJointInterface,0.0,") for row in rows)


def test_a_table_on_a_terminal_is_coloured_and_complete(world: CommandLine) -> None:
    world.ok("spawn", "slider", "-n", "a_robot_with_a_name_that_is_longer_than_a_terminal_is_wide_" + 60 * "Z")
    shown = world.on_a_terminal("robots")
    assert b"\x1b[36m" in shown
    assert shown.count(b"Z") == 2 * 60
    assert b"\x1b[36m" not in world.on_a_terminal("robots", NO_COLOR="1")
    assert b"\x1b" not in world.on_a_terminal("robots", TERM="dumb")
    assert b"\x1b" not in world.on_a_terminal("robots", "--json")


def test_an_empty_world_lists_nothing_on_stdout(world: CommandLine) -> None:
    done = world("robots")
    assert (done.returncode, done.stdout) == (0, "")
    assert "slidectl spawn slider" in done.stderr


def test_a_name_moves_a_model_with_a_namespace_argument_into_its_own_namespace(world: CommandLine) -> None:
    world.ok("spawn", "slider", "-n", "left", "--at", "0", "-1", "0.5")
    left = robot(world, "left")
    assert left["namespace"] == "/left"
    assert left["pose"] == [0.0, -1.0, 0.5, 0.0, 0.0, 0.0, 1.0]
    world.ok("spawn", "slider", "-n", "right", "namespace:=/elsewhere")
    assert robot(world, "right")["namespace"] == "/elsewhere"
    assert robot(world, "/elsewhere")["name"] == "right"


def test_at_takes_three_or_six_numbers(world: CommandLine, tmp_path: Path) -> None:
    world.ok("spawn", box(tmp_path), "--at", "1", "2", "3", "0", "0", "1.5707963267948966")
    assert robot(world, "box")["pose"] == pytest.approx([1, 2, 3, 0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    for words in (["1", "2"], ["1", "2", "3", "4"]):
        assert world("spawn", "slider", "--at", *words).returncode == 2
    done = world("spawn", "slider", "--at", "1", "2", "nan")
    assert (done.returncode, done.stderr) == (2, "error: --at takes finite numbers, not 1 2 nan\n")
    done = world("spawn", "slider", "--at", "1e300", "0", "0")
    assert (done.returncode, done.stderr) == (2, "error: --at takes numbers up to ±1e+06 (m, rad), not 1e+300 0 0\n")


def test_a_script_that_gives_an_argument_that_the_model_has_not_is_refused(world: CommandLine) -> None:
    with world.client() as client:
        with pytest.raises(UsageError, match="slider: nope:= the file has no such argument"):
            client.spawn("slider", nope="3")
        assert client.robots() == []


def test_a_root_is_free_unless_it_is_called_world_or_fixed(world: CommandLine, tmp_path: Path) -> None:
    file = box(tmp_path)
    world.ok("spawn", file)
    world.ok("spawn", file, "-n", "held", "--fixed")
    world.ok("spawn", "slider", "--free")
    fixed = {name: robot(world, name)["fixed"] for name in ("box", "held", "slider")}
    assert fixed == {"box": False, "held": True, "slider": False}


def test_a_model_may_come_from_standard_input(world: CommandLine) -> None:
    done = world("spawn", "-", "-n", "piped", stdin=BOX.format(mass=1, more=""))
    assert done.returncode == 0, done.stderr
    assert robot(world, "piped")["links"] == ["base"]
    assert world("spawn", "-", stdin="").returncode == 2


def test_controllers_are_configured_before_and_started_after_the_spawn(world: CommandLine) -> None:
    done = world("spawn", "slider", "--controllers", CONTROLLERS, "--start", "joint_state_controller", "-q", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["controllers"] == ["joint_state_controller"]
    states = [json.loads(line)["state"] for line in world.ok("controller", "list", "--json").splitlines()]
    assert states == ["running"]


def test_the_shipped_configuration_is_found_from_any_folder(world: CommandLine, tmp_path: Path) -> None:
    done = world("spawn", "slider", "--controllers", CONTROLLERS, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_taken_name_or_namespace_is_refused_and_changes_nothing(world: CommandLine, tmp_path: Path) -> None:
    world.ok("spawn", "slider", "--controllers", CONTROLLERS)
    gains = tmp_path / "gains.yaml"
    gains.write_text("slider:\n  joint1_position_controller:\n    pid: {p: 1.0}\n    type: x/Y\n")
    again = world("spawn", "slider", "--controllers", str(gains))
    assert again.returncode == 1
    assert "there is a robot 'slider' already" in again.stderr
    same_namespace = world("spawn", "slider", "-n", "second", "namespace:=/slider", "--controllers", str(gains))
    assert same_namespace.returncode == 1
    assert "the namespace /slider belongs to robot 'slider' already" in same_namespace.stderr
    world.ok("controller", "load", "joint1_position_controller")
    assert json.loads(world.ok("controller", "list", "--json"))["type"] == "effort_controllers/JointPositionController"


@pytest.mark.parametrize(
    ("name", "robot"),
    [
        ("scout/", "scout"), ("/", "robot"), ("2dof_robot", "robot_2dof_robot"), ("schieber_ü", "schieber_u"),
        ("a b", "a_b"), ("_a", "a"), ("a/b", "a_b"),
    ],
)  # fmt: skip
def test_any_name_is_taken_and_made_a_graph_name_with_a_remark(world: CommandLine, name: str, robot: str) -> None:
    words = ("-n", name, "--controllers", "config/slider_control.yaml", "--start", "joint_state_controller")
    done = world("spawn", "slider", *words)
    assert done.returncode == 0, done.stderr
    assert f"warning: {name!r} cannot be a part of a topic's name: the robot is {robot} here\n" in done.stderr
    assert f"{robot}: spawned in /{robot} at" in done.stdout
    assert json.loads(world.ok("robots", robot, "--json"))["controllers"] == ["joint_state_controller"]


def test_a_model_may_have_a_name_that_is_no_graph_name(world: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "odd.urdf"
    file.write_text('<robot name="2dof robot"><link name="world"/></robot>')
    done = world("spawn", str(file))
    assert done.returncode == 0, done.stderr
    assert "'2dof robot' cannot be a part of a topic's name: the robot is robot_2dof_robot here" in done.stderr
    assert "robot_2dof_robot here" in world.ok("check", str(file))
    answer = world(
        "service", "call", "/gazebo/spawn_urdf_model", f"{{model_name: 'ü/', model_xml: '{file.read_text()}'}}"
    )
    assert "success: True" in answer.stdout, answer.stdout
    assert "'ü/' cannot be a part of a topic's name: the robot is u here" in answer.stderr
    assert json.loads(world.ok("robots", "u", "--json"))["namespace"] == "/u"


def test_no_name_at_all_is_wrong_usage_and_sets_no_parameter(world: CommandLine) -> None:
    before = world.ok("param", "list")
    done = world("spawn", "slider", "-n", "", "--controllers", "config/slider_control.yaml")
    assert done.returncode == 2
    assert "name of a robot" in done.stderr
    assert "-n NAME" in done.stderr
    assert world.ok("param", "list") == before


def test_the_name_of_a_controller_may_hold_a_slash(world: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "grouped.yaml"
    file.write_text(
        "grouped:\n  in/state: {type: joint_state_controller/JointStateController, publish_rate: 50}\n"
        "  arm:\n    position: {type: effort_controllers/JointPositionController, joint: joint1, pid: {p: 1.0}}\n"
    )
    world.ok("spawn", "slider", "-n", "grouped", "--controllers", str(file), "--start", "in/state")
    listed = world.ok("controller", "list", "--all", "--cm", "/grouped", "-o", "csv").splitlines()
    assert [line.split(",")[1:3] for line in listed[1:]] == [["in/state", "running"], ["arm/position", "unloaded"]]
    hint = "arm/position is not loaded; load and start it: slidectl controller spawn arm/position"
    assert hint in world("pub", "/grouped/arm/position/command", "1.0").stderr
    world.ok("controller", "spawn", "arm/position")
    world.ok("pub", "arm/position/command", "0.5")
    world.ok("controller", "stop", "/grouped/arm/position")
    world.ok("controller", "switch", "--start", "arm/position", "--stop", "in/state")
    world.ok("controller", "unspawn", "arm/position/")


def test_an_unknown_controller_is_found_before_the_robot_is_spawned(world: CommandLine) -> None:
    done = world("spawn", "slider", "--controllers", CONTROLLERS, "--start", "joint1_positon_controller")
    assert done.returncode == 1
    assert "Did you mean 'joint1_position_controller'?" in done.stderr
    assert world.ok("robots", "--json") == ""


def test_a_start_that_is_refused_leaves_the_robot_there(world: CommandLine, tmp_path: Path) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text("slider:\n  c: {type: effort_controllers/JointPositionController, joint: nope, pid: {p: 1.0}}\n")
    done = world("spawn", "slider", "--controllers", str(bad), "--start", "c", "--json")
    assert done.returncode == 1
    assert "nope" in done.stderr
    assert json.loads(done.stdout)["name"] == "slider"
    assert robot(world, "slider")["controllers"] == []


def test_a_start_that_is_refused_says_how_to_go_on_and_that_works(world: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    written = "slider:\n  c: {type: effort_controllers/JointPositionController, joint: nope, pid: {p: 1.0}}\n"
    file.write_text(written)
    told = world("spawn", "slider", "--controllers", str(file), "--start", "c").stderr
    config, again = "controller config (\\S+) --cm /slider", "controller spawn c --cm /slider"
    assert re.search(
        f"the robot stays in the world: correct {file}, then slidectl .*{config}; slidectl .*{again}", told
    )
    assert re.search("or take it out again: slidectl .*delete slider", told)
    file.write_text(written.replace("nope", "joint1"))
    world.ok("controller", "config", str(file), "--cm", "/slider")
    world.ok(*again.split())
    assert robot(world, "slider")["controllers"] == ["c"]
    world.ok("delete", "slider")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["slidr"], "Did you mean 'slider'?"),
        (["./nowhere.xacro"], "nowhere.xacro: no such file"),
        (["slider", "width"], "'width' is not KEY:=VALUE"),
        (["slider", "--controllers", "nowhere.yaml"], "nowhere.yaml: no such file"),
        (["slider", "-n", "a" * 1001], "1000 is the most"),
        (["slider", "--package", "here"], "is not KEY=VALUE"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_read_is_a_short_error(world: CommandLine, words: list[str], said: str) -> None:
    done = world("spawn", *words)
    assert done.returncode in (1, 2)
    assert said in done.stderr
    assert len(done.stderr.splitlines()) <= 3
    assert world.ok("robots", "--json") == ""


def test_an_error_in_a_model_names_file_and_line(world: CommandLine, tmp_path: Path) -> None:
    file = box(tmp_path, mass=-1)
    done = world("spawn", file, "--strict")
    assert done.returncode == 2
    assert f"{file}:4" in done.stderr
    assert "'base'" in done.stderr


def test_an_error_in_a_controllers_file_names_file_and_line(world: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "broken.yaml"
    file.write_text("slider:\n  a: [1, 2\n  b: 3\n")
    done = world("spawn", "slider", "--controllers", str(file))
    assert done.returncode == 2
    assert f"{file}:3: not YAML" in done.stderr


def test_tags_without_effect_are_counted_and_v_lists_them(world: CommandLine, tmp_path: Path) -> None:
    file = box(tmp_path, more='<gazebo reference="base"><kp>1</kp><kd>1</kd></gazebo>')
    done = world("spawn", file)
    assert "2 without effect (slidectl robots box -v lists them)" in done.stderr
    listed = world.ok("robots", "box", "-v")
    assert f"{file}:7" in listed
    assert "<kp>" in listed
    assert robot(world, "box")["report"] != []
    verbose = world("spawn", file, "-n", "again", "-v")
    assert f"{file}:7: ignored" in verbose.stderr


def test_delete_takes_the_named_robots_and_no_other(world: CommandLine) -> None:
    for name in ("a", "b", "c"):
        world.ok("spawn", "slider", "-n", name)
    assert world.ok("delete", "a", "/b") == "a: deleted\nb: deleted\n"
    assert [json.loads(line)["name"] for line in world.ok("robots", "--json").splitlines()] == ["c"]


def test_deleting_an_unknown_robot_deletes_none(world: CommandLine) -> None:
    world.ok("spawn", "slider")
    done = world("delete", "slider", "slidre")
    assert (done.returncode, done.stdout) == (1, "")
    assert "no robot 'slidre'. Did you mean 'slider'?" in done.stderr
    assert robot(world, "slider")
    assert world("robots", "slidre").returncode == 1


CONTROLLER = {"type": "effort_controllers/JointEffortController", "joint": "joint1"}


@pytest.mark.parametrize(
    ("tree", "namespaces", "expected"),
    [
        ({"slider": {"c": CONTROLLER}}, ["/slider"], {"slider": {"c": CONTROLLER}}),
        ({"slider": {"c": CONTROLLER}}, ["/left"], {"left": {"c": CONTROLLER}}),
        ({"slider": {"c": CONTROLLER}}, ["/a/b"], {"a": {"b": {"c": CONTROLLER}}}),
        ({"c": CONTROLLER}, ["/left"], {"left": {"c": CONTROLLER}}),
        ({"c": CONTROLLER}, ["/"], {"c": CONTROLLER}),
        ({"slider": {"c": CONTROLLER}}, [], {"slider": {"c": CONTROLLER}}),
        ({"slider": {"c": CONTROLLER}, "x": 1}, ["/left"], {"slider": {"c": CONTROLLER}, "x": 1}),
        ({"a": {"c": CONTROLLER}}, ["/a", "/b"], {"a": {"c": CONTROLLER}}),
    ],
)
def test_a_configuration_goes_to_the_robot_that_it_is_meant_for(
    tree: dict[str, object], namespaces: list[str], expected: dict[str, object]
) -> None:
    assert spawning.placements(tree, namespaces)[0] == expected


def test_a_configuration_for_one_of_several_robots_must_say_which(world: CommandLine, tmp_path: Path) -> None:
    for name in ("a", "b"):
        world.ok("spawn", "slider", "-n", name)
    file = tmp_path / "both.yaml"
    file.write_text(json.dumps({"c": CONTROLLER}))
    done = world("controller", "config", str(file))
    assert done.returncode == 2
    assert "--cm" in done.stderr
    world.ok("controller", "config", str(file), "--cm", "b")
    world.ok("controller", "load", "c", "--cm", "b")


def test_a_configuration_for_somebody_else_is_loaded_with_a_warning(world: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "other.yaml"
    file.write_text("a: {b: 1}\nc: {d: 2}\n")
    done = world("spawn", "slider", "--controllers", str(file))
    assert done.returncode == 0
    assert "no controllers for /slider" in done.stderr


ARM = """<robot name="arm"><link name="world"/>
<joint name="fix" type="fixed"><parent link="world"/><child link="base"/></joint>
<link name="base"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="87" velocity="2"/></joint>
<link name="l1"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="j1"><hardwareInterface>hardware_interface/PositionJointInterface</hardwareInterface></joint>
<actuator name="m"/></transmission>
<gazebo><plugin name="c" filename="libgazebo_ros_control.so">
<robotNamespace>{namespace}</robotNamespace></plugin></gazebo>
</robot>"""
ROOT_CONTROLLERS = """joint_state_controller: {type: joint_state_controller/JointStateController, publish_rate: 100}
j1_pos: {type: position_controllers/JointPositionController, joint: j1}
"""


@pytest.mark.parametrize("written", ["", "/"])
def test_an_empty_robot_namespace_is_the_root_everywhere(world: CommandLine, tmp_path: Path, written: str) -> None:
    model, yaml = tmp_path / "arm.urdf", tmp_path / "arm.yaml"
    model.write_text(ARM.format(namespace=written))
    yaml.write_text(ROOT_CONTROLLERS)
    checked = world.ok("check", str(model), "--controllers", str(yaml))
    assert "controllers live in the namespace /\n" in checked
    assert "0 ignored, 0 wrong" in checked
    done = world.ok("spawn", str(model), "--controllers", str(yaml), "--start", "joint_state_controller")
    assert "arm: spawned in / at" in done
    world.ok("spawn", "slider", "--controllers", CONTROLLERS, "--start", "joint_state_controller")
    assert robot(world, "arm")["namespace"] == "/"
    assert "/controller_manager/list_controllers" in world.ok("service", "list").splitlines()
    world.ok("controller", "spawn", "--cm", "/", "j1_pos")
    listed = [json.loads(line) for line in world.ok("controller", "list", "--cm", "/", "--json").splitlines()]
    assert {(one["manager"], one["name"]) for one in listed} == {("/", "joint_state_controller"), ("/", "j1_pos")}
    topics = world.ok("topic", "list").splitlines()
    assert {"/joint_states", "/j1_pos/command", "/slider/joint_states"} <= set(topics)
    words = {"_SLIDECTL_COMPLETE": "bash_complete", "COMP_WORDS": "slidectl controller list --cm ", "COMP_CWORD": "4"}
    assert "plain,/" in world("", **words).stdout.splitlines()


def test_an_impossible_mass_is_mended_with_old_and_new_values_and_refused_when_strict(
    world: CommandLine, tmp_path: Path
) -> None:
    path = box(tmp_path, mass=0.0)
    refused = world("spawn", path, "--strict")
    assert (refused.returncode, "link 'base' has a mass of 0 kg; it must be above 0" in refused.stderr) == (2, True)
    assert world("check", path, "--strict").returncode == 2
    done = world("spawn", path)
    assert done.returncode == 0, done.stderr
    change = "it is simulated with a mass of 0.001 instead of 0 kg"
    assert f"{path}:4: converted: link 'base'/<inertial>/<mass>: has a mass of 0 kg" in done.stderr
    assert change in done.stderr
    checked = world("check", path, "--only", "converted")
    assert (checked.returncode, change in checked.stdout) == (0, True)


def test_joints_start_where_spawn_says_and_again_after_a_reset(world: CommandLine) -> None:
    world.ok("sim", "pause")
    world.ok("spawn", "rrbot", "--joint", "joint1=0.5", "--joint", "joint2=-1.25")
    positions = {"joint1": 0.5, "joint2": -1.25}
    assert {name: position(world, "rrbot", name) for name in positions} == positions
    world.ok("sim", "step", "500")
    assert position(world, "rrbot", "joint1") != 0.5
    world.ok("sim", "reset")
    assert {name: position(world, "rrbot", name) for name in positions} == positions


def test_a_joint_that_is_commanded_by_its_position_stays_where_it_starts(world: CommandLine, tmp_path: Path) -> None:
    file = tmp_path / "slider.urdf"
    file.write_text(world.ok("urdf", "slider").replace("EffortJointInterface", "PositionJointInterface"))
    world.ok("spawn", str(file), "--joint", "joint1=-0.7")
    for _ in range(2):
        world.ok("sim", "step", "500")
        assert position(world, "slider", "joint1") == pytest.approx(-0.7, abs=1e-6)
        world.ok("sim", "reset")


def test_what_a_robot_is_put_into_is_judged_with_its_joints_where_they_start(
    world: CommandLine, tmp_path: Path
) -> None:
    world.ok("sim", "pause")
    lift = """<link name="world"/><joint name="lift" type="prismatic"><parent link="world"/><child link="base"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>"""
    file = box(tmp_path, more=lift)
    for position, is_in_the_ground in (("0.6", False), ("0.1", True)):
        done = world("spawn", file, "--joint", f"lift={position}")
        assert done.returncode == 0, done.stderr
        assert ("it was put into the ground" in done.stderr) == is_in_the_ground
        assert ("base 400 mm" in done.stderr) == is_in_the_ground
        world.ok("delete", "box")


@pytest.mark.parametrize(
    ("joint", "code", "words"),
    [
        ("joint1=1.5", 1, "joint1 goes from -1 to 1 m, not to 1.5"),
        ("jiont1=0.5", 1, "no moving joint 'jiont1' on robot 'slider'. Did you mean 'joint1'?"),
        ("joint1=30deg", 2, "takes a number, in rad or m, not '30deg'"),
        ("joint1=nan", 1, "must be a finite number"),
        ("joint1", 2, "'joint1' is not KEY=VALUE"),
    ],
)
def test_a_joint_that_cannot_start_there_leaves_no_robot(world: CommandLine, joint: str, code: int, words: str) -> None:
    done = world("spawn", "slider", "--joint", joint)
    assert (done.returncode, words in done.stderr) == (code, True), done.stderr
    assert world.ok("robots", "--json") == ""


def position(world: CommandLine, name: str, joint: str) -> float:
    found = json.loads(world.ok("robots", name, "--json"))["joints"]
    return next(float(one["position"]) for one in found if one["name"] == joint)


SLIPS = """<robot name="slips"><link name="world"/>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<visual><geometry><box size="{size} 0.2 0.2"/></geometry></visual></link>
<joint name="j" type="revolute"><parent link="world"/><child link="a"/>
<limit lower="-{turn}" upper="{turn}" effort="1" velocity="1"/></joint>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="j">
<hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
<actuator name="m"/></transmission>{plugin}</robot>"""
CONTROL = '<gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo>'


def test_slips_of_a_model_are_told_at_the_spawn_in_a_line_each(world: CommandLine, tmp_path: Path) -> None:
    model, controllers = tmp_path / "slips.urdf", tmp_path / "other.yaml"
    controllers.write_text("other:\n  c: {type: effort_controllers/JointEffortController, joint: j}\n")
    model.write_text(SLIPS.format(size="100", turn="90", plugin=""))
    lines = world("spawn", str(model), "--controllers", str(controllers)).stderr.splitlines()
    world.ok("delete", "slips")
    for told in (
        f"warning: {controllers}: the file's controllers are for /other; they are loaded under /slips",
        f"warning: {model}:4: joint 'j': its limits are 28.6 turns apart; angles are in rad: 90 degrees are 1.5708",
        f"warning: {model}:2: link 'a' is 100 m: lengths are in m, 100 mm are 0.1",
    ):
        assert told in lines
    assert any(line.startswith("warning: robot 'slips' has transmissions but no libgazebo_ros_") for line in lines)


def test_a_model_without_slips_is_spawned_without_a_word(world: CommandLine, tmp_path: Path) -> None:
    model = tmp_path / "slips.urdf"
    model.write_text(SLIPS.format(size="1", turn="1.57", plugin=CONTROL))
    assert world("spawn", str(model)).stderr == ""
    world.ok("delete", "slips")


def test_a_xacro_that_does_not_declare_its_prefix_is_told(world: CommandLine, tmp_path: Path) -> None:
    model = tmp_path / "bare.xacro"
    model.write_text('<robot name="bare"><xacro:property name="x" value="1"/><link name="world"/></robot>')
    assert '<robot> lacks xmlns:xacro="http://www.ros.org/wiki/xacro"' in world("spawn", str(model)).stderr
    world.ok("delete", "bare")


def test_a_tag_without_its_bracket_is_quoted(world: CommandLine, tmp_path: Path) -> None:
    model = tmp_path / "stray.urdf"
    text = SLIPS.format(size="1", turn="1.57", plugin=CONTROL)
    model.write_text(text.replace("<limit", "limit"))
    done = world("spawn", str(model))
    assert done.returncode == 2
    assert (
        """there is a text 'limit lower="-1.57" upper="1.57" effort="1" velocity="1"/>': is it a tag""" in done.stderr
    )
    model.write_text(text.replace("<inertial>", '<inertial>origin xyz="0 0 1"/>'))
    assert (
        """the text 'origin xyz="0 0 1"/>' has no effect: is it a tag without its '<'?"""
        in world("spawn", str(model)).stderr
    )
    world.ok("delete", "slips")


def test_a_missing_blank_after_a_colon_is_named(world: CommandLine, tmp_path: Path) -> None:
    controllers = tmp_path / "colon.yaml"
    controllers.write_text(
        "slider:\n  c:\n    type: effort_controllers/JointEffortController\n    joint:joint1\n    p: 1\n"
    )
    done = world("spawn", "slider", "--controllers", str(controllers))
    assert done.returncode == 2
    assert "a blank follows the colon: joint: joint1" in done.stderr
    done = world("pub", "--allow-unheard", "/numbers", "std_msgs/Float64", "data:1.0")
    assert "write a space after the colon: 'data: 1.0'" in done.stderr
