"""What a check finds: notices of the report's own form, the used ones too, and whether a file cannot be used at all.

Only collects and counts. How it looks is for the command line.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from slidectl.description.missing import Missing
from slidectl.description.report import one_line
from slidectl.description.robot import Notice, Verdict
from slidectl.errors import BadFile

# How an error begins by naming the node or the tag that it is about.
_NAMED = re.compile(r"(?P<subject>node \S+|<\w+>|/\S+)(?: \([^)]*\))?: ")


class Findings:
    """Findings in the order in which they were made; each is kept once."""

    def __init__(self, missing: Missing | None = None) -> None:
        self.missing = Missing() if missing is None else missing
        """What the files name and is not there."""
        self.is_drivable = False
        """Whether something is left to drive: a robot, and one at least of its controllers where some are named."""
        self._notices: dict[Notice, None] = {}
        self._files: list[str] = []
        self.broken: list[BadFile] = []
        """Why files cannot be used; each is among the findings too, as wrong."""

    def begin_with(self, files: Iterable[str]) -> None:
        """Put findings in these files before all others."""
        self._files += files

    def add(self, verdict: Verdict, subject: str, text: str, file: str, line: int | None = None) -> None:
        """One finding about `subject`, at its place."""
        self._notices.setdefault(Notice(verdict, subject, one_line(text), file, line))

    def extend(self, notices: Iterable[Notice]) -> None:
        """Take notices over, each on one line."""
        for notice in notices:
            self._notices.setdefault(replace(notice, text=one_line(notice.text)))

    def tell_missing(self) -> None:
        """A finding for each thing that is not there: wrong, or ignored where it is left out."""
        for absence in self.missing.found:
            error = absence.error
            named = _NAMED.match(error.reason)
            subject, start = (named["subject"], named[0]) if named else (error.thing, "")
            if self.missing.forgives(absence):
                reason = error.reason.removeprefix(start).removesuffix(".")
                text = f"{reason}; {absence.loss}" if absence.loss else reason
                self.add("ignored", subject, text, error.file or "", error.line)
            else:
                self.fail(subject, error, start)

    def withdraw(self, notices: Iterable[Notice]) -> None:
        """Take findings back that do not hold once more is known."""
        for notice in list(notices):
            del self._notices[notice]

    def fail(self, subject: str, error: BadFile, *named: str) -> None:
        """A file that cannot be used, and why. `named` are ways in which the error may begin by naming the subject.

        Raises:
            BadFile: `error` itself when it names no line: then there was nothing to check.
        """
        if error.line is None:
            raise error
        self.refuse(error)
        reason = error.reason
        for beginning in named:
            reason = reason.removeprefix(beginning)
        text = "\n".join(part for part in (reason, error.hint) if part)
        self.add("wrong", subject, text, error.file or "", error.line)

    def refuse(self, error: BadFile) -> None:
        """A file that cannot be used, for a reason that a finding tells already."""
        if str(error) not in map(str, self.broken):
            self.broken.append(error)

    def sorted(self, only: Sequence[str] = ()) -> list[Notice]:
        """All findings, or those of some verdicts: files in the order of their first mention, lines rising."""
        mentioned = [*self._files, *(notice.file for notice in self._notices)]
        files = {file: index for index, file in enumerate(dict.fromkeys(mentioned))}
        wanted = [notice for notice in self._notices if not only or notice.verdict in only]
        return sorted(wanted, key=lambda notice: (files[notice.file], notice.line or 0))

    def count(self, verdict: Verdict) -> int:
        """How many findings have this verdict."""
        return sum(notice.verdict == verdict for notice in self._notices)
