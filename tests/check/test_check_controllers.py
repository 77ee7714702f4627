"""Files of controllers: parameters against what their controllers say that they read, and against the robot."""

from __future__ import annotations

import pytest
from check_texts import CONTROLLERS, PLUGIN, Check, cart, driven_cart, transmission

from slidectl.control import registry


def controller(body: str, kind: str = "effort_controllers/JointPositionController") -> str:
    """A file with one controller, whose `type` is in line 3 and whose parameters begin in line 4."""
    return f"bot:\n  c:\n    type: {kind}\n    {body}\n"


def pid(gains: str) -> str:
    return controller(f"joint: slide\n    pid: {{{gains}}}")


def test_a_sound_file_is_all_used(controllers: Check) -> None:
    assert controllers(CONTROLLERS).all == [
        "used 1 /bot: namespace of slide_controller",
        "used 3 /bot/slide_controller/type: effort_controllers/JointPositionController; "
        "on hardware_interface::EffortJointInterface",
        "used 4 /bot/slide_controller/joint: slide; the joint that it drives",
        "used 5 /bot/slide_controller/pid/p: 10.0; proportional gain",
        "used 5 /bot/slide_controller/pid/i: 1.0; integral gain",
        "used 5 /bot/slide_controller/pid/d: 1.0; derivative gain",
        "used 5 /bot/slide_controller/pid/i_clamp: 2.0; bound of the integral term in both directions",
    ]


UNKNOWN = [
    ("joint: slide\n    pid: {p: 1.0}\n    jiont: a", "/bot/c/jiont", "did you mean 'joint'?"),
    ("joint: slide\n    pid: {p: 1.0, i_clmp: 1}", "/bot/c/pid/i_clmp", "did you mean 'pid/i_clamp'?"),
    ("joint: slide\n    pid: {p: 1.0, i_clam: 1}", "/bot/c/pid/i_clam", "did you mean 'pid/i_clamp'?"),
    ("joint: slide\n    pid: {p: 1.0}\n    p: 3", "/bot/c/p", "did you mean 'pid/p'?"),
    ("joint: slide\n    pid: {p: 1.0}\n    zzz: {a: 1, b: 2}", "/bot/c/zzz", "it knows joint, pid/antiwindup"),
]


@pytest.mark.parametrize(("body", "subject", "hint"), UNKNOWN)
def test_an_unknown_parameter_is_ignored_and_the_closest_known_one_is_named(
    controllers: Check, body: str, subject: str, hint: str
) -> None:
    (line,) = controllers(controller(body)).of("ignored")
    assert f" {subject}: is unknown to the controller and has no effect; " in line
    assert hint in line


def test_an_unknown_parameter_names_what_is_lost_below_it(controllers: Check) -> None:
    (line,) = controllers(controller("joint: slide\n    pid: {p: 1.0}\n    zzz: {a: 1, b: 2}")).of("ignored")
    assert line.endswith("(nor have the parameters below it: a, b)")


def test_an_unknown_type_is_wrong_and_its_parameters_have_no_effect(controllers: Check) -> None:
    lines = controllers(controller("joint: slide", "effort_controler/JointPositionController"))
    (line,) = lines.of("wrong")
    assert line.startswith("wrong 3 /bot/c/type: no controller type 'effort_controler/JointPositionController'.")
    assert "Did you mean 'effort_controllers/JointPositionController'?" in line
    assert lines.of("ignored") == ["ignored 4 /bot/c/joint: has no effect, as the controller's type is unknown"]


def test_a_controller_without_a_type_is_wrong_and_its_likely_type_is_named(controllers: Check) -> None:
    (line,) = controllers("bot:\n  c: {joint: slide, pid: {p: 1.0}}\n").of("wrong")
    assert line.startswith("wrong 2 /bot/c: has no 'type'")
    assert "effort_controllers/JointPositionController" in line


