"""Lines that are run without click's parser mean exactly what click makes of them."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import Any

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slidectl.cli import plainly
from slidectl.cli.commands import Group
from slidectl.cli.context import Context
from slidectl.cli.main import root
from slidectl.errors import SlidectlError

PLANS = plainly.plans(root)


def commands(group: click.Group, click_context: click.Context, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """The names of all commands that have a plan."""
    for name in group.list_commands(click_context):
        command = group.get_command(click_context, name)
        if isinstance(command, Group):
            yield from commands(command, click.Context(command, parent=click_context), (*path, name))
        elif PLANS.find((*path, name))[0] is not None:
            yield (*path, name)


PLANNED = list(commands(root, click.Context(root, obj=Context()), ()))
_VALUES = ["1", "-1", "0.5", "-0.5", "1e-3", "-.inf", "max", "json", "a:=b", "/a/b", "command", "", "-", "x y", "5s"]
_ODD = ["--", "--no-such", "--json=1", "-n5", "-vv", "-h", "-xsin(t)", "-(t)", "--n", "-o=json"]


def options(path: tuple[str, ...]) -> list[str]:
    """All that a command and its relatives understand."""
    plan, _ = PLANS.find(path)
    assert plan is not None
    return [name for param in plan._command.get_params(plan._click) for name in (*param.opts, *param.secondary_opts)]


def lines(path: tuple[str, ...]) -> st.SearchStrategy[tuple[tuple[str, ...], list[str]]]:
    word = st.sampled_from(_VALUES) | st.sampled_from(options(path)) | st.sampled_from(_ODD)
    return st.tuples(st.just(path), st.lists(word, max_size=6))


def as_click_reads(path: tuple[str, ...], words: list[str]) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """The parameters, and what the common options made of the context; None when click would not run the command."""
    context = Context()
    parent, command = click.Context(root, obj=context), root
    for name in path:
        found = command.get_command(parent, name)  # type: ignore[attr-defined]
        assert found is not None
        if name is not path[-1]:
            parent, command = click.Context(found, parent=parent), found
    try:
        return found.make_context(path[-1], list(words), parent=parent).params, vars(context)
    except (click.ClickException, click.exceptions.Exit, SlidectlError):
        return None


@given(st.sampled_from(PLANNED).flatmap(lines))
def test_a_line_has_the_parameters_that_click_reads(line: tuple[tuple[str, ...], list[str]]) -> None:
    path, words = line
    plan, rest = PLANS.find([*path, *words])
    context = Context()
    assert plan is not None
    params = plan.parse(rest, context)
    if params is not None:
        assert (params, vars(context)) == as_click_reads(path, words)


@pytest.mark.parametrize(
    "line",
    [
        "pub command 0.5",
        "pub command -0.5 --json",
        "pub -1 /a/command std_msgs/Float64 'data: 1.0'",
        "pub command -r 100 -n 5 sin(t)",
        "service call load_controller \"name: 'x y'\"",
        "service call /rosapi/get_time",
        "param get pid/p --default -1",
        "param set pid/p -0.5 -q",
        "sim step 1",
        "sim step",
        "sim status -o json",
        "echo joint_states/position[0] -n 1",
        "controller list --timeout 5",
        "topic info command --ns /slider",
        "wait joint_states/position[0] --near -1.0 --tol 0.02 --within 15",
    ],
)
def test_everyday_lines_are_plain(line: str) -> None:
    words = plainly.split(line)
    assert words == shlex.split(line, comments=True)
    plan, rest = PLANS.find(words)
    assert plan is not None
    assert plan.parse(rest, Context()) is not None


@pytest.mark.parametrize(
    "line",
    [
        "pub",
        "pub --help",
        "pub command 1 --rate=5",
        "pub command 1 -r fast",
        "sim step 1 2",
        "sim stp 1",
        "no_such_command",
        "sim",
        "sim status -vv",
        "sim status --ns -1",
        "daemon start",
        "check slider",
        "--json sim status",
        "controller switch --start a b",
        "wait x -- y",
    ],
)
def test_the_rest_is_for_click(line: str) -> None:
    plan, rest = PLANS.find(line.split())
    assert plan is None or plan.parse(rest, Context()) is None


@given(st.text(alphabet="ab /:{}-.[]'\"\\#\t\r\n\x0b\x1c\u00e9\u3000", max_size=20))
def test_lines_are_parted_as_shlex_does(line: str) -> None:
    words = plainly.split(line)
    if words is not None:
        assert words == shlex.split(line, comments=True)
