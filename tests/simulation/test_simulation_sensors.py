"""Sensors that a model declares: what they publish is what the world says, at their rates."""

from __future__ import annotations

import math
from typing import Any

import pytest

from slidectl import Simulation, description, msgs
from slidectl.errors import BadFile

LINK = """<link name="{name}"><inertial><mass value="2"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  <collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>"""
LASER = """<gazebo reference="base"><sensor type="ray" name="eye"><pose>0 0 0.05 0 0 0</pose>
  <update_rate>20</update_rate>
  <ray><scan><horizontal><samples>5</samples><min_angle>-1.5707963267948966</min_angle>
  <max_angle>1.5707963267948966</max_angle></horizontal></scan><range><min>0.15</min><max>10</max></range>{noise}</ray>
  <plugin name="p" filename="libgazebo_ros_laser.so"><topicName>scan</topicName><frameName>base</frameName></plugin>
  </sensor></gazebo>"""
IMU = """<gazebo reference="base"><sensor type="imu" name="i"><update_rate>100</update_rate>
  <plugin name="p" filename="libgazebo_ros_imu_sensor.so"><topicName>imu</topicName>
  <gaussianNoise>{noise}</gaussianNoise></plugin></sensor></gazebo>"""
P3D = """<gazebo><plugin name="truth" filename="libgazebo_ros_p3d.so"><bodyName>base</bodyName>
  <topicName>truth</topicName>
  <updateRate>50</updateRate><xyzOffsets>0.1 0 0</xyzOffsets></plugin></gazebo>"""
BUMPER = """<gazebo reference="base"><sensor type="contact" name="b"><update_rate>10</update_rate>
  <plugin name="p" filename="libgazebo_ros_bumper.so"><bumperTopicName>bumper</bumperTopicName></plugin>
  </sensor></gazebo>"""


def urdf(more: str = "", name: str = "thing") -> str:
    return f'<robot name="{name}">{LINK.format(name="base")}{more}</robot>'


def listen(simulation: Simulation, topic: str) -> list[dict[str, Any]]:
    """What comes on the topic; each message has all fields of its type."""
    heard: list[dict[str, Any]] = []
    fields = {field.name for field in msgs.fields(simulation.graph.topics.type_of(topic))}

    def take(message: dict[str, Any]) -> None:
        assert message.keys() == fields
        heard.append(message)

    simulation.subscribe(topic, take)
    return heard


def at(x: float, y: float, z: float) -> Any:
    return ((x, y, z), (0.0, 0.0, 0.0, 1.0))


def values(vector: dict[str, float]) -> list[float]:
    return [vector["x"], vector["y"], vector["z"]]


def test_a_laser_sees_what_stands_around_it_at_its_rate() -> None:
    simulation = Simulation()
    simulation.spawn(urdf(LASER.format(noise="")), "thing", pose=at(0, 0, 0.1))
    simulation.spawn(urdf(name="wall"), "wall", pose=at(3, 0, 0.1))
    scans = listen(simulation, "/thing/scan")
    simulation.step(500)
    assert len(scans) == 10
    scan = scans[-1]
    assert scan["header"]["frame_id"] == "base"
    assert scan["angle_increment"] == pytest.approx(math.pi / 4)
    assert scan["ranges"][2] == pytest.approx(2.9, abs=1e-3)
    assert [distance for index, distance in enumerate(scan["ranges"]) if index != 2] == [math.inf] * 4
    assert (scan["range_min"], scan["range_max"]) == (0.15, 10.0)


def test_noise_is_the_same_in_every_run_and_has_its_deviation() -> None:
    def run() -> list[float]:
        simulation = Simulation()
        noise = "<noise><type>gaussian</type><mean>0</mean><stddev>0.01</stddev></noise>"
        simulation.spawn(urdf(LASER.format(noise=noise)), "thing", pose=at(0, 0, 0.1))
        simulation.spawn(urdf(name="wall"), "wall", pose=at(3, 0, 0.1))
        scans = listen(simulation, "/thing/scan")
        simulation.step(10_000)
        return [scan["ranges"][2] for scan in scans]

    first = run()
    assert first == run()
    spread = math.sqrt(sum((distance - 2.9) ** 2 for distance in first) / len(first))
    assert 0.007 < spread < 0.013


