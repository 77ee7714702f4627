"""Collects things that the user's files name and that do not exist, and reports them in one list.

These are packages, included files, parameter files, programs, meshes, hardware and controllers. A reader that finds one
missing notes it, leaves out what needs it, and reads on. Before anything is started, `refuse` raises an error with all
that was noted, unless the user wants to go on without them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from slidectl.errors import NotThere

AllowedMissing = Literal["nothing", "nodes", "all"]
"""What may be left out without an error: `nodes` is --skip-unknown, `all` is --keep-going."""

TO_GO_ON = "--keep-going leaves out what is not there"


@dataclass(frozen=True)
class Absence:
    """One missing thing. `loss` says what is left out because of it; it is empty when another notice says so."""

    error: NotThere
    loss: str
    is_node: bool

    @property
    def text(self) -> str:
        """The absence on one line, with file and line."""
        first = str(self.error.message).partition("\n")[0]
        return f"{first.removesuffix('.')}; {self.loss}" if self.loss else first


class Missing:
    """The absences of one launch, spawn or check, in the order of reading; each is kept once."""

    def __init__(self, forgiven: AllowedMissing = "nothing") -> None:
        self.forgiven = forgiven
        self._found: dict[str, Absence] = {}

    def __len__(self) -> int:
        return len(self._found)

    @property
    def found(self) -> list[Absence]:
        return list(self._found.values())

    @property
    def keeps_going(self) -> bool:
        """True when everything that is missing is left out."""
        return self.forgiven == "all"

    def note(self, error: NotThere, loss: str = "", is_node: bool = False) -> None:
        """Add an absence. A second one with the same message only adds its `loss`, if the first has none."""
        key = str(error.message)
        known = self._found.get(key)
        if known is None:
            self._found[key] = Absence(error, loss, is_node)
        elif loss and not known.loss:
            self._found[key] = replace(known, loss=loss, is_node=is_node)

    def forgives(self, absence: Absence) -> bool:
        """True when an absence is no error."""
        return self.keeps_going or (self.forgiven == "nodes" and absence.is_node)

    def refuse(self) -> None:
        """Raise an error when something is missing that may not be left out.

        Raises:
            NotThere: the first absence; its hint lists the others.
        """
        found: dict[str, Absence] = {}
        for absence in self.found:
            if not self.forgives(absence):
                found.setdefault(absence.error.thing, absence)
        if not found:
            return
        first, *others = found.values()
        error = first.error
        lines = [error.hint] if error.hint else []
        if others:
            lines += ["these are not there either:", *(f"  {one.error.message!s}" for one in others)]
        raise NotThere(error.reason, error.file, error.line, "\n".join([*lines, TO_GO_ON]), error.thing)

    def lines(self) -> list[str]:
        """The things that are left out, each as `file:line: what is missing; what is left out because of it`."""
        return [absence.text for absence in self.found if self.forgives(absence)]
