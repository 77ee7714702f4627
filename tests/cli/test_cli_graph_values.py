"""Values as a person types them: numbers are numbers, the rest is YAML 1.1; the short way agrees with the long one."""

from __future__ import annotations

import math
import subprocess
import sys
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slidectl import typed_values
from slidectl.errors import UsageError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1.0", 1.0),
        ("-5.0", -5.0),
        ("-5", -5),
        ("1e-3", 0.001),
        ("-.5", -0.5),
        ("0x10", 16),
        ("010", 8),
        ("12:30", 750),
        (".inf", math.inf),
        ("no", False),
        ("Yes", True),
        ("hello", "hello"),
        ("a:=b", "a:=b"),
        ("data:1.0", "data:1.0"),
        ("", None),
        ("~", None),
        ("# comment", None),
        ('"1"', "1"),
        ("'1'", "1"),
        ("data: 1.0", {"data": 1.0}),
        ("{data: 1.0}", {"data": 1.0}),
        ("data: 1e-3", {"data": 0.001}),
        ("[1e-3, -.5, x]", [0.001, -0.5, "x"]),
        ('{"a": [1, null]}', {"a": [1, None]}),
        ("{header: auto, name: [a, b]}", {"header": "auto", "name": ["a", "b"]}),
        ("- 1\n- 2", [1, 2]),
        ("sin(2*pi*0.2*t)", "sin(2*pi*0.2*t)"),
        (
            "{start_controllers: ['a','b'], stop_controllers: [], strictness: 2}",
            {"start_controllers": ["a", "b"], "stop_controllers": [], "strictness": 2},
        ),
    ],
)
def test_a_value_is_read_as_it_was_meant(text: str, value: Any) -> None:
    read = typed_values.read(text)
    assert read == value
    assert type(read) is type(value)


def test_dot_nan_is_not_a_number() -> None:
    assert math.isnan(typed_values.read(".nan"))
    assert typed_values.read("nan") == "nan"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("data: [1", "not valid YAML: expected ',' or ']', but got '<stream end>' (line 1, column 9)"),
        ("2020-01-01", "is a date to YAML"),
        ("{1: 2}", "the key 1"),
        ("!!python/object:os.system x", "not valid YAML"),
        ("a: 1\n---\na: 2", "2 YAML documents"),
        ("&a [*a]", "is nested too deeply"),
        ("a: &a [x,x,x,x,x,x,x,x,x,x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a,*a]\n"
         "c: &c [*b,*b,*b,*b,*b,*b,*b,*b,*b,*b]\nd: &d [*c,*c,*c,*c,*c,*c,*c,*c,*c,*c]\n"
         "e: &e [*d,*d,*d,*d,*d,*d,*d,*d,*d,*d]\nf: [*e,*e,*e,*e,*e,*e,*e,*e,*e,*e]", "expands to more than"),
    ],
)  # fmt: skip
def test_text_that_is_no_value_is_refused_with_the_reason(text: str, reason: str) -> None:
    with pytest.raises(UsageError) as caught:
        typed_values.read(text)
    assert reason in str(caught.value)


WORDS = ["1", "-", "1.5", "e", "E+1", ":", " ", "0", "no", "null", "~", "data", ".", "x", "{", "}", "[", "]", ",", '"']


@given(st.lists(st.sampled_from(WORDS), max_size=6).map("".join))
def test_the_short_way_reads_what_yaml_reads(text: str) -> None:
    try:
        expected: Any = typed_values.read_yaml(text)
    except UsageError:
        return
    assert repr(typed_values.read(text)) == repr(expected)


@given(st.floats(allow_nan=False, allow_infinity=False) | st.integers())
def test_any_number_is_read_back(number: float) -> None:
    assert typed_values.read(repr(number)) == number
    assert typed_values.read(f"data: {number!r}") == {"data": number}


def test_everyday_values_do_not_load_yaml() -> None:
    texts = ["1.0", "-5.0", "1e-3", "true", "hello", "data: 1.0", "{data: 1.0}", "[1, 2]", '{"data": 1}', ""]
    reading = f"import sys\nfrom slidectl.typed_values import read\nfor text in {texts!r}: read(text)\n"
    script = reading + "sys.exit('yaml' in sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)
