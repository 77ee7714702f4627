"""`slidectl doctor` and `slidectl version`: whether slidectl can run on this machine, and what is installed."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING

import click

from slidectl import __version__, entry_points
from slidectl.cli.command_table import has_module
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.entry_points import Part, PartError, Registry
from slidectl.errors import Refused

if TYPE_CHECKING:
    from slidectl.daemon.health import Finding

_LIBRARIES = ("mujoco", "click", "numpy", "rosbags", "xacro")
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


@command(step=None, examples=["slidectl doctor", "slidectl doctor --json"])
@click.pass_obj
def doctor(ctx: Context) -> None:
    """Check this installation.

    It checks Python and the libraries, folders and their permissions, the disk, file descriptors, the daemon and what
    earlier ones left behind, how punctually this machine wakes a process, package paths and variables of ROS, and the
    packages that extend slidectl, which it imports. Each state is ok, look here or broken; exits 1 when something is
    broken. JSON keys: check, state, finding, remedy.
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

    registries = {registry.group: registry for registry in map(_registry, filter(_has_registry, _REGISTRIES))}
    by_owner: dict[str, list[Part]] = {}
    for registry in registries.values():
        yield from (Finding("extensions", LOOK, refusal.message, refusal.hint or "") for refusal in registry.refused())
        for part in registry.parts().values():
            by_owner.setdefault(part.owner, []).append(part)
    for owner, parts in sorted(by_owner.items()):
        usable = []
        for part in parts:
            try:
                registries[part.group].load(part)
                usable.append(f"{registries[part.group].kind} {part.name}")
            except PartError as error:
                yield Finding("extensions", BROKEN, error.message, part.removal)
        if usable:
            yield Finding("extensions", OK, f"{owner}: {', '.join(usable)}")
    for part in entry_points.unknown_groups(registries):
        text = f"{part.owner}: nothing of slidectl uses the entry point {part.name!r} of the group {part.group}"
        yield Finding("extensions", LOOK, text, f"groups: {', '.join(registries)}")
    for unread in entry_points.unread():
        yield Finding("extensions", BROKEN, unread.message, unread.hint or "")


def _has_registry(place: str) -> bool:
    return has_module(place.partition(":")[0].removeprefix("slidectl."))


def _registry(place: str) -> Registry:
    module, _, attribute = place.partition(":")
    registry: Registry = getattr(import_module(module), attribute)
    return registry


@command(step=None, examples=["slidectl version", "slidectl version --json"])
@click.pass_obj
def version(ctx: Context) -> None:
    """Print the version.

    -v adds the versions of the libraries. JSON keys: slidectl, python, and with -v the names of the libraries.
    """
    record = {"slidectl": __version__, "python": sys.version.split()[0]}
    if ctx.verbose:
        record |= {name: _library(name) for name in _LIBRARIES}
    ctx.emit(record, None if ctx.verbose else f"slidectl {__version__}")


def _library(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
