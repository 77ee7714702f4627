"""Nodes of the real rclpy beside a world of slidectl, each in a process of its own."""

from __future__ import annotations

import json
import math
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from daemon_fixture import send, shown
from ros2_environment import DISTRIBUTIONS, folder_of
from ros2_node import Ros2Node
from ros2_world import SPAWN, World, running_world, serving
from waiting import eventually

from slidectl.client import Client
from slidectl.operating_system import LINUX

CONTROLLER = "/slider/joint1_position_controller"
JOINT_STATE, FLOAT, TRIGGER = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64", "std_srvs/srv/Trigger"


@pytest.fixture(scope="module", params=list(DISTRIBUTIONS))
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    with running_world(folder_of(request.param)) as one:
        yield one


@pytest.fixture(scope="module")
def node(world: World) -> Iterator[Ros2Node]:
    with world.node("/test/listener") as one:
        yield one


def _reaches(world: World, node: Ros2Node, name: str, topic: str) -> None:
    """Wait until the daemon and a publisher of ROS 2 know each other: what it sends before is lost."""
    eventually(lambda: name in world.run("topic", "info", topic).stdout)
    eventually(lambda: node.all_are_reached(topic))


def test_joint_states_and_the_clock_are_those_of_the_world(world: World, node: Ros2Node) -> None:
    node.subscribe("/slider/joint_states", JOINT_STATE)
    node.subscribe("/clock", "rosgraph_msgs/msg/Clock", "best_effort")
    state = node.gets("/slider/joint_states")
    assert state["name"] == ["joint1"]
    assert math.isfinite(state["position"][0])
    node.use_sim_time()
    with world.client() as client:
        eventually(lambda: abs(node.time() - client.call("/slidectl/status")["time"]) < 1.0)
    seconds = [one["clock"]["sec"] + one["clock"]["nanosec"] * 1e-9 for one in node.messages("/clock")]
    assert seconds == sorted(seconds)


def test_a_command_moves_the_joint_and_the_daemon_names_the_node(world: World) -> None:
    with world.node("/my_planner") as planner:
        planner.advertise(f"{CONTROLLER}/command", FLOAT)
        _reaches(world, planner, "/my_planner", f"{CONTROLLER}/command")
        planner.publish(f"{CONTROLLER}/command", {"data": 0.7})
        with world.client() as client:

            def set_point() -> float:
                with client.subscribe(f"{CONTROLLER}/state", queue_length=1) as state:
                    return float(state.get(timeout=60)["set_point"])

            eventually(lambda: set_point() == 0.7)
        planner.process.kill()
    eventually(lambda: "/my_planner" not in world.run("topic", "info", f"{CONTROLLER}/command").stdout)


def test_the_description_of_a_robot_reaches_who_comes_later(node: Ros2Node) -> None:
    node.subscribe("/slider/robot_description", "std_msgs/msg/String", "transient")
    assert '<robot name="slider">' in node.gets("/slider/robot_description")["data"]
    assert node.publishers_of("/slider/robot_description") == 1


def test_a_latched_message_stays_when_another_publisher_goes(world: World, node: Ros2Node) -> None:
    topic = "/test/latched"
    with world.client() as stays:
        with world.client() as goes:
            for client, name, number in ((goes, "/first", 1.0), (stays, "/second", 2.0)):
                send(client, op="set_node", node=name)
                client.publish(topic, {"data": number}, "std_msgs/Float64", latch=True)
                client.flush()
            node.subscribe(topic, FLOAT, "transient")
            node.gets(topic, lambda message: message["data"] == 2.0)
            eventually(lambda: "/first" in node.nodes())
        eventually(lambda: "/second" in node.nodes())
        with world.node("/later") as later:
            later.subscribe(topic, FLOAT, "transient")
            later.gets(topic, lambda message: message["data"] == 2.0)


def test_nodes_and_topics_have_the_names_of_the_world(node: Ros2Node) -> None:
    wanted = {CONTROLLER, "/slider/joint_state_controller", "/slider/controller_manager", "/gazebo"}
    eventually(lambda: wanted <= set(node.nodes()))
    assert node.topics()["/slider/joint_states"] == [JOINT_STATE]
    assert f"{CONTROLLER}/get_parameters" in node.services()
    assert f"{CONTROLLER}/get_type_description" not in node.services()  # nobody would answer


