"""The shipped models are those of the tutorials."""

from __future__ import annotations

import pytest

from slidectl.description import Robot, load, namespace_of, parse, takes_namespace, written
from slidectl.description.robot import Box, Limit, Pose, Surface, Vector

EFFORT = ("hardware_interface/EffortJointInterface",)


@pytest.fixture(scope="module")
def slider() -> Robot:
    return parse(load("slider").xml)


@pytest.fixture(scope="module")
def rrbot() -> Robot:
    return parse(load("rrbot").xml)


def bar(robot: Robot, name: str) -> tuple[Vector, Vector]:
    """Size and centre of the one box that a link is, the same for looks and for contacts."""
    (collision,), (visual,) = robot.links[name].collisions, robot.links[name].visuals
    assert (collision.geometry, collision.origin) == (visual.geometry, visual.origin)
    assert isinstance(collision.geometry, Box)
    return collision.geometry.size, collision.origin.xyz


def test_the_sliders_joint_is_that_of_the_tutorial(slider: Robot) -> None:
    joint = slider.joints["joint1"]
    assert (joint.type, joint.parent, joint.child) == ("prismatic", "base_link", "link2")
    assert joint.origin == Pose((0.0, 0.1, 1.0))
    assert joint.axis == (0.0, 0.0, 1.0)
    assert joint.limit == Limit(-1.0, 1.0, 0.1, 100.0, joint.limit.line if joint.limit else None)


def test_the_sliders_links_have_the_tutorials_sizes(slider: Robot) -> None:
    assert slider.is_fixed_to_world
    assert bar(slider, "base_link") == ((0.1, 0.1, 2.0), (0.0, 0.0, 1.0))
    assert bar(slider, "link2") == ((0.1, 0.1, 1.0), (0.0, 0.0, 0.5))


def test_the_block_stays_clear_of_the_ground_at_its_lowest(slider: Robot) -> None:
    lowest = slider.joints["fixed"].origin.xyz[2] + slider.joints["joint1"].origin.xyz[2] - 1.0
    assert lowest == pytest.approx(0.1)


def test_the_slider_has_a_transmission_a_plugin_and_nothing_that_is_ignored(slider: Robot) -> None:
    (transmission,) = slider.transmissions
    assert (transmission.name, transmission.type) == ("tran1", "transmission_interface/SimpleTransmission")
    assert [(joint.name, joint.hardware_interfaces) for joint in transmission.joints] == [("joint1", EFFORT)]
    assert [(motor.name, motor.reduction) for motor in transmission.actuators] == [("motor1", 1.0)]
    assert namespace_of(slider, "anything") == "/slider"
    assert not slider.report


@pytest.mark.parametrize("name", ["slider", "rrbot"])
def test_a_second_robot_gets_another_namespace_by_argument(name: str) -> None:
    assert [argument.get("default") for argument in written(name).arguments.values()] == [f"/{name}"]
    assert takes_namespace(name)
    document = load(name, {"namespace": "/left"})
    assert namespace_of(parse(document.xml), name) == "/left"
    assert not document.report


def test_rrbots_links_and_joints_are_those_of_the_tutorial(rrbot: Robot) -> None:
    assert rrbot.is_fixed_to_world
    assert bar(rrbot, "link1") == ((0.1, 0.1, 2.0), (0.0, 0.0, 1.0))
    assert bar(rrbot, "link2") == ((0.1, 0.1, 1.0), (0.0, 0.0, 0.45))
    assert bar(rrbot, "link3") == ((0.1, 0.1, 1.0), (0.0, 0.0, 0.45))
    for name, place in {"joint1": (0.0, 0.1, 1.95), "joint2": (0.0, 0.1, 0.9)}.items():
        joint = rrbot.joints[name]
        assert (joint.type, joint.axis, joint.damping, joint.limit) == ("continuous", (0.0, 1.0, 0.0), 0.7, None)
        assert joint.origin.xyz == pytest.approx(place)


@pytest.mark.parametrize(
    ("link", "mass", "inertia"),
    [
        ("link1", 1.0, (0.334166667, 0, 0, 0.334166667, 0, 0.001666667)),
        ("link2", 1.0, (0.084166667, 0, 0, 0.084166667, 0, 0.001666667)),
        ("link3", 1.0, (0.084166667, 0, 0, 0.084166667, 0, 0.001666667)),
        ("hokuyo_link", 1e-5, (1e-6, 0, 0, 1e-6, 0, 1e-6)),
        ("camera_link", 1e-5, (1e-6, 0, 0, 1e-6, 0, 1e-6)),
    ],
)
def test_rrbots_masses_are_those_of_the_tutorial(
    rrbot: Robot, link: str, mass: float, inertia: tuple[float, ...]
) -> None:
    inertial = rrbot.links[link].inertial
    assert inertial is not None
    assert inertial.mass == mass
    assert inertial.inertia == pytest.approx(inertia, abs=1e-9)


def test_rrbots_sensors_hang_where_the_tutorial_has_them(rrbot: Robot) -> None:
    places = {name: (rrbot.joints[name].parent, rrbot.joints[name].origin) for name in rrbot.joints}
    assert places["hokuyo_joint"] == ("link3", Pose((0.0, 0.0, 0.975)))
    assert places["camera_joint"] == ("link3", Pose((0.05, 0.0, 0.9)))
    assert places["camera_optical_joint"][0] == "camera_link"
    assert places["camera_optical_joint"][1].rpy == pytest.approx((-1.570796, 0.0, -1.570796), abs=1e-6)
    assert rrbot.links["camera_link_optical"].inertial is None


def test_rrbots_gazebo_tags_reach_its_links_and_its_sensors_are_reported(rrbot: Robot) -> None:
    assert rrbot.links["link1"].surface == Surface(material="Gazebo/Orange")
    assert rrbot.links["link2"].surface == Surface(0.2, 0.2, material="Gazebo/Black")
    assert rrbot.links["camera_link"].surface == Surface(0.2, 0.2, material="Gazebo/Red")
    assert [sensor.name for sensor in rrbot.sensors] == ["head_hokuyo_sensor", "camera1"]
    assert rrbot.report == ()


def test_rrbots_two_joints_are_driven(rrbot: Robot) -> None:
    driven = [(info.name, info.joints[0].name, info.actuators[0].name) for info in rrbot.transmissions]
    assert driven == [("tran1", "joint1", "motor1"), ("tran2", "joint2", "motor2")]
    assert namespace_of(rrbot, "x") == "/rrbot"
