"""The error of all that is wrong with one part of a robot: it names the part, the robot, and the place in the file.

Nothing is checked here.
"""

from __future__ import annotations

from typing import ClassVar, Protocol

from slidectl.errors import SlidectlError


class Part(Protocol):
    """A link, joint or transmission on paper."""

    @property
    def name(self) -> str: ...
    @property
    def file(self) -> str | None: ...
    @property
    def line(self) -> int | None: ...


class BadPart(SlidectlError):
    """A part that cannot be simulated."""

    kind: ClassVar[str] = "part"

    def __init__(self, robot: str, part: Part, trouble: str, hint: str | None = None) -> None:
        super().__init__(f"{self.kind} {part.name!r} of robot {robot!r}{place(part.file, part.line)}: {trouble}", hint)
        self.part = part.name


def place(file: str | None, line: int | None) -> str:
    """` (file:line)`, or what is known of it; empty when nothing is."""
    if line is None:
        return "" if file is None else f" ({file})"
    return f" (line {line})" if file is None else f" ({file}:{line})"
