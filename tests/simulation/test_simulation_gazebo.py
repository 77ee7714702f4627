"""The services and topics of `/gazebo`, as a script of the Gazebo days would use them."""

from __future__ import annotations

import math
from typing import Any

import pytest

from slidectl import description
from slidectl.simulation import Simulation

BALL = """<robot name="ball"><link name="ball">
  <inertial><mass value="2"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
  <collision><geometry><sphere radius="0.1"/></geometry></collision>
</link></robot>"""

CART = """<robot name="cart"><link name="world"/><link name="cart">
  <inertial><mass value="2"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <joint name="rail" type="prismatic"><parent link="world"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-5" upper="5" effort="10" velocity="100"/></joint>
</robot>"""


@pytest.fixture
def simulation() -> Simulation:
    return Simulation()


@pytest.fixture
def world_with_slider(simulation: Simulation) -> Simulation:
    simulation.spawn(description.load("slider").xml, "slider")
    return simulation


def ask(simulation: Simulation, service: str, **request: Any) -> dict[str, Any]:
    return simulation.call(f"/gazebo/{service}", request)


def position_of(simulation: Simulation, model: str, viewer: str = "") -> dict[str, float]:
    answer = ask(simulation, "get_model_state", model_name=model, relative_entity_name=viewer)
    assert answer["success"], answer["status_message"]
    position: dict[str, float] = answer["pose"]["position"]
    return position


def test_a_model_is_spawned_where_it_was_asked_to_be_and_deleted_again(simulation: Simulation) -> None:
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}}
    answer = ask(simulation, "spawn_urdf_model", model_name="ball", model_xml=BALL, initial_pose=pose)
    assert answer["success"], answer["status_message"]
    assert ask(simulation, "get_world_properties")["model_names"] == ["ball"]
    assert position_of(simulation, "ball") == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert ask(simulation, "delete_model", model_name="ball")["success"]
    assert ask(simulation, "get_world_properties")["model_names"] == []


def test_a_model_can_be_spawned_in_the_frame_of_another(simulation: Simulation) -> None:
    half_turn_about_z = {"z": 1.0, "w": 0.0}
    first = {"position": {"x": 1.0, "z": 5.0}, "orientation": half_turn_about_z}
    ask(simulation, "spawn_urdf_model", model_name="a", model_xml=BALL, initial_pose=first)
    second = {"position": {"x": 0.5}}
    ask(simulation, "spawn_urdf_model", model_name="b", model_xml=BALL, initial_pose=second, reference_frame="a")
    place = position_of(simulation, "b")
    assert (place["x"], place["z"]) == pytest.approx((0.5, 5.0))
    assert position_of(simulation, "b", "a")["x"] == pytest.approx(0.5)


@pytest.mark.parametrize("kind", ["urdf", "sdf"])
def test_a_model_of_more_tags_than_any_robot_has_is_refused_before_it_is_read(
    simulation: Simulation, kind: str
) -> None:
    unknown = "".join(f"<x{number}/>" for number in range(90_000))
    model = BALL.replace("</robot>", unknown + "</robot>")
    answer = ask(simulation, f"spawn_{kind}_model", model_name="ball", model_xml=model)
    assert not answer["success"]
    assert "has 90008 tags; the maximum is 25000" in answer["status_message"]
    model = BALL.replace("</robot>", unknown[: unknown.index("<x20000/>")] + "</robot>")
    assert ask(simulation, f"spawn_{kind}_model", model_name="ball", model_xml=model)["success"]


def test_a_refusal_says_why_and_leaves_the_world_as_it_was(simulation: Simulation) -> None:
    broken = ask(simulation, "spawn_urdf_model", model_name="ball", model_xml="<robot name='x'>")
    assert not broken["success"]
    assert "robot_description" in broken["status_message"]
    sdf = ask(simulation, "spawn_sdf_model", model_name="ball", model_xml="<sdf/>")
    assert not sdf["success"]
    assert "there is no <model> in it" in sdf["status_message"]
    assert not ask(simulation, "delete_model", model_name="ball")["success"]
    assert ask(simulation, "get_world_properties")["model_names"] == []


