"""The table of commands, their helps, and how words become options and values."""

from __future__ import annotations

import re
from collections.abc import Iterator

import click
import pytest
from command_line import CommandLine

from slidectl.cli.command_table import COMMANDS, load
from slidectl.cli.commands import Variadic, command, is_number
from slidectl.cli.context import Context
from slidectl.cli.main import root


def every_command() -> Iterator[tuple[str, click.Command]]:
    """Every command and verb with its full name, each once (`topic pub` is `pub`)."""
    roots = {name: load(name) for name in COMMANDS}
    for name, one in roots.items():
        yield f"slidectl {name}", one
        if isinstance(one, click.Group):
            verbs = {verb: inner for verb, inner in one.commands.items() if inner not in roots.values()}
            yield from ((f"slidectl {name} {verb}", inner) for verb, inner in verbs.items())


@pytest.mark.parametrize("name", COMMANDS)
def test_the_table_says_what_the_command_says_of_itself(name: str) -> None:
    assert load(name).get_short_help_str(1000) == COMMANDS[name].help


def test_every_command_has_a_help_and_an_example_of_itself() -> None:
    for name, one in every_command():
        assert one.help, name
        examples = getattr(one, "examples", ())
        assert examples, f"{name} has no example"
        assert any(name in example for example in examples), f"{name}: {examples}"


_QUANTITIES = ("COND", "FACTOR|max", "TIME", "T", "X", "X|FIELD", "JOINT=POSITION", "JOINT=POSITION...", "F[=TOL]...")
"""What stands for a number in options that click does not take as numbers."""
_UNIT = re.compile(
    r"(?<![\w'-])(s|seconds|m|rad|m/s|rad/s|m/s\^2|N|N m|N s/m|kg|J|Hz|10\^6 bytes)(?![\w'-])"
    r"|%|in (the|its|their)( own)? units?\b|times as fast|from 0 to 1|a number of times|Pictures in a simulated second"
)
_COUNTED = re.compile(
    r"\b(lines|port|domain|ROS_DOMAIN_ID|Seed|messages|files|reports|Characters|transforms|Clients|Frames|frame|cases"
    r"|failures)\b",
    re.IGNORECASE,
)


def options_with_numbers() -> Iterator[tuple[str, click.Option, bool]]:
    """The options that take numbers, each with its command, and whether it counts something."""
    for name, one in every_command():
        with click.Context(one) as context:
            for option in one.get_params(context):
                if isinstance(option, click.Option) and not (option.is_flag or option.count):
                    counts = isinstance(option.type, click.types.IntParamType | click.IntRange)
                    is_real = isinstance(option.type, click.types.FloatParamType | click.FloatRange)
                    if counts or is_real or option.metavar in _QUANTITIES:
                        yield f"{name} {option.opts[-1]}", option, counts


def test_every_option_that_takes_a_number_names_its_unit_or_what_it_counts() -> None:
    found = list(options_with_numbers())
    assert {"slidectl wait --near", "slidectl spawn --at", "slidectl daemon logs --lines"} <= {
        name for name, *_ in found
    }
    for name, option, counts in found:
        assert (_COUNTED if counts else _UNIT).search(option.help or ""), f"{name}: {option.help}"


def test_every_time_says_which_clock_it_is_of_and_every_place_in_which_frame() -> None:
    for name, option, counts in options_with_numbers():
        text = option.help or ""
        if option.metavar in ("S", "SECONDS", "TIME"):
            assert re.search(r"\bsimulated\b|\bwall\b", text, re.IGNORECASE), f"{name}: {text}"
        if not counts and (option.metavar or "").startswith("X Y Z"):
            assert re.search(r"\bworld\b|\bframe\b", text), f"{name}: {text}"


def test_the_root_help_lists_every_command_and_every_exit_code() -> None:
    text = root.get_help(click.Context(root, info_name="slidectl"))
    for name, entry in COMMANDS.items():
        assert re.search(rf"^  {name} +{re.escape(entry.help)}", text, re.MULTILINE), name
    for code in (0, 1, 2, 3, 4, 130):
        assert re.search(rf"^    {code} +\w", text, re.MULTILINE), code


def test_help_goes_to_stdout_and_is_success(slidectl: CommandLine) -> None:
    for words in (["--help"], ["-h"], ["sim", "--help"], ["sim", "step", "-h"]):
        done = slidectl(*words)
        assert (done.returncode, done.stderr) == (0, "")
        assert "Common options:" in done.stdout
        assert "Examples:" in done.stdout


