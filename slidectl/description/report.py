"""The report of a robot description: one notice for each thing that is converted, ignored or wrong.

Readers of elements write into a Report while they read. It only collects; readers raise errors themselves.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

from slidectl.description.robot import Notice, Verdict
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile, closest

MOST_NOTICES = 1000
"""Of one robot. Against: a description that was sent, whose every tag makes a notice."""
MOST_OF_ONE = 100
"""The most unknown attributes of one element that are named; the rest is counted. Against: the same."""
MOST_ALIKE = 100
"""The most notices of one file in `bounded` that say the same of different things."""
_MOST_COMPARED = 100
"""The most names that are compared for a suggestion. Against: the same, as comparing is slow."""

# Tags of related formats, with the tag that replaces them here.
_FOREIGN = {
    "plugin": "it belongs in a <gazebo> without a reference",
    "sensor": "it belongs in a <gazebo>",
    "model": "it is SDF's; here a robot is URDF",
}


def is_important(verdict: str, subject: str) -> bool:
    """True for a notice that `spawn` prints in full: "wrong", or a corrected mass or inertia."""
    return verdict == "wrong" or (verdict == "converted" and "/<inertial>" in subject)


class Report:
    """Collects notices in the order of reading."""

    def __init__(self) -> None:
        self.faults: list[BadFile] = []
        """Errors that `attempt` has caught; always empty in this class."""
        self._notices: list[Notice] = []
        self._left_out = 0
        self._compared = 0

    def add(
        self,
        verdict: Verdict,
        element: Element,
        text: str,
        subject: str | None = None,
        attribute: str | None = None,  # noqa: ARG002 - for a subclass that traces single attributes
    ) -> None:
        """Add a notice about `element`, or about one `attribute` of it; `subject` replaces the element's title."""
        if len(self._notices) < MOST_NOTICES:
            self._notices.append(Notice(verdict, subject or element.title, text, element.file, element.line))
        else:
            self._left_out += 1

    def attempt(self, read: Callable[..., Any], element: Element, *values: Any) -> Any:
        """Call `read` for an element and return its result. A check catches its BadFile and returns None."""
        return read(element, *values)

    def notices(self, root: Element) -> tuple[Notice, ...]:
        """All notices up to MOST_NOTICES; one more has the number of the others."""
        if not self._left_out:
            return tuple(self._notices)
        text = f"{self._left_out} more notices are left out"
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
        """Report every attribute and child of `element` that is not among the known ones.

        Of the attributes MOST_OF_ONE are named, and one more notice has the number of the others.
        """
        place = owner or element.title
        names = [name for name in element.attributes if name not in attributes and not is_namespace(name)]
        for name in names[:MOST_OF_ONE]:
            hint = self.meant(name, attributes)
            self.ignored(element, f"attribute {name!r} is unknown here and has no effect{hint}", place, name)
        if len(names) > MOST_OF_ONE:
            self.ignored(element, f"and {len(names) - MOST_OF_ONE} more unknown attributes have no effect", place)
        for child in element.children:
            if child.tag not in children:
                hint = f"; {_FOREIGN[child.tag]}" if child.tag in _FOREIGN else self.meant(child.tag, children, "<{}>")
                self.ignored(child, f"is unknown here and has no effect{hint}", f"{place}/{child.title}")

    def meant(self, name: str, known: Iterable[str], form: str = "{!r}") -> str:
        """`; did you mean ...?` with the known name closest to `name`, or an empty text.

        Comparing is slow, so only a limited number of names per file is compared, with a limited number of known names.
        """
        self._compared += 1
        return did_you_mean(name, islice(known, _MOST_COMPARED), form) if self._compared <= _MOST_COMPARED else ""

    def only(self, element: Element, tag: str) -> Element | None:
        """The first child called `tag`, or None; as in urdfdom, each further one is reported as ignored."""
        found = element.find_all(tag)
        for extra in found[1:]:
            self.ignored(
                extra, f"only the first <{tag}> counts, line {found[0].line}", f"{element.title}/{extra.title}"
            )
        return found[0] if found else None


def bounded(notices: Sequence[Notice]) -> list[Notice]:
    """The notices; of more than MOST_ALIKE that say the same of different things, the rest is one with their number."""
    counts = Counter(map(_kind, notices))
    seen: Counter[tuple[str, str, str]] = Counter()
    shown = []
    for notice in notices:
        kind = _kind(notice)
        seen[kind] += 1
        if notice.verdict == "used" or seen[kind] <= MOST_ALIKE:
            shown.append(notice)
        elif seen[kind] == MOST_ALIKE + 1:
            rest = counts[kind] - MOST_ALIKE
            shown.append(replace(notice, text=f"and {rest} more of this kind, of which this is the first"))
    return shown


def _kind(notice: Notice) -> tuple[str, str, str]:
    """File, verdict, and the text up to the first name in it: equal for those that say the same of different things."""
    return notice.file, notice.verdict, re.split("['\";:]", notice.text, maxsplit=1)[0]


def is_namespace(attribute: str) -> bool:
    """True for an attribute that declares an XML namespace."""
    return attribute == "xmlns" or attribute.startswith("xmlns:")


def did_you_mean(name: str, known: Iterable[str], form: str = "{!r}") -> str:
    """`; did you mean ...?` with the known name closest in spelling, or an empty text."""
    near = closest(name, known)
    return f"; did you mean {form.format(near)}?" if near else ""


def one_line(text: str) -> str:
    """A message and its hints on one line, joined by semicolons where no full stop or question mark ends a line."""
    first, *more = (line.strip() for line in text.splitlines() or [""])
    for line in more:
        first += line and (f" {line}" if first.endswith((".", "?", "!")) else f"; {line}")
    return first