def test_parameters_are_those_of_the_controller(world: World, node: Ros2Node) -> None:
    def call(service: str, **values: Any) -> Any:
        kind = "".join(part.capitalize() for part in service.split("_"))
        return node.call(f"{CONTROLLER}/{service}", f"rcl_interfaces/srv/{kind}", values)

    def of(name: str, **value: Any) -> dict[str, Any]:
        return {"name": name, "value": value}

    assert {"pid.p", "pid.d", "type", "joint"} <= set(call("list_parameters")["result"]["names"])
    assert call("list_parameters", prefixes=["pid"], depth=1)["result"]["names"][:2] == ["pid.antiwindup", "pid.d"]
    assert call("list_parameters", prefixes=["no", "pid.p", "joint"])["result"]["names"] == ["joint", "pid.p"]
    assert call("list_parameters", depth=1)["result"]["names"] == ["joint", "type"]
    values = call("get_parameters", names=["pid.p", "type", "no_such"])["values"]
    assert [one["type"] for one in values] == [3, 4, 0]
    assert values[1]["string_value"] == "effort_controllers/JointPositionController"
    assert call("get_parameter_types", names=["pid.p", "no_such"])["types"] == [3, 0]
    assert call("describe_parameters", names=["joint"])["descriptors"][0]["type"] == 4
    [result] = call("set_parameters", parameters=[of("pid.p", type=3, double_value=117.0)])["results"]
    assert result["successful"]
    with world.client() as client:
        assert client.params.get(f"{CONTROLLER}/pid/p") == 117.0
    bad = [of("pid.p", type=4, string_value="much"), of("pid.d", type=3, double_value=2.0)]
    refused = call("set_parameters_atomically", parameters=bad)["result"]
    assert not refused["successful"]
    assert f"parameter {CONTROLLER}/pid/p must be a number" in refused["reason"]
    assert call("get_parameters", names=["pid.d"])["values"][0]["double_value"] != 2.0
    [refused] = call("set_parameters", parameters=[of("pid.p", type=0)])["results"]
    assert "slidectl param delete" in refused["reason"]


def test_the_commands_of_the_page_do_what_they_say(world: World, node: Ros2Node) -> None:
    """Carried out as `ros2` would: the wheels do not have it."""
    begin = shown("ros2.md", "slidectl daemon start --ros2")
    assert begin[1] == ["slidectl", "daemon", "start", "--ros2"]
    assert begin[2][1:] == SPAWN
    for _, *words in shown("ros2.md", "ros2 topic echo")[:4]:
        match words:
            case ["topic", "echo", topic]:
                eventually(lambda topic=topic: topic in node.topics())
            case ["topic", "pub", "--once", topic, kind, values]:
                node.advertise(topic, kind)
                eventually(lambda topic=topic: node.subscribers(topic))
                node.publish(topic, yaml.safe_load(values))
            case ["param", "set", name, parameter, value]:
                given = [{"name": parameter, "value": {"type": 3, "double_value": float(value)}}]
                kind = "rcl_interfaces/srv/SetParameters"
                [result] = node.call(f"{name}/set_parameters", kind, {"parameters": given})["results"]
                assert result["successful"]
            case ["service", "call", service, kind]:
                node.call(service, kind, {})
            case _:
                pytest.fail(f"not carried out: {words}")
    with world.client() as client:
        assert client.params.get(f"{CONTROLLER}/pid/p") == 120.0
        assert client.call("/slidectl/status")["paused"]
        client.resume()
        with client.subscribe(f"{CONTROLLER}/state", queue_length=1) as state:
            eventually(lambda: state.get(timeout=60)["set_point"] == 1.0)


def test_services_are_called_both_ways(world: World, node: Ros2Node) -> None:
    with world.client() as client:
        node.call("/gazebo/pause_physics", "std_srvs/srv/Empty", {})
        assert client.call("/slidectl/status")["paused"]
        node.call("/gazebo/unpause_physics", "std_srvs/srv/Empty", {})
        assert not client.call("/slidectl/status")["paused"]

        async_answer = {"success": True, "message": "from ROS 2"}
        node.offer("/test/trigger", TRIGGER, async_answer)
        eventually(lambda: "/test/trigger" in world.run("service", "list").stdout)
        assert client.call("/test/trigger") == async_answer
    node.offer("/test/set", "std_srvs/srv/SetBool", {"success": True, "message": "done"})
    eventually(lambda: "/test/set" in world.run("service", "list").stdout)
    assert "done" in world.run("service", "call", "/test/set", "data: true").stdout
    assert node.messages("/test/set") == [{"data": True}]