def test_a_name_in_use_is_refused(world_with_slider: Simulation) -> None:
    answer = ask(world_with_slider, "spawn_urdf_model", model_name="slider", model_xml=BALL)
    assert not answer["success"]
    assert "slider" in answer["status_message"]


def test_the_properties_of_a_model_name_its_parts(world_with_slider: Simulation) -> None:
    answer = ask(world_with_slider, "get_model_properties", model_name="slider")
    assert answer["success"]
    assert {"base_link", "link2"} <= set(answer["body_names"])
    assert "joint1" in answer["joint_names"]


def test_an_unknown_model_names_those_that_exist(world_with_slider: Simulation) -> None:
    for service in ("get_model_properties", "get_model_state"):
        answer = ask(world_with_slider, service, model_name="slidr")
        assert not answer["success"]
        assert "slider" in answer["status_message"]


def test_the_state_of_a_free_model_can_be_set_in_the_world_and_in_a_frame(simulation: Simulation) -> None:
    ask(simulation, "spawn_urdf_model", model_name="a", model_xml=BALL, initial_pose={"position": {"z": 5.0}})
    ask(simulation, "spawn_urdf_model", model_name="b", model_xml=BALL, initial_pose={"position": {"z": 9.0}})
    state = {
        "model_name": "a",
        "pose": {"position": {"x": 1.0}},
        "twist": {"linear": {"x": 0.5}},
        "reference_frame": "b",
    }
    assert ask(simulation, "set_model_state", model_state=state)["success"]
    there = ask(simulation, "get_model_state", model_name="a")
    assert there["pose"]["position"] == pytest.approx({"x": 1.0, "y": 0.0, "z": 9.0})
    assert there["twist"]["linear"]["x"] == pytest.approx(0.5)
    simulation.step(1000)
    assert position_of(simulation, "a")["x"] == pytest.approx(1.5, abs=1e-6)


def test_a_state_can_be_set_by_topic_too(simulation: Simulation) -> None:
    ask(simulation, "spawn_urdf_model", model_name="a", model_xml=BALL)
    simulation.publish("/gazebo/set_model_state", {"model_name": "a", "pose": {"position": {"z": 7.0}}})
    assert position_of(simulation, "a")["z"] == 7.0


def test_a_fixed_robot_cannot_be_thrown(world_with_slider: Simulation) -> None:
    state = {"model_name": "slider", "twist": {"linear": {"x": 1.0}}}
    answer = ask(world_with_slider, "set_model_state", model_state=state)
    assert not answer["success"]
    assert "fixed" in answer["status_message"]


def test_joints_can_be_set_all_or_none(world_with_slider: Simulation) -> None:
    names, service = ["joint1"], "set_model_configuration"
    assert ask(world_with_slider, service, model_name="slider", joint_names=names, joint_positions=[0.25])["success"]
    assert ask(world_with_slider, "get_joint_properties", joint_name="joint1")["position"] == [0.25]
    for positions, joints in (([1.5], ["joint1"]), ([0.1, 0.2], ["joint1"]), ([0.1, 0.1], ["joint1", "jiont"])):
        answer = ask(world_with_slider, service, model_name="slider", joint_names=joints, joint_positions=positions)
        assert not answer["success"]
    assert ask(world_with_slider, "get_joint_properties", joint_name="joint1")["position"] == [0.25]


def test_the_state_of_a_link_is_where_the_joint_puts_it(world_with_slider: Simulation) -> None:
    before = ask(world_with_slider, "get_link_state", link_name="slider::link2")["link_state"]["pose"]["position"]["z"]
    ask(
        world_with_slider,
        "set_model_configuration",
        model_name="slider",
        joint_names=["joint1"],
        joint_positions=[0.5],
    )
    after = ask(world_with_slider, "get_link_state", link_name="link2")["link_state"]["pose"]["position"]["z"]
    assert after - before == pytest.approx(0.5)
    seen = ask(world_with_slider, "get_link_state", link_name="link2", reference_frame="slider::base_link")
    assert seen["link_state"]["pose"]["position"]["z"] == pytest.approx(1.5)


