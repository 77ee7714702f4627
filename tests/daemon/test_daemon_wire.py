"""The operations of the wire, spoken raw to a real daemon."""

from __future__ import annotations

import math
import os
import re
import socket
from collections.abc import Callable
from pathlib import Path

from daemon_fixture import knows_peers
from rosbridge_wire import Wire

Connect = Callable[[], Wire]
PROTOCOL = Path(__file__).parent.parent.parent / "docs" / "protocol.md"


def test_the_answer_to_a_call_comes_after_everything_that_was_sent_before_it(wire: Wire) -> None:
    wire.send(op="subscribe", topic="/echo", type="std_msgs/Int32")
    wire.send(op="publish", topic="/echo", msg={"data": 7})
    wire.send(op="publish", id="bad", topic="/echo", msg={"dat": 7})
    wire.send(op="call_service", id="x", service="/rosapi/get_time")
    assert [wire.receive()["op"] for _ in range(3)] == ["publish", "status", "service_response"]


def test_a_latched_message_waits_for_the_latecomer(connect: Connect) -> None:
    writer, late = connect(), connect()
    writer.send(op="advertise", topic="/latched", type="std_msgs/String", latch=True)
    writer.send(op="publish", topic="/latched", msg={"data": "kept"})
    writer.call("/rosapi/get_time")
    late.send(op="subscribe", topic="/latched")
    assert late.until("publish")["msg"] == {"data": "kept"}


def test_a_publisher_that_hangs_up_takes_its_topic_with_it(connect: Connect) -> None:
    writer, onlooker = connect(), connect()
    writer.send(op="advertise", topic="/short_lived", type="std_msgs/String")
    writer.call("/rosapi/get_time")
    assert "/short_lived" in onlooker.call("/rosapi/topics")["values"]["topics"]
    writer.close()
    assert "/short_lived" not in onlooker.call("/rosapi/topics")["values"]["topics"]


def test_unadvertise_takes_the_publisher_back(wire: Wire) -> None:
    wire.send(op="advertise", topic="/taken_back", type="std_msgs/String")
    wire.send(op="unadvertise", topic="/taken_back")
    assert "/taken_back" not in wire.call("/rosapi/topics")["values"]["topics"]


def test_publishing_on_a_topic_that_nobody_knows_says_which_there_are(wire: Wire) -> None:
    wire.send(op="publish", id="p1", topic="/nowhere", msg={})
    status = wire.receive()
    assert (status["op"], status["level"], status["id"], status["exit_code"]) == ("status", "error", "p1", 1)
    assert "/nowhere" in status["msg"]
    assert "/clock" in status["msg"]


def test_a_wrong_field_is_named_together_with_the_right_ones(wire: Wire) -> None:
    wire.send(op="subscribe", topic="/strict", type="std_msgs/String")
    wire.send(op="publish", id="p1", topic="/strict", msg={"daat": "x"})
    status = wire.receive()
    assert (status["level"], status["exit_code"]) == ("error", 2)
    assert "daat" in status["msg"]
    assert "data" in status["msg"]


def test_who_wants_an_acknowledgement_hears_of_each_message(connect: Connect) -> None:
    reader, writer = connect(), connect()
    reader.send(op="subscribe", topic="/acknowledged", type="std_msgs/Int32")
    reader.call("/rosapi/get_time")
    writer.send(op="set_level", level="none")  # it is an answer, no remark
    writer.send(op="publish", id="p1", ack=True, topic="/acknowledged", msg={"data": 1})
    writer.send(op="publish", id="p2", ack=True, topic="/acknowledged", msg={"data": "two"})
    writer.send(op="publish", id="p3", topic="/acknowledged", msg={"data": 3})
    writer.send(op="publish", id="p4", ack=True, topic="/acknowledged", msg={"data": 4})
    answers = [writer.receive() for _ in range(3)]
    assert [(answer["op"], answer["level"], answer["id"]) for answer in answers] == [
        ("status", "info", "p1"),
        ("status", "error", "p2"),
        ("status", "info", "p4"),
    ]
    assert [reader.receive()["msg"]["data"] for _ in range(3)] == [1, 3, 4]


