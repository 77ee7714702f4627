"""`slidectl doctor`: check whether slidectl can run on this machine, with a remedy for each problem."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
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
    "slidectl.simulation.feature:INSTALLED",
)
"""What installed packages may add to, as `module:attribute`."""
_IMPORT_LIMIT_S = 20.0
"""Wall seconds for the imports of one package."""
_MARK = "slidectl doctor: "
"""The beginning of a line about a part: the code of a package may print lines, too."""


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

    registries = {registry.group: place for place in _REGISTRIES for registry in (_registry(place),)}
    by_owner: dict[str, list[Part]] = {}
    for place in registries.values():
        for refusal in _registry(place).refused():
            yield Finding("extensions", LOOK, refusal.message, refusal.hint or "")
        for part in _registry(place).parts().values():
            by_owner.setdefault(part.owner, []).append(part)
    for owner, parts in sorted(by_owner.items()):
        usable = []
        for part, trouble in _tried(parts, registries):
            kind = _registry(registries[part.group]).kind
            if trouble:
                yield Finding("extensions", BROKEN, trouble, part.removal)
            else:
                usable.append(f"{kind} {part.name}")
        if usable:
            yield Finding("extensions", OK, f"{owner}: {', '.join(usable)}")
    for part in entry_points.unknown_groups(registries):
        text = f"{part.owner}: nothing of slidectl uses the entry point {part.name!r} of the group {part.group}"
        yield Finding("extensions", LOOK, text, f"groups: {', '.join(registries)}")
    for unread in entry_points.unread():
        yield Finding("extensions", BROKEN, unread.message, unread.hint or "")


def _registry(place: str) -> Registry:
    module, _, attribute = place.partition(":")
    registry: Registry = getattr(import_module(module), attribute)
    return registry


def _tried(parts: Sequence[Part], registries: Mapping[str, str]) -> Iterator[tuple[Part, str]]:
    """Each part with what is wrong with it; an empty text if nothing is.

    A process of its own imports them, since an import may do anything. One that ends the process, or takes too long,
    is blamed, and another process imports those behind it.
    """
    left = list(parts)
    while left:
        code = f"import sys; from {__name__} import {try_parts.__name__} as run; run(sys.argv[1:])"
        argv = [sys.executable, "-P", "-c", code, *(f"{registries[part.group]} {part.name}" for part in left)]
        try:
            done = subprocess.run(
                argv, stdin=subprocess.DEVNULL, capture_output=True, timeout=_IMPORT_LIMIT_S, check=False,
                env=with_package(os.environ),
            )  # fmt: skip
            output, end = done.stdout, f"its import ends the process, with exit code {done.returncode}"
        except subprocess.TimeoutExpired as error:
            output, end = error.stdout or b"", f"its import takes longer than {_IMPORT_LIMIT_S:g} s"
        lines = output.decode("utf-8", "replace").splitlines()
        for line in [line.removeprefix(_MARK) for line in lines if line.startswith(_MARK)]:
            yield left.pop(0), json.loads(line)
        if left:
            part = left.pop(0)
            what = f"the {_registry(registries[part.group]).kind} {part.name!r} of {part.owner} cannot be loaded"
            yield part, f"{what}: {end}"


def try_parts(words: Sequence[str]) -> None:
    """Import parts in this process, each given as the place of its registry and its name. Print a line for each with
    what is wrong with it."""
    for word in words:
        place, _, name = word.partition(" ")
        registry, trouble = _registry(place), ""
        try:
            registry.load(registry.parts()[name])
        except PartError as error:
            trouble = error.message
        print(f"\n{_MARK}{json.dumps(trouble)}", flush=True)
