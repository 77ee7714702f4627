"""Plugins of a model that move it: wheels that turn, robots that glide, joints that follow others."""

from __future__ import annotations

import math
from typing import Any

import pytest

from slidectl import Simulation, description
from slidectl.errors import BadFile, MessageRefused
from slidectl.rotations import to_rpy

BODY = """<link name="{0}"><inertial><mass value="{1}"/><inertia ixx="{2}" iyy="{2}" izz="{2}" ixy="0" ixz="0" iyz="0"/>
  </inertial><collision><geometry>{3}</geometry></collision></link>"""
MIMIC = """<gazebo><plugin name="m" filename="libroboticsgroup_gazebo_mimic_joint_plugin.so"><joint>{}</joint>
  <mimicJoint>{}</mimicJoint><multiplier>{}</multiplier><offset>0.1</offset>{}</plugin></gazebo>"""


def cart(drive: str = "plugin", *changes: tuple[str, str]) -> str:
    xml = description.load("cart", {"drive": drive}, description.Packages()).xml
    for old, new in changes:
        assert old in xml
        xml = xml.replace(old, new)
    return xml


def box(more: str) -> str:
    base = BODY.format("base", 2, 0.02, '<box size="0.2 0.2 0.2"/>')
    return f'<robot name="box">{base}{more}</robot>'


def planar(more: str = "") -> str:
    return f'<gazebo><plugin name="glide" filename="libgazebo_ros_planar_move.so">{more}</plugin></gazebo>'