def test_another_type_for_a_known_topic_is_refused(wire: Wire) -> None:
    wire.send(op="subscribe", id="s1", topic="/clock", type="std_msgs/String")
    status = wire.receive()
    assert (status["level"], status["id"]) == ("error", "s1")
    assert "rosgraph_msgs/Clock" in status["msg"]


def test_nan_travels_as_null_and_infinity_as_a_number(connect: Connect) -> None:
    reader, writer = connect(), connect()
    reader.send(op="subscribe", topic="/floats", type="std_msgs/Float64MultiArray")
    reader.call("/rosapi/get_time")
    writer.send(op="publish", topic="/floats", msg={"data": [math.nan, math.inf, None, -math.inf, 1.5]})
    assert reader.receive()["msg"]["data"] == [None, math.inf, None, -math.inf, 1.5]


def test_after_unsubscribe_nothing_comes_any_more(wire: Wire) -> None:
    wire.send(op="subscribe", id="a", topic="/quiet", type="std_msgs/Int32")
    wire.send(op="unsubscribe", id="a", topic="/quiet")
    wire.send(op="publish", topic="/quiet", msg={"data": 1})
    assert wire.receive()["level"] == "error"  # the topic went with its only user
    assert wire.call("/rosapi/get_time")["result"] is True


def test_two_wishes_for_one_topic_give_each_message_once_until_both_are_taken_back(connect: Connect) -> None:
    reader, writer = connect(), connect()
    writer.send(op="advertise", topic="/shared", type="std_msgs/Int32")
    writer.call("/rosapi/get_time")
    reader.send(op="subscribe", id="a", topic="/shared")
    reader.send(op="subscribe", id="b", topic="/shared")
    reader.send(op="unsubscribe", id="a", topic="/shared")
    reader.call("/rosapi/get_time")
    for number in (1, 2):
        writer.send(op="publish", topic="/shared", msg={"data": number})
    assert [reader.receive()["msg"]["data"] for _ in range(2)] == [1, 2]
    reader.send(op="unsubscribe", topic="/shared")
    assert reader.call("/rosapi/subscribers", topic="/shared")["values"]["subscribers"] == []


def test_throttled_messages_come_no_more_often_than_asked(connect: Connect) -> None:
    reader, writer = connect(), connect()
    reader.send(op="subscribe", topic="/fast", type="std_msgs/Int32", throttle_rate=3_600_000)
    reader.call("/rosapi/get_time")
    for number in range(50):
        writer.send(op="publish", topic="/fast", msg={"data": number})
    writer.call("/rosapi/get_time")
    reader.send(op="call_service", id="end", service="/rosapi/get_time")
    assert reader.receive()["msg"]["data"] == 0
    assert reader.receive()["op"] == "service_response"


def test_the_newest_of_the_throttled_messages_comes_when_its_time_has_come(connect: Connect) -> None:
    reader, writer = connect(), connect()
    reader.send(op="subscribe", topic="/silent", type="std_msgs/Int32", throttle_rate=200, stamped=True)
    reader.call("/rosapi/get_time")
    writer.raw(b"".join(b'{"op":"publish","topic":"/silent","msg":{"data":%d}}\n' % number for number in range(50)))
    numbers = [reader.receive()["msg"]["data"]]
    while numbers[-1] != 49:
        numbers.append(reader.receive()["msg"]["data"])
    assert numbers[0] == 0
    assert len(numbers) < 10


