"""Results as JUnit XML, which GitLab, Jenkins and GitHub actions show."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import PurePath
from xml.etree import ElementTree

from slidectl.extensions.scenarios.case_run import ERROR, FAILED, XFAILED, XPASSED, CaseResult
from slidectl.extensions.scenarios.scenario_file import Case

_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_TAGS = {FAILED: "failure", XPASSED: "failure", ERROR: "error", XFAILED: "skipped"}


def junit(cases: Sequence[Case], results: Sequence[CaseResult]) -> bytes:
    """The document: a suite for each file, a test case for each case; a case that was not run is skipped."""
    by_id = {result.id: result for result in results}
    root = ElementTree.Element("testsuites", name="slidectl test")
    for file in dict.fromkeys(case.file for case in cases):
        inside = [case for case in cases if case.file == file]
        suite = ElementTree.SubElement(root, "testsuite", name=_clean(file))
        counts = dict.fromkeys(("failure", "error", "skipped"), 0)
        seconds = 0.0
        for case in inside:
            result = by_id.get(case.id)
            name = case.name or case.scenario
            classname = ".".join(PurePath(file).with_suffix("").parts)
            wall_s = result.wall_time if result else 0.0
            entry = ElementTree.SubElement(
                suite, "testcase", classname=_clean(classname), name=_clean(name), time=f"{wall_s:.3f}"
            )
            tag = "skipped" if result is None else _TAGS.get(result.verdict)
            seconds += wall_s
            if tag is None:
                continue
            counts[tag] += 1
            message = "not run" if result is None else case.xfail if tag == "skipped" else result.message
            element = ElementTree.SubElement(entry, tag, message=_clean(message))
            if tag != "skipped" and result is not None:
                element.set("type", result.verdict)
                element.text = _clean("\n".join(told(case, result)))
        suite.attrib |= {
            "tests": str(len(inside)), "failures": str(counts["failure"]), "errors": str(counts["error"]),
            "skipped": str(counts["skipped"]), "time": f"{seconds:.3f}",
        }  # fmt: skip
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, "utf-8", xml_declaration=True)
    return text + b"\n"


def told(case: Case, result: CaseResult) -> list[str]:
    """The lines that describe a failure."""
    lines = [result.message]
    lines += [result.hint] if result.hint else []
    if result.detail.keys() >= {"expected", "value", "closest"}:
        lines.append("expected {expected}; closest {closest}, last {value}".format(**result.detail))
    if result.step:
        lines.append(f"{case.file}:{result.line}: {result.section}: {result.step}")
    if result.failed_at is not None:
        lines.append(f"at {result.failed_at:.3f} s of simulated time")
    if result.log:
        lines += ["last lines of the log:", *(f"  {line}" for line in result.log)]
    lines += [f"kept: {', '.join(result.kept)}"] if result.kept else []
    return [*lines, f"to run it alone: slidectl test {shlex.quote(result.id)}"] if case.steps else lines


def _clean(text: str) -> str:
    """Replace characters that XML does not allow."""
    return _NO_XML.sub("?", text)