def drive(simulation: Simulation, topic: str, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> None:
    message = {"linear": {"x": x, "y": y}, "angular": {"z": yaw}}
    simulation.publish(topic, message, "geometry_msgs/Twist")


def listen(simulation: Simulation, topic: str) -> list[dict[str, Any]]:
    heard: list[dict[str, Any]] = []
    simulation.subscribe(topic, heard.append)
    return heard


def place(simulation: Simulation, robot: str, link: str) -> tuple[float, float, float]:
    """x, y and heading."""
    position, turn = simulation.world.link_pose(robot, link)
    return position[0], position[1], to_rpy(turn)[2]


def test_the_shipped_cart_has_two_kinds_of_drive_and_refuses_another_word() -> None:
    with pytest.raises(BadFile, match=r"'controler' is not in list.*'plugin', 'controller'"):
        cart("controler")


def test_a_cart_drives_a_circle_and_tells_by_its_wheels_where_it_is() -> None:
    simulation = Simulation()
    simulation.spawn(cart("plugin", ("1.0</wheelAcceleration>", "0</wheelAcceleration>")), "cart")
    odometry, frames = listen(simulation, "/cart/odom"), listen(simulation, "/tf")
    drive(simulation, "/cart/cmd_vel", 0.5, yaw=0.5)
    simulation.step(6000)
    told = odometry[-1]
    assert len(odometry) == 300  # updateRate 50
    assert (told["header"]["frame_id"], told["child_frame_id"]) == ("odom", "base_link")
    assert told["twist"]["twist"]["linear"]["x"] == pytest.approx(0.5, abs=1e-6)
    assert told["twist"]["twist"]["angular"]["z"] == pytest.approx(0.5, abs=1e-6)
    x, y = (told["pose"]["pose"]["position"][axis] for axis in "xy")
    assert math.hypot(x, y - 1.0) == pytest.approx(1.0, abs=0.01)  # the radius of the circle
    assert place(simulation, "cart", "base_link")[:2] == pytest.approx((x, y), abs=0.1)
    told_frames = [one for message in frames for one in message["transforms"] if one["header"]["frame_id"] == "odom"]
    assert told_frames[-1]["child_frame_id"] == "base_link"
    assert told_frames[-1]["transform"]["translation"] == pytest.approx({"x": x, "y": y, "z": 0.0})


def test_the_wheels_gather_speed_as_the_acceleration_says() -> None:
    simulation = Simulation()
    simulation.spawn(cart(), "cart")
    drive(simulation, "/cart/cmd_vel", 0.5)
    simulation.step(270)
    assert simulation.world.link_twist("cart", "base_link")[0][0] == pytest.approx(0.25, abs=0.03)
    simulation.step(500)
    assert simulation.world.link_twist("cart", "base_link")[0][0] == pytest.approx(0.5, abs=0.01)


def test_odometry_of_the_world_is_where_the_cart_is() -> None:
    simulation = Simulation()
    simulation.spawn(cart("plugin", ("encoder", "world"), ("50</updateRate>", "20</updateRate>")), "cart")
    odometry = listen(simulation, "/cart/odom")
    drive(simulation, "/cart/cmd_vel", 0.4, yaw=-0.3)
    simulation.step(3000)
    x, y, yaw = place(simulation, "cart", "base_link")
    told = odometry[-1]
    assert len(odometry) == 60
    assert told["pose"]["pose"]["position"]["x"] == pytest.approx(x)
    assert told["pose"]["pose"]["position"]["y"] == pytest.approx(y)
    assert told["pose"]["pose"]["orientation"]["z"] == pytest.approx(math.sin(yaw / 2), abs=1e-6)
    linear = simulation.world.link_twist("cart", "base_link")[0]
    assert told["twist"]["twist"]["linear"]["x"] == pytest.approx(math.hypot(*linear[:2]), rel=1e-3)
    assert told["pose"]["covariance"][0::7] == [1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3]
    assert told["twist"]["covariance"] == [0.0] * 36


def test_without_legacy_mode_false_the_cart_turns_the_other_way_and_it_is_said() -> None:
    simulation = Simulation()
    robot = simulation.spawn(cart("plugin", ("<legacyMode>false</legacyMode>", "")), "cart")
    assert "without <legacyMode>false</legacyMode>" in "".join(map(str, robot.description.report))
    drive(simulation, "/cart/cmd_vel", yaw=0.5)
    simulation.step(1000)
    assert place(simulation, "cart", "base_link")[2] < -0.3


def test_an_emergency_stop_ends_the_command_and_a_reset_too() -> None:
    simulation = Simulation()
    robot = simulation.spawn(cart(), "cart")
    odometry = listen(simulation, "/cart/odom")
    drive(simulation, "/cart/cmd_vel", 0.5)
    simulation.step(1500)
    robot.emergency_stop = True
    drive(simulation, "/cart/cmd_vel", 0.5)
    simulation.step(1000)
    robot.emergency_stop = False
    simulation.step(1000)
    assert odometry[-1]["twist"]["twist"]["linear"]["x"] == pytest.approx(0.0, abs=1e-6)
    drive(simulation, "/cart/cmd_vel", 0.5)
    simulation.step(1000)
    simulation.reset_simulation()
    simulation.step(1000)
    assert odometry[-1]["pose"]["pose"]["position"]["x"] == pytest.approx(0.0, abs=1e-6)


def test_a_command_that_is_no_number_is_refused() -> None:
    simulation = Simulation()
    simulation.spawn(cart(), "cart")
    with pytest.raises(MessageRefused, match="finite numbers"):
        drive(simulation, "/cart/cmd_vel", math.nan)


def test_two_carts_have_their_own_topics_and_frames_and_one_drives_on_when_the_other_goes() -> None:
    simulation = Simulation()
    for number, name in enumerate(("one", "two")):
        simulation.spawn(cart(), name, f"/{name}", ((0.0, 2.0 * number, 0.0), (0.0, 0.0, 0.0, 1.0)))
    odometry = listen(simulation, "/two/odom")
    drive(simulation, "/two/cmd_vel", 0.5)
    simulation.step(1000)
    simulation.delete("one")
    simulation.step(1000)
    assert simulation.world.link_twist("two", "base_link")[0][0] == pytest.approx(0.5, abs=0.02)
    assert odometry[-1]["header"]["frame_id"] == "two/odom"  # as its other frames
    assert not simulation.graph.topics.exists("/one/cmd_vel")


def test_four_wheels_skid() -> None:
    wheel = """<link name="{0}_wheel"><inertial><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
      <collision><geometry><sphere radius="0.1"/></geometry></collision></link>
      <joint name="{0}_joint" type="continuous"><origin xyz="{1} {2} -0.05"/><axis xyz="0 1 0"/>
      <parent link="base"/><child link="{0}_wheel"/></joint>"""
    ends, sides = {"front": 0.2, "rear": -0.2}, {"left": 0.2, "right": -0.2}
    wheels = [wheel.format(f"{side}_{end}", x, y) for side, y in sides.items() for end, x in ends.items()]
    plugin = """<gazebo><plugin name="skid" filename="libgazebo_ros_skid_steer_drive.so">
      <robotNamespace>/tank</robotNamespace><wheelDiameter>0.2</wheelDiameter><torque>20</torque></plugin></gazebo>"""
    simulation = Simulation()
    simulation.spawn(box("".join(wheels) + plugin), "box", pose=((0.0, 0.0, 0.15), (0.0, 0.0, 0.0, 1.0)))
    odometry = listen(simulation, "/tank/odom")
    drive(simulation, "/tank/cmd_vel", 0.5)
    simulation.step(2000)
    assert place(simulation, "box", "base")[0] == pytest.approx(1.0, abs=0.1)
    assert odometry[-1]["twist"]["covariance"][0::7] == [1e-4, 1e-4, 1e12, 1e12, 1e12, 1e-2]
    assert odometry[-1]["pose"]["pose"]["position"]["z"] == 0.0


def test_a_robot_glides_in_its_own_direction_until_the_command_is_too_old() -> None:
    simulation = Simulation()
    more = "<cmdTimeout>1.0</cmdTimeout><robotBaseFrame>base</robotBaseFrame>"
    simulation.spawn(box(planar(more)), "box", pose=((0.0, 0.0, 0.1), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))))
    odometry = listen(simulation, "/box/odom")
    drive(simulation, "/box/cmd_vel", 0.5, 0.2)
    simulation.step(900)
    told = odometry[-1]
    assert len(odometry) == 18  # odometryRate 20
    assert told["twist"]["twist"]["linear"] == pytest.approx({"x": 0.5, "y": 0.2, "z": 0.0}, abs=1e-3)
    simulation.step(2000)
    assert place(simulation, "box", "base") == pytest.approx((-0.2, 0.5, math.pi / 2), abs=0.01)