def test_version_is_said_in_every_way(slidectl: CommandLine) -> None:
    assert slidectl.ok("--version") == slidectl.ok("version")
    assert slidectl.ok("version", "--json").startswith('{"slidectl": "')
    assert slidectl.ok("version", "-o", "yaml").startswith("slidectl: ")
    assert slidectl.ok("-o", "csv", "version").splitlines()[0] == "slidectl,python"


@command("probe", examples=[])
@click.argument("words", nargs=-1)
@click.option("-1", "--once", is_flag=True)
@click.option("-n", "--count", type=int)
@click.option("--near", type=float)
@click.option("--start", cls=Variadic)
@click.option("--at", cls=Variadic, type=float, takes=is_number)
def probe(**values: object) -> dict[str, object]:
    return values


def parsed(*words: str) -> dict[str, object]:
    """The parameters that the command line gives, without those that are not set."""
    with probe.make_context("probe", list(words), obj=Context()) as context:
        return {key: value for key, value in context.params.items() if value not in (None, (), False)}


@pytest.mark.parametrize("number", ["-5.0", "-5", "-.5", "-1e-3", "-1.5E+3", "-inf", "-.inf", "-nan", "-1_000"])
def test_a_negative_number_needs_no_dashes_before_it(number: str) -> None:
    assert parsed("topic", number, "x") == {"words": ("topic", number, "x")}
    assert parsed("topic", "--", number) == {"words": ("topic", number)}


def test_an_option_that_looks_like_a_number_stays_an_option() -> None:
    assert parsed("topic", "-1") == {"words": ("topic",), "once": True}


def test_the_value_of_an_option_may_be_negative() -> None:
    assert parsed("--near", "-0.5") == {"near": -0.5}
    assert parsed("--near=-0.5") == {"near": -0.5}


@pytest.mark.parametrize("words", [("-n", "5"), ("-n5",), ("-n=5",), ("--count", "5"), ("--count=5",), ("-1n", "5")])
def test_short_and_long_options_may_be_written_in_every_usual_way(words: tuple[str, ...]) -> None:
    assert parsed(*words)["count"] == 5


def test_what_is_no_number_and_no_option_is_refused() -> None:
    with pytest.raises(click.UsageError):
        parsed("topic", "-5x")


def test_a_variadic_option_takes_values_until_the_next_option_and_may_repeat() -> None:
    assert parsed("--start", "a", "b", "-1", "c", "--start", "d") == {
        "start": ("a", "b", "d"),
        "once": True,
        "words": ("c",),
    }
    assert parsed("--start=a", "b") == {"start": ("a",), "words": ("b",)}


def test_a_variadic_option_of_numbers_leaves_other_words_alone() -> None:
    assert parsed("--at", "0", "-1", "2e-1", "slider") == {"at": (0.0, -1.0, 0.2), "words": ("slider",)}


def test_a_variadic_option_needs_a_value() -> None:
    with pytest.raises(click.UsageError, match="requires an argument"):
        parsed("--start")
    with pytest.raises(click.UsageError, match="requires an argument"):
        parsed("--start", "--once")


def test_an_assignment_in_a_value_stays_as_it_is() -> None:
    assert parsed("topic", "a:=b") == {"words": ("topic", "a:=b")}


def options_of(*words: str) -> Context:
    context = Context()
    with probe.make_context("probe", list(words), obj=context):
        return context


def test_common_options_are_understood_after_the_command_too() -> None:
    context = options_of("--json", "-v", "-q", "--timeout", "3", "-i", "one", "--ns", "left")
    assert (context.format, context.verbose, context.quiet, context.timeout) == ("json", 1, True, 3.0)
    assert (context.instance, context.namespace) == ("one", "/left")


def test_a_table_in_a_pipe_is_plain(slidectl: CommandLine) -> None:
    assert "\x1b" not in slidectl.ok("version", FORCE_COLOR="1")


def test_errors_are_coloured_on_a_terminal_unless_no_color_is_set(slidectl: CommandLine) -> None:
    assert b"\x1b[31m" in slidectl.on_a_terminal("robots")
    assert b"\x1b" not in slidectl.on_a_terminal("robots", NO_COLOR="1")
    assert b"\x1b" not in slidectl.on_a_terminal("robots", TERM="dumb")
