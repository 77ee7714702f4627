"""Foxglove's gateway with apps: what they see, publish, call and set, and what becomes of those that do harm."""

from __future__ import annotations

import itertools
import json
import os
import re
import socket
import struct
import threading
from base64 import b64decode
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import node_scripts
import pytest
from daemon_fixture import ROOT, Runtime, running_daemon
from foxglove_app import FoxgloveApp
from running_gateway import log, running_gateway
from waiting import eventually
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from slidectl.client import Client
from slidectl.errors import Refused
from slidectl.extensions.gateways import process
from slidectl.extensions.gateways.ros1.ros1_types import ros1_type
from slidectl.extensions.recording.codec import Codec

COMMAND = "/slider/joint1_position_controller/command"
STATES = "/slider/joint_states"
GAIN = "/slider/joint1_position_controller/pid/p"
MESH = "package://ramp_description/meshes/ramp.stl"


@pytest.fixture(scope="module")
def world() -> Iterator[Runtime]:
    """A daemon with the slider under control."""
    with running_daemon() as daemon:
        spawn_slider(daemon)
        yield daemon


@pytest.fixture(scope="module")
def address(world: Runtime) -> Iterator[str]:
    with running_gateway(world, "foxglove") as address:
        yield address
    assert "Traceback" not in log(world, "foxglove")


@pytest.fixture
def app(address: str) -> Iterator[FoxgloveApp]:
    with FoxgloveApp(address) as app:
        yield app


@pytest.fixture
def client(world: Runtime) -> Iterator[Client]:
    with suppress(Exception), world.client() as client:
        yield client


def spawn_slider(daemon: Runtime) -> None:
    with daemon.client() as client:
        client.spawn(
            "slider",
            controllers=str(ROOT / "config/slider_control.yaml"),
            start=["joint_state_controller", "joint1_position_controller"],
        )


def status(runtime: Runtime) -> dict[str, str]:
    with runtime.client() as client:
        answer = client.call("/slidectl/gateways/foxglove")
    return dict(zip(answer["names"], answer["values"], strict=True))


def float64(value: float) -> bytes:
    return ros1_type("std_msgs/Float64").pack({"data": value})


# --- topics -----------------------------------------------------------------------------------------------------------


def test_an_app_decodes_messages_with_the_schema_that_it_was_given(app: FoxgloveApp) -> None:
    channel = app.channel(STATES)
    assert channel["encoding"] == "ros1"
    assert channel["schemaEncoding"] == "ros1msg"
    subscription = app.subscribe(STATES)
    published = app.wait("message", subscription=subscription)
    decoded = Codec("sensor_msgs/JointState", channel["schema"], "").decode(published["data"])
    assert decoded["name"] == ["joint1"]
    stamp = decoded["header"]["stamp"]
    assert published["time_ns"] == stamp["secs"] * 10**9 + stamp["nsecs"]
    assert app.message(STATES, subscription)["header"]["seq"] == decoded["header"]["seq"] + 1


def test_a_topic_is_subscribed_at_the_daemon_while_an_app_subscribes_it(
    app: FoxgloveApp, address: str, client: Client
) -> None:
    def subscribers() -> list[str]:
        return list(client.call("/rosapi/subscribers", {"topic": STATES})["subscribers"])

    assert subscribers() == []
    subscription = app.subscribe(STATES)
    eventually(lambda: subscribers() == ["/foxglove_gateway"])
    with FoxgloveApp(address) as other:
        also = other.subscribe(STATES)
        other.message(STATES, also)
        app.send("unsubscribe", subscriptionIds=[subscription])
        other.message(STATES, also)
        assert "/foxglove_gateway" in subscribers()
    eventually(lambda: subscribers() == [])


def test_every_app_gets_what_was_latched(app: FoxgloveApp, address: str, client: Client) -> None:
    client.publish("/greeting", {"data": "hello"}, "std_msgs/String", latch=True)
    client.flush()
    assert app.message("/greeting", app.subscribe("/greeting")) == {"data": "hello"}
    with FoxgloveApp(address) as other:
        assert other.message("/greeting", other.subscribe("/greeting")) == {"data": "hello"}


