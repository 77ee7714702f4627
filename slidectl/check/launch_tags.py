"""What became of each tag and attribute of launch files, included ones too.

The loader's own reading is traced, so nothing of its rules is said twice. What nodes and parameters come to is for
launch.py.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from slidectl import paths
from slidectl.check.findings import Findings
from slidectl.check.tags import Tags, Trace, TracedElement, plain
from slidectl.description import xml_tree
from slidectl.description.robot import Notice, Verdict
from slidectl.description.xml_tree import Element
from slidectl.launch.files import shown
from slidectl.launch.plan import Place, Plan, Remap

_ATTRIBUTE = re.compile(r"attribute '([^']*)'")


class LaunchTags:
    """The trees of all files of a launch. `parse` is for the loader; `given` are the arguments of the command line."""

    def __init__(self, given: Mapping[str, str]) -> None:
        self.given = given
        self.trace = Trace()
        self.roots: list[Element] = []

    def parse(self, text: bytes, file: str) -> Element:
        """The elements of a file, which note what is read of them. Raises BadFile."""
        root = TracedElement(xml_tree.read(text, file), self.trace)
        self.roots.append(root)
        return root

    def elements(self, tag: str) -> Iterator[Element]:
        """All elements of that tag that were read, and not for their condition alone."""
        for root in self.roots:
            for element in _walk(root):
                read = self.trace.read_attributes.get(id(element), set())
                if element.tag == tag and id(element) in self.trace.read and (not read or read - {"if", "unless"}):
                    yield element

    def say_of_remap(self, verdict: Verdict, remap: Remap, text: str) -> None:
        """The verdict on a `<remap>`, in the place of that by what was read of it."""
        for element in self.elements("remap"):
            written = plain(element).get("from") or ""
            is_it = written.strip() == remap.source or "$(" in written
            if is_it and (element.file, element.line) == (remap.place.file, remap.place.line):
                notice = Notice(verdict, element.title, text, element.file, element.line)
                self.trace.said.setdefault(id(element), []).append((None, notice))

    def text_at(self, place: Place) -> str:
        """The text of the `<rosparam>` at a place, moved down so that its lines have the numbers of the file."""
        for element in self.elements("rosparam"):
            if (element.file, element.line) == (place.file, place.line):
                pieces = (node for node in element.content if isinstance(node, str))
                return "\n" * (element.line - 1) + "".join(p for p in pieces if not isinstance(p, xml_tree.Comment))
        return ""

    def classify(self, plan: Plan, findings: Findings) -> None:
        """Add a finding for everything in the files. Of those that stand in for ROS's own, only what is amiss."""
        self._take(plan.notices)
        for root in self.roots:
            own = Findings()
            Tags(self.trace, own, self._explain).classify(root)
            is_counterpart = root.file.startswith(shown(_counterparts()))
            findings.extend(n for n in own.sorted() if n.verdict != "used" or not is_counterpart)
        findings.extend(plan.notices)

    def _take(self, notices: list[Notice]) -> None:
        """Lead notices back to their elements, by place and title."""
        by_place: dict[tuple[str, int | None, str], list[Notice]] = {}
        for notice in notices:
            by_place.setdefault((notice.file, notice.line, notice.subject), []).append(notice)
        for element in (element for root in self.roots for element in _walk(root)):
            for notice in by_place.get((element.file, element.line, element.title), ()):
                match = _ATTRIBUTE.match(notice.text)
                self.trace.said.setdefault(id(element), []).append((match[1] if match else None, notice))

    def _explain(self, element: Element, _: str) -> Iterator[Notice] | None:
        """An argument that was given is not what its tag says."""
        name = plain(element).get("name") or ""
        if element.tag != "arg" or name not in self.given or element.file != self.roots[0].file:
            return None
        text = f"{self.given[name]!r}, as given"
        return iter([Notice("used", f"argument {name}", text, element.file, element.line)])


def _counterparts() -> Path:
    return paths.share("launch") / "counterparts"


def _walk(element: Element) -> Iterator[Element]:
    yield element
    for child in plain(element).children:
        yield from _walk(child)
