"""Robots come as a whole or not at all, and go without a trace."""

from __future__ import annotations

from typing import Any

import pytest
from sim_robots import cart, command, drive_up, logged, put_probe, running_cart, state, switch

from slidectl.errors import BadFile, BadName, Refused, SlidectlError, UnknownName
from slidectl.simulation import Simulation
from slidectl.simulation.simulation import SCRIPT_NODE


@pytest.fixture
def simulation() -> Simulation:
    return Simulation(ground=False)


def traces(simulation: Simulation) -> Any:
    graph = simulation.graph
    return (graph.topics.types(), graph.services.names(), graph.parameters.get("/"), simulation.world.names())


def test_a_robot_brings_its_manager_its_description_and_its_place_in_the_world(simulation: Simulation) -> None:
    xml = cart()
    robot = simulation.spawn(xml, "cart")
    assert robot.namespace == "/cart"
    assert simulation.parameters.get("/cart/robot_description") == xml
    assert "/cart/controller_manager/switch_controller" in simulation.graph.services.names()
    assert simulation.robots.names() == simulation.world.names() == ["cart"]


def test_the_namespace_is_the_one_asked_for_else_the_plugins_else_the_name(simulation: Simulation) -> None:
    tag = "<robotNamespace>/written</robotNamespace>"
    assert simulation.spawn(cart(tag), "a", "asked").namespace == "/asked"
    assert simulation.spawn(cart(tag), "b").namespace == "/written"
    assert simulation.spawn(cart(), "c").namespace == "/c"


@pytest.mark.parametrize("written", ["", "/", " / "])
def test_an_empty_namespace_of_the_plugin_is_the_root(simulation: Simulation, written: str) -> None:
    robot = simulation.spawn(cart(f"<robotNamespace>{written}</robotNamespace>"), "cart")
    assert robot.namespace == "/"
    assert "/controller_manager/switch_controller" in simulation.graph.services.names()
    with pytest.raises(Refused, match="the namespace / belongs to robot 'cart'"):
        simulation.spawn(cart("<robotNamespace/>"), "other")


def test_a_robot_in_the_root_gives_a_description_that_was_there_before_back(simulation: Simulation) -> None:
    simulation.parameters.set("/robot_description", "<robot/>")
    simulation.spawn(cart("<robotNamespace/>"), "cart")
    simulation.delete("cart")
    assert simulation.parameters.get("/robot_description") == "<robot/>"


def test_a_deleted_robot_leaves_nothing_behind_and_may_come_again(simulation: Simulation) -> None:
    before = traces(simulation)
    for _ in range(3):
        simulation.spawn(cart(), "cart")
        drive_up(simulation)
        simulation.step(10)
        simulation.delete("cart")
        simulation.parameters.delete("/cart")
        assert traces(simulation) == before
    simulation.step(10)


def test_a_name_or_namespace_that_is_taken_is_refused(simulation: Simulation) -> None:
    simulation.spawn(cart(), "cart")
    before = traces(simulation)
    with pytest.raises(Refused, match="a robot 'cart' already"):
        simulation.spawn(cart(), "cart", "/elsewhere")
    with pytest.raises(Refused, match="/cart belongs to robot 'cart'"):
        simulation.spawn(cart(), "other", "/cart")
    assert traces(simulation) == before


@pytest.mark.parametrize("name", ["", "a" * 1001])
def test_a_name_that_cannot_be_one_is_refused(simulation: Simulation, name: str) -> None:
    with pytest.raises(BadName):
        simulation.spawn(cart(), name)


@pytest.mark.parametrize(("name", "legal"), [("a/b", "a_b"), ("a b", "a_b"), ("9lives", "robot_9lives"), ("~x", "x")])
def test_another_name_is_made_legal(simulation: Simulation, name: str, legal: str) -> None:
    simulation.spawn(cart(), name)
    assert simulation.robots.names() == [legal]
    with pytest.raises(Refused, match=f"a robot '{legal}' already"):
        simulation.spawn(cart(), name)