@pytest.mark.parametrize(("encoding", "target"), [("ros1", 0.5), ("json", -0.5)])
def test_a_command_of_an_app_moves_the_slider(app: FoxgloveApp, encoding: str, target: float) -> None:
    channel = app.advertise(COMMAND, "std_msgs/Float64", encoding)
    app.publish(channel, float64(target) if encoding == "ros1" else json.dumps({"data": target}).encode())
    subscription = app.subscribe(STATES)
    eventually(lambda: abs(app.message(STATES, subscription)["position"][0] - target) < 0.05)


def test_an_app_publishes_a_topic_of_its_own_with_times_as_it_has_them(app: FoxgloveApp, client: Client) -> None:
    channel = app.advertise("/from_app", "geometry_msgs/msg/PointStamped", "json")
    app.channel("/from_app")
    got = client.subscribe("/from_app")
    app.publish(channel, b'{"header": {"stamp": {"sec": 3, "nsec": 4}}, "point": {"x": 1.5}}')
    message = got.get(timeout=20)
    assert message["header"]["stamp"] == {"secs": 3, "nsecs": 4}
    assert message["point"]["x"] == 1.5
    got.close()
    app.send("unadvertise", channelIds=[channel])
    while "/from_app" in app.channels:
        app.receive()


def test_an_app_is_told_why_its_message_was_refused(app: FoxgloveApp) -> None:
    channel = app.advertise(COMMAND, "std_msgs/Float64")
    app.publish(channel, b"\x00\x00")
    assert "2 bytes that are not std_msgs/Float64" in app.error()
    app.publish(channel, float64(float("nan")))
    assert "it must be a finite number, not nan or infinity" in app.error()
    app.advertise(COMMAND, "std_msgs/NoSuchType")
    assert "no message type 'std_msgs/NoSuchType'" in app.error()


# --- services, parameters, time, graph, files -------------------------------------------------------------------------


def test_an_app_calls_services_in_both_encodings(app: FoxgloveApp) -> None:
    name = "/slider/controller_manager/list_controllers"
    answer = app.call(name)
    assert {one["name"] for one in answer["controller"]} == {"joint_state_controller", "joint1_position_controller"}
    call = app.begin_call(name, b"{}", "json")
    assert json.loads(app.wait("response", call=call)["data"]) == answer


def test_a_failing_call_tells_the_reason(app: FoxgloveApp) -> None:
    with pytest.raises(AssertionError, match="no robot 'nobody'"):
        app.call("/slidectl/trace", {"robot": "nobody", "joint": "", "last": 1.0, "duration": 0.0})
    call = app.begin_call("/slidectl/status", b"[1", "json")
    assert "not JSON" in app.wait("serviceCallFailure", callId=call)["message"]


def test_parameters_are_read_set_and_refused(app: FoxgloveApp, client: Client) -> None:
    app.send("getParameters", parameterNames=[], id="all")
    parameters = {each["name"]: each for each in app.wait("parameterValues", id="all")["parameters"]}
    assert parameters[GAIN]["type"] == "float64"
    assert parameters["/use_sim_time"]["value"] is True
    assert parameters["/slider/robot_description"]["value"].startswith("<?xml")
    app.send("setParameters", parameters=[{"name": GAIN, "value": 120, "type": "float64"}], id="set")
    assert app.wait("parameterValues", id="set")["parameters"] == [{"name": GAIN, "value": 120.0, "type": "float64"}]
    assert json.loads(client.call("/rosapi/get_param", {"name": GAIN})["value"]) == 120.0
    app.send("setParameters", parameters=[{"name": GAIN, "value": "much"}, {"name": "/mine", "value": [1, 2]}], id="2")
    assert GAIN in app.error()
    assert app.wait("parameterValues", id="2")["parameters"][1] == {"name": "/mine", "value": [1, 2]}


