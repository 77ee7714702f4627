"""The services of simulation_interfaces, as a test runner that knows no simulator in particular would use them."""

from __future__ import annotations

import random
import re
from pathlib import Path
from typing import Any

import pytest

from slidectl import msgs
from slidectl.errors import UsageError
from slidectl.features.posix_pattern import PosixPattern
from slidectl.simulation import Simulation

BOX = """<sdf version="1.6"><model name="box"><link name="link">
  <collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision></link></model></sdf>"""
BALL = """<robot name="ball"><link name="ball">
  <inertial><mass value="2"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
  <collision><geometry><sphere radius="0.1"/></geometry></collision></link></robot>"""
MESH = "<robot name='m'><link name='l'><collision><geometry><mesh filename='{}'/></geometry></collision></link></robot>"


@pytest.fixture
def simulation() -> Simulation:
    return Simulation()


def ask(simulation: Simulation, service: str, **request: Any) -> dict[str, Any]:
    return simulation.call(f"/slidectl/{service}", request)


def result(answer: dict[str, Any]) -> int:
    code: int = answer["result"]["result"]
    return code


def value(kind: str, name: str) -> int:
    return next(int(one.value) for one in msgs.constants(f"simulation_interfaces/{kind}") if one.name == name)


def name_of(kind: str, code: int) -> str:
    """The constant of a result; those of one service are above 100."""
    of = "Result" if code <= 100 else kind
    return next(one.name for one in msgs.constants(f"simulation_interfaces/{of}") if one.value == code)


def spawn(simulation: Simulation, name: str, resource: str, x: float = 0.0, z: float = 0.0, **more: Any) -> str:
    """Spawn a text or a URI, and give the result's name."""
    what = {"resource_string" if resource.startswith("<") else "uri": resource}
    place = {"pose": {"position": {"x": x, "z": z}}}
    answer = ask(simulation, "spawn_entity", name=name, entity_resource=what, **{"initial_pose": place, **more})
    return name_of("SpawnResult", result(answer))


def entities(simulation: Simulation, **filters: Any) -> list[str]:
    answer = ask(simulation, "get_entities", filters=filters)
    assert result(answer) == 1, answer["result"]["error_message"]
    found: list[str] = answer["entities"]
    return found


def test_every_feature_that_is_announced_has_its_service_and_the_others_are_not_there(simulation: Simulation) -> None:
    features = set(ask(simulation, "get_simulator_features")["features"]["features"])
    services = simulation.graph.services.names()
    for feature, service in {
        "SPAWNING": "spawn_entity", "SPAWNING_ENTITIES": "spawn_entities", "DELETING": "delete_entity",
        "NAMED_POSES": "get_named_poses", "ENTITY_BOUNDS": "get_entity_bounds", "SPAWNABLES": "get_spawnables",
        "ENTITY_STATE_GETTING": "get_entities_states", "ENTITY_STATE_SETTING": "set_entity_state",
        "ENTITY_INFO_GETTING": "get_entity_info", "ENTITY_INFO_SETTING": "set_entity_info",
        "SIMULATION_RESET": "reset_simulation", "SIMULATION_STATE_GETTING": "get_simulation_state",
        "SIMULATION_STATE_SETTING": "set_simulation_state", "STEP_SIMULATION_MULTIPLE": "step_simulation",
        "WORLD_LOADING": "load_world", "WORLD_INFO_GETTING": "get_current_world",
    }.items():  # fmt: skip
        assert (value("SimulatorFeatures", feature) in features) is (f"/slidectl/{service}" in services), feature


def test_a_spawnable_is_spawned_by_its_uri_with_its_controllers_interfaces_in_its_namespace(
    simulation: Simulation,
) -> None:
    answer = ask(simulation, "get_spawnables", sources=["rrbot_description", "no_such"])
    uris = [one["entity_resource"]["uri"] for one in answer["spawnables"]]
    assert result(answer) == 1
    assert "no_such" in answer["result"]["error_message"]
    assert "package://rrbot_description/urdf/rrbot.xacro" in uris
    slider = next(uri for uri in uris if uri.endswith("slider.xacro"))
    assert spawn(simulation, "", slider) == "RESULT_OK"
    assert spawn(simulation, "", slider, x=2.0, allow_renaming=True) == "RESULT_OK"
    assert spawn(simulation, "arm", "package://rrbot_description/urdf/rrbot.xacro", entity_namespace="/lab/arm")
    assert entities(simulation) == ["slider", "slider_1", "arm"]
    for namespace in ("/slider", "/slider_1", "/lab/arm"):
        assert simulation.graph.services.exists(f"{namespace}/controller_manager/list_controllers")


