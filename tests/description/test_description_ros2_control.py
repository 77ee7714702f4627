"""`<ros2_control>` is taken or refused as hardware_interface's parser does, and what has no effect is a notice."""

from __future__ import annotations

import pytest
from description_urdf_text import TRANSMISSION, cart, joint, link, robot

from slidectl.description import namespace_of, parse
from slidectl.description.robot import Mimic, Robot
from slidectl.errors import BadFile

HARDWARE = "<hardware><plugin>gz_ros2_control/GazeboSimSystem</plugin></hardware>"
STATES = '<state_interface name="position"/><state_interface name="velocity"/>'
EFFORT = f'<joint name="slide"><command_interface name="effort"/>{STATES}</joint>'


def control(inside: str, attributes: str = 'name="sys" type="system"', hardware: str = HARDWARE) -> str:
    return f"<ros2_control {attributes}>{hardware}{inside}</ros2_control>"


def plugin(inside: str, file: str = "libgz_ros2_control-system.so") -> str:
    return f'<gazebo><plugin name="gz" filename="{file}">{inside}</plugin></gazebo>'


def read(*texts: str) -> tuple[Robot, list[str]]:
    bot = parse(cart(*texts), "bot.urdf")
    return bot, [f"{notice.verdict} {notice}" for notice in bot.report]


def interfaces(*commands: str) -> list[str]:
    written = "".join(f'<command_interface name="{name}"/>' for name in commands)
    bot, _ = read(control(f'<joint name="slide">{written}{STATES}</joint>'))
    assert bot.ros2_control is not None
    return [one.name for one in bot.ros2_control.joints["slide"].interfaces()]


def test_the_usual_tag_is_read_without_a_word() -> None:
    bot, report = read(control(EFFORT))
    assert report == []
    assert bot.ros2_control is not None
    (component,) = bot.ros2_control.components
    assert (component.name, component.type, component.plugin) == ("sys", "system", "gz_ros2_control/GazeboSimSystem")
    assert component.joints == ("slide",)
    found = bot.ros2_control.joints["slide"]
    assert (list(found.commands), list(found.states)) == (["effort"], ["position", "velocity"])


@pytest.mark.parametrize(
    ("commands", "expected"),
    [
        (["position"], ["PositionJointInterface"]),
        (["velocity", "effort"], ["VelocityJointInterface", "EffortJointInterface"]),
        (["torque"], ["EffortJointInterface"]),
        (["position_pid"], ["PositionJointInterface"]),
        (["position", "velocity"], ["PositionJointInterface", "VelocityJointInterface", "PosVelJointInterface"]),
        (
            ["position", "velocity", "acceleration"],
            ["PositionJointInterface", "VelocityJointInterface", "PosVelJointInterface", "PosVelAccJointInterface"],
        ),
        ([], []),
    ],
)
def test_command_interfaces_are_those_of_simulated_joints(commands: list[str], expected: list[str]) -> None:
    assert interfaces(*commands) == expected


def test_a_robot_of_ros2_is_in_the_root_or_where_the_plugin_says() -> None:
    bot, _ = read(control(EFFORT))
    assert namespace_of(bot, "bot") == "/"
    bot, report = read(control(EFFORT), plugin("<ros><namespace>r1/</namespace></ros>"))
    assert namespace_of(bot, "bot") == "/r1"
    assert report == []


def test_the_plugin_names_files_and_whether_joints_are_held() -> None:
    text = "<parameters>a.yaml</parameters><parameters>b.yaml</parameters><hold_joints>false</hold_joints>"
    bot, report = read(control(EFFORT), plugin(text, "gz_ros2_control-system"))
    assert bot.ros2_control is not None
    assert bot.ros2_control.parameter_files == ("a.yaml", "b.yaml")
    assert not bot.ros2_control.holds_joints
    assert report == []


def test_a_plugin_without_a_tag_has_no_effect() -> None:
    bot, report = read(plugin("<parameters>a.yaml</parameters>"))
    assert bot.ros2_control is None
    assert len(report) == 1
    assert "has no effect without a <ros2_control> that drives the joints" in report[0]