def test_a_shorter_throttle_counts_at_once(connect: Connect) -> None:
    reader, writer = connect(), connect()
    reader.send(op="subscribe", topic="/slow", type="std_msgs/Int32", throttle_rate=1_000_000)
    reader.call("/rosapi/get_time")
    for number in range(2):
        writer.send(op="publish", topic="/slow", msg={"data": number})
    writer.call("/rosapi/get_time")
    assert reader.receive()["msg"]["data"] == 0
    reader.send(op="subscribe", topic="/slow", throttle_rate=10)
    assert reader.receive()["msg"]["data"] == 1


def test_a_call_that_is_given_up_leaves_nothing_behind(connect: Connect) -> None:
    caller = connect()
    never = {"topic": "/never", "field": "data", "condition": "equals", "value": "1"}
    caller.send(op="advertise", topic="/never", type="std_msgs/Int32")
    for number in range(1001):
        caller.send(op="call_service", id=f"wait {number}", service="/slidectl/wait", args=never)
        caller.send(op="cancel_call", id=f"wait {number}")
    assert caller.call("/rosapi/subscribers", topic="/never")["values"]["subscribers"] == []
    caller.send(op="cancel_call")
    assert caller.receive()["msg"] == "cancel_call without the id of the call"


def test_the_shortest_queue_keeps_the_newest_and_tells_what_was_dropped(connect: Connect) -> None:
    reader, writer = connect(), connect()
    reader.send(op="subscribe", topic="/flood", type="std_msgs/Int32", queue_length=1)
    reader.call("/rosapi/get_time")
    line = b'{"op":"publish","topic":"/flood","msg":{"data":%d}}\n'
    writer.raw(b"".join(line % number for number in range(20)))
    said = [reader.receive()]
    while said[-1].get("msg") != {"data": 19}:
        said.append(reader.receive())
    told = [message for message in said if message["op"] == "status"]
    assert len(told) >= 1
    assert sum(message["dropped"] for message in told) + len(said) - len(told) == 20
    assert told[0]["msg"] == f"{told[0]['dropped']} messages on /flood were dropped: read too slowly"


def test_a_service_that_fails_answers_with_its_reason_and_exit_code(wire: Wire) -> None:
    answer = wire.call("/slidectl/set_speeed", speed=1.0)
    assert answer["result"] is False
    assert "/slidectl/set_speed" in answer["values"]
    assert answer["exit_code"] == 1


def test_arguments_of_a_service_may_come_as_a_list(wire: Wire) -> None:
    wire.send(op="call_service", id="x", service="/rosapi/topic_type", args=["/clock"])
    assert wire.receive()["values"] == {"type": "rosgraph_msgs/Clock"}
    wire.send(op="call_service", id="y", service="/rosapi/topic_type", args=["/clock", "more"])
    assert wire.receive()["result"] is False


def test_an_answer_carries_no_id_when_the_call_had_none(wire: Wire) -> None:
    wire.send(op="call_service", service="/rosapi/get_time")
    assert "id" not in wire.receive()


def test_a_service_of_a_client_is_called_like_any_other(connect: Connect) -> None:
    provider, caller = connect(), connect()
    provider.send(op="advertise_service", service="/ping", type="std_srvs/Trigger")
    provider.call("/rosapi/get_time")
    caller.send(op="call_service", id="c1", service="/ping", args={})
    asked = provider.until("call_service")
    assert (asked["service"], asked["args"]) == ("/ping", {})
    provider.send(op="service_response", id=asked["id"], service="/ping", values={"success": True}, result=True)
    assert caller.receive()["values"] == {"success": True, "message": ""}
    provider.send(op="unadvertise_service", service="/ping")
    provider.call("/rosapi/get_time")
    assert caller.call("/ping")["result"] is False


def test_a_provider_may_fail_a_call(connect: Connect) -> None:
    provider, caller = connect(), connect()
    provider.send(op="advertise_service", service="/grumpy", type="std_srvs/Trigger")
    provider.call("/rosapi/get_time")
    caller.send(op="call_service", id="c1", service="/grumpy")
    asked = provider.until("call_service")
    provider.send(op="service_response", id=asked["id"], service="/grumpy", values="not today", result=False)
    answer = caller.receive()
    assert (answer["result"], answer["values"]) == (False, "not today")


