"""How the ROS commands read their words: options as optparse does, names, remappings, and messages as genpy does."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import click
import pytest
import yaml
from cli_graph_types import schema
from hypothesis import given
from hypothesis import strategies as st

from slidectl import typed_values
from slidectl.cli.context import Context
from slidectl.extensions.ros_commands import genpy
from slidectl.extensions.ros_commands.arguments import (
    Failure,
    Parser,
    option,
    resolve,
    resolve_remapped,
    without_remappings,
)

PARSER = Parser(
    "tool",
    "tool verb [options] WORD...",
    option("-v", "say more", dest="verbose"),
    option("-l --latch", "stay"),
    option("-n", "so many", "COUNT", dest="count"),
    option("-r --rate", "how often", "HZ"),
    option("--noarr", "no arrays"),
    option("--nostr", "no strings"),
)


def given_by(*words: str) -> tuple[dict[str, Any], list[str]]:
    """The options that were given, and the words."""
    given = vars(PARSER.parse(words))
    rest = given.pop("words")
    return {name: value for name, value in given.items() if value is not None}, rest


@pytest.mark.parametrize(
    ("words", "values", "rest"),
    [
        ("-vln1 a", {"verbose": True, "latch": True, "count": "1"}, ["a"]),
        ("--ra 5 a", {"rate": "5"}, ["a"]),
        ("-r -1 a", {"rate": "-1"}, ["a"]),
        ("-n -v a", {"count": "-v"}, ["a"]),
        ("a -5.0 -1e-3 -.inf -0x10 -1:30", {}, ["a", "-5.0", "-1e-3", "-.inf", "-0x10", "-1:30"]),
        ("a -- -v --bogus", {}, ["a", "-v", "--bogus"]),
        ("- a", {}, ["-", "a"]),
    ],
)
def test_options_and_words(words: str, values: dict[str, Any], rest: list[str]) -> None:
    assert given_by(*words.split()) == (values, rest)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("-vz", "no such option: -z"),
        ("--no", "ambiguous option: --no (--noarr, --nostr?)"),
        ("-n", "-n option requires 1 argument"),
        ("--latch=5", "--latch option does not take a value"),
    ],
)
def test_wrong_usage_is_2(words: str, complaint: str) -> None:
    with pytest.raises(Failure) as caught:
        PARSER.parse(words.split())
    assert str(caught.value) == f"Usage: tool verb [options] WORD...\n\ntool: error: {complaint}"
    assert caught.value.exit_code == 2


def test_help_shows_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(click.exceptions.Exit):
        PARSER.parse(["a", "--help"])
    text = capsys.readouterr().out
    assert text.startswith("Usage: tool verb [options] WORD...\n\nOptions:\n")
    assert "  -r HZ, --rate=HZ  how often\n" in text
    assert "  -h, --help        show this help message and exit\n" in text


@given(st.lists(st.text(alphabet="-=abnrv1.:", max_size=6), max_size=6))
def test_any_words_are_read_or_refused(words: list[str]) -> None:
    with suppress(Failure):
        PARSER.parse(words)


# --- names ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("namespace", "name", "full"),
    [
        ("", "/abs", "/abs"),
        ("", "rel", "/rel"),
        ("/ns", "rel", "/ns/rel"),
        ("ns/", "rel", "/ns/rel"),
        ("/ns", "/abs", "/abs"),
        ("", "~x", "/rosparam/x"),
        ("/ns", "~x", "/ns/rosparam/x"),
    ],
)
def test_names_are_resolved_as_in_ros(monkeypatch: pytest.MonkeyPatch, namespace: str, name: str, full: str) -> None:
    monkeypatch.setenv("ROS_NAMESPACE", namespace)
    assert resolve(Context(), name, "rosparam") == full


def test_the_namespace_of_slidectl_counts_where_that_of_ros_is_not_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_NAMESPACE", raising=False)
    context = Context()
    context.namespace = "/left"
    assert resolve(context, "rel", "rostopic") == "/left/rel"


def test_remappings_go_and_payloads_stay() -> None:
    assert without_remappings(["-n", "1", "/t", "a:=b", "__name:=x", "_rate:=5", "~p:=q"]) == ["-n", "1", "/t"]
    words = ["-1", "x:=y", "/s", "std_msgs/String", "a:=b", "__log:=/tmp/log", "data: 'c:=d'"]
    kept = ["-1", "/s", "std_msgs/String", "a:=b", "data: 'c:=d'"]
    assert without_remappings(words, payload_from=2) == kept


@pytest.mark.parametrize(
    ("words", "full"),
    [
        (["a:=b"], "/ns/b"),
        (["/ns/a:=/c"], "/c"),
        (["/a:=/c"], "/ns/a"),
        (["a:=b", "a:=c"], "/ns/c"),
        (["_a:=b", "__name:=a"], "/ns/a"),
        (["/ns/a", "std_msgs/String", "a:=b"], "/ns/a"),
    ],
)
def test_remappings_rename_what_is_published(monkeypatch: pytest.MonkeyPatch, words: list[str], full: str) -> None:
    monkeypatch.setenv("ROS_NAMESPACE", "/ns")
    assert resolve_remapped(Context(), "a", "rostopic", words, payload_from=2) == full


# --- messages ---------------------------------------------------------------------------------------------------------


MISFITS = [
    ("geometry_msgs/PoseWithCovariance", [{"covariance": [1.0]}], "incorrect number of elements: 1 != 36"),
    ("geometry_msgs/PoseStamped", [{"header": {"stamp": "later"}}], "No key named [later]"),
    ("geometry_msgs/PoseStamped", [{"pose": 5}], "invalid msg_args type: 5"),
    ("geometry_msgs/PoseArray", [{"poses": [{"positions": 1}]}], "No field name [poses.positions]"),
    ("std_msgs/Time", [[1, 2, 3]], "Too many arguments:\n * Given: [1, 2, 3]\n * Expected: ['secs', 'nsecs']"),
]


@pytest.mark.parametrize(("kind", "values", "text"), MISFITS, ids=[text for _, _, text in MISFITS])
def test_a_misfit_is_explained_in_genpys_words(kind: str, values: list[Any], text: str) -> None:
    with pytest.raises(genpy.WrongStructure) as caught:
        genpy.explain(schema(kind), values)
    assert text in str(caught.value)


NO_TEXT = "must be of type bytes or an ascii string"
WRONG = [
    ("std_msgs/UInt8", -1, "field data must be unsigned integer type"),
    ("std_msgs/UInt64", 2**64, "field data exceeds specified width [uint64]"),
    ("std_msgs/Int8", 128, "field data exceeds specified width [int8]"),
    ("std_msgs/Byte", 300, "field data exceeds specified width [byte]"),
    ("std_msgs/Char", -1, "field data must be unsigned integer type"),
    ("std_msgs/Float32", True, "field data must be float type"),
    ("std_msgs/Bool", "on", "field data is not a bool"),
    ("std_msgs/Header", {"stamp": {"secs": "1"}}, "field stamp.secs must be an integer type"),
    ("std_msgs/Header", {"stamp": {"secs": 2**32 - 1}, "frame_id": 5}, f"field frame_id {NO_TEXT}"),
    ("std_msgs/Header", {"stamp": {"nsecs": -1}, "frame_id": 5}, f"field frame_id {NO_TEXT}"),
]


@pytest.mark.parametrize(("kind", "value", "text"), WRONG, ids=[f"{kind} {value}" for kind, value, _ in WRONG])
def test_a_wrong_type_is_explained_in_genpys_words(kind: str, value: Any, text: str) -> None:
    with pytest.raises(genpy.WrongType) as caught:
        genpy.explain(schema(kind), [value])
    assert str(caught.value) == text


@given(st.text(alphabet=" '\"\\:#{},ab1%\n\té"))
def test_quoted_text_in_a_mapping_is_what_yaml_says(text: str) -> None:
    for line in (f"name: '{text}'", f'name: "{text}"', f"{{name: '{text}'}}"):
        shortcut = typed_values._pair(line)
        assert shortcut is typed_values._UNKNOWN or shortcut == yaml.safe_load(line)
