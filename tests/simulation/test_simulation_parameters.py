"""The parameter tree: values and namespaces, search, watchers, and what is no parameter."""

from __future__ import annotations

import math
import sys
from typing import Any

import pytest

from slidectl.errors import BadName, Refused, UsageError
from slidectl.simulation.parameters import Parameters, UnknownParameter


@pytest.fixture
def parameters() -> Parameters:
    made = Parameters()
    made.set("/slider", {"pid": {"p": 100.0, "i": 0.01}, "joints": ["joint1"]})
    return made


def test_a_namespace_reads_as_a_mapping(parameters: Parameters) -> None:
    assert parameters.get("/slider/pid") == {"p": 100.0, "i": 0.01}
    assert parameters.get("/slider/pid/p") == 100.0
    assert parameters.get("/") == {"slider": {"pid": {"p": 100.0, "i": 0.01}, "joints": ["joint1"]}}
    assert parameters.get("/slider/") == parameters.get("/slider")


def test_names_are_those_of_the_values(parameters: Parameters) -> None:
    assert parameters.names() == ["/slider/joints", "/slider/pid/i", "/slider/pid/p"]
    assert parameters.names("/slider/pid") == ["/slider/pid/i", "/slider/pid/p"]
    assert parameters.names("/slider/pid/p") == ["/slider/pid/p"]
    assert parameters.names("/nope") == []


def test_an_unset_one_is_named_with_the_closest(parameters: Parameters) -> None:
    with pytest.raises(UnknownParameter, match="Did you mean '/slider/pid/p'"):
        parameters.get("/slider/pid/pp")
    with pytest.raises(KeyError):
        parameters.get("/slider/pid/p/q")
    assert parameters.get("/nope", None) is None


def test_a_mapping_replaces_a_namespace_unless_it_is_merged(parameters: Parameters) -> None:
    parameters.set("/slider/pid", {"d": 1}, merge=True)
    assert parameters.get("/slider/pid") == {"p": 100.0, "i": 0.01, "d": 1}
    parameters.set("/slider/pid", {"d": 2})
    assert parameters.get("/slider/pid") == {"d": 2}


def test_a_value_below_a_value_makes_a_namespace_of_it(parameters: Parameters) -> None:
    parameters.set("/slider/pid/p/deep", 1)
    assert parameters.get("/slider/pid/p") == {"deep": 1}


def test_deleting_takes_the_whole_namespace_and_empty_ones_above(parameters: Parameters) -> None:
    parameters.set("/a/b/c", 1)
    parameters.delete("/a/b/c")
    assert not parameters.has("/a")
    parameters.delete("/slider")
    assert parameters.names() == []
    with pytest.raises(UnknownParameter):
        parameters.delete("/slider")


def test_what_is_read_and_written_is_a_copy(parameters: Parameters) -> None:
    value = {"names": ["a"]}
    parameters.set("/x", value)
    value["names"].append("b")
    parameters.get("/x/names").append("c")
    assert parameters.get("/x/names") == ["a"]


def test_search_finds_the_nearest_namespace_with_the_first_component(parameters: Parameters) -> None:
    parameters.set("/robot_description", "<robot/>")
    parameters.set("/slider/other/robot_description", "near")
    assert parameters.search("/slider/controller", "robot_description") == "/robot_description"
    assert parameters.search("/slider/other/deep", "robot_description") == "/slider/other/robot_description"
    assert parameters.search("/slider/controller", "pid/nope") == "/slider/pid/nope", "the first component decides"
    assert parameters.search("/slider", "nope") is None
    assert parameters.search("/slider", "/slider/pid/p") == "/slider/pid/p"
    assert parameters.search("/slider", "/nope") is None


@pytest.mark.parametrize("name", ["/slider/pid", "/slider/pid/p", "/slider"])
def test_a_watcher_hears_of_changes_at_below_and_above_its_name(parameters: Parameters, name: str) -> None:
    heard: list[str] = []
    parameters.watch(name, lambda: heard.append(name))
    parameters.set("/slider/pid/p", 1.0)
    parameters.set("/slider", {"pid": {"p": 2.0}})
    parameters.delete("/slider/pid/p")
    parameters.set("/other", 1)
    assert heard == [name] * 3


def test_a_watcher_hears_once_of_a_merge_and_nothing_after_it_closed(parameters: Parameters) -> None:
    heard: list[int] = []
    close = parameters.watch("/slider/pid", lambda: heard.append(1))
    parameters.set("/slider", {"pid": {"p": 1.0, "i": 2.0}, "other": 1}, merge=True)
    parameters.set("/slider", {"other": 2}, merge=True)
    assert heard == [1]
    close()
    parameters.set("/slider/pid/p", 3.0)
    assert heard == [1]


def test_keys_with_slashes_are_namespaces(parameters: Parameters) -> None:
    parameters.set("/x", {"a/b": 1, "a": {"c": 2}, "/d/": 3})
    assert parameters.get("/x") == {"a": {"b": 1, "c": 2}, "d": 3}


@pytest.mark.parametrize(
    "value", [None, {"a": None}, [1, None], {"a": {1: 2}}, {"": 1}, {"a b": 1}, b"bytes", object()]
)
def test_what_is_no_parameter_is_refused_and_changes_nothing(parameters: Parameters, value: object) -> None:
    before = parameters.get("/")
    with pytest.raises(UsageError):
        parameters.set("/slider/pid", value)
    assert parameters.get("/") == before


