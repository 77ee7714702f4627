"""The data between slidectl and ROS 1: an end of TCPROS that says what it likes, and what only data can show."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

import pytest
from daemon_fixture import ROOT, Runtime, running_daemon
from ros1_tools import Ros, gateway, need_ros
from tcpros_wire import TcprosWire, subscribers_address
from waiting import eventually

from slidectl.client import Client
from slidectl.extensions.gateways.ros1.tcpros import encode_header

STATES = "/slider/joint_states"
CONTROLLERS = ["joint_state_controller", "joint1_position_controller"]
MEBIBYTE = 1024 * 1024


@pytest.fixture(scope="module")
def daemon() -> Iterator[Runtime]:
    """With a slider that publishes its state at 1 kHz."""
    need_ros()
    with running_daemon() as runtime, runtime.client() as client:
        client.spawn("slider", controllers=str(ROOT / "config/slider_control.yaml"))
        client.call("/rosapi/set_param", {"name": "/slider/joint_state_controller/publish_rate", "value": "1000"})
        for controller in CONTROLLERS:
            client.controllers("/slider").load(controller)
        client.controllers("/slider").switch(CONTROLLERS)
        yield runtime


@pytest.fixture(scope="module")
def ros(daemon: Runtime) -> Iterator[Ros]:
    with gateway(daemon) as ros:
        yield ros


@pytest.fixture
def client(daemon: Runtime) -> Iterator[Client]:
    with daemon.client() as client:
        yield client


def status(client: Client) -> dict[str, str]:
    """What `slidectl gateway ros1 status` shows."""
    told = client.call("/slidectl/gateways/ros1")
    return dict(zip(told["names"], told["values"], strict=True))


# Topics


def test_one_message_of_a_command_line_reaches_a_node_of_ros(ros: Ros, client: Client) -> None:
    with ros.started("rostopic echo /announced") as echo:  # of a type that nobody has told yet
        client.advertise("/announced", "std_msgs/String", latch=True)
        client.publish("/announced", {"data": "first"}, latch=True)
        echo.prints("first")
        with client_of(client) as another:
            another.publish("/announced", {"data": "second"})
        assert echo.prints("second").count("data:") == 2


def client_of(client: Client) -> Client:
    """Another client of the same daemon."""
    return Client(socket=str(client.paths.socket), timeout=20.0)


def test_what_a_rospy_node_latched_reaches_who_subscribes_later(ros: Ros, client: Client) -> None:
    with ros.started("talker.py latching") as talker:
        talker.prints("ready")
        for _ in range(2):
            with client_of(client) as reader, reader.subscribe("/latching/said", "std_msgs/String") as said:
                assert said.get()["data"] == "latching"
        assert "/latching" in client.call("/rosapi/publishers", {"topic": "/latching/said"})["publishers"]
    eventually(lambda: "/latching/said" not in client.topics())


def test_a_message_is_not_echoed_to_the_side_that_it_came_from(ros: Ros, client: Client) -> None:
    """A node gets what another publishes from that one, and only what slidectl publishes from here."""
    point = "geometry_msgs/PointStamped"
    with ros.started("rostopic echo /both") as echo, client.subscribe("/both", point) as heard:
        client.advertise("/both", point)
        with ros.started("rostopic pub -r 10 /both " + point + " '{header: {frame_id: theirs}}'"):
            echo.prints("theirs")
            eventually(lambda: heard.get()["header"]["frame_id"] == "theirs")
            client.publish("/both", {"header": {"frame_id": "ours"}})
            client.flush()
            text = echo.prints("ours(.|\n)*theirs(.|\n)*theirs(.|\n)*theirs")
    got = re.findall(r'seq: (\d+)(?:.|\n)*?frame_id: "?(\w+)', text)
    numbers = [int(number) for number, frame in got if frame == "theirs"]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert [frame for _, frame in got].count("ours") == 1


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"topic": STATES, "md5sum": "*"}, "Missing required 'callerid' field"),
        ({"topic": STATES, "callerid": "/wire"}, "Missing required 'md5sum' field"),
        ({"topic": "/no", "md5sum": "*", "callerid": "/wire"}, "is not a publisher of [/no]. Topics are "),
        (
            {"topic": STATES, "md5sum": "1", "callerid": "/wire", "type": "my_msgs/State"},
            "topic types do not match: [my_msgs/State] vs. [sensor_msgs/JointState]",
        ),
        (
            {"topic": STATES, "md5sum": "1", "callerid": "/wire"},
            "Client [/wire] wants topic [/slider/joint_states] to have datatype/md5sum [sensor_msgs/JointState/1], but "
            "our version has [sensor_msgs/JointState/3066dcd76a6cfaef579bd0f34173e9fd] Dropping connection.",
        ),
        ({"service": "/no", "md5sum": "*", "callerid": "/wire"}, "is not a provider of  [/no]"),
        (
            {"service": "/gazebo/pause_physics", "md5sum": "1", "callerid": "/wire"},
            "request from [/wire]: md5sums do not match: [1] vs. [d41d8cd98f00b204e9800998ecf8427e]",
        ),
        ({"callerid": "/wire"}, "no topic or service name detected"),
    ],
)
def test_a_header_that_does_not_fit_is_answered_with_the_reason(ros: Ros, fields: dict[str, str], reason: str) -> None:
    with TcprosWire(subscribers_address(ros, STATES)) as wire:
        assert reason in wire.begin(**fields)["error"]
        assert wire.is_over()


@pytest.mark.parametrize(
    ("sent", "reason"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "a header of 542393671 bytes exceeds 262144"),
        (struct.pack("<II", 4, 0), "Invalid 0-length handshake header field"),
        (struct.pack("<II", 5, 9) + b"x", "Invalid line length in handshake header: 5"),
        (struct.pack("<II", 5, 1) + b"x", "Invalid line in handshake header: [x]"),
    ],
)
def test_bytes_that_are_no_header_are_answered_with_the_reason(ros: Ros, sent: bytes, reason: str) -> None:
    with TcprosWire(subscribers_address(ros, STATES)) as wire:
        wire.socket.sendall(sent)
        assert wire.header()["error"] == reason


def test_the_header_of_a_publisher_tells_type_definition_and_node(ros: Ros) -> None:
    with TcprosWire(subscribers_address(ros, STATES)) as wire:
        header = wire.begin(topic=STATES, md5sum="*", callerid="/wire", type="*", tcp_nodelay="1")
        assert "\nMSG: std_msgs/Header\n" in header.pop("message_definition")
        assert header == {
            "callerid": "/gazebo",
            "latching": "0",
            "md5sum": "3066dcd76a6cfaef579bd0f34173e9fd",
            "topic": STATES,
            "type": "sensor_msgs/JointState",
        }
        assert wire.message()


def test_a_reader_that_stops_costs_messages_of_its_own_and_memory_of_nobody(ros: Ros, client: Client) -> None:
    before = int(status(client)["dropped"])
    client.advertise("/large", "std_msgs/String")
    fields = {"topic": "/large", "md5sum": "*", "type": "std_msgs/String"}
    address = subscribers_address(ros, "/large", "std_msgs/String")
    with TcprosWire(address, small=True) as stopped, TcprosWire(address) as reading:
        stopped.begin(callerid="/stopped", **fields)
        reading.begin(callerid="/reading", **fields)
        memory = gateway_memory(ros)
        for number in range(60):
            client.publish("/large", {"data": f"{number} " + "x" * MEBIBYTE})
            assert reading.message()[4:].startswith(f"{number} ".encode())
        eventually(lambda: int(status(client)["dropped"]) > before)
        assert gateway_memory(ros) - memory < 40 * MEBIBYTE
        assert stopped.message()[4:].startswith(b"0 ")


def gateway_pid(ros: Ros) -> int:
    """The master's process."""
    with ServerProxy(ros.env["ROS_MASTER_URI"]) as master:
        pid: Any = master.getPid("/test")
        return int(pid[2])