def test_a_link_that_two_robots_have_must_be_named_in_full(world_with_slider: Simulation) -> None:
    other = description.load("slider", {"namespace": "/other"}).xml
    ask(
        world_with_slider,
        "spawn_urdf_model",
        model_name="other",
        model_xml=other,
        initial_pose={"position": {"y": 3.0}},
    )
    answer = ask(world_with_slider, "get_link_state", link_name="link2")
    assert not answer["success"]
    assert "slider::link2" in answer["status_message"]
    assert "other::link2" in answer["status_message"]
    assert ask(world_with_slider, "get_link_state", link_name="other::link2")["success"]


def test_a_link_in_the_middle_cannot_be_put_somewhere(world_with_slider: Simulation) -> None:
    answer = ask(world_with_slider, "set_link_state", link_state={"link_name": "slider::link2"})
    assert not answer["success"]
    assert "is held by a joint" in answer["status_message"]


def test_an_effort_on_a_joint_acts_for_its_duration(simulation: Simulation) -> None:
    ask(simulation, "spawn_urdf_model", model_name="cart", model_xml=CART)
    assert ask(simulation, "apply_joint_effort", joint_name="rail", effort=4.0, duration={"nsecs": 500_000_000})[
        "success"
    ]
    simulation.step(2000)
    rate = ask(simulation, "get_joint_properties", joint_name="rail")["rate"][0]
    assert rate == pytest.approx(1.0, rel=0.01)  # 4 N for half a second on 2 kg


def test_an_effort_without_end_acts_until_it_is_cleared(simulation: Simulation) -> None:
    ask(simulation, "spawn_urdf_model", model_name="cart", model_xml=CART)
    ask(simulation, "apply_joint_effort", joint_name="cart::rail", effort=2.0, duration={"secs": -1})
    simulation.step(500)
    ask(simulation, "clear_joint_forces", joint_name="rail")
    rate = ask(simulation, "get_joint_properties", joint_name="rail")["rate"][0]
    assert rate == pytest.approx(0.5, rel=0.01)
    simulation.step(500)
    assert ask(simulation, "get_joint_properties", joint_name="rail")["rate"][0] == pytest.approx(rate, rel=1e-6)


def test_a_wrench_holds_a_ball_against_gravity(simulation: Simulation) -> None:
    ask(simulation, "spawn_urdf_model", model_name="ball", model_xml=BALL, initial_pose={"position": {"z": 3.0}})
    wrench = {"force": {"z": 2 * 9.8}}
    assert ask(simulation, "apply_body_wrench", body_name="ball::ball", wrench=wrench, duration={"secs": -1})["success"]
    simulation.step(1000)
    assert position_of(simulation, "ball")["z"] == pytest.approx(3.0, abs=1e-9)
    ask(simulation, "clear_body_wrenches", body_name="ball")
    simulation.step(500)
    assert position_of(simulation, "ball")["z"] == pytest.approx(3.0 - 9.8 * 0.25 / 2, abs=0.01)


def test_a_force_beside_the_centre_of_mass_turns_the_body(simulation: Simulation) -> None:
    ask(simulation, "spawn_urdf_model", model_name="ball", model_xml=BALL, initial_pose={"position": {"z": 3.0}})
    request = {
        "body_name": "ball",
        "reference_frame": "ball",
        "reference_point": {"y": 0.1},
        "wrench": {"force": {"x": 1.0}},
    }
    ask(simulation, "apply_body_wrench", duration={"nsecs": 100_000_000}, **request)
    simulation.step(200)
    twist = ask(simulation, "get_model_state", model_name="ball")["twist"]
    assert twist["linear"]["x"] == pytest.approx(0.05, rel=0.05)
    assert twist["angular"]["z"] == pytest.approx(-1.0, rel=0.05)  # 0.1 N·m for 0.1 s on 0.01 kg·m²


def test_a_point_in_the_frame_of_the_world_is_told_to_have_no_effect(simulation: Simulation) -> None:
    ask(simulation, "spawn_urdf_model", model_name="ball", model_xml=BALL, initial_pose={"position": {"z": 3.0}})
    request = {"body_name": "ball", "wrench": {"force": {"x": 1.0}}, "duration": {"nsecs": 1_000_000}}
    for frame in ("", "world"):
        said = ask(simulation, "apply_body_wrench", reference_frame=frame, reference_point={"y": 0.1}, **request)
        assert said["success"]
        assert "reference_point has no effect in the frame world: the force acts at" in said["status_message"]
    for reference in ({"reference_frame": "ball", "reference_point": {"y": 0.1}}, {"reference_frame": "world"}):
        said = ask(simulation, "apply_body_wrench", **request, **reference)
        assert said["status_message"] == "wrench on ball::ball set"