VALUES = [
    ('joint: slide\n    pid: {p: "1"}', "/bot/c/pid/p: must be a number, not the string '1'", "it is required"),
    ("joint: slide\n    pid: {p: 1.0, d: [1]}", "/bot/c/pid/d: must be a number, not [1]", "not set: 0.0"),
    ("joint: slide\n    pid: {p: 1.0, antiwindup: 1}", "/bot/c/pid/antiwindup: must be true or false, not 1", "false"),
    ("joint: 3\n    pid: {p: 1.0}", "/bot/c/joint: must be a string, not 3", "it is required"),
]


@pytest.mark.parametrize(("body", "start", "end"), VALUES)
def test_a_value_of_the_wrong_type_is_wrong(controllers: Check, body: str, start: str, end: str) -> None:
    (line,) = controllers(controller(body)).of("wrong")
    assert f" {start}" in line
    assert line.endswith(end)


def test_a_number_that_yaml_takes_for_text_is_explained(controllers: Check) -> None:
    lines = controllers(pid("p: 1.0, d: 1e-3"))
    assert any("as 1.0e-3" in line for line in lines.of("wrong"))


def test_a_required_parameter_that_is_missing_is_wrong(controllers: Check) -> None:
    lines = controllers(controller("pid: {d: 1.0}"))
    assert [line.split(";")[0] for line in lines.of("wrong")] == [
        "wrong 2 /bot/c/joint: is missing: a string, the joint that it drives",
        "wrong 4 /bot/c/pid/p: is missing: a number, proportional gain",
    ]


GAINS = [
    ("p: 1.0, i: 0.01", [("ignored", "pid/i: 0.01 has no effect without i_clamp")]),
    ("p: 1.0, i: 1.0, i_clamp: 0.0", [("ignored", "pid/i: 1 has no effect without i_clamp")]),
    ("p: 1.0, i: 1.0, i_clamp_min: -1.0, i_clamp_max: 1.0", []),
    ("p: 1.0, antiwindup: true", [("ignored", "pid/antiwindup: true has no effect, as i is 0")]),
    ("p: 1.0, antiwindup: false", []),
    ("p: 1.0, i_clamp: 3.0", [("ignored", "pid/i_clamp: 3 bounds nothing, as i is 0")]),
    (
        "p: 1.0, i: 1.0, antiwindup: true",
        [("ignored", "pid/i: 1 has no effect"), ("ignored", "pid/antiwindup: true has no effect")],
    ),
    (
        "p: 1.0, i: 1.0, i_clamp: 9.0, i_clamp_min: -1.0, i_clamp_max: 1.0",
        [("ignored", "pid/i_clamp: 9 has no effect beside i_clamp_min and i_clamp_max")],
    ),
    ("p: 1.0, i: 1.0, i_clamp: -2.0", [("converted", "pid/i_clamp: -2 is taken as 2")]),
    ("p: 1.0, i: 1.0, i_clamp: 2.0, i_clamp_min: 1.0", [("converted", "pid/i_clamp_min: 1 is taken as -1")]),
    ("p: -1.0", [("wrong", "pid/p: -1 is negative")]),
    ("p: 0.0", [("wrong", "pid/p: 0.0, as are all gains: the controller never pushes")]),
    ("p: .nan", [("wrong", "pid/p: nan is not a finite number")]),
]


@pytest.mark.parametrize(("gains", "expected"), GAINS)
def test_gains_without_effect_are_found(controllers: Check, gains: str, expected: list[tuple[str, str]]) -> None:
    found = controllers(pid(gains)).of("converted", "ignored", "wrong")
    assert len(found) == len(expected), found
    for line, (verdict, text) in zip(found, expected, strict=True):
        assert line.startswith(f"{verdict} 5 /bot/c/{text}")


def test_each_gain_is_mentioned_once(controllers: Check) -> None:
    lines = controllers(pid("p: 1.0, i: 0.01, d: 1.0, i_clamp: 0.0, antiwindup: true"))
    subjects = [line.split(":")[0].split()[-1] for line in lines.about("/pid/")]
    assert len(subjects) == len(set(subjects)) == 5


