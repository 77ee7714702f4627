"""Documents from pipes and files, and values with expressions in them."""

from __future__ import annotations

import math
from typing import Any

import pytest
from cli_graph_types import schema

from slidectl.errors import UsageError
from slidectl.msgs.fill import fill, mentions_clock
from slidectl.msgs.message_expressions import number_converter
from slidectl.typed_values import split


@pytest.mark.parametrize(
    ("text", "documents"),
    [
        ("", []),
        ("\n\n", []),
        ("data: 1\n", [{"data": 1}]),
        ("data: 1\n---\ndata: 2", [{"data": 1}, {"data": 2}]),
        ("---\ndata: 1\n---\ndata: 2\n---\n", [{"data": 1}, {"data": 2}]),
        ("a: 1\nb: 2\n---\na: 3\n", [{"a": 1, "b": 2}, {"a": 3}]),
        ("data: 1\n...\ndata: 2\n...\n", [{"data": 1}, {"data": 2}]),
        ('{"a": 1}\n{"a": [2]}\n', [{"a": 1}, {"a": [2]}]),
        ('{"a": 1}\n\n{"a": 2}\n\n', [{"a": 1}, {"a": 2}]),
        ('{"a": 1}\n---\n{"a": 2}\n---\n', [{"a": 1}, {"a": 2}]),
        ("0.5\n---\n0.25\n---\n", [0.5, 0.25]),
        ("0.5\n0.25\n", [0.5, 0.25]),
        ("\n---\n\n---\n", [None, None]),
        ("\n- a\n- b\n---\n", [["a", "b"]]),
        ("{a: 1,\n b: 2}\n", [{"a": 1, "b": 2}]),
    ],
)
def test_a_stream_is_cut_into_its_documents(text: str, documents: list[Any]) -> None:
    assert list(split(text.splitlines(keepends=True))) == documents


def test_null_in_a_json_line_is_not_a_number() -> None:
    ((value,),) = (message["data"] for message in split(['{"data": [null]}\n']))
    assert math.isnan(value)


def test_a_broken_document_is_named_by_its_number() -> None:
    documents = split(["a: 1\n", "---\n", "a: [\n"])
    assert next(documents) == {"a": 1}
    with pytest.raises(UsageError, match="document 2 is not valid YAML"):
        next(documents)


def at(type_name: str, values: list[Any], index: int = 2, seconds: float = 0.5) -> Any:
    types = schema(type_name)
    return fill(types.fields, types.root, values, (0, 0), number_converter(index, seconds))


@pytest.mark.parametrize(
    ("type_name", "values", "result"),
    [
        ("std_msgs/Float64", ["2*t"], {"data": 1.0}),
        ("std_msgs/Float64", [{"data": "t + i"}], {"data": 2.5}),
        ("std_msgs/Int32", ["i * 2.0"], {"data": 4}),
        ("std_msgs/Bool", ["t > 0"], {"data": True}),
        ("std_msgs/String", ["t"], {"data": "t"}),
        ("geometry_msgs/Point", ["t", 1, "i"], {"x": 0.5, "y": 1.0, "z": 2.0}),
        (
            "geometry_msgs/Twist",
            [["t", 0, 0], {"z": "i"}],
            {"linear": {"x": 0.5, "y": 0.0, "z": 0.0}, "angular": {"z": 2.0}},
        ),
        ("std_msgs/Float64MultiArray", [["t", 1.0]], {"data": [0.5, 1.0]}),
        ("std_msgs/UInt8MultiArray", [["i", 1]], {"data": "AgE="}),
        ("sensor_msgs/JointState", [{"name": ["t"], "position": ["t"]}], {"name": ["t"], "position": [0.5]}),
        ("geometry_msgs/PoseArray", [{"poses": [{"position": {"x": "t"}}]}], {"poses": [{"position": {"x": 0.5}}]}),
    ],
)
def test_text_where_a_number_is_due_is_an_expression(type_name: str, values: list[Any], result: Any) -> None:
    assert at(type_name, values) == result


@pytest.mark.parametrize(
    ("type_name", "values", "text"),
    [
        ("std_msgs/Int32", ["i / 4"], "data must be an integer (int32), not the number 0.5"),
        ("std_msgs/Float64", [{"wrong": "t"}], "no field 'wrong'"),
        ("std_msgs/Float64", ["t", "t"], "too many arguments"),
        ("std_msgs/Float64", ["q"], "no name 'q'"),
    ],
)
def test_an_expression_that_cannot_be_is_refused(type_name: str, values: list[Any], text: str) -> None:
    with pytest.raises(UsageError) as refused:
        at(type_name, values)
    assert text in str(refused.value)


def test_without_expressions_only_nan_and_inf_are_numbers() -> None:
    number_of = number_converter(0, 0.0, expressions=False)
    assert math.isnan(number_of("nan", "float64"))
    assert number_of("-Inf", "float64") == -math.inf
    assert number_of("t", "float64") == "t"


@pytest.mark.parametrize(
    ("values", "needs"), [(["auto"], True), ([{"header": {"stamp": "now"}}], True), ([["now"]], True), ([1.0], False)]
)
def test_the_clock_is_asked_only_when_a_value_stands_for_it(values: list[Any], needs: bool) -> None:
    assert mentions_clock(values) is needs
