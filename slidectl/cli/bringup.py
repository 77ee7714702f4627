"""Bringing controllers up: load, start in one switch, wait for the robot, and say what became of each.

Shared by `controller` and `spawn`. Works through a Manager only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

from slidectl.cli.context import Context
from slidectl.cli.managers import UNLOADED, Manager, owner
from slidectl.errors import Refused, SlidectlError, TimedOut, UnknownName

WAIT_S = 30.0
_LOOK_AGAIN_S = 0.2


def each(action: Callable[[str], None], names: Sequence[str]) -> None:
    """Try all of them; then raise what went wrong."""
    failures = []
    for name in names:
        try:
            action(name)
        except Refused as error:
            failures.append(str(error))
    if failures:
        raise Refused("\n".join(failures))


def bring_up(target: Manager, names: Sequence[str], start: bool = True) -> None:
    """Load what is not loaded, then start what does not run in one strict switch. Raises Refused with the reasons."""
    states = target.states()
    each(target.load, [name for name in dict.fromkeys(names) if name not in states])
    idle = [name for name in dict.fromkeys(names) if states.get(name) != "running"]
    if start and idle:
        target.switch(idle, ())
        check_started(target, idle)


def check_started(target: Manager, names: Sequence[str]) -> None:
    """A switch may be done and a controller still not run: it aborted, or it waits for its joints."""
    states = target.states()
    failed = [
        f"{name} is {states.get(name, UNLOADED)}" for name in names if states.get(name) not in ("running", "waiting")
    ]
    if failed:
        raise Refused(f"did not start: {', '.join(failed)}", "slidectl daemon logs says why")


def wait_for_owner(ctx: Context, manager: str | None, names: Sequence[str]) -> None:
    """Return when a controller manager knows all the controllers.

    Looks again whenever something is logged (every spawn is), and now and then: parameters are not logged.
    Raises TimedOut with what is missing.
    """
    from time import monotonic

    limit = ctx.wait_limit(WAIT_S)
    deadline = monotonic() + limit
    with ctx.client.subscribe("/rosout") as lines:
        while (missing := _missing(ctx, manager, names)) is not None:
            if monotonic() >= deadline:
                raise TimedOut(f"still so after {limit:g} s: {missing.message}", missing.hint)
            with suppress(TimedOut):
                lines.get(min(_LOOK_AGAIN_S, max(0.0, deadline - monotonic())))


def _missing(ctx: Context, manager: str | None, names: Sequence[str]) -> SlidectlError | None:
    """Why the controllers have no owner yet; a wrong command line is raised at once."""
    try:
        owner(ctx, manager, names)
    except (Refused, UnknownName) as error:
        return error
    return None


class Report:
    """Says for each controller what it was and what it is, also when the action between failed half way."""

    def __init__(self, ctx: Context, manager: Manager, names: Sequence[str]) -> None:
        self.ctx = ctx
        self.manager = manager
        self.names = list(dict.fromkeys(names))
        self.before: dict[str, str] = {}

    def __enter__(self) -> Report:
        self.before = self.manager.states()
        return self

    def __exit__(self, _type: object, error: BaseException | None, _trace: object) -> None:
        if error is not None and not isinstance(error, Refused):
            return
        after = self.manager.states()
        for name in self.names:
            was, state = self.before.get(name, UNLOADED), after.get(name, UNLOADED)
            if error is None or was != state:
                self._tell(name, was, state)

    def _tell(self, name: str, was: str, state: str) -> None:
        record = {"manager": self.manager.namespace, "name": name, "state": state, "before": was}
        self.ctx.done(record, f"{name}: {state}" + (" already" if was == state else f" (was {was})"))
