"""Expressions: arithmetic and fields, nothing else, errors before the first message, and an end to each."""

from __future__ import annotations

import math
from typing import Any

import pytest
from cli_graph_types import schema
from command_line import CommandLine

from slidectl.errors import Refused, UsageError
from slidectl.msgs.message_expressions import Expression, Filter

JOINTS = schema("sensor_msgs/JointState")
MESSAGE = {
    "header": {"seq": 7, "stamp": {"secs": 2, "nsecs": 500_000_000}, "frame_id": "base"},
    "name": ["slide", "latch"],
    "position": [0.4, None],
    "velocity": [],
    "effort": [1.5, -2.0],
}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("sin(2*pi*0.2*t)", math.sin(2 * math.pi * 0.2 * 0.5)),
        ("i % 2", 1),
        ("-t ** 2 + 1", 0.75),
        ("1 if t < 1 else 0", 1),
        ("max(i, 10) // 3", 3),
        ("hypot(3, 4)", 5.0),
        ("0 < t < 1 and not i == 4", True),
        ("round(e, 2)", 2.72),
        ("10 ** 20", 10**20),
        ("factorial(4) + comb(4, 2) + isqrt(16)", 34),
        ("round(1234, -2)", 1200),
        ("math.floor(math.pi)", 3),
    ],
)
def test_numbers_are_computed_with_the_names_of_the_math_module(text: str, value: float) -> None:
    assert Expression(text, ("i", "t"))(i=3, t=0.5) == value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("m.position[0] > 0.3", True),
        ("m.position[1] > 0.3", False),
        ("'latch' in m.name", True),
        ("len(m.velocity) == 0", True),
        ("m.header.frame_id == 'base' and m.header.seq < 8", True),
        ("m.header.stamp.secs == 2", True),
        ("m.header.stamp.to_sec() == 2.5", True),
        ("m.header.stamp.to_nsec() == 2500000000", True),
        ("sum(m.effort[0:1]) == 1.5", True),
        ("m.header.frame_id[0] == 'b'", True),
        ("min([1, 2]) in (1, 3)", True),
        ("math.isnan(m.position[1])", True),
        ("(m.position[0] > 0) & (m.header.seq == 8)", False),
        ("any([m.position[0] > 1, m.header.seq == 7])", True),
        ("m.name[0].startswith('sl') and m.header.frame_id.upper() == 'BASE'", True),
        ("m.position[m.name.index('slide')] == 0.4", True),
        ("any(x.startswith('la') for x in m.name)", True),
    ],
)
def test_a_filter_sees_the_fields_of_the_message(text: str, value: bool) -> None:
    assert Filter(text, JOINTS)(MESSAGE) is value


def test_bytes_are_numbers_in_a_filter() -> None:
    assert Filter("m.data[1] == 65", schema("std_msgs/UInt8MultiArray"))({"data": "AEH/"})


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("m.data ==", "invalid syntax"),
        ("m.positon[0] > 1", "Did you mean 'position'?"),
        ("m.header.stamp.hours", "fields: nsecs, secs"),
        ("topic == 1", "no name 'topic'"),
        ("__import__('os')", "no name '__import__'"),
        ("m.__class__", "no field '__class__'"),
        ("open('/etc/passwd')", "no name 'open'"),
        ("1" * 5000, "longer than"),
        ("(" * 300, "not a valid expression"),
    ],
)
def test_what_expressions_do_not_have_is_refused_before_the_start(text: str, reason: str) -> None:
    with pytest.raises(UsageError) as caught:
        Filter(text, JOINTS)
    assert reason in str(caught.value)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("1 / (i - i)", {"i": 1}),
        ("sqrt(-1)", {"i": 1}),
        ("9 ** 9 ** 9", {"i": 1}),
        ("2 ** 4000 * 2 ** 4000", {"i": 1}),
        ("round(i, -100000000)", {"i": 1}),
        ("round(1, 10 ** 9)", {"i": 1}),
        ("factorial(3000000)", {"i": 1}),
        ("comb(10 ** 9, 10 ** 8)", {"i": 1}),
        ("math.perm(10 ** 6)", {"i": 1}),
        ("prod([2 ** 4000, 2 ** 4000])", {"i": 1}),
        ("lcm(2 ** 4000 - 1, 2 ** 4000 - 3)", {"i": 1}),
        ("exp(1000)", {"i": 1}),
        ("[1][2]", {"i": 1}),
        ("len(i)", {"i": 1}),
        ("i.lower()", {"i": 1}),
        ("i.lower()", {"i": ["A"]}),
        ("i.__class__", {"i": 1}),
        ("1" + "+1" * 1990, {}),
        ("[0 for a in range(10 ** 4) for b in range(10 ** 4)]", {}),
    ],
)
def test_what_cannot_be_computed_says_so(text: str, names: dict[str, Any]) -> None:
    with pytest.raises(Refused, match="cannot compute"):
        Expression(text, ("i",))(**names)


@pytest.mark.parametrize(
    "words",
    [
        ["pub", "/z", "std_msgs/Float64", "-r", "10", "round(1, -100000000)", "--allow-unheard"],
        ["pub", "/z", "std_msgs/Float64", "-r", "10", "factorial(3000000)", "--allow-unheard"],
        ["echo", "/kept", "--filter", "round(7, -30000000) == 0"],
    ],
)
def test_a_command_with_an_expression_that_would_never_end_ends(world: CommandLine, words: list[str]) -> None:
    with world.client() as client:
        client.publish("/kept", {"data": 1.0}, "std_msgs/Float64", latch=True)
        client.flush()
        done = world(*words)
    assert done.returncode == 1, done.stderr
    assert "cannot compute" in done.stderr


def test_an_index_out_of_range_in_a_filter_is_an_error() -> None:
    with pytest.raises(Refused, match="cannot compute"):
        Filter("m.position[5] > 0", JOINTS)(MESSAGE)