def test_a_provider_that_vanishes_fails_the_calls_that_wait_for_it(connect: Connect) -> None:
    provider, caller = connect(), connect()
    provider.send(op="advertise_service", service="/vanishing", type="std_srvs/Trigger")
    provider.call("/rosapi/get_time")
    caller.send(op="call_service", id="c1", service="/vanishing")
    provider.until("call_service")
    provider.close()
    answer = caller.receive()
    assert answer["result"] is False
    assert "went away" in answer["values"]


def test_set_level_chooses_which_statuses_come(wire: Wire) -> None:
    wire.send(op="set_level", level="none")
    wire.send(op="publish", topic="/nowhere", msg={})
    assert wire.call("/rosapi/get_time")["result"] is True
    wire.send(op="set_level", level="error")
    wire.send(op="publish", topic="/nowhere", msg={})
    assert wire.receive()["level"] == "error"
    wire.send(op="set_level", level="loud")
    assert "warning" in wire.receive()["msg"]


@knows_peers
def test_a_client_stands_in_the_graph_under_its_process_id(wire: Wire) -> None:
    wire.send(op="advertise", topic="/mine", type="std_msgs/String")
    publishers = wire.call("/rosapi/publishers", topic="/mine")["values"]["publishers"]
    assert len(publishers) == 1
    assert publishers[0].startswith(f"/slidectl_{os.getpid()}_")


def test_other_calls_are_answered_while_one_is_pending(wire: Wire) -> None:
    wire.send(op="call_service", id="long", service="/slidectl/step", args={"cycles": 20_000})
    wire.send(op="call_service", id="short", service="/rosapi/get_time")
    assert [wire.receive()["id"] for _ in range(2)] == ["short", "long"]


def test_what_was_asked_over_a_half_closed_connection_is_still_answered(connect: Connect) -> None:
    wire = connect()
    wire.send(op="call_service", id="last", service="/slidectl/step", args={"cycles": 2000})
    wire.socket.shutdown(socket.SHUT_WR)
    assert wire.receive()["values"]["success"] is True
    assert wire.socket.recv(1) == b""


def test_the_page_names_every_op_and_no_other(wire: Wire) -> None:
    wire.send(op="fly")
    known = set(wire.receive()["msg"].partition("ops: ")[2].split(", "))
    table = PROTOCOL.read_text(encoding="utf-8").partition("| from the client")[2].partition("\n\n")[0]
    first_cells = [row.partition("|")[0] for row in table.split("\n| ")[1:]]
    assert {op for cell in first_cells for op in re.findall(r"`(\w+)`", cell)} == known


def test_messages_are_published_at_their_time_and_too_many_of_them_are_refused(connect: Connect) -> None:
    reader, writer = connect(), connect()
    reader.send(op="subscribe", topic="/later", type="std_msgs/String", stamped=True)
    now = reader.call("/rosapi/get_time")["values"]["time"]
    due, never = ({"secs": now["secs"] + seconds, "nsecs": now["nsecs"]} for seconds in (1, 1000))
    writer.send(op="publish", id="a", topic="/later", msg={"data": "due"}, at=due, ack=True)
    writer.send(op="publish", id="b", topic="/later", msg={"data": 3}, at=due, ack=True)
    status = writer.receive()
    assert (status["id"], status["level"]) == ("b", "error")
    for number in range(5):
        writer.send(op="publish", id=f"large {number}", topic="/later", msg={"data": 15_000_000 * "x"}, at=never)
    status = writer.receive()
    assert (status["id"], "64 MiB" in status["msg"]) == ("large 4", True)
    writer.call("/slidectl/step", seconds=1.0)
    assert reader.receive() == {"op": "publish", "topic": "/later", "time": due, "msg": {"data": "due"}}
    writer.close()


