"""What the user's files name and is not there, gathered by all who read them, and told in one list.

Packages, included files, files of parameters, programs, meshes, hardware and controllers. Whoever meets such a thing
notes it, leaves out what needs it, and reads on. Where nothing has been started yet, `refuse` ends the work with all
that was noted, unless the user wants to go on without.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from slidectl.errors import NotThere

Forgiven = Literal["nothing", "nodes", "all"]
"""What is left out without ending the work: `nodes` is --skip-unknown, `all` is --keep-going."""

TO_GO_ON = "--keep-going leaves out what is not there"


@dataclass(frozen=True)
class Absence:
    """One thing that is not there. `loss` is what is left out for it; empty when that is told elsewhere."""

    error: NotThere
    loss: str
    is_node: bool

    @property
    def text(self) -> str:
        """On one line, with file and line."""
        first = str(self.error.message).partition("\n")[0]
        return f"{first.removesuffix('.')}; {self.loss}" if self.loss else first


class Missing:
    """The absences of one launch, spawn or check, in the order in which they were met; each stands once."""

    def __init__(self, forgiven: Forgiven = "nothing") -> None:
        self.forgiven = forgiven
        self._found: dict[str, Absence] = {}

    def __len__(self) -> int:
        return len(self._found)

    @property
    def found(self) -> list[Absence]:
        return list(self._found.values())

    @property
    def keeps_going(self) -> bool:
        """Whether everything that is not there is left out."""
        return self.forgiven == "all"

    def note(self, error: NotThere, loss: str = "", is_node: bool = False) -> None:
        """Take one in; a second mention of the same thing at the same place may only say what is left out for it."""
        key = str(error.message)
        known = self._found.get(key)
        if known is None:
            self._found[key] = Absence(error, loss, is_node)
        elif loss and not known.loss:
            self._found[key] = replace(known, loss=loss, is_node=is_node)

    def forgives(self, absence: Absence) -> bool:
        """Whether the work goes on without it."""
        return self.keeps_going or (self.forgiven == "nodes" and absence.is_node)

    def refuse(self) -> None:
        """End the work when something is not there that is not forgiven.

        Raises:
            NotThere: the first absence, with the others in its hint.
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
        """What was left out, for a list: `file:line: what is not there; what is left out for it`."""
        return [absence.text for absence in self.found if self.forgives(absence)]
