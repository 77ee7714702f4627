"""The gateway as a ROS master: names, addresses and parameters, for foreign nodes that speak nothing but XML-RPC."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from typing import Any
from urllib.parse import urlsplit
from xmlrpc.client import Binary, DateTime, Fault, MultiCall, ServerProxy

import pytest
from daemon_fixture import Runtime, running_daemon
from foreign_nodes import ForeignNode
from raw_websocket import descriptors, memory_mib
from running_gateway import log, running_gateway
from waiting import eventually

from slidectl.errors import Refused
from slidectl.extensions.gateways import process
from slidectl.extensions.gateways.ros1 import xmlrpc
from slidectl.wire.bounds import HeldBytes

FLOAT = "std_msgs/Float64"
COMMAND = "/slider/joint1_position_controller/command"
GAIN = "/slider/joint1_position_controller/pid/p"


@pytest.fixture(scope="module")
def daemon() -> Iterator[Runtime]:
    with running_daemon(paused=True) as runtime:
        slider(runtime)
        yield runtime


@pytest.fixture(scope="module")
def master(daemon: Runtime) -> Iterator[str]:
    with running_gateway(daemon, "ros1") as address:
        yield address


@pytest.fixture(scope="module")
def joining() -> Iterator[Runtime]:
    """A second daemon, with another robot."""
    with running_daemon(paused=True) as runtime:
        run(runtime, "spawn rrbot --controllers config/rrbot_control.yaml --start joint_state_controller")
        yield runtime


def slider(runtime: Runtime) -> None:
    words = "spawn slider --controllers config/slider_control.yaml --start joint_state_controller"
    run(runtime, f"{words} joint1_position_controller")


def run(runtime: Runtime, line: str) -> str:
    words = [sys.executable, "-m", "slidectl", *line.split()]
    done = subprocess.run(words, env=runtime.env, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


def parameter(runtime: Runtime, name: str) -> Any:
    with closing(runtime.client()) as client:
        return json.loads(client.call("/rosapi/get_param", {"name": name})["value"])


# --- names ----------------------------------------------------------------------------------------------------------


def test_a_node_of_slidectl_is_found_as_any_other(master: str) -> None:
    with ForeignNode(master, "/looker") as looker:
        publishers, subscribers, services = (dict(kind) for kind in looker.value("getSystemState"))
        assert publishers["/slider/joint_states"] == ["/gazebo"]
        assert subscribers[COMMAND] == ["/gazebo"]
        assert services["/slider/controller_manager/list_controllers"] == ["/gazebo"]
        assert subscribers["/rosout"] == publishers["/rosout_agg"] == ["/rosout"]
        assert dict(looker.value("getTopicTypes"))["/slider/joint_states"] == "sensor_msgs/JointState"
        assert ["/clock", "rosgraph_msgs/Clock"] in looker.value("getPublishedTopics", "")
        assert [topic for topic, _ in looker.value("getPublishedTopics", "/slider")] == [
            topic for topic in publishers if topic.startswith("/slider/")
        ]
        assert not [node for nodes in publishers.values() for node in nodes if "gateway" in node]
        address = looker.value("lookupNode", "/gazebo")
        with ServerProxy(address) as gazebo:
            assert gazebo.getName("/looker")[2] == "/gazebo"
            assert gazebo.getMasterUri("/looker")[2] == looker.value("getUri") == f"{master}/"
            assert ["/slider/joint_states", "sensor_msgs/JointState"] in gazebo.getPublications("/looker")[2]
            assert [COMMAND, FLOAT] in gazebo.getSubscriptions("/looker")[2]
            assert gazebo.getBusInfo("/looker")[0] == gazebo.getBusStats("/looker")[0] == 1
            protocol, host, port = gazebo.requestTopic("/looker", "/clock", [["TCPROS"]])[2]
            assert (protocol, host, port > 0) == ("TCPROS", "localhost", True)
            assert gazebo.requestTopic("/looker", "/clock", [["UDPROS"]])[:2] == [
                0,
                "no supported protocol implementations",
            ]
            assert gazebo.requestTopic("/looker", "/nothing", [["TCPROS"]])[0] == -1
            assert gazebo.publisherUpdate("/master", "/clock", ["x"])[:2] == [
                -1,
                "ERROR: param [publishers] does not contain valid URLs [x]",
            ]
            assert gazebo.shutdown("/looker", "user request")[0] == -1  # rosnode kill
            assert gazebo.getPid("/looker")[2] > 0
        assert looker.value("lookupService", "/gazebo/pause_physics").startswith("rosrpc://localhost:")
        assert looker.lookupNode("/nobody") == [-1, "unknown node [/nobody]", ""]


def test_foreign_nodes_are_told_of_each_other_and_listed_in_slidectl(daemon: Runtime, master: str) -> None:
    with ForeignNode(master, "/talker") as talker, ForeignNode(master, "/listener") as listener:
        assert listener.registerSubscriber("/chat", "my_msgs/Word", listener.uri) == [1, "Subscribed to [/chat]", []]
        answer = talker.registerPublisher("/chat", "my_msgs/Word", talker.uri)
        assert answer == [1, "Registered [/talker] as publisher of [/chat]", [listener.uri]]
        listener.hears("publisherUpdate", "/master", "/chat", [talker.uri])
        assert ["/chat", "my_msgs/Word"] in talker.value("getTopicTypes")
        assert "/chat" not in run(daemon, "topic list")  # a type that slidectl does not know
        talker.value("registerPublisher", COMMAND, FLOAT, talker.uri)
        eventually(lambda: "/talker" in run(daemon, f"topic info {COMMAND}"), "the publisher is not listed")
        assert [dict(kind)[COMMAND][0] for kind in talker.value("getSystemState")[:2]] == ["/talker", "/gazebo"]
        assert talker.value("unregisterPublisher", "/chat", talker.uri) == 1
        listener.hears("publisherUpdate", "/master", "/chat", [])
        assert talker.unregisterPublisher("/chat", talker.uri)[1:] == [
            "[/talker] is not a known provider of [/chat]",
            0,
        ]
        talker.value("unregisterPublisher", COMMAND, talker.uri)
        eventually(lambda: "/talker" not in run(daemon, f"topic info {COMMAND}"), "the publisher is still listed")
        assert talker.lookupNode("/talker")[0] == -1


def test_a_second_node_of_a_name_shuts_the_first_down(master: str) -> None:
    with ForeignNode(master, "/twin") as first, ForeignNode(master, "/twin") as second:
        first.value("registerService", "/twin/do", "rosrpc://127.0.0.1:1", first.uri)
        second.value("registerPublisher", "/twins", FLOAT, second.uri)
        first.hears("shutdown", "/master", "[/twin] Reason: new node registered with same name")
        assert second.value("lookupNode", "/twin") == second.uri
        assert second.lookupService("/twin/do") == [-1, "no provider", ""]
        second.value("unregisterPublisher", "/twins", second.uri)


def test_the_simulation_keeps_its_names(master: str) -> None:
    with ForeignNode(master, "/gazebo") as other:
        code, message, _ = other.registerPublisher("/x", FLOAT, other.uri)
        assert (code, "slidectl has a node [/gazebo]" in message) == (-1, True)
        other.hears("shutdown", "/master", "[/gazebo] Reason: slidectl has a node of this name")
        assert other.value("lookupNode", "/gazebo") != other.uri


def test_what_comes_and_goes_in_slidectl_is_told(daemon: Runtime, master: str) -> None:
    with ForeignNode(master, "/listener") as listener, closing(daemon.client()) as client:
        assert listener.value("registerSubscriber", "/later", "my_msgs/Word", listener.uri) == []
        client.advertise("/later", FLOAT)
        eventually(lambda: dict(listener.value("getSystemState")[0]).get("/later"), "the publisher is not listed")
        eventually(lambda: any(call[3] for call in listener.calls), "the subscriber was not told")
        client.close()
        eventually(lambda: listener.calls[-1][3] == [], "the subscriber was not told of the end")
        listener.value("unregisterSubscriber", "/later", listener.uri)


def test_registrations_outlive_the_daemon() -> None:
    with (
        running_daemon(paused=True) as runtime,
        running_gateway(runtime, "ros1") as address,
        ForeignNode(address, "/stays") as node,
    ):
        uris = node.value("registerSubscriber", "/clock", "*", node.uri)
        assert len(uris) == 1
        os.kill(runtime.pid or 0, signal.SIGKILL)
        node.hears("publisherUpdate", "/master", "/clock", [])
        assert dict(node.value("getSystemState")[1]) == {"/clock": ["/stays"]}
        assert node.lookupNode("/gazebo")[0] == -1
        runtime.start(paused=True)
        node.hears("publisherUpdate", "/master", "/clock", uris)
        assert node.value("getParam", "/use_sim_time") is True
        eventually(lambda: "/stays" in run(runtime, "topic info /clock"), "the subscriber is not listed")


# --- parameters -----------------------------------------------------------------------------------------------------


def test_parameters_are_those_of_the_daemon(daemon: Runtime, master: str) -> None:
    with ForeignNode(master, "/ns/tuner") as node:
        assert node.setParam(GAIN, 120) == [1, f"parameter {GAIN} set", 0]
        assert parameter(daemon, GAIN) == 120.0
        code, message, _ = node.setParam(GAIN, "soft")
        assert (code, "must be a number, not the string 'soft'" in message) == (-1, True)
        code, message, _ = node.deleteParam(GAIN)
        assert (code, "is a gain of a loaded controller" in message) == (-1, True)
        tree = {"a": 1, "b": {"c": [1.5, True, "two"]}, "text": "<&>"}
        node.value("setParam", "~own", tree | {"when": DateTime("20200102T03:04:05")})
        assert parameter(daemon, "/ns/tuner/own") == tree | {"when": "20200102T03:04:05"}
        assert node.value("getParam", "tuner/own/b") == {"c": [1.5, True, "two"]}
        assert node.value("getParam", "/ns/tuner/own") == tree | {"when": "20200102T03:04:05"}
        assert node.value("searchParam", "use_sim_time") == "/use_sim_time"
        assert node.value("searchParam", "own/none") == "/ns/tuner/own/none"
        assert node.searchParam("missing") == [-1, "Cannot find parameter [missing] in an upwards search", ""]
        assert node.hasParam("own") == [1, "/ns/own", False]
        assert "/ns/tuner/own/b/c" in node.value("getParamNames")
        assert node.getParam("/no") == [-1, "Parameter [/no] is not set", 0]
        code, message, _ = node.setParam("/bytes", Binary(b"\x00\xff"))
        assert (code, "binary data is not a value" in message) == (-1, True)
        assert node.value("deleteParam", "~own") == 0
        with closing(daemon.client()) as client:  # what XML-RPC of ROS cannot say
            client.call("/rosapi/set_param", {"name": "/ns/odd", "value": json.dumps([2**40, "<\r\n\x07"])})
        assert node.value("getParam", "odd") == [2**40, "<\r\n\N{REPLACEMENT CHARACTER}"]
        node.value("deleteParam", "odd")
        assert node.deleteParam("/") == [-1, "parameter [/] is not set", 0]
        names = node.value("getParamNames")
        assert {"/run_id", "/rosdistro", "/rosversion", "/use_sim_time"} <= set(names)
        assert not [name for name in names if name.startswith("/ns")]


def test_who_subscribes_a_parameter_is_told_of_changes_by_others(daemon: Runtime, master: str) -> None:
    with ForeignNode(master, "/watcher") as watcher, ForeignNode(master, "/setter") as setter:
        assert watcher.value("subscribeParam", watcher.uri, "/tree") == {}
        assert setter.value("subscribeParam", setter.uri, "/tree/x") == {}
        setter.value("setParam", "/tree/x", 1)
        watcher.hears("paramUpdate", "/master", "/tree/x/", 1)
        run(daemon, "param set /tree/x 2")
        watcher.hears("paramUpdate", "/master", "/tree/x/", 2)
        setter.hears("paramUpdate", "/master", "/tree/x/", 2)
        assert ["paramUpdate", "/master", "/tree/x/", 1] not in setter.calls
        watcher.value("setParam", "/tree", {"y": 3})
        setter.hears("paramUpdate", "/master", "/tree/x/", {})
        watcher.value("unsubscribeParam", watcher.uri, "/tree")
        setter.answer = [-1, "not subscribed", 0]
        run(daemon, "param set /tree/x 4")
        setter.hears("paramUpdate", "/master", "/tree/x/", 4)
        eventually(lambda: setter.lookupNode("/setter")[0] == -1, "it says that it is not subscribed, and still is")
        setter.value("deleteParam", "/tree")


def test_many_calls_in_one(master: str) -> None:
    with ServerProxy(master) as server:
        calls: Any = MultiCall(server)
        calls.setParam("/loader", "/many/a", 1)
        calls.setParam("/loader", "/many/b", 2)
        calls.getParam("/loader", "/many")
        calls.deleteParam("/loader", "/many")
        assert [answer[2] for answer in calls()] == [0, 0, {"a": 1, "b": 2}, 0]


# --- where it listens -----------------------------------------------------------------------------------------------


def test_a_taken_port_names_the_master_that_is_there(master: str, joining: Runtime) -> None:
    port = urlsplit(master).port
    with pytest.raises(Refused) as refused:
        running_gateway(joining, "ros1", port=port).__enter__()
    assert "a ROS master is there already, process" in str(refused.value)
    assert f"--master http://127.0.0.1:{port}" in str(refused.value)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(Refused, match=f"port {port}: Address already in use"):
            running_gateway(joining, "ros1", port=port).__enter__()


def test_hosts_that_do_not_exist_are_refused_by_name(joining: Runtime) -> None:
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        nobody = f"http://127.0.0.1:{deaf.getsockname()[1]}"
    for options, reason in (
        ({"host": "no.such.host.invalid"}, "does not resolve"),
        ({"master": "http://no.such.host.invalid:11311"}, "does not resolve"),
        ({"host": "192.0.2.1"}, r"cannot listen on 192\.0\.2\.1"),
        ({"master": nobody}, f"no ROS master answers at {nobody}"),
        ({"master": "localhost:11311"}, "--master .localhost:11311. is not the URI of a ROS master"),
    ):
        with pytest.raises(Refused, match=reason):
            running_gateway(joining, "ros1", **options).__enter__()


def test_ros_hostname_and_ros_ip_are_the_host_that_others_are_told(
    joining: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(joining.env, "ROS_IP", "127.0.0.1")
    with running_gateway(joining, "ros1") as address, ServerProxy(address) as server:
        assert address.startswith("http://127.0.0.1:")
        found: Any = server.lookupService("/x", "/gazebo/pause_physics")
        assert found[2].startswith("rosrpc://127.0.0.1:")
    monkeypatch.setitem(joining.env, "ROS_HOSTNAME", "http://localhost")
    with pytest.raises(Refused, match="write it without http://"):
        running_gateway(joining, "ros1").__enter__()


# --- somebody else's master -----------------------------------------------------------------------------------------


def test_two_daemons_share_a_master(master: str, joining: Runtime) -> None:
    """The master of the one is a foreign one for the other."""
    with ForeignNode(master, "/looker") as looker:
        with running_gateway(joining, "ros1", master=master) as address:
            assert address == master

            def is_registered() -> bool:
                return "/rrbot/joint_states" in dict(looker.value("getSystemState")[0])

            eventually(is_registered, "what the daemon publishes is not registered")
            assert dict(looker.value("getSystemState")[0])["/rrbot/joint_states"] == ["/slidectl_default"]
            assert dict(looker.value("getSystemState")[2])["/gazebo/pause_physics"] == ["/gazebo"]
            gain = "/rrbot/joint1_position_controller/pid/p"
            eventually(lambda: looker.hasParam(gain)[2], "the parameters are not mirrored")
            looker.value("setParam", gain, 77.0)
            eventually(lambda: parameter(joining, gain) == 77.0, "what was set there did not come here")
            run(joining, f"param set {gain} 78")
            eventually(lambda: looker.value("getParam", gain) == 78.0, "what was set here did not come there")
            run(joining, "controller load /rrbot/joint1_position_controller")
            looker.value("setParam", gain, "much")
            eventually(lambda: looker.value("getParam", gain) == 78.0, "what is refused here stays there")
            looker.value("registerPublisher", "/rrbot/hello", FLOAT, looker.uri)
            with joining.client() as client:
                asked = "/rosapi/publishers", {"topic": "/rrbot/hello"}
                eventually(lambda: client.call(*asked)["publishers"] == ["/looker"], "foreign nodes are not listed")
            looker.value("unregisterPublisher", "/rrbot/hello", looker.uri)
        assert not is_registered()


def test_a_master_that_talks_nonsense_is_asked_again(joining: Runtime) -> None:
    with ForeignNode("", "/odd") as odd:
        with running_gateway(joining, "ros1", master=odd.uri):
            for nonsense in (
                [],
                [1],
                "no",
                [1, "", [[1, 2]]],
                [1, "", [[], [["/t", 3]], []]],
                [1, "", [[], [], []]],
                7,
            ):
                odd.answer = nonsense  # type: ignore[assignment]
                seen = len(odd.calls)
                eventually(lambda seen=seen: len(odd.calls) > seen + 1, "it is not asked any more")  # type: ignore[misc]
        assert "nonsense" in log(joining, "ros1")
        assert "Traceback" not in log(joining, "ros1")


def test_a_master_that_comes_back_gets_everything_again(joining: Runtime) -> None:
    with running_daemon(paused=True) as owner, ExitStack() as joined:
        with running_gateway(owner, "ros1") as first:
            joined.enter_context(running_gateway(joining, "ros1", master=first))
        with running_gateway(owner, "ros1", port=urlsplit(first).port) as again, ServerProxy(again) as server:

            def is_registered() -> bool:
                answer: Any = server.getSystemState("/looker")
                return "/slidectl_default" in dict(answer[2][0])["/clock"]

            eventually(is_registered, "it did not register again")
            joined.close()


# --- hostile input --------------------------------------------------------------------------------------------------

CALL = "<methodCall><methodName>{}</methodName><params>{}</params></methodCall>"
LAUGHS = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>'


def exchange(address: str, raw: bytes) -> bytes:
    """What comes back for these bytes."""
    with socket.create_connection((urlsplit(address).hostname, urlsplit(address).port or 0), timeout=30) as wire:
        wire.sendall(raw)
        wire.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: wire.recv(65536), b""))


def post(address: str, body: str) -> str:
    head = f"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: {len(body.encode())}\r\nConnection: close\r\n\r\n"
    return exchange(address, (head + body).encode()).decode()


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("", "no element found"),
        ("<methodCall>", "no element found"),
        (LAUGHS + CALL.format("getPid", "<param><value>&b;</value></param>"), "document type"),
        (CALL.format("getPid", "<param>" + "<value><array><data>" * 65), "nested deeper than 64"),
        (CALL.format("getPid", "<param><value><i4>x</i4></value></param>"), "invalid literal"),
        (CALL.format("getPid", "<param><value><int>99999999999999999999</int></value></param>"), "64 bits"),
        (CALL.format("getPid", "<param><value><base64>a</base64></value></param>"), "this is not XML-RPC"),
        (CALL.format("getPid", "<param><value><script/></value></param>"), "&lt;script&gt; is not expected"),
        (CALL.format("getPid", "<param><value><data/></value></param>"), "&lt;data&gt; is not expected"),
        (CALL.format("fly", "<param><value>/x</value></param>"), "is not supported"),
        (CALL.format("getPid", ""), "missing required caller_id parameter"),
        (CALL.format("getPid", "<param><value><nil/></value></param>"), "caller_id must be a string"),
        (CALL.format("getParam", "<param><value>/x</value></param>"), "Error: bad call arity"),
        (CALL.format("system.multicall", "<param><value><array><data><value>a</value></data></array></value></param>"),
         "has a methodName and params"),
        (CALL.format("getParam", f"<param><value>/x</value></param><param><value>/{'a' * 2000}</value></param>"),
         "longer than 1000 characters"),
    ],
)  # fmt: skip
def test_nonsense_is_answered_with_a_reason(master: str, body: str, expected: str) -> None:
    assert expected in post(master, body)


@pytest.mark.parametrize(
    ("raw", "status"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", b" 501 "),
        (b"POST / HTTP/1.1\r\n\r\n", b" 411 "),
        (b"POST / HTTP/1.1\r\nOrigin: http://evil.example\r\nContent-Length: 0\r\n\r\n", b" 403 "),
        (b"POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", b" 411 "),
        (b"POST / HTTP/1.1\r\nContent-Length: 200000000\r\n\r\n", b" 413 "),
        (b"\x16\x03\x01 a TLS hello\r\n\r\n", b" 501 "),
        (b"POST / HTTP/1.1\r\n" + b"x: y\r\n" * 5000 + b"\r\n", b""),
        (b"POST / HTTP/1.1\r\nContent-Length: 10\r\n\r\nshort", b""),
    ],
)
def test_bad_http_ends_the_connection(master: str, raw: bytes, status: bytes) -> None:
    answer = exchange(master, raw)
    assert status in answer.partition(b"\r\n")[0]
    with ServerProxy(master) as server:
        assert server.getPid("/x")[0] == 1


def test_more_nodes_than_can_be_are_refused_and_cost_nobody_anything(daemon: Runtime, master: str) -> None:
    with ServerProxy(master) as server:
        address = "http://127.0.0.1:9/"
        answers: list[Any] = [server.registerPublisher(f"/fake{i}", COMMAND, FLOAT, address) for i in range(320)]
        assert [code for code, _, _ in answers].count(1) >= 290
        assert answers[-1][:1] == [-1]
        assert "rosnode cleanup" in answers[-1][1]
        eventually(lambda: "/fake200" in run(daemon, f"topic info {COMMAND}"), "the nodes are not listed")
        for i in range(320):
            server.unregisterPublisher(f"/fake{i}", COMMAND, address)
        eventually(lambda: "/fake" not in run(daemon, f"topic info {COMMAND}"), "the nodes are still listed")


def test_idle_connections_make_room_for_new_ones(master: str) -> None:
    host, port = "127.0.0.1", urlsplit(master).port or 0
    idle = [socket.create_connection((host, port), timeout=30) for _ in range(450)]
    try:
        with ServerProxy(master) as server:
            eventually(lambda: _answers(server), "a new connection gets no answer", 30)
    finally:
        for wire in idle:
            wire.close()


def claiming(master: str, length: int, sent: bytes = b"") -> socket.socket:
    """A connection that has begun a request with a body that it claims to have this length."""
    wire = socket.create_connection(("127.0.0.1", urlsplit(master).port or 0), timeout=60)
    wire.sendall(b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % length)
    with suppress(BrokenPipeError, ConnectionResetError):
        wire.sendall(sent)
    return wire


def test_bodies_that_are_only_claimed_lock_nobody_out(master: str) -> None:
    with ExitStack() as stack:
        for _ in range(20):
            stack.enter_context(claiming(master, 16 << 20))
        with ServerProxy(master) as server:
            assert server.getPid("/x")[0] == 1
            assert (
                server.setParam("/x", "/long", "x" * 8_000_000)[0] == 1
            )  # what it has sent counts, not what it claims
            assert server.deleteParam("/x", "/long")[0] == 1


def test_bodies_that_have_come_and_are_not_whole_hold_a_bounded_sum(daemon: Runtime, master: str) -> None:
    with daemon.environment():
        running = process.find(daemon.paths, "ros1")
    assert running is not None
    before = memory_mib(running.pid)
    with ExitStack() as stack:
        some = [stack.enter_context(claiming(master, 16 << 20, bytes(16_000_000))) for _ in range(30)]
        with ServerProxy(master) as server:
            assert server.getPid("/x")[0] == 1
            assert server.setParam("/x", "/long", "x" * 8_000_000)[0] == 1
            assert server.deleteParam("/x", "/long")[0] == 1
        assert some[0].recv(100).startswith(b"HTTP/1.1 503")  # it held most for longest
        assert memory_mib(running.pid) < before + 64 + 100
    eventually(lambda: memory_mib(running.pid) < before + 60)


def test_slow_senders_make_room_for_new_ones_before_idle_ones_do(master: str) -> None:
    with ExitStack() as stack:
        idle = [stack.enter_context(ServerProxy(master)) for _ in range(5)]
        assert all(_answers(server) for server in idle)
        slow = [stack.enter_context(claiming(master, 1000, b"<")) for _ in range(395)]
        assert len(slow) == 395
        for _ in range(10):
            server = stack.enter_context(ServerProxy(master))
            eventually(lambda server=server: _answers(server), "a new connection gets no answer")
        for server in idle:
            assert server.getPid("/x")[0] == 1


def test_a_thousand_connections_leave_nothing(daemon: Runtime, master: str) -> None:
    with daemon.environment():
        running = process.find(daemon.paths, "ros1")
    assert running is not None
    had, before = descriptors(running.pid), memory_mib(running.pid)
    with ExitStack() as stack:
        for _ in range(1000):
            stack.enter_context(claiming(master, 10))
        server = stack.enter_context(ServerProxy(master))
        eventually(lambda: _answers(server), "a new connection gets no answer")
        assert memory_mib(running.pid) < before + 60
    eventually(lambda: descriptors(running.pid) <= had)


def test_a_request_has_a_limit_from_its_first_byte_to_its_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sender that sends a byte now and then is ended, in the head and in the body."""
    monkeypatch.setattr(xmlrpc, "_REQUEST_LIMIT_S", 1.0)

    async def answer(*_: Any) -> Any:
        return 1

    async def sends_for_ever(head: bytes) -> None:
        server = xmlrpc.XmlRpcServer(answer, any_user=True)
        port = await server.open("127.0.0.1", 0)
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(head)
        async with asyncio.timeout(30):
            with suppress(ConnectionError):
                while True:
                    writer.write(b"x")
                    await writer.drain()
                    await asyncio.sleep(0.05)
        writer.close()
        await server.close()
        assert (server.held, server.connections) == (0, 0)

    for head in (b"POST / HTT", b"POST / HTTP/1.1\r\nContent-Length: 100000\r\n\r\n"):
        asyncio.run(sends_for_ever(head))