def test_the_entries_of_a_list_of_joints_are_checked_one_by_one(controllers: Check) -> None:
    entries = "[{name: a, position: 1.0}, {name: b, position: 1}, {velocity: 0.0}, c, {name: d, speed: 1.0}]"
    body = f"publish_rate: 50\n    extra_joints: {entries}"
    lines = controllers(controller(body, "joint_state_controller/JointStateController"))
    troubles = [line.partition("/bot/c/extra_joints")[2].partition(";")[0] for line in lines.of("ignored", "wrong")]
    assert sorted(troubles) == [
        "[1]/position: must be a float, such as 0.0, not 1",
        "[2]/name: is missing: a string, name of such a joint",
        "[3]: must be a mapping",
        "[4]/speed: is unknown to the controller and has no effect",
    ]


def test_a_name_that_is_written_twice_is_wrong(controllers: Check) -> None:
    (line,) = controllers(pid("p: 1.0, p: 2.0")).of("wrong")
    assert "duplicate key" in line


def test_a_name_of_ros_2_that_is_a_value_and_a_namespace_is_wrong(controllers: Check) -> None:
    text = "bot:\n  c:\n    ros__parameters:\n      type: a/B\n      x: 1\n      x.y: 2\n"
    assert controllers(text).about("wrong", "/bot/c/x: is both a value and a namespace of values: the last one counts")


def test_what_nobody_reads_is_ignored(controllers: Check) -> None:
    lines = controllers(CONTROLLERS + "  colour: red\nother: 3\n")
    assert [line.split(":")[0] for line in lines.of("ignored")] == ["ignored 6 /bot/colour", "ignored 7 /other"]


def test_parameters_of_ros_2_that_are_none_are_ignored(controllers: Check) -> None:
    assert controllers("ros__parameters: 5").about("ignored 1 /ros__parameters", "no controller reads it")


def test_a_broken_file_cannot_be_used(controllers: Check) -> None:
    lines = controllers("bot:\n  c: [1,\n")
    assert [error.line for error in lines.findings.broken] == [3]
    assert lines.of("wrong")[0].startswith("wrong 3 parameters: not YAML")


# --- against a robot ---


def test_a_file_that_fits_the_robot_is_all_used(model: Check) -> None:
    assert model(driven_cart(), CONTROLLERS).of("converted", "ignored", "wrong") == []


def test_a_joint_that_the_robot_has_not_is_wrong(model: Check) -> None:
    (line,) = model(driven_cart(), CONTROLLERS.replace("joint: slide", "joint: slyde")).of("wrong")
    assert "/bot/slide_controller/joint: the robot has no joint 'slyde'; did you mean 'slide'? joints: slide" in line


def test_a_joint_without_a_transmission_is_wrong_for_a_controller(model: Check) -> None:
    (line,) = model(cart(PLUGIN), CONTROLLERS).of("wrong")
    assert line.endswith("no transmission drives joint 'slide', so controllers do not know it")


def test_a_joint_that_takes_other_commands_is_wrong_for_a_controller(model: Check) -> None:
    xml = cart(transmission(interface="hardware_interface/PositionJointInterface"), PLUGIN)
    (line,) = model(xml, CONTROLLERS).of("wrong")
    assert line.endswith("offers PositionJointInterface, the controller needs EffortJointInterface")


@pytest.mark.parametrize("rate", ["0", "-5"])
def test_a_rate_that_publishes_nothing_has_no_effect(model: Check, rate: str) -> None:
    lines = model(driven_cart(), controller(f"publish_rate: {rate}", "joint_state_controller/JointStateController"))
    (line,) = lines.of("ignored")
    assert line.endswith(f"publish_rate: {rate} is not above 0: nothing is published")


def test_joint_states_take_joints_of_any_interface(model: Check) -> None:
    xml = cart(transmission(interface="hardware_interface/PositionJointInterface"), PLUGIN)
    body = "publish_rate: 50\n    joints: [slide]"
    assert model(xml, controller(body, "joint_state_controller/JointStateController")).of("wrong") == []


def test_controllers_for_another_namespace_are_moved_and_that_is_said(model: Check) -> None:
    lines = model(driven_cart(), CONTROLLERS.replace("bot:", "bat:").replace("slide\n", "slyde\n"))
    (line,) = lines.of("converted")
    assert line.startswith("converted 1 /bat: the file's controllers are for /bat; they are loaded under /bot")
    assert lines.about("the robot has no joint 'slyde'")