def test_a_refused_call_of_a_node_carries_the_reason(world: World, node: Ros2Node) -> None:
    def fail(_: dict[str, Any]) -> dict[str, Any]:
        raise ValueError("the gripper is open")

    with world.client() as client:
        client.advertise_service("/test/grip", "std_srvs/Trigger", fail)
        with serving(client):
            answer = node.call("/test/grip", TRIGGER, {})
    assert answer == {"success": False, "message": "the gripper is open"}


def test_topics_of_nodes_are_the_daemons_too(world: World, node: Ros2Node) -> None:
    node.advertise("/test/numbers", FLOAT)
    eventually(lambda: "/test/numbers" in world.run("topic", "list").stdout)
    with world.client() as client, client.subscribe("/test/numbers", "std_msgs/Float64") as numbers:
        eventually(lambda: node.subscribers("/test/numbers"))
        node.publish("/test/numbers", {"data": 4.5})
        assert numbers.get(timeout=60)["data"] == 4.5
        node.publish("/test/numbers", {"data": math.inf}, 3)
        assert [numbers.get(timeout=60)["data"] for _ in range(3)] == [math.inf] * 3
    node.subscribe("/test/words", "std_msgs/msg/String")
    eventually(lambda: "/test/words" in world.run("topic", "list").stdout)
    with world.client() as client:
        client.advertise("/test/words", "std_msgs/String")
        eventually(lambda: client.publish("/test/words", {"data": "ü"}) is None and node.messages("/test/words"))
    assert node.messages("/test/words")[0] == {"data": "ü"}


def test_each_subscriber_gets_each_message_once(world: World) -> None:
    """Publishers and subscribers on both sides: nothing goes round in circles."""
    topic = "/test/both"
    with world.node("/both") as other, world.client() as client:
        other.subscribe(topic, FLOAT)
        other.advertise(topic, FLOAT)
        client.advertise(topic, "std_msgs/Float64")
        with client.subscribe(topic, "std_msgs/Float64") as here:
            eventually(
                lambda: client.publish(topic, {"data": -1.0}) is None and {"data": -1.0} in other.messages(topic)
            )
            eventually(lambda: other.subscribers(topic) == 2)
            eventually(lambda: other.publish(topic, {"data": -2.0}) is None and -2.0 in _drained(client, here))
            for number in range(10):
                client.publish(topic, {"data": float(number)})
                other.publish(topic, {"data": 100.0 + number})
            wanted = [*map(float, range(10)), *(100.0 + number for number in range(10))]
            seen: list[float] = []
            eventually(lambda: seen.extend(_drained(client, here)) is None and set(wanted) <= set(seen))
            eventually(lambda: set(wanted) <= {one["data"] for one in other.messages(topic)})
            client.sleep(1.0)  # in which what goes round would come again
            seen.extend(_drained(client, here))
            there = [one["data"] for one in other.messages(topic)]
            assert [seen.count(number) for number in wanted] == [1] * 20
            assert [there.count(number) for number in wanted] == [1] * 20


def _drained(client: Client, subscription: Any) -> list[float]:
    found = []
    for _ in client.events(timeout=0.05):
        pass
    while subscription.queue:
        found.append(subscription.get()["data"])
    return found


def test_who_publishes_briefly_reaches_a_subscriber(world: World, node: Ros2Node) -> None:
    node.subscribe("/test/brief", FLOAT)
    eventually(lambda: "/test/brief" in world.run("topic", "list").stdout)
    eventually(lambda: node.publishers_of("/test/brief"))
    for _ in range(20):
        world.run("pub", "/test/brief", "0.5")
        if node.messages("/test/brief"):
            break
    assert node.messages("/test/brief")[0] == {"data": 0.5}
    node.subscribe(f"{CONTROLLER}/command", FLOAT)
    eventually(lambda: node.publishers_of(f"{CONTROLLER}/command"))

    def arrives() -> bool:  # the publisher may still not have found the subscriber
        world.run("pub", f"{CONTROLLER}/command", "0.4")
        return {"data": 0.4} in node.messages(f"{CONTROLLER}/command")

    eventually(arrives)


def test_another_node_of_a_name_of_slidectl_is_named_in_the_log(world: World) -> None:
    with world.node("/gazebo") as double:
        double.advertise("/test/double", FLOAT)
        log = world.runtime.paths.folder / "gateway-ros2.log"
        eventually(lambda: "ROS 2 has another node /gazebo" in log.read_text("utf-8"))


