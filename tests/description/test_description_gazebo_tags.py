"""The gazebo tags that matter, and the word on those that do not."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from description_urdf_text import cart

from slidectl.description import namespace_of, parse, with_transmissions
from slidectl.description.robot import ControlPlugin, Surface
from slidectl.errors import BadFile

Notices = Callable[[str], list[str]]
Refuse = Callable[[str], BadFile]


def plugin(inside: str = "", filename: str = "libgazebo_ros_control.so") -> str:
    return f'<gazebo><plugin name="gazebo_ros_control" filename="{filename}">{inside}</plugin></gazebo>'


def of_cart(inside: str) -> str:
    return f'<gazebo reference="cart">{inside}</gazebo>'


def test_a_plugin_without_parameters_has_the_defaults() -> None:
    bot = parse(cart(plugin()), "bot.urdf")
    assert bot.plugin == ControlPlugin(line=5, file="bot.urdf")
    assert bot.plugin.robot_sim_type == "gazebo_ros_control/DefaultRobotHWSim"
    assert not bot.report


def test_the_plugins_parameters_are_read() -> None:
    inside = (
        "<robotNamespace> /left </robotNamespace><robotParam>other</robotParam>"
        "<controlPeriod>0.01</controlPeriod><eStopTopic>stop</eStopTopic>"
    )
    bot = parse(cart(plugin(inside)))
    assert bot.plugin is not None
    assert bot.plugin.robot_namespace == "/left"
    assert bot.plugin.robot_param == "other"
    assert bot.plugin.control_period == 0.01
    assert bot.plugin.estop_topic == "stop"


@pytest.mark.parametrize("filename", ["libgazebo_ros_control", "/opt/ros/lib/libgazebo_ros_control.so"])
def test_the_plugin_is_known_with_a_path_and_without_its_suffix(filename: str) -> None:
    assert parse(cart(plugin(filename=filename))).plugin is not None


@pytest.mark.parametrize(
    ("written", "namespace"),
    [
        ("<robotNamespace>/slider</robotNamespace>", "/slider"),
        ("<robotNamespace>slider</robotNamespace>", "/slider"),
        ("<robotNamespace>/a/b/</robotNamespace>", "/a/b"),
        ("<robotNamespace>/</robotNamespace>", "/"),
        ("<robotNamespace/>", "/"),
        ("", "/left"),
    ],
)
def test_the_namespace_is_the_plugins_else_the_robots_name(written: str, namespace: str) -> None:
    assert namespace_of(parse(cart(plugin(written))), "left") == namespace


def test_without_a_plugin_the_namespace_is_the_name() -> None:
    assert namespace_of(parse(cart()), "left") == "/left"


def test_a_name_that_is_no_namespace_becomes_one() -> None:
    assert namespace_of(parse(cart()), "my robot/2") == "/my_robot/robot_2"


@pytest.mark.parametrize(
    ("inside", "reason"),
    [
        ("<robotNamespace>two words</robotNamespace>", "not a legal name"),
        ("<controlPeriod>fast</controlPeriod>", "'fast', which is not a number"),
        ("<controlPeriod>0</controlPeriod>", "must be above 0"),
    ],
)
def test_impossible_parameters_of_the_plugin_are_refused(refuse: Refuse, inside: str, reason: str) -> None:
    error = refuse(cart(plugin(inside)))
    assert reason in str(error)
    assert error.line == 5


def test_turn_gravity_off_friction_self_collision_and_material_go_to_the_link() -> None:
    inside = (
        "<mu1>0.2</mu1><mu2 value='0.3'/><turnGravityOff>true</turnGravityOff>"
        "<selfCollide>1</selfCollide><material>Gazebo/Red</material>"
    )
    bot = parse(cart(of_cart(inside)))
    assert bot.links["cart"].surface == Surface(0.2, 0.3, True, True, "Gazebo/Red")
    assert bot.links["world"].surface == Surface()
    assert not bot.report


def test_tags_of_one_link_in_several_places_are_joined_and_the_last_one_wins() -> None:
    bot = parse(cart(of_cart("<mu1>0.2</mu1><mu2>0.2</mu2>"), of_cart("<mu1>0.5</mu1>")))
    assert bot.links["cart"].surface == Surface(0.5, 0.2)


@pytest.mark.parametrize(("text", "off"), [("True", True), ("yes", True), ("0", False), ("no", False)])
def test_gravity_is_turned_off_by_any_word_for_yes(text: str, off: bool) -> None:
    bot = parse(cart(of_cart(f"<turnGravityOff>{text}</turnGravityOff>")))
    assert bot.links["cart"].surface.turn_gravity_off is off


@pytest.mark.parametrize(
    ("text", "verdict", "reason"),
    [
        (plugin("<legacyModeNS>true</legacyModeNS>"), "ignored", "legacyModeNS has no effect"),
        (plugin("<foo/>"), "ignored", "<foo>: is unknown here"),
        (plugin(filename="libgazebo_ros_vacuum_gripper.so"), "ignored", "not loaded: libgazebo_ros_vacuum_gripper.so"),
        (plugin() + plugin(), "ignored", "only the first libgazebo_ros_control.so counts, line 5"),
        ("<gazebo><static>true</static></gazebo>", "ignored", "use --fixed"),
        (of_cart("<kp>1000</kp>"), "ignored", '<gazebo reference="cart">/<kp>: has no effect here'),
        (of_cart('<sensor name="eye"/>'), "ignored", '<sensor name="eye">: has no effect: sensors here are'),
        (of_cart("<mu1>-1</mu1>"), "converted", "<mu1>: -1 is below 0 and counts as infinite, as in Gazebo"),
        (of_cart("<minDepth>0.001</minDepth>"), "ignored", "<minDepth>: has no effect here"),
        (of_cart("<turnGravityOff>perhaps</turnGravityOff>"), "wrong", "neither true nor false"),
        (
            '<gazebo reference="slide"><implicitSpringDamper>1</implicitSpringDamper></gazebo>',
            "ignored",
            "tags of joints have no effect",
        ),
        ('<gazebo reference="nobody"><mu1>1</mu1></gazebo>', "wrong", "there is no link or joint 'nobody'"),
        ('<gazebo id="7"/>', "ignored", "attribute 'id' is unknown"),
    ],
)
def test_a_tag_without_effect_is_reported_with_its_line(notices: Notices, text: str, verdict: str, reason: str) -> None:
    (line,) = notices(cart(text))
    assert line.startswith(f"{verdict} bot.urdf:5: ")
    assert reason in line


def test_what_is_said_of_transmissions_is_not_said_to_a_plugin_without_effect() -> None:
    misplaced = of_cart('<plugin name="gazebo_ros_control" filename="libgazebo_ros_control.so"/>')
    for text in (misplaced, misplaced + plugin(), ""):
        bot = parse(with_transmissions(cart(text), "real"))
        assert bot.plugin is not None
        assert bot.plugin.transmissions == "real"


@pytest.mark.parametrize("inside", ["<mu1>slippery</mu1>", "<mu2>nan</mu2>", "<mu1/>"])
def test_an_impossible_friction_is_refused(refuse: Refuse, inside: str) -> None:
    error = refuse(cart(of_cart(inside)))
    assert "link 'cart': <mu" in str(error)
    assert error.line == 5
