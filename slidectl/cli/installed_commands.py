"""Commands of installed packages: top-level ones, and verbs of slidectl's groups as `GROUP.VERB`."""

from __future__ import annotations

from functools import cache
from typing import Any

import click

from slidectl.cli.command_table import COMMANDS, load
from slidectl.cli.output import ClosedPipe
from slidectl.entry_points import Part, Registry

_NOT_BLAMED = (click.ClickException, click.Abort, click.exceptions.Exit, ClosedPipe, OSError)
"""Exceptions by which a command ends on purpose, or because of its output."""


class _NamesOfOurs:
    """The names of slidectl's own commands, those of verbs as `GROUP.VERB`."""

    def __contains__(self, name: object) -> bool:
        top, _, verb = str(name).partition(".")
        group = _group_of(top)
        return group is not None and verb in group.commands if verb else top in COMMANDS


def _group_of(name: str) -> click.Group | None:
    command = load(name) if name in COMMANDS else None
    return command if isinstance(command, click.Group) else None


def _bad_name(name: str) -> str:
    top, dot, verb = name.partition(".")
    if dot and _group_of(top) is None:
        return f"slidectl has no group {top!r}"
    words = [top, verb] if dot else [top]
    if not all(word.replace("-", "").replace("_", "").isalnum() for word in words):
        return "a name is COMMAND or GROUP.VERB, of letters, digits, '-' and '_'"
    return ""


def _expected(found: Any) -> str:
    return "" if isinstance(found, click.Command) else "command: decorate a function with slidectl.cli.command"


INSTALLED = Registry("slidectl.commands", "command", _NamesOfOurs, _expected, _bad_name)


def find(name: str) -> click.Command | None:
    """The command of an installed package by its name, `COMMAND` or `GROUP.VERB`; None: there is none.

    Raises PartError: several packages claim it, or it cannot be loaded.
    """
    part = INSTALLED.find(name)
    return None if part is None else _load(part)


@cache
def _load(part: Part) -> click.Command:
    """The command, under the name of its entry point. An exception that it raises names its package."""
    from copy import copy

    command: click.Command = copy(INSTALLED.load(part))
    command.name = part.name.rpartition(".")[2]

    def blamed(method: Any) -> Any:
        def call(*args: Any, **given: Any) -> Any:
            with INSTALLED.running(part, *_NOT_BLAMED):
                try:
                    return method(*args, **given)
                except SystemExit as leaving:
                    raise click.exceptions.Exit(leaving.code if isinstance(leaving.code, int) else 1) from None

        return call

    for name in ("make_context", "invoke"):
        setattr(command, name, blamed(getattr(command, name)))
    return command
