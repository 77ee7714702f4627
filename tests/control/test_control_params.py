"""Typed reading of parameters: what counts as what, and that nothing is passed over in silence."""

import pytest

from slidectl.control import params
from slidectl.errors import Refused


@pytest.mark.parametrize(
    ("value", "number"), [(1, 1.0), (2.5, 2.5), (True, None), ("1.0", None), ("1e-3", None), (10**400, None)]
)
def test_a_number_is_an_int_or_a_float(value, number):
    assert params.as_number(value) == number


@pytest.mark.parametrize(
    ("value", "integer"),
    [(3, 3), (3.49, 3), (3.5, 4), (-3.5, -3), (-3.51, -4), (True, None), ("3", None), (float("inf"), None)],
)
def test_an_integer_is_an_int_or_a_float_rounded_half_up(value, integer):
    assert params.as_integer(value) == integer


@pytest.mark.parametrize(("value", "flag"), [(True, True), (False, False), (1, None), (0, None), ("true", None)])
def test_a_boolean_is_nothing_but_a_boolean(value, flag):
    assert params.as_boolean(value) is flag


@pytest.mark.parametrize(("value", "texts"), [(["a", "b"], ["a", "b"]), ([], []), (["a", 1], None), ("a", None)])
def test_a_list_of_strings_has_nothing_else_in_it(value, texts):
    assert params.as_texts(value) == texts


@pytest.mark.parametrize(
    ("value", "numbers"), [([1, 2.5, True], [1.0, 2.5, 1.0]), ([1, "2"], None), (1.0, None), ([10**400], None)]
)
def test_a_list_of_numbers_takes_booleans_too(value, numbers):
    assert params.as_numbers(value) == numbers


def test_a_parameter_of_the_wrong_type_counts_as_not_set_and_is_pointed_out(graph):
    node = graph.node("/bot")
    kinds = {
        "number": params.NUMBER,
        "integer": params.INTEGER,
        "boolean": params.BOOLEAN,
        "texts": params.TEXTS,
        "numbers": params.NUMBERS,
    }
    for name, kind in kinds.items():
        node.set_param(name, "x")
        assert params.read(node, name, kind) is None
        assert f"/bot/{name} has no effect" in graph.log[-1][1]
    node.set_param("text", 1)
    assert params.read(node, "text", params.TEXT) is None
    assert graph.log[-1] == ("warn", "parameter /bot/text has no effect: it must be a string, not 1")


def test_a_parameter_that_is_not_set_is_none_without_a_word(graph):
    assert params.read(graph.node("/bot"), "p", params.NUMBER) is None
    assert graph.log == []


def test_a_number_that_yaml_took_for_text_is_explained(graph):
    node = graph.node("/bot")
    node.set_param("p", "1e-3")
    with pytest.raises(params.BadParameter, match=r"string '1e-3' \(YAML reads .* 1.0e-3\)"):
        params.needed(node, "p", params.NUMBER)


def test_a_needed_parameter_that_is_missing_is_named_with_what_to_type(graph):
    node = graph.node("/bot/controller")
    with pytest.raises(Refused) as refusal:
        params.needed(node, "joint", params.TEXT)
    assert str(refusal.value) == (
        "parameter /bot/controller/joint is not set; it must be a string\n"
        "slidectl param set /bot/controller/joint VALUE"
    )


def test_needed_parameters_of_the_right_type_are_returned(graph):
    node = graph.node("/bot")
    for name, value in (("n", 2), ("t", "x")):
        node.set_param(name, value)
    assert params.needed(node, "n", params.NUMBER) == 2.0
    assert params.needed(node, "t", params.TEXT) == "x"
