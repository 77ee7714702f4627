"""What a command is as a step of a scenario. A command declares it; the runner of scenarios reads it here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from slidectl.errors import SlidectlError, UsageError


class StepEffects(NamedTuple):
    """What a step does, as far as its words tell before it runs."""

    starts_programs: bool = False
    """True when it starts other programs, which run by wall time."""
    controllers: str = ""
    """The parameter file of a spawn."""
    named: tuple[str, ...] = ()
    """The controllers that must have parameters."""
    may_add_controllers: bool = False
    """True when controllers, or their parameters, may come from elsewhere than the files of spawns."""
    model: str = ""
    """The model of a spawn."""
    refusal: SlidectlError | None = None
    """The error that the command would raise for its words."""


class CommandStep(NamedTuple):
    """A command as a step. Without values it acts in the world of its scenario and ends by itself."""

    stays: bool = False
    """True when the command, once it is up, goes on in the background until the case ends. It calls `Context.up`."""
    may_add_controllers: bool = False
    """As `StepEffects.may_add_controllers`, whatever the words are."""
    effects: Callable[[Mapping[str, Any], bool], StepEffects] | None = None
    """From the command's parameters by name, and whether the world has a daemon. Raises SlidectlError where the words
    cannot be a step."""


def check_not_detached(parameters: Mapping[str, Any], has_daemon: bool) -> StepEffects:  # noqa: ARG001
    """The effects of a command with `--detach`, which a step cannot have. Raises UsageError."""
    if parameters["detach"]:
        raise UsageError("--detach leaves a process behind", "to go on meanwhile: background: true")
    return StepEffects()
