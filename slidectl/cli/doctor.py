"""`slidectl doctor`: check whether slidectl can run on this machine, with a remedy for each problem."""

from __future__ import annotations

import click

from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.errors import Refused


@command(step=None, examples=["slidectl doctor", "slidectl doctor --json"])
@click.pass_obj
def doctor(ctx: Context) -> None:
    """Look whether slidectl can run here.

    Python and libraries, folders and their rights, disk, descriptors, the daemon and those that were left, how
    punctually this machine wakes a process, package paths and variables of ROS. Each is ok, something to look at, or
    broken; exits 1 when something is broken. JSON keys: check, state, finding, remedy.
    """
    from slidectl.daemon.health import BROKEN, findings

    broken = 0
    for one in findings(lambda: ctx.paths):
        remedy = "".join(f"\n{'':>23}-> {line}" for line in one.remedy.splitlines())
        ctx.emit(one._asdict(), f"{one.state:<9}  {one.check + ':':<12}{one.finding}{remedy}")
        broken += one.state == BROKEN
    if broken:
        raise Refused(f"{broken} {'is' if broken == 1 else 'are'} broken, see above")
