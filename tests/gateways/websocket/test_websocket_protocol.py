"""rosbridge's protocol over WebSocket, frame by frame: what the daemon answers, and what the gateway adds."""

from __future__ import annotations

import json
from collections.abc import Iterator

import cbor2
import pytest
from daemon_fixture import Runtime
from rosbags.typesys import Stores, get_typestore
from rosbridge_client import RosbridgeClient
from running_gateway import running_gateway

TOPIC = "/slider/joint_states"


@pytest.fixture(scope="module")
def url(world: Runtime) -> Iterator[str]:
    with running_gateway(world, "websocket") as address:
        yield address


@pytest.fixture
def browser(url: str) -> Iterator[RosbridgeClient]:
    with RosbridgeClient(url) as one:
        yield one


def step(browser: RosbridgeClient, cycles: int = 40) -> None:
    assert browser.call("/slidectl/step", cycles=cycles)["result"]


def test_calls_and_messages_pass_in_order(browser: RosbridgeClient, world: Runtime) -> None:
    browser.send(op="subscribe", topic="/note", type="std_msgs/String", id="s")
    for number in range(100):
        browser.send(op="publish", topic="/note", type="std_msgs/String", msg={"data": str(number)})
    answer = browser.call("/rosapi/topic_type", topic="/note")
    assert answer["values"] == {"type": "std_msgs/String"}
    assert [browser.op("publish")["msg"]["data"] for _ in range(100)] == [str(number) for number in range(100)]
    node = browser.call("/rosapi/subscribers", topic="/note")["values"]["subscribers"][0]
    assert node.startswith("/rosbridge_websocket_")
    with world.client() as client:
        assert node in client.call("/rosapi/nodes")["nodes"]


def test_a_frame_may_be_written_over_several_lines(browser: RosbridgeClient) -> None:
    browser.socket.send(json.dumps({"op": "call_service", "id": "x", "service": "/rosapi/get_time"}, indent=2))
    assert browser.op("service_response", id="x")["result"]
    browser.socket.send(json.dumps({"op": "call_service", "id": "y", "service": "/rosapi/get_time"}).encode())
    assert browser.op("service_response", id="y")["result"]


@pytest.mark.parametrize(
    "frame", ["{nonsense", "[1, 2]", "null", "{}", '{"op": "no_such_op"}', b"\xff\xfe", "[" * 50_000]
)
def test_nonsense_is_answered_and_the_connection_lives_on(browser: RosbridgeClient, frame: str | bytes) -> None:
    browser.socket.send(frame)
    assert browser.op("status", level="error")["msg"]
    assert browser.call("/rosapi/get_time")["result"]


def test_refusals_are_told_as_rosbridge_does(browser: RosbridgeClient) -> None:
    browser.send(op="publish", topic="/rosout", msg={"level": "text"}, id="p1")
    assert "level" in browser.op("status", id="p1", level="error")["msg"]
    assert browser.call("/no/such/service")["result"] is False
    browser.send(op="subscribe", topic="/rosout", compression="zip", id="z")
    assert "cbor-raw" in browser.op("status", id="z")["msg"]
    browser.send(op="subscribe", topic="/no_such_topic", compression="cbor", id="t")
    assert "type" in browser.op("status", id="t")["msg"]
    browser.send(op="set_level", level="none")
    browser.send(op="publish", topic="/rosout", msg={"level": "text"})
    assert browser.call("/rosapi/get_time")["result"]
    assert not [frame for frame in browser.frames if '"status"' in str(frame)]
    browser.send(op="set_level", level="loud")
    browser.send(op="auth", mac="m", client="c", dest="d", rand="r", t=0, level="l", end=0)
    assert browser.call("/rosapi/get_time")["result"]


def test_cbor_holds_typed_arrays_and_cbor_raw_ros_bytes(browser: RosbridgeClient, url: str) -> None:
    with RosbridgeClient(url) as plain, RosbridgeClient(url) as raw:
        plain.send(op="subscribe", topic=TOPIC)
        browser.send(op="subscribe", topic=TOPIC, compression="cbor")
        raw.send(op="subscribe", topic=TOPIC, compression="cbor-raw")
        for one in (plain, browser, raw):
            assert one.call("/rosapi/get_time")["result"]
        step(browser)
        expected = plain.op("publish", topic=TOPIC)["msg"]
        packed = cbor2.loads(browser.frame(lambda frame: isinstance(frame, bytes)))
        assert (packed["op"], packed["topic"], packed["msg"]["header"]) == ("publish", TOPIC, expected["header"])
        position = packed["msg"]["position"]
        assert (position.tag, len(position.value)) == (86, 8)
        assert memoryview(position.value).cast("d").tolist() == expected["position"]
        message = cbor2.loads(raw.frame(lambda frame: isinstance(frame, bytes)))["msg"]
        assert {key: message[key] for key in ("secs", "nsecs")} == expected["header"]["stamp"]
        store = get_typestore(Stores.ROS1_NOETIC)
        state = store.deserialize_ros1(message["bytes"], "sensor_msgs/msg/JointState")
        assert (state.name, state.position.tolist()) == (expected["name"], expected["position"])