@pytest.mark.parametrize(
    ("name", "resource", "more", "expected"),
    [
        ("ball", BALL, {}, "NAME_NOT_UNIQUE"),
        ("", "<robot><link name='l'/></robot>", {}, "NAME_INVALID"),
        ("my ball", BALL, {}, "NAME_INVALID"),
        ("world", BALL, {}, "NAME_INVALID"),
        ("b", "<mujoco/>", {}, "UNSUPPORTED_FORMAT"),
        ("b", "/etc/hostname", {}, "UNSUPPORTED_FORMAT"),
        ("b", "https://example.org/b.urdf", {}, "UNSUPPORTED_FORMAT"),
        ("b", "<robot xmlns:xacro='http://ros.org/wiki/xacro'><xacro:m/></robot>", {}, "UNSUPPORTED_FORMAT"),
        ("b", " ", {}, "NO_RESOURCE"),
        ("b", BALL, {"entity_namespace": "/a b"}, "NAMESPACE_INVALID"),
        ("b", "<robot", {}, "RESOURCE_PARSE_ERROR"),
        ("b", "<robot name='b'/>", {}, "RESOURCE_PARSE_ERROR"),
        ("b", MESH.format("/no/such.stl"), {}, "MISSING_ASSETS"),
        ("b", MESH.format("/etc/hostname"), {}, "UNSUPPORTED_ASSETS"),
        ("b", "sliderr", {}, "RESULT_NOT_FOUND"),
        ("b", "file:///no/such.urdf", {}, "RESULT_NOT_FOUND"),
        ("b", BALL, {"initial_pose": {"header": {"frame_id": "nowhere"}}}, "RESULT_NOT_FOUND"),
        ("b", BALL, {"initial_pose": {"pose": {"orientation": {"w": 3.0}}}}, "INVALID_POSE"),
        ("b", BALL, {"initial_pose": {"pose": {"position": {"x": 1e9}}}}, "INVALID_POSE"),
    ],
)
def test_what_cannot_be_spawned_has_the_code_of_its_reason_and_leaves_nothing(
    simulation: Simulation, name: str, resource: str, more: dict[str, Any], expected: str
) -> None:
    assert spawn(simulation, "ball", BALL, z=1.0) == "RESULT_OK"
    services = simulation.graph.services.names()
    assert spawn(simulation, name, resource, **more) == expected
    assert entities(simulation) == ["ball"]
    assert simulation.graph.services.names() == services


