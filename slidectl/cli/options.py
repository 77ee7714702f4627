"""The options that every command understands, before the command and after it.

They store into the Context. Nothing is parsed here that belongs to one command.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from functools import cache
from typing import Any

import click

from slidectl.cli import output
from slidectl.cli.context import Context

Callback = Callable[[click.Context, click.Parameter, Any], None]


def positive_seconds(_click: click.Context, _param: click.Parameter, value: float | None) -> float | None:
    """Callback of an option in seconds: the value, or a usage error unless it is above 0."""
    if value is not None and not value > 0:
        raise click.BadParameter(f"{value:g} is not above 0")
    return value


def simulated_seconds(click_context: click.Context, param: click.Parameter, value: float | None) -> float | None:
    """Callback of an option in seconds of the world, which has no end to wait for: above 0 and finite."""
    if value == math.inf:
        raise click.BadParameter("the simulated time never gets there; leave the option out for no limit")
    return positive_seconds(click_context, param, value)


def _store(attribute: str, convert: Callable[[Any], Any] = lambda value: value) -> Callback:
    def callback(click_context: click.Context, _param: click.Parameter, value: Any) -> None:
        context = click_context.find_object(Context)
        if value not in (None, False, 0) and context is not None:
            setattr(context, attribute, convert(value))

    return callback


def _store_timeout(click_context: click.Context, param: click.Parameter, value: float | None) -> None:
    context = click_context.find_object(Context)
    if positive_seconds(click_context, param, value) is not None and context is not None:
        context.timeout = value


def _add_verbosity(click_context: click.Context, _param: click.Parameter, value: int) -> None:
    context = click_context.find_object(Context)
    if context is not None:
        context.verbose += value


def _namespace(value: str) -> str:
    from slidectl import names

    return names.check(names.join("/", value.rstrip("/") or "/"))


def environment_namespace() -> str:
    """`SLIDECTL_NAMESPACE` as an absolute name, else the root."""
    given = os.environ.get("SLIDECTL_NAMESPACE")
    return _namespace(given) if given else "/"


@cache
def common_options() -> tuple[click.Option, ...]:
    """The shared options, in the order of the help. Those that pick the daemon come first."""
    return (
        _option(["-i", "--instance"], "Which daemon, by name.", _store("instance"), metavar="NAME"),
        _option(["--socket"], "Which daemon, by its socket.", _store("socket"), metavar="PATH"),
        _option(
            ["--ns"], "Where relative names are tried first.", _store("namespace", _namespace), metavar="NAMESPACE"
        ),
        _option(["-o", "--output"], "Format of the results.", _store("format"), type=click.Choice(output.FORMATS)),
        _option(
            ["--json"], "The same as -o json: one object a line.", _store("format", lambda _: "json"), is_flag=True
        ),
        _option(["-q", "--quiet"], "Only results and errors.", _store("quiet"), is_flag=True),
        _option(["-v", "--verbose"], "Say more; twice shows tracebacks.", _add_verbosity, count=True),
        _option(["--timeout"], "Wait at most so long (wall time).", _store_timeout, type=float, metavar="SECONDS"),
    )


def _show_help(click_context: click.Context, _param: click.Parameter, value: bool) -> None:
    if value and not click_context.resilient_parsing:
        output.write(click_context.get_help())
        click_context.exit()


@cache
def help_option() -> click.Option:
    """`--help` of every command. click's own looks up a translation of its text, which takes longer than to parse."""
    text = "Show this message and exit."
    return _option(["-h", "--help"], text, _show_help, is_flag=True, is_eager=True)


def _option(names: list[str], text: str, callback: Callback, **attributes: Any) -> click.Option:
    # A storage name that no command's own parameter has.
    storage = "common_" + names[-1].lstrip("-")
    return click.Option([*names, storage], help=text, callback=callback, expose_value=False, **attributes)


def wait_for_world_s(simulated_s: float) -> float:
    """Wall-clock limit for something that takes `simulated_s` in the world, where `--timeout` says nothing.

    A minute, plus what a world at a tenth of real time would need.
    """
    return 60.0 + 10.0 * simulated_s