def test_an_app_hears_of_parameters_that_others_set(app: FoxgloveApp, client: Client) -> None:
    app.send("subscribeParameterUpdates", parameterNames=[GAIN, "/shared"])
    app.send("getParameters", parameterNames=[GAIN], id="now")
    app.wait("parameterValues", id="now")
    client.call("/rosapi/set_param", {"name": GAIN, "value": "80.0"})

    def hears(expected: dict[str, Any]) -> None:
        while expected not in app.wait("parameterValues")["parameters"]:  # the gain may be told twice
            pass

    hears({"name": GAIN, "value": 80.0, "type": "float64"})
    client.call("/rosapi/set_param", {"name": "/shared", "value": '"x"'})
    hears({"name": "/shared", "value": "x"})
    client.call("/rosapi/delete_param", {"name": "/shared"})
    hears({"name": "/shared"})


def test_the_time_is_that_of_the_simulation_and_stands_while_it_is_paused(app: FoxgloveApp, address: str) -> None:
    assert app.wait("time")["time_ns"] < app.wait("time")["time_ns"]
    app.call("/gazebo/pause_physics")
    try:
        with FoxgloveApp(address) as other:
            stopped = other.wait("time")["time_ns"]
            other.call("/slidectl/step", {"cycles": 5, "news": False})
            eventually(lambda: other.wait("time")["time_ns"] == stopped + 5_000_000)
    finally:
        app.call("/gazebo/unpause_physics")


def test_an_app_sees_who_is_connected_with_whom(app: FoxgloveApp, world: Runtime) -> None:
    app.send("subscribeConnectionGraph")
    whole = app.wait("connectionGraphUpdate")
    assert {each["name"]: each["publisherIds"] for each in whole["publishedTopics"]}[STATES] == ["/gazebo"]
    assert {each["name"] for each in whole["advertisedServices"]} >= {"/slider/controller_manager/list_controllers"}
    with world.client() as other:
        other.advertise("/passing", "std_msgs/Float64")
        other.flush()
        while "/passing" not in [each["name"] for each in app.wait("connectionGraphUpdate")["publishedTopics"]]:
            pass
    while "/passing" not in app.wait("connectionGraphUpdate")["removedTopics"]:
        pass
    assert "/passing" not in app.channels