def test_a_plugin_lets_a_joint_follow_and_what_it_says_goes_before_a_mimic_tag() -> None:
    joint = """<joint name="{0}" type="continuous"><origin xyz="0 {1} 0"/><axis xyz="0 1 0"/>{2}
      <parent link="base"/><child link="{0}_link"/></joint>"""
    links = "".join(BODY.format(f"{name}_link", 1, 0.01, '<sphere radius="0.05"/>') for name in ("lead", "tail"))
    joints = joint.format("lead", 0.5, "") + joint.format("tail", -0.5, '<mimic joint="lead" multiplier="5"/>')
    simulation = Simulation(gravity=(0.0, 0.0, 0.0))
    xml = box(links + joints + MIMIC.format("lead", "tail", -2.0, "<hasPID/>"))
    robot = simulation.spawn(xml, "box", pose=((0.0, 0.0, 5.0), (0.0, 0.0, 0.0, 1.0)))
    said = [(notice.verdict, notice.text) for notice in robot.description.report]
    assert [verdict for verdict, _ in said] == ["ignored", "wrong"]
    simulation.robots.set_joints("box", ["lead"], [0.2])
    assert simulation.world.joint_state("box", "tail")[0] == pytest.approx(0.1 - 2.0 * 0.2)
    simulation.reset_world()
    simulation.world.add_joint_force("box", "lead", 0.05)
    simulation.step(500)
    lead, tail = (simulation.world.joint_state("box", name)[0] for name in ("lead", "tail"))
    assert lead > 0.05
    assert tail == pytest.approx(0.1 - 2.0 * lead, abs=0.01)


def test_a_plugin_that_cannot_let_a_joint_follow_is_refused_or_has_no_effect() -> None:
    joint = '<joint name="{0}" type="{1}"><parent link="base"/><child link="{0}_link"/></joint>'
    links = "".join(BODY.format(f"{name}_link", 1, 0.01, "<sphere radius='0.05'/>") for name in ("lead", "tail"))
    parts = links + joint.format("lead", "continuous")
    with pytest.raises(BadFile, match="<multiplier> is 'inf', which is not a finite number"):
        description.parse(box(parts + joint.format("tail", "continuous") + MIMIC.format("lead", "tail", "inf", "")))
    robot_model = description.parse(box(parts + joint.format("tail", "fixed") + MIMIC.format("lead", "tail", 1, "")))
    assert "'tail' is fixed and cannot follow; the plugin has no effect" in robot_model.report[-1].text
    assert robot_model.joints["tail"].mimic is None


@pytest.mark.parametrize(
    ("plugin", "words"),
    [
        (MIMIC.format("lead", "tail", 1.0, ""), "there is no joint 'lead'"),
        (planar().replace("libgazebo_ros_planar_move", "libgazebo_ros_diff_drive"), "no joint 'right_joint'"),
        (planar("<comandTopic>x</comandTopic>"), "did you mean <commandTopic>?"),
    ],
)
def test_what_a_plugin_cannot_do_is_said(plugin: str, words: str) -> None:
    assert any(words in str(notice) for notice in description.parse(box(plugin)).report)


