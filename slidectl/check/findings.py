"""What a check finds: notices of the report's own form, the used ones too, and whether a file cannot be used at all.

Only collects and counts. How it looks is for the command line.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import get_args

from slidectl.description.robot import Notice, Verdict
from slidectl.errors import BadFile

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)


class Findings:
    """Findings in the order in which they were made; each is kept once."""

    def __init__(self) -> None:
        self._notices: dict[Notice, None] = {}
        self._files: list[str] = []
        self.broken: list[BadFile] = []
        """Why files cannot be used; each is among the findings too, as wrong."""

    def begin_with(self, files: Iterable[str]) -> None:
        """Put findings in these files before all others."""
        self._files += files

    def add(self, verdict: Verdict, subject: str, text: str, file: str, line: int | None = None) -> None:
        """One finding about `subject`, at its place."""
        self._notices.setdefault(Notice(verdict, subject, text, file, line))

    def extend(self, notices: Iterable[Notice]) -> None:
        """Take notices over as they are."""
        for notice in notices:
            self._notices.setdefault(notice)

    def fail(self, subject: str, error: BadFile) -> None:
        """A file that cannot be used, and why.

        Raises:
            BadFile: `error` itself when it names no line: then there was nothing to check.
        """
        if error.line is None:
            raise error
        self.broken.append(error)
        text = " ".join(part for part in (error.reason, error.hint) if part)
        self.add("wrong", subject, text.replace("\n", "; "), error.file or "", error.line)

    def sorted(self, only: Sequence[str] = ()) -> list[Notice]:
        """All findings, or those of some verdicts: files in the order of their first mention, lines rising."""
        mentioned = [*self._files, *(notice.file for notice in self._notices)]
        files = {file: index for index, file in enumerate(dict.fromkeys(mentioned))}
        wanted = [notice for notice in self._notices if not only or notice.verdict in only]
        return sorted(wanted, key=lambda notice: (files[notice.file], notice.line or 0))

    def count(self, verdict: Verdict) -> int:
        """How many findings have this verdict."""
        return sum(notice.verdict == verdict for notice in self._notices)
