"""What became of each tag and attribute of a robot: used, or what the parser says of it, or not even read.

Goes once through traced elements after the parser has been there. Knows no rules of URDF: these are the parser's.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator

from slidectl.check.findings import Findings
from slidectl.check.stand_ins import STAND_IN
from slidectl.check.traced import Trace, plain
from slidectl.description.report import is_namespace
from slidectl.description.robot import Notice, Verdict
from slidectl.description.xml_tree import TITLES, Element

# Not read, and yet not without use: there is but one version, and a doc is for people.
_HARMLESS = {("robot", "version"), ("arg", "doc")}
_CONDITIONS = {"if", "unless"}
_ROOTS = ("robot", "launch")
_LONGEST = 60

Explain = Callable[[Element, str], Iterator[Notice] | None]
"""The findings of an element that is worth more than one line, given the name of what it belongs to; None of others."""


class Tags:
    """One robot's tags. `dead` elements were dropped with all below them; `explain` may speak for an element."""

    def __init__(self, trace: Trace, findings: Findings, dead: Collection[int], explain: Explain) -> None:
        self.trace = trace
        self.findings = findings
        self.dead = dead
        self.explain = explain

    def classify(self, root: Element) -> None:
        """Add a finding for everything in the tree, each once."""
        self._element(root, "", "")

    def _element(self, element: Element, above: str, owner: str) -> None:
        if element.line == STAND_IN:
            return
        said = self.trace.said.get(id(element), [])
        self.findings.extend(notice for _, notice in said)
        if any(attribute is None and notice.verdict == "ignored" for attribute, notice in said):
            return
        subject = _subject(element, above)
        if id(element) in self.dead:
            self.findings.extend(notice for below in plain(element).walk() for notice in self._said(below))
            return
        if id(element) not in self.trace.read:
            if not any(attribute is None for attribute, _ in said):
                self._add("ignored", element, subject, "is not read, nor what is in it")
            return
        if self._is_left_out(element):
            self._add("used", element, subject, f"left out by its condition, {_content(element, ())}")
            return
        self._used(element, subject, owner)
        for child in plain(element).children:
            self._element(child, "" if element.tag in _ROOTS else subject, owner or _owner(child))

    def _said(self, element: Element) -> Iterator[Notice]:
        return (notice for _, notice in self.trace.said.get(id(element), []))

    def _is_left_out(self, element: Element) -> bool:
        """Whether nothing was read of it but its condition, in a launch file."""
        read = self.trace.read_attributes.get(id(element), set())
        return bool(read) and read <= _CONDITIONS and not _CONDITIONS.isdisjoint(plain(element).attributes)

    def _used(self, element: Element, subject: str, owner: str) -> None:
        said = self.trace.said.get(id(element), [])
        spoken = {attribute for attribute, _ in said}
        explained = self.explain(element, owner)
        if explained is not None:
            self.findings.extend(explained)
            return
        for name in element.attributes:
            if name not in spoken and not self._is_read(element, name) and not is_namespace(name):
                self._add("ignored", element, f"{subject}, attribute {name!r}", "is not read")
                spoken.add(name)
        if None not in spoken:
            self._add("used", element, subject, _content(element, spoken))

    def _is_read(self, element: Element, name: str) -> bool:
        return name in self.trace.read_attributes.get(id(element), ()) or (element.tag, name) in _HARMLESS

    def _add(self, verdict: Verdict, element: Element, subject: str, text: str) -> None:
        self.findings.add(verdict, subject, text, element.file, element.line)


def _owner(element: Element) -> str:
    return plain(element).attributes.get("name", "")


def _subject(element: Element, above: str) -> str:
    """As the parser's notices name things: `link 'a'/<inertial>/<mass>`."""
    name = plain(element).attributes.get("name")
    if not above:
        return f"{element.tag} {name!r}" if name is not None else plain(element).title
    return f"{above}/{plain(element).title}"


def _content(element: Element, spoken: Collection[str | None]) -> str:
    """What stands in an element, as far as nothing else was said of it: attributes, text, and the tags inside."""
    attributes = plain(element).attributes
    titled = next((name for name in TITLES if name in attributes), None)
    shown = [
        f'{name}="{value}"'
        for name, value in attributes.items()
        if name not in spoken and name != titled and not is_namespace(name)
    ]
    tags = list(dict.fromkeys(f"<{child.tag}>" for child in plain(element).children if child.line != STAND_IN))
    if text := plain(element).first_text:
        shown.append(text if len(text) <= _LONGEST else text[:_LONGEST] + " ...")
    elif tags:
        shown.append("with " + ", ".join(tags))
    return " ".join(shown) or "as it stands"