def test_a_robot_of_a_force_based_drive_falls_to_the_ground_and_stays_there() -> None:
    simulation = Simulation()
    simulation.spawn(box(force_based()), name="box", pose=((0.0, 0.0, 0.4), (0.0, 0.0, 0.0, 1.0)))
    simulation.step(2000)
    position = simulation.world.link_pose("box", "base")[0]
    assert position[2] == pytest.approx(0.1, abs=2e-3)
    simulation.step(45_000)
    assert simulation.world.link_pose("box", "base")[0] == pytest.approx(position, abs=1e-4)


@pytest.mark.parametrize("friction", [0.5, 100.0, 1e14])
def test_a_base_with_wheels_of_any_friction_turns_as_commanded(friction: float) -> None:
    surface = f"<mu1>{friction}</mu1><mu2>{friction}</mu2>"
    wheels = [f'<gazebo reference="{link}">{surface}</gazebo>' for link in ("left_wheel", "right_wheel")]
    simulation = Simulation()
    simulation.spawn(cart("plugin", ("</robot>", "".join(wheels) + "</robot>")), name="cart")
    drive(simulation, "/cart/cmd_vel", yaw=0.5)
    simulation.step(2000)
    _, _, before = place(simulation, "cart", "base_link")
    simulation.step(2000)
    assert place(simulation, "cart", "base_link")[2] - before == pytest.approx(1.0, abs=0.03)
    drive(simulation, "/cart/cmd_vel", 0.25)
    simulation.step(2000)
    x, y, _ = place(simulation, "cart", "base_link")
    simulation.step(4000)
    assert math.dist((x, y), place(simulation, "cart", "base_link")[:2]) == pytest.approx(1.0, abs=0.03)


ON_WHEELS = """<robot name="b"><link name="base"><inertial><origin xyz="-0.001 0 0.05"/><mass value="0.8"/>
<inertia ixx="0.003" iyy="0.002" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="-0.08 0 0.013"/><geometry><box size="0.03 0.009 0.02"/></geometry></collision></link>{}{}
<gazebo reference="base"><mu1>0.1</mu1><mu2>0.1</mu2></gazebo>
<gazebo><plugin name="d" filename="libgazebo_ros_diff_drive.so"><leftJoint>l_joint</leftJoint><rightJoint>r_joint
</rightJoint><legacyMode>false</legacyMode><wheelSeparation>0.16</wheelSeparation><wheelDiameter>0.066</wheelDiameter>
<wheelTorque>10</wheelTorque></plugin></gazebo></robot>"""
WHEEL = """<link name="{0}"><inertial><mass value="0.03"/>
<inertia ixx="2e-5" iyy="2e-5" izz="4e-5" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><cylinder length="0.018" radius="0.033"/></geometry></collision></link>
<joint name="{0}_joint" type="continuous"><parent link="base"/><child link="{0}"/>
<origin xyz="0 {1} 0.033" rpy="-1.57 0 0"/><axis xyz="0 0 1"/></joint>
<gazebo reference="{0}"><mu1>0.1</mu1><mu2>0.1</mu2></gazebo>"""


def test_a_light_robot_that_stands_on_its_wheels_does_not_creep() -> None:
    simulation = Simulation()
    simulation.spawn(ON_WHEELS.format(WHEEL.format("l", 0.08), WHEEL.format("r", -0.08)), name="b")
    simulation.step(2000)
    before = place(simulation, "b", "base")
    simulation.step(5000)
    assert place(simulation, "b", "base") == pytest.approx(before, abs=1e-7)


def force_based(more: str = "") -> str:
    return f'<gazebo><plugin name="push" filename="libridgeback_ros_force_based_move.so">{more}</plugin></gazebo>'


def test_force_based_move_gives_the_commanded_velocity_until_its_time_has_passed() -> None:
    simulation = Simulation()
    smooth = '<gazebo reference="base"><mu1>0</mu1><mu2>0</mu2></gazebo>'
    simulation.spawn(box(smooth + force_based("<yaw_velocity_p_gain>500</yaw_velocity_p_gain>")), name="box")
    simulation.step(1000)  # it comes up to the ground
    x, y, _ = place(simulation, "box", "base")
    for _ in range(20):
        drive(simulation, "/box/cmd_vel", 0.3, 0.1)
        simulation.step(100)
    assert place(simulation, "box", "base")[:2] == pytest.approx((x + 0.6, y + 0.2), abs=0.01)
    simulation.step(300)
    before = place(simulation, "box", "base")
    simulation.step(1000)
    assert place(simulation, "box", "base") == pytest.approx(before, abs=1e-3)
