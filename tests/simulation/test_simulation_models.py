"""Models of SDF in the world: without controllers, and otherwise like robots."""

from __future__ import annotations

from typing import Any

import pytest

from slidectl import description
from slidectl.simulation import Simulation

BOX = """<sdf version="1.6"><model name="box"><pose>1 0 0.5 0 0 0</pose>{more}<link name="l">
<collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision></link></model></sdf>"""
TWO = BOX.format(more="<link name='other'><pose>5 0 0 0 0 0</pose></link>")


def ask(simulation: Simulation, service: str, **request: Any) -> dict[str, Any]:
    answer: dict[str, Any] = simulation.call(f"/gazebo/{service}", request)
    return answer


def spawn(simulation: Simulation, xml: str, name: str = "thing", **request: Any) -> dict[str, Any]:
    return ask(simulation, "spawn_sdf_model", model_name=name, model_xml=xml, **request)


def robot(simulation: Simulation, name: str) -> dict[str, Any]:
    [found] = simulation.call("/slidectl/list_robots", {"name": name})["robots"]
    return dict(found)


def test_a_model_stands_where_its_file_and_the_request_say_and_has_no_controller_manager() -> None:
    simulation = Simulation()
    at = {"position": {"x": 2.0}, "orientation": {"w": 1.0}}
    assert spawn(simulation, BOX.format(more=""), initial_pose=at)["success"]
    assert robot(simulation, "thing")["kind"] == "model"
    assert robot(simulation, "thing")["pose"][:3] == pytest.approx([3.0, 0.0, 0.5])
    services = simulation.call("/rosapi/services")["services"]
    assert not [service for service in services if "controller_manager" in service]
    assert not simulation.parameters.has("/thing/robot_description")
    simulation.step(100)
    assert ask(simulation, "get_link_state", link_name="thing::l")["success"]
    simulation.call("/gazebo/reset_simulation")
    assert ask(simulation, "delete_model", model_name="thing")["success"]
    assert ask(simulation, "get_world_properties")["model_names"] == []


def test_a_static_model_is_said_to_be_one_and_is_in_no_cycle() -> None:
    simulation = Simulation()
    spawn(simulation, BOX.format(more="<static>1</static>"))
    assert robot(simulation, "thing")["kind"] == "static"
    assert ask(simulation, "get_model_properties", model_name="thing")["is_static"]
    assert simulation.loop.robots == ()


def test_urdf_that_has_transmissions_is_a_robot_whichever_service_spawns_it() -> None:
    simulation = Simulation()
    assert spawn(simulation, description.load("slider").xml, "slider")["success"]
    assert robot(simulation, "slider")["kind"] == "robot"


def test_all_parts_of_a_model_are_spawned_or_none() -> None:
    simulation = Simulation()
    assert spawn(simulation, TWO)["success"]
    assert ask(simulation, "get_world_properties")["model_names"] == ["thing", "thing_l"]
    ask(simulation, "delete_model", model_name="thing")
    answer = spawn(simulation, TWO)
    assert not answer["success"]
    assert "thing_l" in answer["status_message"]
    assert ask(simulation, "get_world_properties")["model_names"] == ["thing_l"]


def test_an_emergency_stop_concerns_robots_and_refuses_a_model_by_name() -> None:
    simulation = Simulation()
    spawn(simulation, BOX.format(more=""))
    simulation.spawn(description.load("slider").xml, "slider")
    assert simulation.call("/slidectl/estop", {"stop": True})["robots"] == ["slider"]
    answer = simulation.call("/slidectl/estop", {"names": ["thing"], "stop": True})
    assert "without a controller manager" in answer["message"]
