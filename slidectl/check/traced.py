"""Elements that remember what was read of them, and a report that remembers what was said of which.

With these the parser itself tells which tags and attributes it uses, and nothing has to be listed a second time.
They behave as what they stand in for; no meaning of tags here.
"""

from __future__ import annotations

from typing import Any

from slidectl.description.report import Report
from slidectl.description.robot import Notice, Verdict
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile


class Trace:
    """What happened to the elements of one tree. Elements go by identity."""

    def __init__(self) -> None:
        self.read: set[int] = set()
        self.read_attributes: dict[int, set[str]] = {}
        self.said: dict[int, list[tuple[str | None, Notice]]] = {}
        """Of each element, what was said of an attribute of it (its name), or of itself (None)."""
        self.culprit: Element | None = None
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
    """An element that notes what is read of it."""

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

    def error(self, message: str, hint: str | None = None) -> BadFile:
        self.trace.culprit = self
        return Element.error(self, message, hint)


def plain(element: Element) -> Element:
    """The element alone, without a trace: reading it leaves no mark. Its content is shared."""
    return Element(element.tag, dict(element.attributes), element.file, element.line, element.content)


class TracedReport(Report):
    """A report that notes the element of each notice. It leaves nothing out."""

    def __init__(self, trace: Trace) -> None:
        super().__init__()
        self._trace = trace

    def add(
        self, verdict: Verdict, element: Element, text: str, subject: str | None = None, attribute: str | None = None
    ) -> None:
        notice = Notice(verdict, subject or element.title, text, element.file, element.line)
        self._trace.said.setdefault(id(element), []).append((attribute, notice))