def test_an_answer_of_a_node_that_never_ends_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """What nodes answer to the gateway's own calls counts as well."""
    monkeypatch.setattr(xmlrpc, "_HELD", HeldBytes(1_000_000))

    async def answer_much(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 16000000\r\n\r\n" + bytes(2_000_000))

    async def call() -> None:
        node = await asyncio.start_server(answer_much, "127.0.0.1", 0)
        port = node.sockets[0].getsockname()[1]
        with pytest.raises(Refused, match="unfinished"):
            await xmlrpc.call(f"http://127.0.0.1:{port}", "getPid", "/x")
        node.close()

    asyncio.run(call())


def _answers(server: ServerProxy) -> bool:
    try:
        return bool(server.getPid("/x"))
    except (OSError, EOFError):
        return False


def test_a_value_too_many_is_a_fault(master: str) -> None:
    many = "<value><i4>1</i4></value>" * 100_001
    with pytest.raises(Fault, match="more than 100000 values"):
        raise _fault(
            post(master, CALL.format("setParam", f"<param><value><array><data>{many}</data></array></value></param>"))
        )


def _fault(answer: str) -> Fault:
    import xmlrpc.client

    try:
        xmlrpc.client.loads(answer.partition("\r\n\r\n")[2])
    except Fault as fault:
        return fault
    raise AssertionError(answer)