def test_a_broken_mesh_is_an_unsupported_asset(simulation: Simulation, tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_text("nothing")
    assert spawn(simulation, "b", MESH.format(tmp_path / "a.stl")) == "UNSUPPORTED_ASSETS"


def test_several_are_spawned_one_by_one_and_the_failed_ones_are_named(simulation: Simulation) -> None:
    resource = {"resource_string": BALL}
    asked = [{"name": "a", "entity_resource": resource}, {"name": "a", "entity_resource": resource}, {"name": "c"}]
    asked.append({"name": "a", "entity_resource": resource, "allow_renaming": True})
    answer = ask(simulation, "spawn_entities", spawn_requests=asked)
    assert result(answer) == value("SpawnEntitiesResponse", "ENTITIES_SPAWN_FAILED")
    codes = [name_of("SpawnResult", result(one)) for one in answer["results"]]
    assert codes == ["RESULT_OK", "NAME_NOT_UNIQUE", "NO_RESOURCE", "RESULT_OK"]
    assert entities(simulation) == ["a", "a_1"]
    many = ask(simulation, "spawn_entities", spawn_requests=[{}] * 101)
    assert name_of("", result(many)) == "RESULT_OPERATION_FAILED"


def test_entities_are_filtered_by_name_category_tags_and_place(simulation: Simulation) -> None:
    spawn(simulation, "slider", "slider")
    spawn(simulation, "crate", BOX, x=3.0, z=0.5)
    spawn(simulation, "ball", BALL, x=5.0, z=1.0)
    assert entities(simulation, filter="^(crate|ball)$") == ["crate", "ball"]
    assert entities(simulation, categories=[{"category": value("EntityCategory", "CATEGORY_OBJECT")}]) == ["crate"]
    info = {"category": {"category": 4}, "description": "rolls", "tags": ["round", "red"]}
    assert result(ask(simulation, "set_entity_info", entity="ball", info=info)) == 1
    assert ask(simulation, "get_entity_info", entity="ball")["info"] == info
    assert entities(simulation, categories=[{"category": 4}]) == ["ball"]
    assert entities(simulation, tags={"tags": ["red", "blue"]}) == ["ball"]
    assert entities(simulation, tags={"tags": ["red", "blue"], "filter_mode": 1}) == []
    box, ball = value("Bounds", "TYPE_BOX"), value("Bounds", "TYPE_SPHERE")
    corners = [{"x": 6.0, "y": 1.0, "z": 2.0}, {"x": 3.4, "y": -1.0, "z": 0.0}]
    assert entities(simulation, bounds={"type": box, "points": corners}) == ["crate", "ball"]
    assert entities(simulation, bounds={"type": ball, "points": [{"x": 5.0, "z": 1.3}, {"x": 0.21}]}) == ["ball"]
    assert entities(simulation, bounds={"type": ball, "points": [{"x": 5.0, "z": 1.3}, {"x": 0.19}]}) == []
    hull = ask(simulation, "get_entities", filters={"bounds": {"type": value("Bounds", "TYPE_CONVEX_HULL")}})
    assert name_of("", result(hull)) == "RESULT_FEATURE_UNSUPPORTED"
    for wrong in ({"filter": "(a"}, {"bounds": {"type": box}}):
        assert name_of("", result(ask(simulation, "get_entities", filters=wrong))) == "RESULT_OPERATION_FAILED"
    assert name_of("", result(ask(simulation, "get_entity_state", entity="nobody"))) == "RESULT_NOT_FOUND"


def test_bounds_are_a_box_on_the_axes_of_the_root_link(simulation: Simulation) -> None:
    quarter_turn = {"z": 0.5**0.5, "w": 0.5**0.5}
    pose = {"pose": {"position": {"x": 9.0}, "orientation": quarter_turn}}
    spawn(simulation, "slider", "slider", initial_pose=pose)
    simulation.call("/gazebo/set_model_configuration",
                    {"model_name": "slider", "joint_names": ["joint1"], "joint_positions": [0.5]})  # fmt: skip
    upper, lower = ask(simulation, "get_entity_bounds", entity="slider")["bounds"]["points"]
    assert upper["x"] == pytest.approx(-lower["x"])
    assert upper["y"] > upper["x"], "the block slides beside the column"


def test_a_state_is_set_in_a_frame_and_only_where_the_flags_say(simulation: Simulation) -> None:
    spawn(simulation, "slider", "slider")
    spawn(simulation, "crate", BOX, x=3.0, z=5.0)
    turned = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"z": 1.0, "w": 0.0}}
    moving = {"linear": {"x": 1.0}, "angular": {"z": 2.0}}
    asked = {"pose": turned, "twist": moving, "acceleration": {"linear": {"x": 1.0}}}
    assert result(ask(simulation, "set_entity_state", entity="crate", state=asked, set_twist=True)) == 1
    state = ask(simulation, "get_entity_state", entity="crate")["state"]
    assert state["pose"]["position"] == {"x": 3.0, "y": 0.0, "z": 5.0}
    assert state["twist"]["linear"]["x"] == pytest.approx(1.0)
    ask(simulation, "set_entity_state", entity="crate", state=asked, set_pose=True)
    state = ask(simulation, "get_entities_states", filters={"filter": "crate"})["states"][0]
    assert state["pose"]["position"] == pytest.approx({"x": 1.0, "y": 2.0, "z": 3.0})
    assert state["twist"]["angular"]["z"] == pytest.approx(2.0), "it turns on"
    seen = {"header": {"frame_id": "crate"}, "pose": {"position": {"x": 1.0, "z": 7.0}}}
    spawn(simulation, "ball", BALL, initial_pose=seen)
    place = ask(simulation, "get_entity_state", entity="ball")["state"]["pose"]["position"]
    assert place == pytest.approx({"x": 0.0, "y": 2.0, "z": 10.0})
    simulation.step(10)
    falling = ask(simulation, "get_entity_state", entity="ball")["state"]
    assert falling["acceleration"]["linear"]["z"] == pytest.approx(-9.8)
    assert (falling["header"]["stamp"]["nsecs"], falling["header"]["frame_id"]) == (10_000_000, "world")
    for request, expected in (
        ({"state": {"pose": {"orientation": {"x": 2.0}}}, "set_pose": True}, 101),
        ({"state": {"twist": moving}, "set_twist": True}, 4),
        ({"state": {"header": {"frame_id": "nowhere"}}, "set_pose": True}, 2),
    ):
        assert result(ask(simulation, "set_entity_state", entity="slider", **request)) == expected
    told = ask(simulation, "set_entity_state", entity="ball", state=asked, set_acceleration=True)
    assert (result(told), "not set" in told["result"]["error_message"]) == (1, True)