def test_transmissions_of_ros1_drive_nothing_beside_it() -> None:
    bot, report = read(control(EFFORT), TRANSMISSION)
    assert not bot.transmissions
    assert len(report) == 1
    assert "is of ROS 1 and has no effect" in report[0]


def test_the_plugin_of_gazebo_ros_control_makes_it_a_robot_of_ros1() -> None:
    text = '<gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo>'
    bot, report = read(control(EFFORT), TRANSMISSION, text)
    assert bot.ros2_control is None
    assert len(bot.transmissions) == 1
    assert len(report) == 1
    assert "gazebo_ros_control" in report[0]


@pytest.mark.parametrize(
    ("text", "notice"),
    [
        (
            control(EFFORT, hardware="<hardware><plugin>a/B</plugin></hardware>"),
            "converted bot.urdf:5: ros2_control 'sys'/<hardware>: a/B is replaced by the simulation",
        ),
        (
            control(EFFORT, hardware=HARDWARE.replace("</plugin>", '</plugin><param name="ip">1</param>')),
            "ignored bot.urdf:5: ros2_control 'sys'/<hardware>/<param>: has no effect on the simulation: ip",
        ),
        (control(EFFORT + '<gpio name="g"/>'), "ignored bot.urdf:5: ros2_control 'sys'/<gpio name=\"g\">: simulated"),
        (control(EFFORT + '<sensor name="s"/>'), "ignored bot.urdf:5: ros2_control 'sys'/<sensor name=\"s\">: measure"),
        (
            control(EFFORT + '<transmission name="t"/>'),
            "ignored bot.urdf:5: ros2_control 'sys'/<transmission name=\"t\">",
        ),
        (
            control('<joint name="slide"><command_interface name="stiffness"/></joint>'),
            "ignored bot.urdf:5: ros2_control 'sys'/joint 'slide'/<command_interface> stiffness: has no effect: "
            "simulated joints take position, velocity and effort",
        ),
        (
            control('<joint name="slide"><param name="can_id">3</param></joint>'),
            "ignored bot.urdf:5: ros2_control 'sys'/joint 'slide'/<param>, can_id: has no effect",
        ),
        (
            control(EFFORT, 'name="sys" type="system" rw_rate="50"'),
            "ignored bot.urdf:5: ros2_control 'sys': rw_rate has no effect",
        ),
    ],
)
def test_what_has_no_effect_is_reported(text: str, notice: str) -> None:
    _, report = read(text)
    assert len(report) == 1
    assert report[0].startswith(notice)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (control(EFFORT, 'type="system"'), "ros2_control: <ros2_control> lacks the attribute 'name'"),
        (control(EFFORT, 'name="sys"'), "ros2_control 'sys': <ros2_control> lacks the attribute 'type'"),
        (control(EFFORT, 'name="sys" type="robot"'), "ros2_control 'sys': no type 'robot'"),
        (control(EFFORT + '<sensr name="s"/>'), "ros2_control 'sys': no tag 'sensr'"),
        (control(EFFORT, hardware="<hardware/>"), "ros2_control 'sys': <hardware> lacks <plugin> with a text"),
        (control(EFFORT) + control(EFFORT), "duplicate ros2_control 'sys'; the first is at bot.urdf:5"),
        (control('<joint name="slid"/>'), "ros2_control 'sys': no joint 'slid'"),
        (control(EFFORT + EFFORT), "ros2_control 'sys'/joint 'slide': effort is commanded by the component at line 5"),
        (control('<joint name="slide" mimic="true"/>'), "mimic is true, but the joint has no <mimic>"),
        (
            control('<joint name="slide"><command_interface name="effort"><param name="max">5,0</param>'
                    "</command_interface></joint>"),
            "is '5,0', which is not a number (the decimal sign is a point)",
        ),
    ],
)  # fmt: skip
def test_what_ros2_control_refuses_is_refused(text: str, error: str) -> None:
    with pytest.raises(BadFile) as caught:
        read(text)
    assert error in str(caught.value)
    assert "bot.urdf:5" in str(caught.value)


