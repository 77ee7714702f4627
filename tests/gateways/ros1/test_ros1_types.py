"""Messages as ROS 1 bytes and back, for all types that slidectl knows, beside what rosbags makes of them."""

from __future__ import annotations

import json
import math
from random import Random
from typing import Any

import pytest
from random_messages import all_types, bytes_of, md5_of, random_message

from slidectl.errors import BadMessage
from slidectl.extensions.gateways.ros1.ros1_types import ros1_type
from slidectl.extensions.recording.codec import BadDefinition, Codec
from slidectl.wire.json_lines import encode


def test_all_types_have_the_bytes_that_rosbags_gives_them_and_come_back_the_same() -> None:
    rng = Random(1)
    for name in all_types():
        kind = ros1_type(name)
        codec = Codec(name, kind.definition, "")
        assert kind.md5 == codec.md5 == md5_of(name)
        for _ in range(3):
            message = random_message(rng, name)
            packed = kind.pack(message)
            assert packed == codec.encode(message) == bytes_of(name, message), name
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
        ("std_msgs/Float64", b"1234567", "7 bytes that are not std_msgs/Float64"),
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


def nesting(depth: int) -> str:
    """A definition of nine fields, each of a type with nine fields, and so on."""
    types = {f"a/N{level}": f"a/N{level + 1}" for level in range(1, depth)}
    parts = ["".join(f"a/N1 x{number}\n" for number in range(9))]
    parts += [f"MSG: {name}\n" + "".join(f"{inner} x{n}\n" for n in range(9)) for name, inner in types.items()]
    return f"{'=' * 80}\n".join([*parts, f"MSG: a/N{depth}\nfloat64 x\n"])


@pytest.mark.parametrize(
    ("definition", "reason"),
    [
        ("a/Other other\n", "the definition of a/T lacks that of a/Other"),
        ("float64 x\nnonsense", "the definition of a/T cannot be read: neither a field nor a constant: 'nonsense'"),
        ("a/T again\n", "the definition of a/T cannot be read"),
        (nesting(30), "a/T is too large"),
    ],
)
def test_definitions_of_recordings_that_are_none_are_refused_with_the_reason(definition: str, reason: str) -> None:
    with pytest.raises(BadDefinition, match=reason):
        Codec("a/T", definition, "")