def test_gravity_and_the_time_step_can_be_changed(simulation: Simulation) -> None:
    ask(simulation, "spawn_urdf_model", model_name="ball", model_xml=BALL, initial_pose={"position": {"z": 3.0}})
    moon = {"time_step": 0.002, "max_update_rate": 0.0, "gravity": {"x": 0.0, "y": 0.0, "z": -1.62}}
    assert ask(simulation, "set_physics_properties", **moon)["success"]
    got = ask(simulation, "get_physics_properties")
    assert (got["time_step"], got["max_update_rate"], got["gravity"]["z"]) == (0.002, 0.0, -1.62)
    simulation.step(500)
    assert simulation.time_ns == 1_000_000_000
    assert position_of(simulation, "ball")["z"] == pytest.approx(3.0 - 0.81, abs=0.01)


@pytest.mark.parametrize(
    "wrong",
    [
        {"time_step": 0.0},
        {"time_step": 0.001, "max_update_rate": -1.0},
        {"time_step": math.nan},
        {"time_step": 1e9},
        {"time_step": 1e-9},
    ],
)
def test_impossible_physics_is_refused(simulation: Simulation, wrong: dict[str, float]) -> None:
    before = ask(simulation, "get_physics_properties")
    assert not ask(simulation, "set_physics_properties", **wrong)["success"]
    assert ask(simulation, "get_physics_properties") == before


def test_pause_is_seen_in_the_properties_of_the_physics(simulation: Simulation) -> None:
    ask(simulation, "pause_physics")
    assert ask(simulation, "get_physics_properties")["pause"]
    ask(simulation, "unpause_physics")
    assert not ask(simulation, "get_physics_properties")["pause"]


def test_link_and_model_states_come_every_cycle(world_with_slider: Simulation) -> None:
    links: list[dict[str, Any]] = []
    models: list[dict[str, Any]] = []
    world_with_slider.subscribe("/gazebo/link_states", links.append)
    listener = world_with_slider.subscribe("/gazebo/model_states", models.append)
    world_with_slider.step(5)
    listener.close()
    world_with_slider.step(5)
    assert (len(links), len(models)) == (10, 5)
    assert links[0]["name"] == ["slider::base_link", "slider::link2"]
    assert models[0]["name"] == ["slider"]


def transforms(messages: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {part["child_frame_id"]: part for message in messages for part in message["transforms"]}


def test_moving_joints_are_on_tf_at_50_hz_and_fixed_ones_latched(world_with_slider: Simulation) -> None:
    moving: list[dict[str, Any]] = []
    fixed: list[dict[str, Any]] = []
    world_with_slider.subscribe("/tf", moving.append)
    world_with_slider.subscribe("/tf_static", fixed.append)
    world_with_slider.world.set_joint("slider", "joint1", 0.5)
    world_with_slider.step(100)
    stamps = [message["transforms"][0]["header"]["stamp"]["nsecs"] for message in moving]
    assert stamps == [20_000_000, 40_000_000, 60_000_000, 80_000_000, 100_000_000]
    link2 = transforms(moving)["link2"]
    assert link2["header"]["frame_id"] == "base_link"
    assert link2["transform"]["translation"]["z"] == pytest.approx(1.5, abs=1e-6)
    assert transforms(fixed)["base_link"]["header"]["frame_id"] == "world"


def test_the_frames_of_two_equal_robots_are_kept_apart(world_with_slider: Simulation) -> None:
    world_with_slider.spawn(description.load("slider", {"namespace": "/left"}).xml, "left")
    seen: list[dict[str, Any]] = []
    world_with_slider.subscribe("/tf", seen.append)
    world_with_slider.step(20)
    assert set(transforms(seen)) == {"link2", "left/link2"}
    world_with_slider.delete("left")
    assert not world_with_slider.parameters.has("/left/tf_prefix")