def test_the_world_is_played_paused_stepped_and_stopped(simulation: Simulation) -> None:
    def is_now() -> str:
        state = ask(simulation, "get_simulation_state")["state"]["state"]
        return next(one.name for one in msgs.constants("simulation_interfaces/SimulationState") if one.value == state)

    def change(state: str) -> str:
        answer = ask(simulation, "set_simulation_state", state={"state": value("SimulationState", state)})
        return name_of("SetSimulationStateResponse", result(answer))

    assert is_now() == "STATE_PLAYING"
    assert result(ask(simulation, "step_simulation")) == 4
    assert change("STATE_STOPPED") == "RESULT_OK"
    assert (is_now(), change("STATE_PAUSED")) == ("STATE_STOPPED", "INCORRECT_TRANSITION")
    assert result(ask(simulation, "step_simulation")) == 1
    assert (simulation.cycles, is_now()) == (1, "STATE_PAUSED")
    assert result(ask(simulation, "step_simulation", steps=9)) == 1
    assert simulation.cycles == 10
    assert change("STATE_PAUSED") == "ALREADY_IN_TARGET_STATE"
    assert change("STATE_PLAYING") == "RESULT_OK"
    assert change("STATE_PAUSED") == "RESULT_OK"
    assert change("STATE_LOADING_WORLD") == "RESULT_FEATURE_UNSUPPORTED"
    assert change("STATE_STOPPED") == "RESULT_OK"
    assert simulation.cycles == 0


def test_a_reset_puts_back_what_its_scope_says(simulation: Simulation) -> None:
    simulation.call("/gazebo/spawn_sdf_model", {"model_name": "scene", "model_xml": BALL,
                                                "initial_pose": {"position": {"z": 3.0}}})  # fmt: skip
    spawn(simulation, "ball", BALL, z=9.0)
    simulation.save("both")

    def height(name: str) -> float:
        z: float = ask(simulation, "get_entity_state", entity=name)["state"]["pose"]["position"]["z"]
        return z

    simulation.step(10)
    assert result(ask(simulation, "reset_simulation", scope=1)) == 0, "time alone"
    assert result(ask(simulation, "reset_simulation", scope=2)) == 1
    assert (simulation.cycles, height("ball")) == (10, 9.0)
    simulation.step(10)
    assert result(ask(simulation, "reset_simulation", scope=3)) == 1
    assert (simulation.cycles, height("scene"), entities(simulation)) == (0, 3.0, ["scene", "ball"])
    simulation.step(10)
    ask(simulation, "reset_simulation", scope=4)
    assert (simulation.cycles, entities(simulation)) == (10, ["scene"])
    simulation.load("both")
    simulation.step(10)
    ask(simulation, "reset_simulation")
    assert (simulation.cycles, height("scene"), entities(simulation)) == (0, 3.0, ["scene"]), (
        "a snapshot keeps who came"
    )


def test_patterns_are_those_of_posix() -> None:
    dice = random.Random(14)

    def pattern(depth: int = 0) -> str:
        kind = dice.randrange(10) if depth < 4 else 0
        if kind < 4:
            return dice.choice(["a", "b", ".", "[ab]", "[^a]", "[a-c]", r"\."])
        if kind < 6:
            return pattern(depth + 1) + pattern(depth + 1)
        if kind < 7:
            return f"({pattern(depth + 1)}|{pattern(depth + 1)})"
        if kind < 8:
            return f"({pattern(depth + 1)}){dice.choice(['*', '+', '?', '{1,2}', '{2}', '{0,}'])}"
        return f"^{pattern(depth + 1)}" if kind < 9 else f"{pattern(depth + 1)}$"

    for _ in range(5000):
        text, name = pattern(), "".join(dice.choice("abc.") for _ in range(dice.randrange(8)))
        assert PosixPattern(text).is_in(name) is bool(re.search(text, name)), (text, name)
    assert PosixPattern("[[:alpha:]][[:digit:]_]").is_in("robot_1")
    assert PosixPattern("x[]y]").is_in("x]")


MANY_TIMES = "(" * 9 + ")" + "{255})" * 8


@pytest.mark.parametrize(
    "text",
    ["(", ")", "[", "[a", "[[:x:]]", "*", "a|*", "a{", "a{2,1}", "a{999}", "\\", "(" * 60, "(" * 2000, MANY_TIMES],
)
def test_no_pattern_holds_up_the_world(text: str) -> None:
    with pytest.raises(UsageError):
        PosixPattern(text).is_in("robot")


def test_a_pattern_of_many_repeats_is_too_large_or_says_no() -> None:
    assert not PosixPattern("a{255}{255}{255}{255}").is_in("a" * 200)
    with pytest.raises(UsageError, match="too large"):
        PosixPattern("a" + "{1}" * 2000).is_in("a")


def test_a_pattern_that_takes_long_is_given_up() -> None:
    pattern = PosixPattern("(a?){200}b")
    with pytest.raises(UsageError, match="takes too long"):
        pattern.is_in("a" * 1000)
