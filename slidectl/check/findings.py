"""The result of a check: notices in the form of the report, "used" ones included, and the errors of unusable files.

This module only collects and counts. The command line prints the findings.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from slidectl.description.missing import Missing
from slidectl.description.report import bounded, one_line
from slidectl.description.robot import Notice, Verdict
from slidectl.errors import BadFile

# The beginning of an error that names its node or tag.
_NAMED = re.compile(r"(?P<subject>node \S+|<\w+>|/\S+)(?: \([^)]*\))?: ")


class Findings:
    """Findings in the order in which they were added; equal ones are kept once."""

    def __init__(self, missing: Missing | None = None) -> None:
        self.missing = Missing() if missing is None else missing
        """The missing things that the files name."""
        self.is_drivable = False
        """True when something can be driven: a robot, and at least one of its controllers if any are named."""
        self._notices: dict[Notice, None] = {}
        self._files: list[str] = []
        self.broken: list[BadFile] = []
        """The errors of files that cannot be used. Each is also a finding with the verdict "wrong"."""

    def begin_with(self, files: Iterable[str]) -> None:
        """Let findings in these files come before all others."""
        self._files += files

    def add(self, verdict: Verdict, subject: str, text: str, file: str, line: int | None = None) -> None:
        """Add a finding about `subject` at a place."""
        self._notices.setdefault(Notice(verdict, subject, one_line(text), file, line))

    def extend(self, notices: Iterable[Notice]) -> None:
        """Add notices, each on one line."""
        for notice in notices:
            self._notices.setdefault(replace(notice, text=one_line(notice.text)))

    def add_missing(self) -> None:
        """Add a finding for each missing thing: "ignored" if it is left out, else "wrong"."""
        for absence in self.missing.absences:
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
        """Remove findings that later information has made wrong."""
        for notice in list(notices):
            del self._notices[notice]

    def fail(self, subject: str, error: BadFile, *named: str) -> None:
        """Add the error of a file that cannot be used. `named`: possible beginnings of it that repeat the subject.

        Raises:
            BadFile: `error` itself when it has no line: then there was nothing to check.
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
        """Add the error of a file that cannot be used, if a finding tells the reason already."""
        if str(error) not in map(str, self.broken):
            self.broken.append(error)

    def sorted(self, only: Sequence[str] = ()) -> list[Notice]:
        """All findings, or those with some verdicts: files in the order of their first mention, lines rising.

        Of many that say the same of different things the first are there; see `report.bounded`.
        """
        mentioned = [*self._files, *(notice.file for notice in self._notices)]
        files = {file: index for index, file in enumerate(dict.fromkeys(mentioned))}
        wanted = [notice for notice in self._notices if not only or notice.verdict in only]
        ordered = sorted(wanted, key=lambda notice: (files[notice.file], notice.line or 0))
        return bounded(ordered)

    def count(self, verdict: Verdict) -> int:
        """The number of findings with this verdict."""
        return sum(notice.verdict == verdict for notice in self._notices)
