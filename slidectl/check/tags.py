"""What became of each tag and attribute: used, or what the parser says of it, or not even read.

The parser gets elements that remember what is read of them, and a report that remembers what is said of which. So the
parser itself tells which tags it uses, and nothing is listed a second time. No rules of URDF or launch files here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import Any

from slidectl.check.findings import Findings
from slidectl.description.report import Report, is_namespace
from slidectl.description.robot import Notice, Verdict
from slidectl.description.xml_tree import TITLES, Element
from slidectl.errors import BadFile

# Not read, and yet not without use: there is but one version, and a doc is for people.
_HARMLESS = {("robot", "version"), ("arg", "doc"), ("plugin", "name")}
_CONDITIONS = {"if", "unless"}
_ROOTS = ("robot", "launch")
_LONGEST = 60

Explain = Callable[[Element, str], Iterator[Notice] | None]
"""The findings of an element that is worth more than one line, given the name of what it belongs to; None of others."""


class Trace:
    """What happened to the elements of one tree. Elements go by identity."""

    def __init__(self) -> None:
        self.read: set[int] = set()
        self.read_attributes: dict[int, set[str]] = {}
        self.said: dict[int, list[tuple[str | None, Notice]]] = {}
        """Of each element, what was said of an attribute of it (its name), or of itself (None)."""
        self.unused: set[int] = set()
        """Parts of which nothing came: those that are dropped, left out or broken."""
        self.at_fault: Element | None = None
        """The element of the last error that was made."""


class TracedAttributes(dict[str, str]):
    """Attributes that note who is asked for. Going through their names is no reading."""

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
    """An element that notes what is read of it. To go through all of them (`walk`) is no reading."""

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
        """As Element.title: to be named is not to be read."""
        return plain(self).title

    def error(self, message: str, hint: str | None = None, kind: type[BadFile] = BadFile) -> BadFile:
        self.trace.at_fault = self
        return Element.error(self, message, hint, kind)


def plain(element: Element) -> Element:
    """The element alone, without a trace: reading it leaves no mark. Its content is shared."""
    return Element(element.tag, dict(element.attributes), element.file, element.line, element.content)


class TracedReport(Report):
    """A report that notes the element of each notice, leaves nothing out, and takes faults in."""

    def __init__(self, trace: Trace) -> None:
        super().__init__()
        self.trace = trace

    def add(
        self, verdict: Verdict, element: Element, text: str, subject: str | None = None, attribute: str | None = None
    ) -> None:
        notice = Notice(verdict, subject or element.title, text, element.file, element.line)
        self.trace.said.setdefault(id(element), []).append((attribute, notice))

    def attempt(self, read: Callable[..., Any], element: Element, *values: Any) -> Any:
        """What is read of an element; None when it is broken, which is said then."""
        try:
            result = read(element, *values)
        except BadFile as error:
            self.take(error)
            result = None
        if result is None and element.tag not in _ROOTS:
            self.trace.unused.add(id(element))
        return result

    def take(self, error: BadFile) -> None:
        """An error of an element as a fault and a notice, once."""
        if error not in self.faults:
            assert self.trace.at_fault is not None
            self.faults.append(error)
            self.wrong(self.trace.at_fault, "\n".join(part for part in (error.reason, error.hint) if part))


class Tags:
    """The tags of one file. `explain` may speak for an element. `is_whole`: False when the reading has stopped early,
    so that what is not read may have a use."""

    def __init__(self, trace: Trace, findings: Findings, explain: Explain, is_whole: bool = True) -> None:
        self.trace = trace
        self.findings = findings
        self.explain = explain
        self.is_whole = is_whole

    def classify(self, root: Element) -> None:
        """Add a finding for everything in the tree, each once."""
        self._element(root, "", "")

    def _element(self, element: Element, above: str, owner: str) -> None:
        said = self.trace.said.get(id(element), [])
        self.findings.extend(notice for _, notice in said)
        if any(attribute is None and notice.verdict == "ignored" for attribute, notice in said):
            return
        bare = plain(element)
        name = bare.attributes.get("name")
        # As the parser's notices name things: `link 'a'/<inertial>/<mass>`.
        subject = f"{element.tag} {name!r}" if name is not None and not above else bare.title
        subject = f"{above}/{subject}" if above else subject
        if id(element) in self.trace.unused:
            for below in element.walk():
                self.findings.extend(notice for _, notice in self.trace.said.get(id(below), []))
            return
        if id(element) not in self.trace.read:
            if self.is_whole and not any(attribute is None for attribute, _ in said):
                self._add("ignored", element, subject, "is not read, nor what is in it")
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
        spoken = {attribute for attribute, _ in self.trace.said.get(id(element), [])}
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
    """What stands in an element, as far as nothing else was said of it: attributes, text, and the tags inside."""
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