@pytest.fixture(scope="module")
def ramp(world: Runtime, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot with a mesh of a package, in the world. Returns the package's folder."""
    package = tmp_path_factory.mktemp("packages") / "ramp_description"
    (package / "meshes").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>ramp_description</name></package>")
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    facets = [struct.pack("<12fH", 0, 0, 0, *(x for c in face for x in corners[c]), 0) for face in faces]
    (package / "meshes/ramp.stl").write_bytes(b"\0" * 80 + struct.pack("<I", len(facets)) + b"".join(facets))
    (package / "meshes/secret.stl").write_bytes(b"secret")
    (package / "ramp.urdf").write_text(
        f'<robot name="ramp"><link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" '
        f'ixy="0" ixz="0" iyz="0"/></inertial>'
        f'<visual><geometry><mesh filename="{MESH}"/></geometry></visual></link></robot>'
    )
    with world.client() as client:
        client.spawn(str(package / "ramp.urdf"), at=(3, 0, 1))
    return package


def test_an_app_gets_meshes_of_robots_and_nothing_else_of_the_disk(app: FoxgloveApp, ramp: Path) -> None:
    answer = app.fetch(MESH)
    assert answer["error"] == ""
    assert answer["data"] == (ramp / "meshes/ramp.stl").read_bytes()
    folder = MESH.rpartition("/")[0]
    for uri in (
        f"{folder}/secret.stl",
        f"{folder}/../package.xml",
        f"{folder}/../meshes/ramp.stl",
        f"file://{ramp}/meshes/secret.stl",
        f"file://{ramp}/meshes/ramp.stl",
        "file:///etc/passwd",
        "/etc/passwd",
        "package://ramp_description/../../../../etc/passwd",
        "\ud800",
        "",
    ):
        answer = app.fetch(uri)
        assert not answer["is_there"]
        assert "no asset" in answer["error"]


def test_foxgloves_own_client_sees_topics_and_calls_publishes_and_sets(
    address: str, ramp: Path, client: Client
) -> None:
    client.call("/rosapi/set_param", {"name": GAIN, "value": "100.0"})
    seen = json.loads(node_scripts.run("foxglove.mjs", address, MESH))
    assert {"clientPublish", "services", "parameters", "time", "connectionGraph", "assets"} <= set(seen["capabilities"])
    assert seen["time"] > 0
    codec = Codec("sensor_msgs/JointState", seen["channel"]["schema"], "")
    assert codec.decode(b64decode(seen["message"]))["name"] == ["joint1"]
    assert seen["service"]["type"] == "controller_manager_msgs/ListControllers"
    assert len(seen["answer"]["controller"]) == 2
    assert seen["failure"] == "there is no service 4000000"
    assert (seen["before"]["value"], seen["after"]["value"]) == (100, 90)
    assert seen["asset"]["size"] == (ramp / "meshes/ramp.stl").stat().st_size
    assert seen["noAsset"]["status"] == 1
    with FoxgloveApp(address) as app:
        subscription = app.subscribe(STATES)
        eventually(lambda: abs(app.message(STATES, subscription)["position"][0] - 0.25) < 0.05)


# --- daemons that come and go -----------------------------------------------------------------------------------------


def test_apps_stay_connected_when_the_daemon_restarts() -> None:
    with running_daemon() as daemon:
        spawn_slider(daemon)
        with running_gateway(daemon, "foxglove") as address, FoxgloveApp(address) as app:
            session = app.wait("serverInfo")["sessionId"]
            app.message(STATES, app.subscribe(STATES))
            channel = app.advertise(COMMAND, "std_msgs/Float64")
            app.send("subscribeParameterUpdates", parameterNames=[GAIN])
            daemon.stop()
            assert "the daemon has ended" in app.wait("status", id="no-daemon")["message"]
            while app.channels or app.services:
                app.receive()
            app.publish(channel, float64(1.0))
            assert "no daemon" in app.error()
            with FoxgloveApp(address) as other:
                assert "the daemon has ended" in other.wait("status", id="no-daemon")["message"]
            daemon.start()
            assert app.wait("serverInfo")["sessionId"] != session
            spawn_slider(daemon)
            gain = {"name": GAIN, "value": 100.0, "type": "float64"}
            eventually(lambda: gain in app.wait("parameterValues")["parameters"])
            subscription = app.subscribe(STATES)
            app.publish(channel, float64(0.5))
            eventually(lambda: abs(app.message(STATES, subscription)["position"][0] - 0.5) < 0.05)


def test_a_channel_goes_with_its_robot_though_an_app_subscribes_it(app: FoxgloveApp, client: Client) -> None:
    client.spawn("rrbot")
    controllers = str(ROOT / "config/rrbot_control.yaml")
    client.call("/gazebo/delete_model", {"model_name": "rrbot"})
    client.spawn("rrbot", controllers=controllers, start=["joint_state_controller"])
    topic = "/rrbot/joint_states"
    app.message(topic, app.subscribe(topic))
    client.call("/gazebo/delete_model", {"model_name": "rrbot"})
    while topic in app.channels:
        app.receive()


# --- harm -------------------------------------------------------------------------------------------------------------


def test_nonsense_is_answered_with_an_error_and_the_app_stays(app: FoxgloveApp) -> None:
    app.channel(STATES)
    for frame in (
        "", "{", "[]", "null", '{"op": 1}', '{"op": "fly"}', "[" * 100_000,
        '{"op":' * 50_000, "[" + "1," * 200_000 + "1]",
        '{"op": "subscribe"}', '{"op": "subscribe", "subscriptions": [1]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 123456}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1e999, "channelId": true}]}',
        '{"op": "advertise", "channels": [{"id": 1, "topic": "no name", "encoding": "ros1", "schemaName": "x"}]}',
        '{"op": "advertise", "channels": [{"id": 1, "topic": "/a", "encoding": "cdr", "schemaName": "x"}]}',
        '{"op": "getParameters", "parameterNames": [1]}',
        '{"op": "getParameters", "parameterNames": [], "id": 3}',
        '{"op": "setParameters", "parameters": [{"name": 1}]}',
        '{"op": "setParameters", "parameters": [{"name": "/a", "value": 1, "type": "byte_array"}]}',
        '{"op": "setParameters", "parameters": [{"name": "a b", "value": 1}]}',
        '{"op": "fetchAsset", "uri": 1, "requestId": 1}',
        b"", b"\x00", b"\x01", b"\x01\x00\x00\x00\x00", b"\x02\x00\x00", b"\xff" * 100,
        struct.pack("<BIII", 2, 1, 1, 2**32 - 1) + b"ros1",
    ):  # fmt: skip
        app.websocket.send(frame)
        assert app.error()
    app.message(STATES, app.subscribe(STATES))


def test_a_huge_message_ends_its_connection_alone(app: FoxgloveApp, address: str) -> None:
    subscription = app.subscribe(STATES)
    with FoxgloveApp(address) as other:
        with suppress(ConnectionClosed):
            other.websocket.send(b"\x01" * (40 * 2**20))
        with pytest.raises(ConnectionClosed, match=r"1009|no close frame"):
            other.wait("nothing")
    app.message(STATES, subscription)


def test_an_app_that_does_not_read_loses_the_oldest_messages_and_the_others_lose_none(
    world: Runtime, address: str, client: Client
) -> None:
    """`/clock` comes a thousand times a second."""
    before = int(status(world)["dropped"])
    client.advertise("/much", "std_msgs/String")
    with FoxgloveApp(address) as reader, FoxgloveApp(address) as stopped:
        stopped.subscribe("/clock")
        stopped.subscribe("/much")
        subscription = reader.subscribe("/clock")
        reader.message("/clock", subscription)
        times: list[int] = []
        is_over = threading.Event()

        def read() -> None:
            while not is_over.is_set():
                times.append(reader.wait("message", subscription=subscription)["time_ns"])

        thread = threading.Thread(target=read)
        thread.start()
        try:
            for _ in range(35):
                for _ in range(10):
                    client.publish("/much", {"data": "x" * 100_000})
                client.flush()
            eventually(lambda: int(status(world)["dropped"]) > before)
            eventually(lambda: len(times) > 1000)
        finally:
            is_over.set()
            thread.join()
        assert {later - time_ns for time_ns, later in itertools.pairwise(times)} == {1_000_000}
        assert resident_bytes(world) < 300 * 2**20


def resident_bytes(runtime: Runtime) -> int:
    """Of the gateway's process."""
    with runtime.environment():
        found = process.find(runtime.paths, "foxglove")
    assert found is not None
    pages = int(Path(f"/proc/{found.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def test_a_foreign_page_and_one_without_the_token_stay_outside() -> None:
    def outcome(place: str, **headers: str) -> int:
        """The status of HTTP; 0 for one that is let in."""
        try:
            with FoxgloveApp(place, additional_headers=headers) as app:
                app.wait("serverInfo")
        except InvalidStatus as refused:
            return refused.response.status_code
        return 0

    with running_daemon() as daemon:
        with running_gateway(daemon, "foxglove") as address:
            assert outcome(address, Origin="https://evil.example") == 403
            assert outcome(address, Origin="null") == 403
            assert outcome(address, Host="evil.example:8765") == 403
            for origin in ("https://app.foxglove.dev", "file://"):
                assert outcome(address, Origin=origin) == 0
            with pytest.raises(InvalidStatus):
                FoxgloveApp(address, "some.other.protocol")
        with running_gateway(daemon, "foxglove", token="a-long-secret", max_connections=2) as address:
            assert outcome(address) == 401
            assert outcome(f"{address}/?token=a-long-secreT") == 401
            assert outcome(f"{address}/?token=a-long-secret", Origin="https://evil.example") == 403
            place = f"{address}/?token=a-long-secret"
            assert outcome(place) == 0
            with FoxgloveApp(place), FoxgloveApp(place):
                assert outcome(place) == 503
            eventually(lambda: outcome(place) == 0)


def test_a_read_only_gateway_lets_apps_look_and_change_nothing() -> None:
    with running_daemon() as daemon:
        spawn_slider(daemon)
        with running_gateway(daemon, "foxglove", read_only=True) as address, FoxgloveApp(address) as app:
            assert "clientPublish" not in app.wait("serverInfo")["capabilities"]
            assert len(app.call("/slider/controller_manager/list_controllers")["controller"]) == 2
            assert "/slider/controller_manager/switch_controller" not in app.services
            assert "/gazebo/pause_physics" not in app.services
            app.advertise(COMMAND, "std_msgs/Float64")
            assert "read-only" in app.error()
            app.send("setParameters", parameters=[{"name": GAIN, "value": 1.0}], id="set")
            assert "read-only" in app.error()
            app.send("getParameters", parameterNames=[GAIN], id="get")
            assert app.wait("parameterValues", id="get")["parameters"][0]["value"] == 100.0


def test_many_connections_and_half_handshakes_leave_room_for_an_app(address: str, app: FoxgloveApp) -> None:
    host, _, port = address.removeprefix("ws://").rpartition(":")
    idle: list[socket.socket] = []
    try:
        for _ in range(300):
            with suppress(OSError):  # cut at once
                connection = socket.create_connection((host, int(port)), timeout=20)
                idle.append(connection)
                connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n")
        app.message(STATES, app.subscribe(STATES))
        eventually(lambda: sum(map(is_cut, idle)) >= 40)  # those that the kernel has taken are accepted in their turn
    finally:
        for connection in idle:
            connection.close()
    eventually(lambda: lets_in(address))


def is_cut(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def lets_in(address: str) -> bool:
    with suppress(OSError, InvalidHandshake, ConnectionClosed), FoxgloveApp(address) as app:
        return app.wait("serverInfo")["name"] == "slidectl"
    return False


def test_a_port_that_is_taken_is_said(address: str) -> None:
    port = int(address.rpartition(":")[2])
    with running_daemon() as daemon, pytest.raises(Refused, match=f"port {port} of localhost is taken"):  # noqa: SIM117
        with running_gateway(daemon, "foxglove", port=port):
            pass


def test_the_layout_of_the_docs_shows_what_there_is(app: FoxgloveApp) -> None:
    layout = json.loads((ROOT / "docs/foxglove-slider.json").read_text())
    panels = layout["configById"]
    published = panels["Publish!command"]
    assert app.channel(published["topicName"])["schemaName"] == published["datatype"]
    codec = Codec(published["datatype"], app.channel(published["topicName"])["schema"], "")
    assert codec.encode(json.loads(published["value"]))
    for path in panels["Plot!position"]["paths"]:
        topic, _, field = path["value"].partition(".")
        subscription = app.subscribe(topic)
        assert field in app.message(topic, subscription)
        app.send("unsubscribe", subscriptionIds=[subscription])
    for name in ("CallService!pause", "CallService!unpause"):
        assert app.service(panels[name]["serviceName"])
    parameter = panels["3D!robot"]["layers"]["slider"]["parameter"]
    app.send("getParameters", parameterNames=[parameter], id="urdf")
    assert "<robot" in app.wait("parameterValues", id="urdf")["parameters"][0]["value"]
    named = re.findall(r'"(\w+![\w]+)"', json.dumps(layout["layout"]))
    assert sorted(named) == sorted(panels)