def test_an_imu_feels_gravity_at_rest_and_nothing_in_free_fall() -> None:
    simulation = Simulation()
    simulation.spawn(urdf(IMU.format(noise=0)), "still", pose=at(0, 0, 0.1))
    simulation.spawn(urdf(IMU.format(noise=0)), "falling", pose=at(5, 0, 50))
    still, falling = listen(simulation, "/still/imu"), listen(simulation, "/falling/imu")
    simulation.step(1000)
    assert values(still[-1]["linear_acceleration"]) == pytest.approx([0, 0, 9.8], abs=1e-2)
    assert values(falling[-1]["linear_acceleration"]) == pytest.approx([0, 0, 0], abs=1e-9)
    assert len(still) == 100


def test_an_imu_away_from_the_centre_feels_the_turn() -> None:
    simulation = Simulation(gravity=(0.0, 0.0, 0.0))
    plugin = IMU.format(noise=0).replace("<topicName>", "<xyzOffset>0.5 0 0</xyzOffset><topicName>")
    simulation.spawn(urdf(plugin), "top", pose=at(0, 0, 5))
    simulation.world.set_pose("top", at(0, 0, 5), ((0.0, 0.0, 0.0), (0.0, 0.0, 2.0)))
    heard = listen(simulation, "/top/imu")
    simulation.step(20)
    assert values(heard[-1]["linear_acceleration"]) == pytest.approx([-2.0, 0, 0], abs=1e-6)
    assert values(heard[-1]["angular_velocity"]) == pytest.approx([0, 0, 2.0], abs=1e-9)


def test_ground_truth_is_the_place_and_velocity_that_the_world_has() -> None:
    simulation = Simulation()
    simulation.spawn(urdf(P3D), "thing", pose=at(1, 2, 3))
    heard = listen(simulation, "/thing/truth")
    simulation.step(100)
    state = simulation.call("/gazebo/get_link_state", {"link_name": "thing::base"})["link_state"]
    last = heard[-1]
    assert values(last["pose"]["pose"]["position"]) == pytest.approx([1.1, 2.0, state["pose"]["position"]["z"]])
    assert values(last["twist"]["twist"]["linear"]) == pytest.approx(values(state["twist"]["linear"]))
    assert last["child_frame_id"] == "base"


def test_a_bumper_carries_the_weight_of_what_stands_on_the_ground() -> None:
    simulation = Simulation()
    simulation.spawn(urdf(BUMPER), "thing", pose=at(0, 0, 0.1))
    heard = listen(simulation, "/thing/bumper")
    simulation.step(2000)
    (state,) = heard[-1]["states"]
    assert (state["collision1_name"], state["collision2_name"]) == ("thing::base", "ground_plane::link")
    assert values(state["total_wrench"]["force"]) == pytest.approx([0, 0, 2 * 9.8], abs=0.05)
    assert all(values(normal) == pytest.approx([0, 0, 1]) for normal in state["contact_normals"])


def test_the_joint_state_plugin_publishes_the_joints_that_it_names() -> None:
    plugin = """<gazebo><plugin name="js" filename="libgazebo_ros_joint_state_publisher.so">
      <jointName>joint1, nothing</jointName><updateRate>10</updateRate></plugin></gazebo>"""
    simulation = Simulation()
    text = description.load("slider").urdf.replace("</robot>", plugin + "</robot>")
    simulation.spawn(text, "slider")
    heard = listen(simulation, "/slider/joint_states")
    simulation.step(1000)
    assert len(heard) == 10
    assert heard[-1]["name"] == ["joint1"]
    assert heard[-1]["position"] == [simulation.world.joint_state("slider", "joint1")[0]]