def gateway_memory(ros: Ros) -> int:
    """Resident bytes of the gateway."""
    with open(f"/proc/{gateway_pid(ros)}/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * 4096


# Services


def test_a_rospy_client_calls_services_of_slidectl_on_one_connection(ros: Ros) -> None:
    lines = ros.ok("client.py /gazebo/get_model_state slider").splitlines()
    assert lines[0].startswith("True")
    assert lines[1].startswith("False")


def test_a_long_answer_arrives_whole_before_the_connection_ends(ros: Ros, client: Client) -> None:
    client.call("/rosapi/set_param", {"name": "/long", "value": json.dumps("x" * 4 * MEBIBYTE)})
    with TcprosWire(subscribers_address(ros, STATES), small=True) as wire:
        wire.begin(service="/rosapi/get_param", md5sum="*", callerid="/wire")
        name = b"/long"
        request = struct.pack("<I", len(name)) + name + bytes(4)
        wire.socket.sendall(struct.pack("<I", len(request)) + request)
        assert wire.exactly(1) == b"\1"
        assert wire.message().count(b"x") == 4 * MEBIBYTE
        assert wire.is_over()
    client.call("/rosapi/delete_param", {"name": "/long"})


def test_a_request_of_200_mb_ends_in_an_error_that_says_the_limit(ros: Ros) -> None:
    with TcprosWire(subscribers_address(ros, STATES)) as wire:
        wire.begin(service="/gazebo/delete_model", md5sum="*", callerid="/wire", persistent="1")
        memory = gateway_memory(ros)
        wire.socket.sendall(struct.pack("<I", 200_000_000))
        for _ in range(200):
            wire.socket.sendall(bytes(1_000_000))
        assert wire.exactly(1) == b"\0"
        assert wire.message() == (b"service cannot process request: a message of 200000000 bytes exceeds 12582912")
        assert gateway_memory(ros) - memory < 20 * MEBIBYTE
        request = b"nobody"
        wire.socket.sendall(struct.pack("<II", 4 + len(request), len(request)) + request)
        assert wire.exactly(1) == b"\1"
        assert b"nobody" in wire.message()


# Many, and half of one


def test_connections_are_bounded_and_who_says_nothing_loses_its_own(ros: Ros, client: Client) -> None:
    address = subscribers_address(ros, STATES)
    with ExitStack() as stack:
        silent = [stack.enter_context(TcprosWire(address)) for _ in range(1000)]
        silent[0].socket.sendall(encode_header({"topic": STATES})[:10])
        for _ in range(20):  # newcomers are served meanwhile
            late = stack.enter_context(TcprosWire(address))
            assert "error" not in late.begin(topic=STATES, md5sum="*", callerid="/wire")
        assert silent[0].is_over()
    eventually(lambda: int(status(client)["connections"]) < 100)


def test_a_thousand_clients_are_refused_plainly_and_leave_nothing(ros: Ros) -> None:
    address = subscribers_address(ros, STATES)
    pid = gateway_pid(ros)
    had, memory = len(list(Path(f"/proc/{pid}/fd").iterdir())), gateway_memory(ros)
    with ExitStack() as stack:
        for _ in range(1001):
            one = stack.enter_context(TcprosWire(address))
            answer = one.begin(service="/gazebo/delete_model", md5sum="*", callerid="/wire", persistent="1")
            if "error" in answer:
                break
        assert answer["error"] == "too many connections: 1000 are open"
    eventually(lambda: len(list(Path(f"/proc/{pid}/fd").iterdir())) <= had + 5)
    assert gateway_memory(ros) < memory + 60 * MEBIBYTE
    with TcprosWire(address) as wire:
        assert "error" not in wire.begin(topic=STATES, md5sum="*", callerid="/wire")


def test_messages_that_are_begun_and_not_ended_hold_a_bounded_sum(ros: Ros) -> None:
    address = subscribers_address(ros, STATES)
    memory = gateway_memory(ros)
    with ExitStack() as stack:
        begun = []
        for _ in range(40):
            one = stack.enter_context(TcprosWire(address))
            one.begin(service="/gazebo/delete_model", md5sum="*", callerid="/wire", persistent="1")
            with suppress(OSError):
                one.socket.sendall(struct.pack("<I", 12_000_000) + bytes(11_900_000))
            begun.append(one)
        assert begun[0].is_over()  # it held most for longest
        assert gateway_memory(ros) < memory + 200 * MEBIBYTE
        with TcprosWire(address) as wire:
            wire.begin(service="/gazebo/delete_model", md5sum="*", callerid="/wire")
            wire.socket.sendall(struct.pack("<II", 10, 6) + b"nobody")
            assert wire.exactly(1) == b"\1"
            assert b"nobody" in wire.message()
