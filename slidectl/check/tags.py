"""Finds the effect of each tag and attribute: used, reported by the parser, or not read at all.

The parser gets elements that record which parts are read, and a report that records the element of each notice. So the
parser itself shows which tags it uses, and no second list is needed. No rules of URDF or launch files here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import Any

from slidectl.check.findings import Findings
from slidectl.description.report import Report, is_namespace
from slidectl.description.robot import Notice, Verdict
from slidectl.description.xml_tree import TITLES, Element
from slidectl.errors import BadFile

# These are not read, but are not useless: there is only one version, and a doc is for people.
_HARMLESS = {("robot", "version"), ("arg", "doc"), ("plugin", "name")}
_CONDITIONS = {"if", "unless"}
_ROOTS = ("robot", "launch")
_LONGEST = 60

Explain = Callable[[Element, str], Iterator[Notice] | None]
"""Takes an element and the name of its owner. Returns the findings if one line is not enough for it, else None."""


class Trace:
    """Records how the elements of one tree are read. Elements are identified by id()."""

    def __init__(self) -> None:
        self.read: set[int] = set()
        self.read_attributes: dict[int, set[str]] = {}
        self.notices: dict[int, list[tuple[str | None, Notice]]] = {}
        """For each element the notices about it, each with the name of the attribute or None."""
        self.unused: set[int] = set()
        """Elements that were dropped, left out or broken."""
        self.at_fault: Element | None = None
        """The element of the latest error."""


class TracedAttributes(dict[str, str]):
    """Attributes that record which of them are read. Iterating over the names does not count as a read."""

    def __init__(self, attributes: dict[str, str], element: int, trace: Trace) -> None:
        super().__init__(attributes)
        self._element = element
        self._trace = trace

    def _note(self, name: object) -> None:
        self._trace.read.add(self._element)
        self._trace.read_attributes.setdefault(self._element, set()).add(str(name))

    def __getitem__(self, name: str) -> str:
        self._note(name)
        return super().__getitem__(name)

    def __contains__(self, name: object) -> bool:
        self._note(name)
        return super().__contains__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self._note(name)
        return super().get(name, default)


class TracedElement(Element):
    """An element that records what is read of it. Iterating over all elements (`walk`) does not count as a read."""

    __slots__ = ("trace",)

    def __init__(self, element: Element, trace: Trace) -> None:
        attributes = TracedAttributes(element.attributes, id(self), trace)
        content: list[Element | str] = [
            TracedElement(node, trace) if isinstance(node, Element) else node for node in element.content
        ]
        super().__init__(element.tag, attributes, element.file, element.line, content)
        self.trace = trace

    @property
    def children(self) -> list[Element]:
        self.trace.read.add(id(self))
        return plain(self).children

    @property
    def first_text(self) -> str:
        self.trace.read.add(id(self))
        return plain(self).first_text

    @property
    def title(self) -> str:
        """As Element.title; it does not count as a read."""
        return plain(self).title

    def error(self, message: str, hint: str | None = None, kind: type[BadFile] = BadFile) -> BadFile:
        self.trace.at_fault = self
        return Element.error(self, message, hint, kind)


def plain(element: Element) -> Element:
    """A copy of the element without a trace, so that reading it is not recorded. The content is shared."""
    return Element(element.tag, dict(element.attributes), element.file, element.line, element.content)


class TracedReport(Report):
    """A report that records the element of each notice, keeps all notices, and collects faults."""

    def __init__(self, trace: Trace) -> None:
        super().__init__()
        self.trace = trace

    def add(
        self, verdict: Verdict, element: Element, text: str, subject: str | None = None, attribute: str | None = None
    ) -> None:
        notice = Notice(verdict, subject or element.title, text, element.file, element.line)
        self.trace.notices.setdefault(id(element), []).append((attribute, notice))

    def attempt(self, read: Callable[..., Any], element: Element, *values: Any) -> Any:
        """Call `read` for an element; a BadFile is collected, and None is returned."""
        try:
            result = read(element, *values)
        except BadFile as error:
            self.collect(error)
            result = None
        if result is None and element.tag not in _ROOTS:
            self.trace.unused.add(id(element))
        return result

    def collect(self, error: BadFile) -> None:
        """Add an error as a fault and as a notice, once."""
        if error not in self.faults:
            assert self.trace.at_fault is not None
            self.faults.append(error)
            self.wrong(self.trace.at_fault, "\n".join(part for part in (error.reason, error.hint) if part))


class Tags:
    """Adds findings for the tags of one file. `explain` may replace them. `is_whole`: False when the reading stopped
    early, so that an unread tag may have an effect."""

    def __init__(self, trace: Trace, findings: Findings, explain: Explain, is_whole: bool = True) -> None:
        self.trace = trace
        self.findings = findings
        self.explain = explain
        self.is_whole = is_whole

    def classify(self, root: Element) -> None:
        """Add one finding for each element of the tree."""
        self._element(root, "", "")

    def _element(self, element: Element, above: str, owner: str) -> None:
        said = self.trace.notices.get(id(element), [])
        self.findings.extend(notice for _, notice in said)
        if any(attribute is None and notice.verdict == "ignored" for attribute, notice in said):
            return
        bare = plain(element)
        name = bare.attributes.get("name")
        # The subject has the form of the parser's notices: `link 'a'/<inertial>/<mass>`.
        subject = f"{element.tag} {name!r}" if name is not None and not above else bare.title
        subject = f"{above}/{subject}" if above else subject
        if id(element) in self.trace.unused:
            for below in element.walk():
                self.findings.extend(notice for _, notice in self.trace.notices.get(id(below), []))
            return
        if id(element) not in self.trace.read:
            if self.is_whole and not any(attribute is None for attribute, _ in said):
                self._add("ignored", element, subject, "is not read, nor is its content")
            return
        read = self.trace.read_attributes.get(id(element), set())
        if read and read <= _CONDITIONS and not _CONDITIONS.isdisjoint(bare.attributes):
            self._add("used", element, subject, f"left out by its condition, {_content(bare, ())}")
            return
        self._used(element, bare, subject, owner)
        for child in bare.children:
            inside = "" if element.tag in _ROOTS else subject
            self._element(child, inside, owner or plain(child).attributes.get("name", ""))

    def _used(self, element: Element, bare: Element, subject: str, owner: str) -> None:
        explained = self.explain(element, owner)
        if explained is not None:
            self.findings.extend(explained)
            return
        spoken = {attribute for attribute, _ in self.trace.notices.get(id(element), [])}
        read = self.trace.read_attributes.get(id(element), ())
        for name in bare.attributes if self.is_whole else ():
            if name not in {*spoken, *read} and (element.tag, name) not in _HARMLESS and not is_namespace(name):
                self._add("ignored", element, f"{subject}, attribute {name!r}", "is not read")
                spoken.add(name)
        if None not in spoken:
            self._add("used", element, subject, _content(bare, spoken))

    def _add(self, verdict: Verdict, element: Element, subject: str, text: str) -> None:
        self.findings.add(verdict, subject, text, element.file, element.line)


def _content(bare: Element, spoken: Collection[str | None]) -> str:
    """The content of an element without what is reported elsewhere: attributes, text, and the tags inside."""
    titled = next((name for name in TITLES if name in bare.attributes), None)
    shown = [
        f'{name}="{value}"'
        for name, value in bare.attributes.items()
        if name not in spoken and name != titled and not is_namespace(name)
    ]
    tags = list(dict.fromkeys(f"<{child.tag}>" for child in bare.children))
    if text := bare.first_text:
        shown.append(text if len(text) <= _LONGEST else text[:_LONGEST] + " ...")
    elif tags:
        shown.append("with " + ", ".join(tags))
    return " ".join(shown) or "as it stands"