def test_the_place_of_a_null_inside_is_named(parameters: Parameters) -> None:
    with pytest.raises(UsageError, match=r"/slider/pid/gains\[1\]/p: null"):
        parameters.set("/slider/pid", {"gains": [1, {"p": None}]})


@pytest.mark.parametrize("name", ["/bad name", "", "/a//b"])
def test_illegal_names_cannot_be_set(parameters: Parameters, name: str) -> None:
    with pytest.raises(BadName):
        parameters.set(name, 1)


def test_the_root_can_be_replaced_by_a_mapping_only(parameters: Parameters) -> None:
    with pytest.raises(UsageError, match="root"):
        parameters.set("/", 1)
    parameters.set("/", {"a": 1})
    assert parameters.names() == ["/a"]
    parameters.delete("/")
    assert parameters.names() == []


@pytest.mark.parametrize("value", ["\ud800", {"\ud800": 1}, [{"a": ["\udfff"]}]])
def test_half_of_a_surrogate_pair_is_not_text(value: Any) -> None:
    parameters = Parameters()
    with pytest.raises(UsageError, match="half of a surrogate pair"):
        parameters.set("/x", value)
    assert parameters.names() == []


def test_what_is_nested_without_end_is_refused(parameters: Parameters) -> None:
    before = parameters.names()
    deep: list[object] = []
    for _ in range(500):
        deep = [deep]
    for name, value in (("/deep", deep), ("/a" * 300, 1), ("/a", {"/b" * 300: 1}), ("/a" * 40, {"b/" * 30: 1})):
        with pytest.raises(UsageError, match="nested deeper"):
            parameters.set(name, value)
    assert parameters.names() == before


@pytest.mark.parametrize("value", [math.nan, math.inf, 10**400, [0.0, -math.inf], {"p": math.nan}])
def test_only_finite_numbers_are_parameters(value: Any) -> None:
    parameters = Parameters()
    with pytest.raises(UsageError, match="is not a finite number"):
        parameters.set("/x", value)
    assert parameters.names() == []


def test_a_watcher_that_fails_keeps_nobody_from_hearing_of_it() -> None:
    parameters, heard = Parameters(), []

    def fail() -> None:
        raise RuntimeError("this one")

    parameters.watch("/x", fail)
    parameters.watch("/x", lambda: heard.append(parameters.get("/x")))
    with pytest.raises(RuntimeError, match="this one"):
        parameters.set("/x", 1)
    assert heard == [1]


def test_all_parameters_together_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slidectl.simulation.parameters.LARGEST", 1000)
    parameters = Parameters()
    for _ in range(5):  # what is replaced does not count
        parameters.set("/text", "x" * 500)
    with pytest.raises(Refused, match="larger than 1000 characters"):
        parameters.set("/other", "x" * 500)
    assert parameters.names() == ["/text"]
    parameters.delete("/text")
    parameters.set("/other", "x" * 500)


def test_what_nodes_derive_is_not_given_until_a_client_sets_it_or_it_changes() -> None:
    parameters = Parameters()
    parameters.set("/a/p", 1.0)
    for name in ("/a/i", "/a/d", "/a/p"):  # the last one was given
        parameters.set(name, 0.0, derived=True)
    assert parameters.given("/") == {"a": {"p": 0.0}}
    assert (parameters.given("/a/i"), parameters.derived()) == ({}, ["/a/d", "/a/i"])
    parameters.set("/a/i", 0.0, derived=True)  # the same value once more
    assert parameters.derived() == ["/a/d", "/a/i"]
    parameters.set("/a/i", 0.0)
    parameters.set("/a/d", 2.0, derived=True)
    assert parameters.given("/a") == {"a": {"p": 0.0, "i": 0.0, "d": 2.0}}


@pytest.mark.parametrize("change", ["delete", "set"])
def test_a_namespace_that_is_deleted_or_replaced_takes_what_was_derived_along(change: str) -> None:
    parameters = Parameters()
    parameters.set("/a/i", 0.0, derived=True)
    if change == "delete":
        parameters.delete("/a")
    parameters.set("/a", {"i": 0.0})
    assert parameters.given("/") == {"a": {"i": 0.0}}


def calls_to_set(values: dict[str, Any], derived: int) -> int:
    """How many functions run while the values are set, beside so many derived parameters in the same namespace."""
    parameters = Parameters()
    for number in range(derived):
        parameters.set(f"/r/gains/{number}", 0.0, derived=True)
    count = 0

    def counted(_frame: object, event: str, _argument: object) -> None:
        nonlocal count
        count += event == "call"

    before = sys.getprofile()
    sys.setprofile(counted)
    try:
        parameters.set_all(values)
    finally:
        sys.setprofile(before)
    assert len(parameters.derived()) == derived
    return count


def test_the_work_of_many_values_does_not_grow_with_what_is_derived_beside_them() -> None:
    values = {f"/r/other/{number}": 1 for number in range(2000)}
    assert calls_to_set(values, 200) < 2 * calls_to_set(values, 1)
