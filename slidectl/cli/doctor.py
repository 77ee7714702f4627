"""`slidectl doctor`: check whether slidectl can run on this machine, with a remedy for each problem."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING

import click

from slidectl import entry_points
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.entry_points import Part, PartError, Registry
from slidectl.errors import Refused
from slidectl.paths import with_package

if TYPE_CHECKING:
    from slidectl.daemon.health import Finding

_REGISTRIES = (
    "slidectl.cli.installed_commands:INSTALLED",
    "slidectl.control.registry:INSTALLED",
    "slidectl.description.gazebo_tags:HARDWARE",
    "slidectl.description.sensors:INSTALLED",
    "slidectl.extensions.gateways.gateway_kinds:GATEWAYS",
    "slidectl.extensions.scenarios.commands.step_runner:STEP_KINDS",
)
"""What installed packages may add to, as `module:attribute`."""
_IMPORT_LIMIT_S = 20.0


@command(step=None, examples=["slidectl doctor", "slidectl doctor --json"])
@click.pass_obj
def doctor(ctx: Context) -> None:
    """Look whether slidectl can run here.

    Python and libraries, folders and their rights, disk, descriptors, the daemon and those that were left, how
    punctually this machine wakes a process, package paths and variables of ROS, and what installed packages add to
    slidectl, each of which is imported. Each is ok, something to look at, or broken; exits 1 when something is broken.
    JSON keys: check, state, finding, remedy.
    """
    from slidectl.daemon.health import BROKEN, findings

    broken = 0
    for found in (findings(lambda: ctx.paths), _extensions()):
        for one in found:
            remedy = "".join(f"\n{'':>23}-> {line}" for line in one.remedy.splitlines())
            ctx.emit(one._asdict(), f"{one.state:<9}  {one.check + ':':<12}{one.finding}{remedy}")
            broken += one.state == BROKEN
    if broken:
        raise Refused(f"{broken} {'is' if broken == 1 else 'are'} broken, see above")


def _extensions() -> Iterator[Finding]:
    """What installed packages add: a line for each package, and one for each part that cannot be used."""
    from slidectl.daemon.health import BROKEN, LOOK, OK, Finding

    registries = {_registry(place).group: place for place in _REGISTRIES}
    usable: dict[str, list[str]] = {}
    for place in _REGISTRIES:
        registry = _registry(place)
        for refusal in registry.refused():
            yield Finding("extensions", LOOK, refusal.message, refusal.hint or "")
        for part in registry.parts().values():
            if trouble := _trouble(place, registry.kind, part):
                yield Finding("extensions", BROKEN, trouble, part.removal)
            else:
                usable.setdefault(part.owner, []).append(f"{registry.kind} {part.name}")
    for part in entry_points.unknown_groups(registries):
        text = f"{part.owner}: nothing of slidectl uses the entry point {part.name!r} of the group {part.group}"
        yield Finding("extensions", LOOK, text, f"groups: {', '.join(registries)}")
    for unread in entry_points.unread():
        yield Finding("extensions", BROKEN, unread.message, unread.hint or "")
    for owner, parts in sorted(usable.items()):
        yield Finding("extensions", OK, f"{owner}: {', '.join(parts)}")


def _registry(place: str) -> Registry:
    module, _, attribute = place.partition(":")
    registry: Registry = getattr(import_module(module), attribute)
    return registry


def _trouble(place: str, kind: str, part: Part) -> str:
    """Why a part cannot be used; empty if it can. A process of its own imports it, since an import may do anything."""
    what = f"the {kind} {part.name!r} of {part.owner} cannot be loaded"
    code = f"import sys; from {__name__} import {try_part.__name__} as run; run(*sys.argv[1:])"
    argv = [sys.executable, "-P", "-c", code, place, part.name]
    try:
        done = subprocess.run(
            argv, stdin=subprocess.DEVNULL, capture_output=True, timeout=_IMPORT_LIMIT_S, check=False,
            env=with_package(os.environ),
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"{what}: its import takes longer than {_IMPORT_LIMIT_S:g} s"
    last = (done.stdout.decode("utf-8", "replace").splitlines() or [""])[-1]
    try:
        return str(json.loads(last)["trouble"])
    except (ValueError, LookupError, TypeError):
        return f"{what}: its import ends the process, with exit code {done.returncode}"


def try_part(place: str, name: str) -> None:
    """Import a part in this process and print a line with what is wrong with it."""
    registry, trouble = _registry(place), ""
    try:
        registry.load(registry.parts()[name])
    except PartError as error:
        trouble = error.message
    print(f"\n{json.dumps({'trouble': trouble})}", flush=True)