def test_a_fixed_joint_is_refused() -> None:
    text = robot(link("world"), link("cart"), joint(kind="fixed", inside=""), control(EFFORT))
    with pytest.raises(BadFile, match="joint 'slide' is fixed and cannot be driven"):
        parse(text, "bot.urdf")


def test_values_of_interfaces_are_numbers_and_limits_can_be_off() -> None:
    inside = (
        '<command_interface name="position"><param name="min">-0.5</param><param name="max"> 0.25 </param>'
        '</command_interface><command_interface name="effort"><limits enable="false"/></command_interface>'
        '<state_interface name="position"><param name="initial_value">0.125</param></state_interface>'
    )
    bot, report = read(control(f'<joint name="slide">{inside}</joint>'))
    assert report == []
    assert bot.ros2_control is not None
    slide = bot.ros2_control.joints["slide"]
    assert (slide.commands["position"].minimum, slide.commands["position"].maximum) == (-0.5, 0.25)
    assert slide.commands["position"].is_limited
    assert not slide.commands["effort"].is_limited
    assert slide.start == 0.125


def fingers(attributes: str = "", mimic: str = "", params: str = "") -> tuple[Robot, list[str]]:
    """Two fingers, of which the second may follow the first."""
    limit = '<limit lower="-1" upper="1" effort="10" velocity="2"/>'
    text = robot(
        link("world", ""), link("a"), link("b"),
        joint("left", child="a"), joint("right", child="b", inside=limit + mimic),
        control(f'<joint name="left"><command_interface name="position"/>{STATES}</joint>'
                f'<joint name="right" {attributes}><command_interface name="position"/>{STATES}{params}</joint>'),
    )  # fmt: skip
    bot = parse(text, "bot.urdf")
    return bot, [str(notice) for notice in bot.report]


def test_a_joint_follows_by_the_urdf_and_its_command_interfaces_have_no_effect() -> None:
    bot, report = fingers(mimic='<mimic joint="left" multiplier="-1"/>')
    assert bot.joints["right"].mimic == Mimic("left", -1.0)
    assert bot.ros2_control is not None
    assert not bot.ros2_control.joints["right"].commands
    assert len(report) == 1
    assert report[0].endswith("its command interfaces have no effect: it follows 'left'")


def test_a_joint_does_not_follow_when_mimic_is_false() -> None:
    bot, report = fingers('mimic="false"', '<mimic joint="left"/>')
    assert bot.joints["right"].mimic is None
    assert bot.ros2_control is not None
    assert list(bot.ros2_control.joints["right"].commands) == ["position"]
    assert report == []


def test_a_joint_follows_by_the_parameters_of_humble() -> None:
    bot, _ = fingers(params='<param name="mimic">left</param><param name="multiplier">2</param>')
    assert bot.joints["right"].mimic == Mimic("left", 2.0)
    with pytest.raises(BadFile, match="no joint 'lft'"):
        fingers(params='<param name="mimic">lft</param>')


def test_an_initial_value_beyond_the_limits_starts_at_the_limit() -> None:
    state = '<state_interface name="position"><param name="initial_value">7</param></state_interface>'
    _, report = read(control(f'<joint name="slide"><command_interface name="position"/>{state}</joint>'))
    assert len(report) == 1
    assert "initial_value 7 is beyond the limits: the joint starts at 1" in report[0]


def test_an_imu_without_a_plugin_is_there_for_controllers() -> None:
    sensor = '<gazebo reference="cart"><sensor name="imu" type="imu"><update_rate>50</update_rate></sensor></gazebo>'
    bot, report = read(control(EFFORT + '<sensor name="imu"><state_interface name="orientation.x"/></sensor>'), sensor)
    assert report == []
    (imu,) = bot.sensors
    assert (imu.name, imu.link, imu.topic, imu.frame) == ("imu", "cart", "", "cart")
