"""The slips that are made most with the tutorials' files: each is found, with what to write instead."""

from __future__ import annotations

import pytest
from check_texts import BALL, CONTROLLERS, INERTIAL, LIMIT, PLUGIN, Check, cart, driven_cart, transmission

POSITION = cart(transmission(interface="hardware_interface/PositionJointInterface"), PLUGIN)
UNPLUGGED = cart(transmission(), PLUGIN.replace("<gazebo>", "").replace("</gazebo>", ""))
OLD = '<transmission name="t" type="SimpleTransmission"><joint name="slide"/><actuator name="m"/></transmission>'


def inertial(mass: str, moment: str) -> str:
    moments = f'ixx="{moment}" ixy="0" ixz="0" iyy="{moment}" iyz="0" izz="{moment}"'
    return f'<inertial><mass value="{mass}"/><inertia {moments}/></inertial>'


def degrees(lower: str, upper: str) -> str:
    return driven_cart(kind="revolute", joint=f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>')


MODELS = [
    (
        cart(transmission().replace("hardwareInterface>", "hardware_interface>"), PLUGIN),
        "ignored 5",
        "did you mean <hardwareInterface>?",
    ),
    (
        cart(transmission(interface=""), PLUGIN),
        "wrong 5",
        "add <hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface>",
    ),
    (cart(OLD, PLUGIN), "wrong 5", "an attribute does not count; add <type>transmission_interface/SimpleTransmission"),
    (driven_cart().replace("libgazebo", "gazebo"), "wrong 6", "did you mean libgazebo_ros_control.so?"),
    (driven_cart().replace("ros_control.so", "ros2_control.so"), "wrong 6", "has no effect without a <ros2_control>"),
    (UNPLUGGED, "ignored 6", "it belongs in a <gazebo> without a reference"),
    (
        driven_cart().replace("<gazebo>", '<gazebo reference="cart">'),
        "wrong 6",
        "it belongs in a <gazebo> without a reference",
    ),
    (driven_cart().replace("robotNamespace", "robotNameSpace"), "ignored 6", "did you mean <robotNamespace>?"),
    (driven_cart('<gazebo reference="crat"/>'), "wrong 7", "no link or joint 'crat'; the tag has no effect; did you"),
    (driven_cart('<ros2_control name="a"/>'), "ignored 7", "the plugin of gazebo_ros_control, and its <transmission>s"),
    (driven_cart(link=INERTIAL + BALL.replace("collision", "colision")), "ignored 3", "did you mean <collision>?"),
    (driven_cart(joint='<limit lower="-1" uper="1" effort="1" velocity="1"/>'), "ignored 4", "did you mean 'upper'?"),
    (driven_cart(link=BALL), "wrong 3", "has no <inertial>, nor has a link fixed to it; give it an <inertial>"),
    (driven_cart(joint=""), "wrong 4", "lacks <limit>; add <limit lower upper effort velocity/>"),
    (driven_cart(link=inertial("1e-9", "1e-12") + BALL), "used 3", "times as thin as air"),
    (driven_cart(link=inertial("1e5", "1e3") + BALL), "used 3", "times as dense as osmium"),
    (driven_cart(link=inertial("1e9", "1e7") + BALL), "wrong 3", "times as dense as osmium"),
    (driven_cart(link=inertial("0.1", "100")), "used 3", "lie 31.6 m away from their centre"),
    (degrees("-90", "90"), "used 4", "90 degrees are 1.5708"),
    (f'<robot name="b">\n<link name="base">{INERTIAL}</link></robot>', "used 1", "it falls through the ground"),
]


@pytest.mark.parametrize(("xml", "place", "text"), MODELS)
def test_slips_in_models(model: Check, xml: str, place: str, text: str) -> None:
    lines = model(xml)
    assert [line for line in lines.all if line.startswith(f"{place} ") and text in line], "\n".join(lines.all)


def test_plugins_of_sensors_are_not_taken_for_misspelt_control(model: Check) -> None:
    camera = PLUGIN.replace("libgazebo_ros_control", "libgazebo_ros_camera")
    (line,) = model(cart(transmission(), camera)).about("not loaded")
    assert line.startswith("ignored")


@pytest.mark.parametrize("limits", [("-3.14", "3.14"), ("-1e16", "1e16"), ("0", "10")])
def test_limits_in_radians_are_not_taken_for_degrees(model: Check, limits: tuple[str, str]) -> None:
    assert not model(degrees(*limits)).about("degrees")


def test_all_faults_are_told_at_once_and_all_that_is_sound_is_checked(model: Check) -> None:
    faulty = driven_cart(
        '<gazebo reference="cart"><mu1>x</mu1></gazebo>',
        link=inertial("zero", "1") + BALL + '<visual><geometry><box size="1 1"/></geometry></visual>',
        joint='<axis xyz="0 0 0"/><limit lower="a" upper="1" effort="10" velocity="2"/><mimic joint="slid"/>',
    )
    lines = model(faulty)
    assert sorted(str(error.line) for error in lines.findings.broken) == ["3", "3", "4", "4", "4", "7"]
    for reason in ("is 'zero'", "'1 1': 2 numbers", "is not a direction", "no joint 'slid'", "'a'", "'x'"):
        assert [line for line in lines.of("wrong") if reason in line], reason
    assert lines.about("used 3 link 'cart'/<collision>/<geometry>/<sphere>")
    assert not lines.about("used", "/<limit>")
    assert not lines.about("used", "/<mass>")
    assert all(notice.line for notice in lines.findings.sorted())


LIMITS = [
    (POSITION, "<limit>, effort", "counts only with gains in gazebo_ros_control/pid_gains"),
    (cart(), "<limit>, effort", "no transmission drives the joint"),
]


@pytest.mark.parametrize(("xml", "subject", "text"), LIMITS)
def test_what_a_limit_does_is_for_the_interface_to_say(model: Check, xml: str, subject: str, text: str) -> None:
    assert model(xml).about(subject, text)


SOFT = '<safety_controller soft_lower_limit="-.5" soft_upper_limit="0.5" k_position="10" k_velocity="10"/>'


def test_soft_limits_without_effect_are_ignored(model: Check) -> None:
    position = transmission(interface="hardware_interface/PositionJointInterface")
    (only,) = model(cart(position, PLUGIN, joint=LIMIT + SOFT)).of("ignored")
    assert "<safety_controller>, k_velocity: 10" in only
    turning = '<limit effort="1" velocity="1"/>' + SOFT
    assert len(model(driven_cart(kind="continuous", joint=turning)).about("ignored", "joint does not have")) == 3
    assert len(model(cart(joint=LIMIT + SOFT)).about("ignored", "no transmission drives the joint")) == 4


PARAMETERS = [
    ("bot:\n\tc: 1\n", "wrong 2", "YAML allows no tabs: use spaces"),
    (CONTROLLERS.replace("    joint:", "   joint:"), "wrong 4", "begin in the same column"),
    (CONTROLLERS.replace("    ", "  "), "wrong 2", "indent what belongs to it"),
    (CONTROLLERS.replace(": ", ":"), "wrong 2", "a blank follows each colon"),
    (CONTROLLERS.replace("p: 10.0", "p:10.0"), "wrong 5", "a blank follows the colon: p: 10.0"),
    (CONTROLLERS.replace("joint:", "joints:"), "wrong 2", "joint: is missing: a string"),
    (CONTROLLERS.replace("joint:", "joints:"), "ignored 4", "did you mean 'joint'?"),
    (CONTROLLERS.replace("/JointP", "::JointP"), "wrong 3", "Did you mean 'effort_controllers/JointPositionController"),
    (CONTROLLERS + "  pid_gains: {slide: {p: 1}}\n", "ignored 6", "looks for gazebo_ros_control/pid_gains"),
    ("m:\n  ros__parameters:\n    c: {type: x}\n", "converted 1", "is ROS 2's"),
]


@pytest.mark.parametrize(("yaml", "place", "text"), PARAMETERS)
def test_slips_in_files_of_controllers(controllers: Check, yaml: str, place: str, text: str) -> None:
    lines = controllers(yaml)
    assert [line for line in lines.all if line.startswith(f"{place} ") and text in line], "\n".join(lines.all)


def test_gains_of_the_hardware_are_read_in_the_namespace_of_the_robot_only(model: Check) -> None:
    gains = "gazebo_ros_control: {pid_gains: {slide: {p: 1.0}}}\n"
    (line,) = model(POSITION, CONTROLLERS + gains).about("/gazebo_ros_control")
    assert line.startswith("ignored 6 /gazebo_ros_control: no robot lives here; simulated hardware reads /bot/gazebo_r")
    inside = CONTROLLERS + f"  {gains}"
    assert model(POSITION, inside).about("used 6 /bot/gazebo_ros_control/pid_gains/slide/p: 1.0")


def test_of_a_controller_that_is_there_twice_only_the_last_one_counts(model: Check) -> None:
    again = "  slide_controller: {type: effort_controllers/JointEffortController, joint: slide}\n"
    lines = model(driven_cart(), CONTROLLERS + again)
    assert lines.of("wrong") == ["wrong 6 slide_controller: duplicate key, also in line 2; the last one counts"]
    assert not lines.about("/pid/")


XACRO = '<robot name="bot" xmlns:xacro="x">\n{}\n<link name="world"/></robot>'
UNUSED = [
    ('<xacro:property name="wide" value="1"/>', 'ignored 2 <xacro:property name="wide">: no expression uses it'),
    ('<xacro:macro name="leg" params="a"/>', 'ignored 2 <xacro:macro name="leg">: is never called'),
]


@pytest.mark.parametrize(("part", "line"), UNUSED)
def test_what_a_xacro_file_makes_and_nobody_uses_is_ignored(model: Check, part: str, line: str) -> None:
    assert model(XACRO.format(part), name="bot.xacro").of("ignored") == [line]


USED = [
    '<xacro:property name="a" value="1"/><material name="m${a}"><color rgba="1 1 1 1"/></material>',
    '<xacro:property name="a" value="1"/><xacro:property name="b" value="${a}"/><xacro:if value="${b == 2}"/>',
    '<xacro:property name="a" value="1"/><xacro:macro name="m" params="a:=^"/><xacro:m/>',
    '<xacro:property name="a"><link name="b"/></xacro:property><xacro:if value="0">'
    '<xacro:insert_block name="a"/></xacro:if>',
    '<xacro:macro name="m" params=""/><xacro:call macro="m"/>',
    '<xacro:include filename="library.xacro"/><xacro:property name="own" value="1"/>',
]


@pytest.mark.parametrize("parts", USED)
def test_what_is_used_anywhere_is_not_ignored(model: Check, write: Check, parts: str) -> None:
    library = '<xacro:property name="unused" value="1"/><xacro:if value="${own == 2}"/>'
    write("library.xacro", f'<robot xmlns:xacro="x">{library}</robot>')
    lines = model(XACRO.format(parts), name="bot.xacro")
    assert lines.of("ignored") == []