def test_controllers_of_several_other_namespaces_find_no_robot(model: Check) -> None:
    lines = model(driven_cart(), CONTROLLERS.replace("bot:", "a:") + CONTROLLERS.replace("bot:", "b:"))
    (line,) = lines.of("wrong")
    assert "no controllers for /bot in the file" in line
    assert "whose plugin says /bot" in line


def test_a_file_for_several_robots_is_held_against_the_right_one(model: Check) -> None:
    other = CONTROLLERS.replace("bot:", "bat:").replace("joint: slide", "joint: wing")
    assert model(driven_cart(), CONTROLLERS + other).of("wrong") == []


def test_controllers_without_a_namespace_get_the_robots(model: Check) -> None:
    flat = "\n".join(line[2:] for line in CONTROLLERS.splitlines()[1:])
    lines = model(driven_cart(), flat)
    assert lines.about("used", "/bot/slide_controller/pid/p: 10.0")
    assert lines.of("converted", "ignored", "wrong") == []


HARDWARE = [
    ("joint_limits: {slide: {has_velocity_limits: true, max_velocity: 1.0}}", []),
    ("joint_limits: {slide: {max_velocity: 1.0}}", ["max_velocity: has no effect without has_velocity_limits: true"]),
    ("joint_limits: {slide: {has_velocity_limits: true}}", ["has_velocity_limits: true has no effect without max_vel"]),
    ("joint_limits: {slide: {has_soft_limits: true}}", ["has_soft_limits: true has no effect without soft_lower"]),
    ("joint_limits: {slide: {max_velocty: 1.0}}", ["max_velocty: simulated hardware does not read it; did you mean"]),
    ("joint_limits: {slyde: {max_velocity: 1.0}}", ["slyde: the robot has no joint 'slyde'; did you mean 'slide'?"]),
    ("gazebo_ros_control: {pid_gains: {slide: {p: 1.0}}}", ["slide: joint 'slide' takes efforts"]),
    ("gazebo_ros_control: {other: 1}", ["other: simulated hardware does not read it"]),
]


@pytest.mark.parametrize(("text", "expected"), HARDWARE)
def test_what_the_simulated_hardware_reads_is_known(model: Check, text: str, expected: list[str]) -> None:
    found = model(driven_cart(), f"{CONTROLLERS}  {text}\n").of("ignored", "wrong")
    assert len(found) == len(expected), found
    for line, end in zip(found, expected, strict=True):
        assert f"/{end}" in line


def test_gains_of_a_position_joint_are_used_and_judged(model: Check) -> None:
    xml = cart(transmission(interface="hardware_interface/PositionJointInterface"), PLUGIN)
    lines = model(xml, "bot:\n  gazebo_ros_control: {pid_gains: {slide: {i: 1.0}}}\n")
    assert lines.about("ignored", "/slide/i: 1 has no effect without i_clamp")
    assert lines.about("wrong", "/slide/p: is missing")


@pytest.mark.parametrize(
    "type_name", [name for name in registry.common.types() if registry.common.find(name).parameters]
)
def test_every_type_of_controller_is_known_by_its_parameters(controllers: Check, type_name: str) -> None:
    lines = controllers(controller("nonsense: 1", type_name))
    assert lines.about("/bot/c/nonsense: is unknown to the controller")
    required = [parameter.name for parameter in registry.common.find(type_name).parameters if parameter.required]
    missing = [name for name in required if "[]" not in name and "<" not in name]
    assert [name for name in missing if not lines.about(f"/bot/c/{name}: is missing")] == []


def test_of_many_unknown_parameters_the_first_are_named_and_the_rest_is_counted(controllers: Check) -> None:
    unknown = "".join(f"    x{number}: 1\n" for number in range(700))
    lines = controllers(f"bot:\n  move:\n    type: effort_controllers/JointPositionController\n{unknown}")
    assert len(lines.about("unknown to the controller")) == 100
    assert len(lines.about("and 600 more of this kind")) == 1
    assert lines.findings.count("ignored") == 700