def test_two_of_one_kind_stand_side_by_side(simulation: Simulation) -> None:
    simulation.spawn(cart(), "left")
    simulation.spawn(cart(), "right", pose=((0.0, 5.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
    for namespace in ("/left", "/right"):
        drive_up(simulation, namespace)
    command(simulation, 1.0, "/right/position1/command")
    simulation.step(3000)
    assert state(simulation, "left")[0] == 0.0
    assert state(simulation, "right")[0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("broken", "text"),
    [
        (lambda xml: xml.replace("</robot>", ""), "robot_description"),
        (lambda xml: xml.replace('value="1"', 'value="one"'), "box1"),
        (lambda xml: xml.replace("EffortJointInterface", "MagicInterface"), "Magic"),
        (
            lambda xml: xml.replace(
                'libgazebo_ros_control.so">', 'libgazebo_ros_control.so"><robotSimType>no/Such</robotSimType>'
            ),
            "no/Such",
        ),
    ],
    ids=["xml", "mass", "interface", "hardware"],
)
def test_a_robot_that_cannot_be_leaves_nothing_behind(simulation: Simulation, broken: Any, text: str) -> None:
    before = traces(simulation)
    with pytest.raises(SlidectlError, match=text):
        simulation.spawn(broken(cart()), "cart")
    assert traces(simulation) == before
    assert len(simulation.robots) == 0
    simulation.spawn(cart(), "cart")


def test_a_failing_part_of_a_robot_takes_the_robot_back(simulation: Simulation) -> None:
    before = traces(simulation)

    def fail(_robot: Any) -> Any:
        raise Refused("not with me")

    simulation.robots.on_spawn.append(fail)
    with pytest.raises(Refused, match="not with me"):
        simulation.spawn(cart(), "cart")
    assert traces(simulation) == before


def test_broken_xml_names_the_line(simulation: Simulation) -> None:
    with pytest.raises(BadFile, match=r"robot_description:\d+:"):
        simulation.spawn(cart().replace("</link>", "</lnk>", 1), "cart")


def test_an_unknown_robot_is_named_with_those_that_exist(simulation: Simulation) -> None:
    simulation.spawn(cart(), "cart")
    with pytest.raises(UnknownName, match="Did you mean 'cart'"):
        simulation.delete("carte")


def test_what_has_no_effect_is_on_the_log_and_in_the_listing(simulation: Simulation) -> None:
    lines = logged(simulation)
    xml = cart().replace("<gazebo>", '<gazebo reference="box1"><kp>1000</kp></gazebo><gazebo>')
    simulation.spawn(xml, "cart")
    assert any(severity == "warn" and "kp" in text and text.startswith("cart: ") for severity, text in lines)
    report = simulation.call("/slidectl/list_robots", {"name": "cart"})["robots"][0]["report"]
    assert any("kp" in notice["subject"] and notice["line"] > 0 for notice in report)


def test_list_robots_shows_links_joints_limits_and_controllers() -> None:
    simulation = running_cart()
    command(simulation, 1.0)
    simulation.step(100)
    (robot,) = simulation.call("/slidectl/list_robots")["robots"]
    assert (robot["name"], robot["namespace"], robot["fixed"]) == ("cart", "/cart", True)
    assert robot["links"] == ["world", "box1"]
    assert robot["controllers"] == ["states", "position1"]
    (joint,) = robot["joints"]
    assert (joint["name"], joint["type"]) == ("joint1", "prismatic")
    assert joint["hardware_interface"] == "hardware_interface/EffortJointInterface"
    assert (joint["lower"], joint["upper"], joint["max_effort"], joint["max_velocity"]) == (-100, 100, 1000, 1000)
    assert (joint["position"], joint["velocity"], joint["effort"]) == state(simulation)
    assert robot["pose"] == [0, 0, 0, 0, 0, 0, 1]
    with pytest.raises(UnknownName, match="carte"):
        simulation.call("/slidectl/list_robots", {"name": "carte"})


def test_robots_cannot_come_or_go_in_the_middle_of_a_cycle() -> None:
    simulation = running_cart()
    refusals: list[str] = []

    def meddle(_message: Any) -> None:
        for action in (lambda: simulation.delete("cart"), lambda: simulation.spawn(cart(), "b"), simulation.step):
            with pytest.raises(Refused, match="in the middle of a control cycle") as caught:
                action()
            refusals.append(str(caught.value))

    subscription = simulation.subscribe("/cart/joint_states", meddle)
    simulation.step(30)
    subscription.close()
    assert len(refusals) == 3
    assert simulation.robots.names() == ["cart"]


def test_a_timer_may_delete_a_robot_between_two_cycles() -> None:
    simulation = running_cart()
    simulation.graph.timers.at(5_000_000, lambda: simulation.delete("cart"))
    assert simulation.step(10) == 10
    assert simulation.robots.names() == []
    assert simulation.time_ns == 10_000_000


def test_a_running_robot_can_be_deleted(simulation: Simulation) -> None:
    simulation.spawn(cart(), "cart")
    drive_up(simulation)
    assert switch(simulation, stop=["position1"])
    simulation.delete("cart")
    assert simulation.step(5) == 5


@pytest.mark.parametrize("engine", ["plain", "auto"])
def test_the_controllers_of_a_robot_that_goes_are_stopped_first(engine: str) -> None:
    simulation = running_cart(engine=engine)
    simulation.delete("cart")
    robot = simulation.spawn(cart(joints=2), "cart")
    probe, idle = put_probe(simulation, robot), put_probe(simulation, robot, "idle", "joint2")
    assert switch(simulation, start=["probe"])
    simulation.step(20)
    probe.calls.clear()
    simulation.delete("cart")
    assert probe.calls == [("stopping", simulation.time_ns)]
    assert idle.calls == []


def test_a_controller_that_fails_to_stop_is_told_of_and_the_robot_goes_all_the_same(simulation: Simulation) -> None:
    robot = simulation.spawn(cart(), "cart")
    put_probe(simulation, robot)
    assert switch(simulation, start=["probe"])
    lines = logged(simulation)
    controller: Any = robot.manager.get("probe")
    controller.stopping = lambda _: 1 / 0
    simulation.delete("cart")
    assert any("ZeroDivisionError" in text for severity, text in lines if severity == "fatal")
    assert simulation.robots.names() == simulation.world.names() == []


@pytest.mark.parametrize("name", ["world", "map"])
def test_no_robot_can_have_a_name_of_the_worlds(simulation: Simulation, name: str) -> None:
    with pytest.raises(Refused, match=f"a robot cannot be named '{name}': .*the world itself\nchoose another name"):
        simulation.spawn(cart(), name)
    assert simulation.robots.names() == []


@pytest.mark.parametrize("name", ["gazebo", "rosapi", "slidectl", "clock", "tf"])
def test_a_robot_may_share_a_name_with_what_is_built_in(simulation: Simulation, name: str) -> None:
    before = traces(simulation)
    simulation.spawn(cart(), name)
    drive_up(simulation, f"/{name}")
    command(simulation, 0.5, f"/{name}/position1/command")
    simulation.step(2000)
    assert state(simulation, name)[0] == pytest.approx(0.5, abs=0.05)
    simulation.delete(name)
    simulation.graph.close_node(SCRIPT_NODE)
    simulation.parameters.delete(f"/{name}")
    assert traces(simulation) == before