def test_the_same_command_twice_arrives_twice(world: World, node: Ros2Node) -> None:
    """Though what slidectl published in between had the same value, and came back from ROS 2."""
    node.subscribe(f"{CONTROLLER}/command", FLOAT)
    with world.client() as client, client.subscribe(f"{CONTROLLER}/state", queue_length=1) as state:

        def arrives(value: float) -> None:
            eventually(lambda: state.get(timeout=60)["set_point"] == value, f"{value} does not arrive")

        for _ in range(3):
            client.publish(f"{CONTROLLER}/command", {"data": 0.5})
            arrives(0.5)
            for value in (0.75, 0.5):
                with world.node("/once") as once:
                    once.advertise(f"{CONTROLLER}/command", FLOAT)
                    _reaches(world, once, "/once", f"{CONTROLLER}/command")
                    once.publish(f"{CONTROLLER}/command", {"data": value})
                    arrives(value)


def test_a_message_that_cannot_be_had_is_left_out_alone(world: World) -> None:
    """ROS 1 has no times before 1970."""
    topic, kind = "/test/stamped", "geometry_msgs/msg/PointStamped"
    with world.node("/early") as early, world.client() as client:
        early.advertise(topic, kind)
        early.subscribe(topic, kind)
        with client.subscribe(topic, "geometry_msgs/PointStamped") as here:
            _reaches(world, early, "/early", topic)
            for second in (-1, 5):
                early.publish(topic, {"header": {"stamp": {"sec": second}}})
            assert here.get(timeout=60)["header"]["stamp"]["secs"] == 5
    assert f"{topic}: a message of ROS 2 is not taken" in world.log


def test_what_is_latched_late_is_kept_for_who_asks(world: World) -> None:
    topic = "/test/late_latch"
    with world.client() as client, world.node("/asks") as asks:
        client.advertise(topic, "std_msgs/Float64", latch=True)
        eventually(lambda: topic in asks.topics())
        client.publish(topic, {"data": 7.0}, latch=True)
        client.flush()
        asks.subscribe(topic, FLOAT, "transient")
        asks.gets(topic, lambda message: message["data"] == 7.0)


def test_what_a_node_keeps_is_latched_here(world: World) -> None:
    with world.node("/keeper") as keeper, world.client() as client:
        keeper.advertise("/test/kept", FLOAT, "transient")
        keeper.publish("/test/kept", {"data": 3.0})
        eventually(lambda: "/test/kept" in client.topics())
        for _ in range(2):
            with world.client() as late, late.subscribe("/test/kept", "std_msgs/Float64") as here:
                assert here.get(timeout=60)["data"] == 3.0


def test_a_program_that_only_looks_like_a_controller_manager_stops_nothing(world: World, node: Ros2Node) -> None:
    with world.client() as client:
        client.advertise_service("/odd/controller_manager/list_controllers", "std_srvs/Trigger", lambda _: {})
        client.advertise("/test/after_odd", "std_msgs/Float64")
        eventually(lambda: "/test/after_odd" in node.topics())


def test_a_publisher_without_reliable_delivery_is_heard(world: World) -> None:
    with world.node("/unsure") as other, world.client() as client:
        other.advertise("/test/unsure", FLOAT, "best_effort")
        with client.subscribe("/test/unsure", "std_msgs/Float64") as here:
            eventually(lambda: other.publish("/test/unsure", {"data": 1.0}) is None and _drained(client, here))


def test_every_common_type_survives_the_way_there_and_back(node: Ros2Node) -> None:
    result = node.round_trips()
    assert result["differ"] == []
    assert result["types"] > 80


def test_names_that_ros_2_does_not_accept_are_left_out_alone(world: World, node: Ros2Node) -> None:
    with world.client() as client:
        client.params["/lab/2nd/robot_description"] = "<robot/>"
        client.advertise("/lab/2nd/numbers", "std_msgs/Float64")
        client.advertise("/lab/second/numbers", "std_msgs/Float64")
        names = {"/lab/2nd/robot_description", "/lab/2nd/numbers"}
        eventually(lambda: names <= set(world.status()["left_out"].split(", ")))
        eventually(lambda: "/lab/second/numbers" in node.topics())
        del client.params["/lab/2nd/robot_description"]


