"""Collects things that the user's files name and that do not exist, and reports them in one list.

These are packages, included files, parameter files, programs, meshes, hardware and controllers. A reader that finds one
missing notes it, leaves out what needs it, and reads on. Before anything is started, `refuse` raises an error with all
that was noted, unless the user wants to go on without them.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal, cast, get_args

from slidectl.errors import NoFileThere, NotThere

AllowedMissing = Literal["nothing", "nodes", "all but files", "all"]
"""What may be left out without an error.

`nodes` is `launch --strict --skip-unknown`. `all but files` is what a launch does by itself: a file that is named and
not there is an error, as roslaunch and xacro have it. `all` is --keep-going.
"""

TO_GO_ON = "--keep-going leaves out what is missing"


@dataclass(frozen=True)
class Absence:
    """One missing thing. `loss` says what is left out because of it; it is empty when another notice says so."""

    error: NotThere
    loss: str
    is_node: bool
    is_required: bool = False
    """True for a required node: a launch cannot go on without it."""

    @property
    def text(self) -> str:
        """The absence on one line, with file and line."""
        first = str(self.error.message).partition("\n")[0]
        return f"{first.removesuffix('.')}; {self.loss}" if self.loss else first


class Missing:
    """The absences of one launch, spawn or check, in the order of reading; each is kept once."""

    def __init__(self, forgiven: AllowedMissing = "nothing", to_go_on: str = TO_GO_ON) -> None:
        self.forgiven = forgiven
        self._to_go_on = to_go_on
        self.world_decides = False
        """True when a daemon runs that may know simulated hardware which is unknown here."""
        self._found: dict[str, Absence] = {}

    def __len__(self) -> int:
        return len(self._found)

    @property
    def absences(self) -> list[Absence]:
        return list(self._found.values())

    @property
    def keeps_going(self) -> bool:
        """True when missing packages, meshes, hardware and controllers are left out."""
        return self.forgiven in ("all but files", "all")

    @property
    def leaves_failures_out(self) -> bool:
        """True when a node that fails is left out, too: on request, and when what is missing may be the reason."""
        return self.forgiven == "all" or (self.keeps_going and bool(self._found))

    def note(self, error: NotThere, loss: str = "", is_node: bool = False, is_required: bool = False) -> None:
        """Add an absence. A second one with the same message only adds its `loss`, if the first has none."""
        key = str(error.message)
        known = self._found.get(key)
        if known is None:
            self._found[key] = Absence(error, loss, is_node, is_required)
        elif loss and not known.loss:
            self._found[key] = replace(known, loss=loss, is_node=is_node)

    def records(self) -> list[Any]:
        """What was noted, as JSON values, for `add` in another process."""
        pairs = ((one.error, one.loss) for one in self.absences)
        return [[isinstance(e, NoFileThere), loss, [e.reason, e.file, e.line, e.hint, e.thing]] for e, loss in pairs]

    def add(self, records: Iterable[Any]) -> None:
        """Note what another process has noted."""
        for is_file, loss, place in records:
            self.note((NoFileThere if is_file else NotThere)(*place), loss)

    def forgives(self, absence: Absence) -> bool:
        """True when an absence is no error."""
        if absence.is_required:
            return False
        if isinstance(absence.error, NoFileThere):
            return self.forgiven == "all"
        return self.keeps_going or (self.forgiven == "nodes" and absence.is_node)

    def refuse(self) -> None:
        """Raise an error when something is missing that may not be left out.

        Raises NotThere: the first absence; its hint lists the others.
        """
        found: dict[str, Absence] = {}
        for absence in self.absences:
            if not self.forgives(absence):
                found.setdefault(absence.error.thing, absence)
        if not found:
            return
        first, *others = found.values()
        error = first.error
        lines = [error.hint] if error.hint else []
        if others:
            lines += ["also missing:", *(f"  {one.error.message!s}" for one in others)]
        if any(absence.is_required for absence in found.values()):
            lines.append("a launch ends with a required node, so it does not start without it")
        else:
            lines.append(self._to_go_on)
        raise NotThere(error.reason, error.file, error.line, "\n".join(lines), error.thing)

    def lines(self) -> list[str]:
        """The things that are left out, each as `file:line: what is missing; what is left out because of it`."""
        return [absence.text for absence in self.absences if self.forgives(absence)]


# --- across processes ------------------------------------------------------------------------------------------------

_FORGIVEN = "SLIDECTL_LEAVES_OUT"
_NOTES = "SLIDECTL_LEFT_OUT"
"""Environment variables for a program that a launch runs, and which may run our xacro: what may be left out there, and
the file for what was."""


def to_environment(missing: Missing, notes: str) -> dict[str, str]:
    """Environment variables with which our xacro, run by another program, judges as this process. `notes` is a file."""
    return {_FORGIVEN: missing.forgiven, _NOTES: notes}


def from_environment() -> Missing | None:
    """The collector that `to_environment` describes to this process, or None."""
    level = os.environ.get(_FORGIVEN)
    return Missing(cast(AllowedMissing, level)) if level in get_args(AllowedMissing) else None


def write_notes(missing: Missing) -> None:
    """Append what is missing to the file of the launch, one JSON record a line. Nothing without such a file."""
    if notes := os.environ.get(_NOTES):
        with open(notes, "a", encoding="utf-8") as file:
            file.writelines(json.dumps(record) + "\n" for record in missing.records())


def read_notes(missing: Missing, text: str) -> None:
    """Add what another process has written with `write_notes`."""
    missing.add(json.loads(line) for line in text.splitlines())