def test_sensors_do_not_change_what_happens() -> None:
    def end(listening: bool) -> Any:
        simulation = Simulation()
        simulation.spawn(urdf(IMU.format(noise=0) + BUMPER + P3D), "thing", pose=at(0, 0, 0.5))
        if listening:
            for topic in ("imu", "bumper", "truth"):
                listen(simulation, f"/thing/{topic}")
        simulation.step(1500)
        return simulation.world.data.qpos.tolist(), simulation.world.data.qvel.tolist()

    assert end(True) == end(False)


def test_topics_of_sensors_go_with_their_robot() -> None:
    simulation = Simulation()
    simulation.spawn(urdf(BUMPER), "thing")
    assert "/thing/bumper" in simulation.call("/rosapi/topics")["topics"]
    simulation.delete("thing")
    assert "/thing/bumper" not in simulation.call("/rosapi/topics")["topics"]


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (LASER.format(noise="").replace("<max>10</max>", "<max>0.1</max>"), "min is below its max"),
        (LASER.format(noise="").replace("<samples>5</samples>", "<samples>many</samples>"), "not a number"),
        (LASER.format(noise="").replace("0 0 0.05 0 0 0", "0 0"), "<pose> is 6 numbers"),
        (LASER.format(noise="").replace("<samples>5</samples>", "<samples>inf</samples>"), "not a finite number"),
        (LASER.format(noise="").replace("<min_angle>-1.5707963267948966", "<min_angle>-inf"), "not a finite number"),
        (LASER.format(noise="").replace("<update_rate>20<", "<update_rate>1e-320<"), "its period above 2147483647 s"),
        (P3D.replace("<updateRate>50<", "<updateRate>-50<"), "is -50 Hz; it must not be negative"),
        (IMU.format(noise="inf"), "not a finite number"),
    ],
)
def test_a_broken_sensor_is_refused_with_its_line(more: str, text: str) -> None:
    with pytest.raises(BadFile, match=text) as refused:
        Simulation().spawn(urdf(more), "thing")
    assert refused.value.line is not None


def test_a_scan_takes_what_gazebo_takes_a_fraction_of_a_sample_and_a_turn_backwards() -> None:
    simulation = Simulation()
    left = LASER.format(noise="").replace("<samples>5</samples>", "<samples>5.7</samples>")
    left = left.replace("<min_angle>-", "<min_angle>").replace("<max_angle>1", "<max_angle>-1")
    robot = simulation.spawn(urdf(left), "thing", pose=at(0, 0, 0.1))
    simulation.spawn(urdf(name="block"), "block", pose=at(0, 2, 0.1))  # on the left
    scans = listen(simulation, "/thing/scan")
    simulation.step(100)
    assert scans[-1]["angle_increment"] == pytest.approx(-math.pi / 4)
    assert scans[-1]["ranges"][0] == pytest.approx(1.9, abs=0.01)
    said = " ".join(notice.text for notice in robot.description.report)
    assert "5.7 is read as 5" in said
    assert "the scan goes backwards" in said


@pytest.mark.parametrize(
    "more",
    [
        '<gazebo reference="base"><sensor type="sonar" name="s"/></gazebo>',
        '<gazebo reference="base"><sensor type="ray" name="s"/></gazebo>',
        P3D.replace("<bodyName>base", "<bodyName>no"),
    ],
)
def test_a_sensor_that_measures_nothing_is_reported(more: str) -> None:
    robot_model = description.parse(urdf(more))
    assert not robot_model.sensors
    assert robot_model.report[-1].verdict in ("ignored", "wrong")


@pytest.mark.parametrize("kind", ["<type>none</type>", "<type>uneven</type>"])
def test_noise_of_another_type_than_gaussian_adds_nothing(kind: str) -> None:
    simulation = Simulation()
    noise = f"<noise>{kind}<mean>0.5</mean><stddev>0.2</stddev></noise>"
    simulation.spawn(urdf(LASER.format(noise=noise)), "thing", pose=at(0, 0, 0.1))
    simulation.spawn(urdf(name="wall"), "wall", pose=at(3, 0, 0.1))
    scans = listen(simulation, "/thing/scan")
    simulation.step(1000)
    assert [scan["ranges"][2] for scan in scans] == [pytest.approx(2.9, abs=1e-3)] * len(scans)
