"""Messages as ROS 1 bytes and back, for all types that slidectl knows, beside what rosbags makes of them."""

from __future__ import annotations

import json
import math
from random import Random
from typing import Any

import pytest
from random_messages import all_types, oracle, random_message

from slidectl.client.lines import encode
from slidectl.errors import BadMessage
from slidectl.gateways.ros1.ros1_types import ros1_type


def test_all_types_have_the_bytes_that_rosbags_gives_them_and_come_back_the_same() -> None:
    rng = Random(1)
    for name in all_types():
        kind, codec = ros1_type(name), oracle(name)
        assert kind.md5 == codec.md5
        assert kind.definition == codec.definition
        for _ in range(3):
            message = random_message(rng, name)
            packed = kind.pack(message)
            assert packed == codec.encode(message), name
            assert on_the_wire(kind.unpack(packed)) == on_the_wire(message), name


def on_the_wire(message: dict[str, Any]) -> Any:
    """As the daemon gets it: not-a-number is null there."""
    return json.loads(encode(message))


def test_numbers_that_json_does_not_have_keep_their_meaning() -> None:
    kind = ros1_type("std_msgs/Float64MultiArray")
    message = json.loads('{"layout": {"dim": [], "data_offset": 0}, "data": [null, 1e999, -1e999]}')
    back = kind.unpack(kind.pack(message))["data"]
    assert math.isnan(back[0])
    assert back[1:] == [math.inf, -math.inf]


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("std_msgs/Float64", b"1234567", "7 bytes that are no std_msgs/Float64"),
        ("std_msgs/Float64", b"123456789", "1 bytes follow"),
        ("std_msgs/String", b"\xff\xff\xff\xff12", "4294967293 bytes are missing"),
        ("std_msgs/Float64MultiArray", bytes(8) + b"\xff\xff\xff\xff", "more than 100000 values"),
        ("tf2_msgs/TFMessage", b"\xff\xff\xff\xff", "more than 100000 values"),
        (
            "sensor_msgs/JointState",
            bytes(16) + b"\x50\xc3\0\0" + bytes(4 * 50000) + b"\x51\xc3\0\0",
            "more than 100000",
        ),
    ],
)
def test_bytes_that_are_no_message_are_refused_with_the_reason(name: str, data: bytes, reason: str) -> None:
    with pytest.raises(BadMessage, match=reason):
        ros1_type(name).unpack(data)


def test_text_that_is_no_utf_8_passes_with_marks_in_its_place() -> None:
    assert ros1_type("std_msgs/String").unpack(b"\3\0\0\0a\xffb") == {"data": "a\ufffdb"}
