"""The report of a robot description: one notice for each thing that is converted, ignored or wrong.

Parsers of elements write into a Report while they read. It only collects: what is an error is raised by them.
"""

from __future__ import annotations

from collections.abc import Collection

from slidectl.description.robot import Notice, Verdict
from slidectl.description.xml_tree import Element

MOST_NOTICES = 1000


class Report:
    """Collects notices in the order of reading."""

    def __init__(self) -> None:
        self._notices: list[Notice] = []
        self._untold = 0

    def add(
        self,
        verdict: Verdict,
        element: Element,
        text: str,
        subject: str | None = None,
        attribute: str | None = None,  # noqa: ARG002 - for a report that follows attributes one by one
    ) -> None:
        """One line about `element`, or about one `attribute` of it; `subject` replaces the element's own tag."""
        if len(self._notices) < MOST_NOTICES:
            self._notices.append(Notice(verdict, subject or element.title, text, element.file, element.line))
        else:
            self._untold += 1

    def notices(self, root: Element) -> tuple[Notice, ...]:
        """All of them; of a hopeless file, the first ones and how many more there are."""
        if not self._untold:
            return tuple(self._notices)
        text = f"{self._untold} more notices are left out"
        return (*self._notices, Notice("ignored", root.title, text, root.file, None))

    def ignored(self, element: Element, text: str, subject: str | None = None, attribute: str | None = None) -> None:
        self.add("ignored", element, text, subject, attribute)

    def converted(self, element: Element, text: str, subject: str | None = None) -> None:
        self.add("converted", element, text, subject)

    def wrong(self, element: Element, text: str, subject: str | None = None) -> None:
        self.add("wrong", element, text, subject)

    def unknown(
        self, element: Element, attributes: Collection[str], children: Collection[str], owner: str | None = None
    ) -> None:
        """Report every attribute and child of `element` that is not among the known ones."""
        place = owner or element.title
        for name in element.attributes:
            if name not in attributes and not is_namespace(name):
                self.ignored(element, f"attribute {name!r} is unknown here and has no effect", place, name)
        for child in element.children:
            if child.tag not in children:
                self.ignored(child, "is unknown here and has no effect", f"{place}/{child.title}")

    def only(self, element: Element, tag: str) -> Element | None:
        """The first child called `tag`, or None; each further one is reported as ignored, as urdfdom reads it."""
        found = element.find_all(tag)
        for extra in found[1:]:
            self.ignored(
                extra, f"only the first <{tag}> counts, line {found[0].line}", f"{element.title}/{extra.title}"
            )
        return found[0] if found else None


def is_namespace(attribute: str) -> bool:
    """True for the attribute that only names an XML namespace."""
    return attribute == "xmlns" or attribute.startswith("xmlns:")
