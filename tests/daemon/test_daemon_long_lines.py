"""Single lines that are costly to carry out: refused or carried out at a bounded cost, and told in a few words."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from unittest import mock

import pytest
from daemon_fixture import Runtime
from rosbridge_wire import Wire

from slidectl.errors import SlidectlError, UnknownName, closest
from slidectl.logfile import LogFile
from slidectl.simulation.parameters import Parameters

Connect = Callable[[], Wire]


@dataclass(frozen=True)
class Long:
    """A long text, which is made when a test needs it: the parameters of tests stay in memory to the end."""

    part: str
    count: int
    before: str = ""

    def __str__(self) -> str:
        return self.before + self.part * self.count


def made(value: Any) -> Any:
    """The value with the long texts in it made."""
    if isinstance(value, dict):
        return {made(key): made(content) for key, content in value.items()}
    if isinstance(value, list):
        return [made(content) for content in value]
    return str(value) if isinstance(value, Long) else value() if callable(value) else value


def short(part: object) -> str:
    """A name for a parameter, the same in all processes."""
    return re.sub(r"<function .*? at \w+>", "made", str(part))[:60]


LONG = Long("n", 5_000_000)
PARTS = Long("a/", 2_500_000)
FEW_KB = 8192
URDF = """<robot name="box"><link name="world"/><link name="base"/><link name="arm">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="fixed" type="fixed"><parent link="world"/><child link="base"/></joint>
<joint name="joint" type="prismatic"><parent link="base"/><child link="arm"/>
<axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="1"/></joint>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="joint">
<hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
<actuator name="a"/></transmission>
<gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo></robot>"""
SWITCH = "/box/controller_manager/switch_controller"

CALLS: list[tuple[str | Long, dict[str, Any]]] = [
    (SWITCH, {"start_controllers": [LONG], "strictness": 1}),
    (SWITCH, {"start_controllers": [LONG], "strictness": 2}),
    (SWITCH, {"start_controllers": lambda: [f"n{number}" for number in range(90_000)], "strictness": 1}),
    ("/box/controller_manager/load_controller", {"name": LONG}),
    ("/box/controller_manager/load_controller", {"name": PARTS}),
    ("/box/controller_manager/unload_controller", {"name": LONG}),
    ("/rosapi/set_param", {"name": PARTS, "value": "1"}),
    ("/rosapi/set_param", {"name": "/x", "value": lambda: json.dumps({str(PARTS): 1})}),
    ("/rosapi/set_param", {"name": LONG, "value": lambda: json.dumps([None] * 90_000)}),
    ("/rosapi/get_param", {"name": LONG}),
    ("/rosapi/get_param", {"name": PARTS}),
    ("/rosapi/delete_param", {"name": LONG}),
    ("/rosapi/has_param", {"name": PARTS}),
    ("/rosapi/search_param", {"name": PARTS}),
    ("/rosapi/topic_type", {"topic": LONG}),
    ("/rosapi/service_type", {"service": LONG}),
    ("/rosapi/node_details", {"node": LONG}),
    ("/rosapi/message_details", {"type": LONG}),
    ("/rosapi/service_request_details", {"type": Long("n", 5_000_000, "std_srvs/")}),
    (
        "/slidectl/wait",
        {"topic": "/clock", "field": Long("[0]", 1_500_000, "clock"), "condition": "near", "value": "1"},
    ),
    ("/slidectl/wait", {"topic": "/clock", "field": Long("clock.", 800_000), "condition": "near", "value": "1"}),
    ("/slidectl/wait", {"topic": "/clock", "field": "clock", "condition": LONG, "value": "1"}),
    ("/slidectl/wait", {"topic": Long("n", 5_000_000, "/"), "field": "clock", "condition": "near", "value": "1"}),
    ("/slidectl/list_robots", {"name": LONG}),
    ("/gazebo/spawn_urdf_model", {"model_name": "x", "model_xml": Long("<!-- -->", 500_000, "<robot name='x'>")}),
    ("/gazebo/delete_model", {"model_name": LONG}),
    ("/gazebo/get_model_state", {"model_name": LONG}),
    ("/gazebo/get_link_state", {"link_name": LONG}),
    ("/gazebo/apply_joint_effort", {"joint_name": LONG}),
    ("/gazebo/set_model_state", {"model_state": {"model_name": LONG}}),
    (LONG, {}),
    (Long("n", 5_000_000, "/"), {}),
]
OPS: list[dict[Any, Any]] = [
    *({"op": op, "topic": LONG, "type": "std_msgs/String"} for op in ("publish", "subscribe", "advertise")),
    *({"op": op, "topic": "/x", "type": LONG} for op in ("publish", "subscribe", "advertise")),
    *({"op": op, "topic": LONG} for op in ("unsubscribe", "unadvertise")),
    {"op": "advertise_service", "service": LONG, "type": "std_srvs/Empty"},
    {"op": "advertise_service", "service": "/x", "type": LONG},
    {"op": "unadvertise_service", "service": LONG},
    {"op": "set_level", "level": LONG},
    {"op": "subscribe", "topic": "/clock", "compression": LONG},
    {"op": "publish", "topic": "/x", "type": "std_msgs/String", "msg": {LONG: 1}},
    {"op": "publish", "topic": "/x", "type": "std_msgs/String", "msg": lambda: {str(key): 1 for key in range(90_000)}},
    {"op": "service_response", "id": LONG},
    {"op": LONG},
]


@pytest.fixture
def robot(daemon: Runtime, wire: Wire) -> Runtime:
    """The daemon with a robot, whose controller manager logs what it refuses."""
    if not wire.call("/slidectl/list_robots")["values"]["robots"]:
        answer = wire.call("/gazebo/spawn_urdf_model", model_name="box", model_xml=URDF)
        assert answer["values"]["success"], answer
    return daemon


def log_size(daemon: Runtime) -> int:
    return sum(path.stat().st_size for path in daemon.paths.folder.glob("log*"))


@pytest.mark.parametrize(("service", "args"), CALLS, ids=short)
def test_a_call_with_a_huge_argument_is_answered_in_a_few_words(
    robot: Runtime, wire: Wire, service: str | Long, args: dict[str, Any]
) -> None:
    before = log_size(robot)
    wire.send(op="call_service", id="huge", service=made(service), args=made(args))
    answer = wire.until("service_response", id="huge")
    assert len(json.dumps(answer)) < FEW_KB
    assert "internal error" not in json.dumps(answer)
    assert log_size(robot) - before < 2 * FEW_KB


@pytest.mark.parametrize("message", OPS, ids=lambda message: str(message["op"])[:40])
def test_an_op_with_a_huge_name_is_refused_in_a_few_words(robot: Runtime, wire: Wire, message: dict[Any, Any]) -> None:
    before = log_size(robot)
    wire.send(**made(message))
    status = wire.receive()
    assert (status["op"], status["level"]) == ("status", "error")
    assert len(json.dumps(status)) < FEW_KB
    assert "internal error" not in status["msg"]
    assert log_size(robot) - before < FEW_KB


@pytest.mark.parametrize(
    ("args", "reason"),
    [
        (lambda: [[1] * 200_000], "a line with "),
        ({"value": Long("[", 5_000_000)}, "a line with "),
        (lambda: [{}] * 30_000, "a line with 30001 mappings"),
        ({"name": "/x", "value": "9" * 5000}, "the value is not JSON"),
    ],
)
def test_a_line_of_too_many_values_is_not_read_and_the_caller_is_told(wire: Wire, args: object, reason: str) -> None:
    wire.send(op="call_service", id='my "id"', service="/rosapi/set_param", args=made(args))
    answer = wire.receive()
    assert (answer["op"], answer["id"], answer["result"]) == ("service_response", 'my "id"', False)
    assert answer["values"].startswith(reason) or reason in answer["values"]


def test_an_unknown_name_among_very_many_is_compared_with_few() -> None:
    known = [f"/robot_{number:06d}/joint_states" for number in range(100_000)]
    compared = []
    plain = difflib.SequenceMatcher.set_seq1

    def count(matcher: difflib.SequenceMatcher[str], text: str) -> None:
        compared.append(text)
        plain(matcher, text)

    with mock.patch.object(difflib.SequenceMatcher, "set_seq1", count):
        near = closest("/robot_012345/joint_state", known)
        assert closest("n" * 1_000_000, known) is None
    assert near == "/robot_012345/joint_states"
    assert len(compared) < 1500


def test_errors_stay_short_whatever_they_quote() -> None:
    assert len(str(UnknownName("topic", str(LONG), [str(LONG)] * 20))) < FEW_KB
    assert len(str(SlidectlError(str(LONG), str(LONG)))) < 50_000


def test_an_entry_of_the_log_keeps_its_beginning_and_its_end(tmp_path: Any) -> None:
    log = LogFile(tmp_path / "log", foreground=True)
    log.write("info", f"begin {LONG} end")
    log.close()
    text = (tmp_path / "log").read_text()
    assert "begin nnn" in text
    assert text.endswith("nnn end\n")
    assert len(text) < FEW_KB


def test_an_answer_larger_than_a_line_is_refused_before_it_is_written(wire: Wire) -> None:
    for part in range(3):
        assert wire.call("/rosapi/set_param", name=f"/large/{part}", value=json.dumps("x" * 4_000_000))["result"]
    assert len(wire.call("/rosapi/get_param", name="/large/1")["values"]["value"]) == 4_000_002
    answer = wire.call("/rosapi/get_param", name="/large")
    assert answer["result"] is False
    assert "too large for an answer\nask for a part of it" in answer["values"]
    assert wire.call("/rosapi/delete_param", name="/large")["result"]


def test_many_services_do_not_make_an_unknown_one_costly(wire: Wire, connect: Connect) -> None:
    provider = connect()
    provider.raw(
        b"".join(
            b'{"op":"advertise_service","service":"/many/s%05d","type":"std_srvs/Empty"}\n' % number
            for number in range(20_000)
        )
    )
    assert provider.call("/rosapi/get_time")["result"]
    answer = wire.call("/many/s0123x")
    assert answer["result"] is False
    assert "Did you mean '/many/s01" in answer["values"]
    assert len(answer["values"]) < FEW_KB
    provider.close()
    assert wire.call("/rosapi/node_details", node="/slidectl")["values"]["services"]
    assert not any(name.startswith("/many") for name in wire.call("/rosapi/services")["values"]["services"])


def test_a_client_with_many_lines_does_not_keep_the_others_waiting(connect: Connect) -> None:
    busy, other = connect(), connect()
    lines = 50_000
    busy.socket.setblocking(False)
    stream = b'{"op":"call_service","service":"/rosapi/has_param","args":{"name":"/a"}}\n' * lines
    sent = busy.socket.send(stream)
    assert other.call("/rosapi/get_time")["result"]
    for _ in range(10):
        with suppress(BlockingIOError):
            sent += busy.socket.send(stream[sent:])
        assert other.call("/rosapi/get_time")["result"]


def test_names_of_parameters_are_known_after_every_change() -> None:
    parameters = Parameters()
    assert parameters.names() == []
    parameters.set("/b/c", 1)
    assert parameters.names() == ["/b/c"]
    parameters.set("/b/c", 2)
    parameters.set("/a", {"x": [1], "y": {}})
    assert parameters.names() == ["/a/x", "/a/y", "/b/c"]
    parameters.set("/a/x", {"deep": 1})
    assert parameters.names() == ["/a/x/deep", "/a/y", "/b/c"]
    parameters.delete("/b")
    assert parameters.names() == ["/a/x/deep", "/a/y"]