def test_a_subscription_may_change_its_compression_and_a_topic_its_type(
    browser: RosbridgeClient, world: Runtime
) -> None:
    with world.client() as client:
        browser.send(op="subscribe", topic="/changing", type="std_msgs/String", compression="cbor")
        browser.call("/rosapi/get_time")
        client.publish("/changing", {"data": "packed"})
        client.flush()
        assert isinstance(browser.frame(lambda frame: isinstance(frame, bytes)), bytes)
        browser.send(op="subscribe", topic="/changing", compression="none")
        browser.call("/rosapi/get_time")
        client.publish("/changing", {"data": "plain"})
        client.flush()
        assert browser.op("publish", topic="/changing")["msg"] == {"data": "plain"}
        browser.send(op="unsubscribe", topic="/changing")
        # What the daemon refuses is a wish still: the topic may come, and be of another type.
        browser.send(op="subscribe", topic="/other", type="std_msgs/String", compression="cbor", throttle_rate=-1)
        assert "throttle_rate" in browser.op("status", level="error")["msg"]
        browser.send(op="subscribe", topic="/other", id="two", type="geometry_msgs/Point")
        browser.call("/rosapi/get_time")
        client.publish("/other", {"x": 1.0})
        client.flush()
        assert b"/other" in browser.frame(lambda frame: isinstance(frame, bytes))
        browser.send(op="subscribe", topic="/other", id="x" * 1001, compression="png")
        assert "1000 characters" in browser.op("status", level="error")["msg"]


def test_values_of_all_kinds_pass_through_cbor(browser: RosbridgeClient) -> None:
    sent = {"data": "AAEC/w=="}
    browser.send(op="subscribe", topic="/bytes", type="std_msgs/UInt8MultiArray", compression="cbor")
    browser.send(op="publish", topic="/bytes", type="std_msgs/UInt8MultiArray", msg=sent)
    packed = cbor2.loads(browser.frame(lambda frame: isinstance(frame, bytes)))
    assert packed["msg"]["data"] == b"\x00\x01\x02\xff"
    browser.send(op="subscribe", topic="/floats", type="std_msgs/Float32MultiArray", compression="cbor")
    browser.socket.send(
        '{"op":"publish","topic":"/floats","type":"std_msgs/Float32MultiArray","msg":{"data":[1.5,null,1e999]}}'
    )
    data = cbor2.loads(browser.frame(lambda frame: isinstance(frame, bytes)))["msg"]["data"]
    assert data.tag == 85
    assert str(memoryview(data.value).cast("f").tolist()) == "[1.5, nan, inf]"


def test_the_strongest_compression_of_a_topic_holds_until_its_end(browser: RosbridgeClient) -> None:
    def shape() -> object:
        step(browser)
        found = browser.frame(lambda one: isinstance(one, bytes) or one["op"] in ("publish", "png"))
        return type(found) if isinstance(found, bytes) else found["op"]

    browser.send(op="subscribe", topic=TOPIC, id="plain", queue_length=1)
    assert shape() == "publish"
    browser.send(op="subscribe", topic=TOPIC, id="picture", compression="png", queue_length=1)
    assert browser.call("/rosapi/get_time")["result"]
    browser.frames.clear()
    assert shape() == "png"
    browser.send(op="subscribe", topic=TOPIC, id="packed", compression="cbor", queue_length=1)
    assert browser.call("/rosapi/get_time")["result"]
    browser.frames.clear()
    assert shape() is bytes
    for wish, expected in (("packed", "png"), ("picture", "publish")):
        browser.send(op="unsubscribe", topic=TOPIC, id=wish)
        assert browser.call("/rosapi/get_time")["result"]
        browser.frames.clear()
        assert shape() == expected


def test_fragments_go_both_ways(browser: RosbridgeClient) -> None:
    long = "ä" * 3000
    whole = json.dumps({"op": "call_service", "id": "f", "service": "/rosapi/set_param",
                        "args": {"name": "/long", "value": json.dumps(long)}})  # fmt: skip
    pieces = [whole[at : at + 1000] for at in range(0, len(whole), 1000)]
    for number in reversed(range(len(pieces))):  # in any order
        browser.send(op="fragment", id="1", data=pieces[number], num=number, total=len(pieces))
    assert browser.op("service_response", id="f")["result"]

    browser.send(op="call_service", id="g", service="/rosapi/get_param", args={"name": "/long"}, fragment_size=1000)
    found = [browser.op("fragment")]
    while len(found) < found[0]["total"]:
        found.append(browser.op("fragment", id=found[0]["id"]))
    assert [one["num"] for one in found] == list(range(len(found)))
    assert max(len(one["data"]) for one in found) == 1000
    answer = json.loads("".join(one["data"] for one in found))
    assert json.loads(answer["values"]["value"]) == long


def test_fragments_that_never_end_are_refused(browser: RosbridgeClient) -> None:
    browser.send(op="fragment", id="1", data="x", num=3, total=2)
    assert "fragment" in browser.op("status", level="error")["msg"]
    for number in range(40):
        browser.send(op="fragment", id=str(number), data="x", num=0, total=2)
    for _ in range(40 - 16):
        assert "may wait" in browser.op("status", level="error")["msg"]
    inner = json.dumps({"op": "fragment", "id": "i", "data": "x", "num": 0, "total": 1})
    browser.send(op="fragment", id="outer", data=inner, num=0, total=1)
    assert "within" in browser.op("status", level="error")["msg"]
    browser.send(op="call_service", id="g", service="/rosapi/get_time", fragment_size=1)
    assert not browser.op("service_response", id="g")["result"]
    assert browser.call("/rosapi/get_time")["result"]