def test_a_message_with_a_time_keeps_it_over_a_reset(connect: Connect) -> None:
    reader, writer = connect(), connect()
    reader.send(op="subscribe", topic="/kept", type="std_msgs/String", stamped=True)
    reader.call("/rosapi/get_time")
    writer.call("/gazebo/pause_physics")
    writer.call("/gazebo/reset_simulation")
    writer.call("/slidectl/step", seconds=0.5)
    due = {"secs": 1, "nsecs": 0}
    writer.send(op="publish", topic="/kept", msg={"data": "due"}, at=due)
    writer.call("/gazebo/reset_simulation")
    writer.call("/slidectl/step", seconds=1.0)
    assert reader.receive() == {"op": "publish", "topic": "/kept", "time": due, "msg": {"data": "due"}}


def test_one_that_says_no_more_is_let_go_when_its_last_message_is_published(connect: Connect) -> None:
    half, driver = connect(), connect()
    now = half.call("/rosapi/get_time")["values"]["time"]
    due = {"secs": now["secs"] + 1, "nsecs": now["nsecs"]}
    half.send(op="publish", topic="/last_words", type="std_msgs/String", msg={"data": "due"}, at=due)
    half.socket.shutdown(socket.SHUT_WR)
    driver.call("/slidectl/step", seconds=1.5)
    assert half.socket.recv(1) == b""


def test_a_restricted_connection_keeps_what_it_may_do_and_never_gets_more(connect: Connect) -> None:
    wire = connect()
    wire.send(op="restrict", permitted=["reads", "writes"])
    assert wire.call("/slidectl/export_snapshot", name="a", file="/a")["cause"] == "NotPermitted"
    assert wire.call("/rosapi/set_param", name="/a_note", value="1")["result"]
    wire.send(op="restrict", permitted=["reads", "code"])  # what was given up does not come back
    refused = wire.call("/slidectl/load_controller_file", robot="", file="/c.py")
    assert refused["cause"] == "NotPermitted"
    assert wire.call("/rosapi/set_param", name="/a_note", value="2")["cause"] == "NotPermitted"
    assert wire.call("/rosapi/get_param", name="/a_note")["values"] == {"value": "1"}
    for op in ({"op": "publish", "topic": "/x", "type": "std_msgs/Empty"}, {"op": "advertise", "topic": "/x"}):
        wire.send(id="r", **op)
        assert "not permitted on this connection" in wire.until("status")["msg"]
    wire.send(op="subscribe", topic="/clock")
    assert wire.call("/rosapi/get_time")["result"]
    connect().call("/rosapi/delete_param", name="/a_note")


def test_a_list_of_effects_that_is_none_is_refused(wire: Wire) -> None:
    for permitted in ("reads", None, ["everything"], [["reads"]], {"reads": 1}):
        wire.send(op="restrict", id="r", permitted=permitted)
        assert "effects: reads, writes, files, code" in wire.until("status")["msg"]
    assert wire.call("/rosapi/set_param", name="/still", value="1")["result"]
    wire.call("/rosapi/delete_param", name="/still")


def test_the_graph_tells_what_each_service_does(connect: Connect) -> None:
    provider, caller = connect(), connect()
    provider.send(op="advertise_service", service="/look", type="std_srvs/Trigger", effect="reads")
    provider.send(op="advertise_service", service="/act", type="std_srvs/Trigger")
    provider.send(op="advertise_service", id="bad", service="/no", type="std_srvs/Trigger", effect="code")
    assert "effects: reads, writes" in provider.until("status")["msg"]
    graph = caller.call("/slidectl/graph")["values"]["services"]
    effects = {service["name"]: service["effects"] for service in graph}
    assert effects["/look"] == effects["/slidectl/status"] == effects["/rosapi/topics"] == ["reads"]
    assert effects["/act"] == effects["/gazebo/pause_physics"] == ["writes"]
    assert effects["/slidectl/save"] == ["writes", "files"]
    assert effects["/slidectl/load_controller_file"] == ["code"]