@pytest.mark.skipif(not LINUX, reason="/proc says which sockets a process has")
def test_the_gateway_listens_on_loopback_alone(world: World) -> None:
    """A socket that only sends has a port, too: this one is not of the domain."""
    pid = int(json.loads(world.run("gateway", "ros2", "status", "--json").stdout)["pid"])
    links = [os.readlink(path) for path in Path(f"/proc/{pid}/fd").iterdir()]
    own = {link.removeprefix("socket:[").removesuffix("]") for link in links if link.startswith("socket:[")}
    rows = [line.split() for line in Path("/proc/net/udp").read_text("utf-8").splitlines()[1:]]
    heard = [address for _, address, *rest in rows if rest[7] in own for address in [address.split(":")]]
    ports = range(7400 + 250 * world.domain, 7400 + 250 * (world.domain + 1))  # DDS counts them so
    of_domain = [address for address, port in heard if int(port, 16) in ports]
    assert of_domain
    assert set(of_domain) == {"0100007F"}


def test_parameters_of_all_kinds_are_listed_as_far_as_ros_2_has_them(world: World, node: Ros2Node) -> None:
    values = {"i": [1, 2], "f": [1, 2.5], "s": ["a"], "none": [], "huge": [2**70], "mixed": [1, "a"], "b": [True]}
    with world.client() as client:
        for name, value in values.items():
            client.params[f"{CONTROLLER}/kinds/{name}"] = value
        names = [f"kinds.{name}" for name in values]
        kind = "rcl_interfaces/srv/GetParameterTypes"
        types = node.call(f"{CONTROLLER}/get_parameter_types", kind, {"names": names})["types"]
        del client.params[f"{CONTROLLER}/kinds"]
    assert dict(zip(values, types, strict=True)) == {
        "i": 7, "f": 8, "s": 9, "none": 9, "huge": 0, "mixed": 0, "b": 6,
    }  # fmt: skip


def test_what_ros_2_lacks_is_named_once(world: World) -> None:
    assert {"control_msgs", "controller_manager_msgs"} <= set(world.status()["left_out"].split(", "))
    lines = [line for line in world.log.splitlines() if "controller_manager_msgs" in line]
    assert len(lines) == 1
    assert "apt install ros-$ROS_DISTRO-controller-manager-msgs" in lines[0]


def test_a_topic_of_another_type_is_left_out(world: World, node: Ros2Node) -> None:
    with world.node("/confused") as confused:
        confused.advertise("/slider/joint_states", "std_msgs/msg/String")
        eventually(lambda: "/slider/joint_states" in world.status()["left_out"])
    count = len(node.messages("/slider/joint_states"))
    eventually(lambda: len(node.messages("/slider/joint_states")) > count)


def test_a_node_that_is_killed_is_listed_no_longer(world: World) -> None:
    with world.node("/doomed") as doomed:
        doomed.advertise("/test/doomed", FLOAT)
        eventually(lambda: "/test/doomed" in world.run("topic", "list").stdout)
        os.kill(doomed.process.pid, signal.SIGKILL)
    eventually(lambda: "/test/doomed" not in world.run("topic", "list").stdout, limit_s=120)


def test_the_daemon_goes_and_comes(world: World, node: Ros2Node) -> None:
    world.run("daemon", "restart")
    world.spawn()
    before = len(node.messages("/slider/joint_states"))
    eventually(lambda: len(node.messages("/slider/joint_states")) > before + 5)
    eventually(lambda: CONTROLLER in node.nodes())
    node.advertise(f"{CONTROLLER}/command", FLOAT)
    with world.client() as client, client.subscribe(f"{CONTROLLER}/state", queue_length=1) as state:
        eventually(
            lambda: (
                node.publish(f"{CONTROLLER}/command", {"data": 0.25}) is None
                and state.get(timeout=60)["set_point"] == 0.25
            )
        )


def test_a_flood_leaves_the_daemon_untouched(world: World) -> None:
    with world.node("/flood") as flood, world.client() as client:
        flood.advertise(f"{CONTROLLER}/command", FLOAT)
        _reaches(world, flood, "/flood", f"{CONTROLLER}/command")
        flood.publish(f"{CONTROLLER}/command", {"data": 0.1}, 20_000)
        assert client.call("/slidectl/status", timeout=60)["robots"]
        with client.subscribe(f"{CONTROLLER}/state", queue_length=1) as state:
            eventually(lambda: state.get(timeout=60)["set_point"] == 0.1)
