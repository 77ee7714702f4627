"""One tag of a launch file as its readers see it: attributes with everything substituted, and errors with the place.

Knows no tag by name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator
from functools import cached_property

from slidectl import names
from slidectl.description.xml_tree import Comment, Element
from slidectl.errors import BadFile, NotThere, closest
from slidectl.launch import protected
from slidectl.launch.plan import Place, Plan
from slidectl.launch.scope import Scope, absent_packages
from slidectl.launch.substitution import OPEN, SubstitutionError
from slidectl.launch.typed import boolean, flag

CONDITIONS = ("if", "unless")
_MOST_INCLUDERS = 3


class Tag:
    """An element in a scope."""

    def __init__(self, element: Element, scope: Scope) -> None:
        self.element = element
        self.scope = scope

    @property
    def name(self) -> str:
        return self.element.tag

    @property
    def plan(self) -> Plan:
        return self.scope.launch.plan

    @property
    def place(self) -> Place:
        return Place(self.element.file, self.element.line)

    def error(self, message: str, hint: str | None = None) -> BadFile:
        """A BadFile at the tag, to be raised; it says which includes led here."""
        return self.place.error(f"<{self.name}>: {message}", self._with_trail(hint))

    def absence(self, message: str, hint: str | None = None, thing: str = "") -> NotThere:
        """The same, of what the tag names and is not there."""
        return self.place.absence(f"<{self.name}>: {message}", self._with_trail(hint), thing)

    def _with_trail(self, hint: str | None) -> str | None:
        lines = [hint] if hint else []
        lines += [f"included from {place}" for place in self.scope.trail[: -_MOST_INCLUDERS - 1 : -1]]
        return "\n".join(lines) or None

    def raw(self, attribute: str, hands_on: bool = False) -> str | None:
        """The attribute with substitutions, its paths still protected. Raises BadFile.

        A package that is not there is an error, unless `hands_on`: then it stands in the text for those who need it.
        """
        text = self.element.get(attribute)
        if text is None or OPEN not in text:
            return text
        try:
            found = self.scope.substitution.resolve(text)
        except SubstitutionError as error:
            raise self.error(f"{attribute}: {error.message}", error.hint) from None
        self.scope.launch.count_text(self, found)
        for package in () if hands_on else absent_packages(found):
            raise self.absence_of(package)
        return found

    def note_absent(self, attribute: str) -> None:
        """Take in the packages that the attribute itself looks for, not those of arguments in it, in vain."""
        if "find" in (self.element.get(attribute) or ""):
            for package in absent_packages(self.raw(attribute, hands_on=True) or ""):
                self.plan.missing.note(self.absence_of(package))

    def absence_of(self, package: str) -> NotThere:
        """The error of a package that was looked up in vain."""
        error = self.scope.launch.absent[package]
        return self.absence(error.message, error.hint, f"package {package}")

    def get(self, attribute: str) -> str | None:
        """The attribute with substitutions, or None. Raises BadFile."""
        text = self.raw(attribute)
        return None if text is None else protected.plain(text)

    def required(self, attribute: str) -> str:
        """The attribute, which must be there and not empty. Raises BadFile."""
        value = self.get(attribute)
        if value is None or not value.strip():
            there = "is empty" if value is not None else "is missing"
            raise self.error(f"the attribute {attribute!r} {there}{self.slip([attribute])}")
        return value

    def slip(self, missing: Collection[str]) -> str:
        """` (...)` about an attribute that is there and looks like one of those that are not; else nothing."""
        for name in self.element.attributes:
            if name not in (*missing, *CONDITIONS) and (near := closest(name, missing)):
                return f" ({name!r} is there: did you mean {near!r}?)"
        return ""

    def words(self, attribute: str, hands_on: bool = False) -> list[str]:
        """The attribute taken apart as a shell would do it; `hands_on` as for `raw`. Raises BadFile."""
        try:
            return protected.words(self.raw(attribute, hands_on) or "")
        except ValueError as error:
            raise self.error(f"{attribute}: {str(error).lower()} in {self.get(attribute)!r}") from None

    def flag(self, attribute: str) -> bool:
        """true or false; false when it is not there. Raises BadFile."""
        return self._either(attribute, flag)

    @property
    def clears(self) -> bool:
        """What `clear_params` says; an empty one is false. Raises BadFile."""
        return bool(self.get("clear_params")) and self.flag("clear_params")

    def _either(self, attribute: str, read: Callable[[str], bool]) -> bool:
        text = self.get(attribute)
        try:
            return text is not None and read(text)
        except ValueError as error:
            raise self.error(f"{attribute}: {error}") from None

    def number(self, attribute: str, default: float) -> float:
        """A number of at least 0. Raises BadFile."""
        text = self.get(attribute)
        try:
            value = float(text) if text is not None else default
        except ValueError:
            value = -1.0
        if not 0.0 <= value < 1e9:
            raise self.error(f"{attribute} is a number of seconds, 0 or more, not {text!r}")
        return value

    def namespace(self) -> str:
        """The namespace of the scope, or that which `ns` makes of it. Raises BadFile."""
        text = self.get("ns")
        if text == "":
            raise self.error("the attribute 'ns' is empty", "leave it out: the namespace stays")
        return self.scope.namespace if text is None else self.within(self.scope.namespace, text)

    def within(self, namespace: str, name: str) -> str:
        """`name` in `namespace`, a legal absolute name; slashes too many are left out. Raises BadFile."""
        full = re.sub("//+", "/", names.join(namespace, name)).rstrip("/") or "/"
        if name.startswith("~") or not names.is_legal(full):
            raise self.error(f"{name!r} is not a legal name here", "names are letters, digits, '_' and '/'")
        return full

    @cached_property
    def applies(self) -> bool:
        """What `if` and `unless` say. Raises BadFile when they contradict, or say neither true nor false."""
        given = [attribute for attribute in CONDITIONS if self.element.get(attribute) is not None]
        if len(given) > 1:
            raise self.error("'if' and 'unless' exclude each other")
        return all(self._either(attribute, boolean) is (attribute == "if") for attribute in given)

    @property
    def text(self) -> str:
        """The text of the tag, without its comments."""
        return "".join(part for part in self.element.content if isinstance(part, str) and not isinstance(part, Comment))

    def knows(self, attributes: Collection[str], conditions: bool = True) -> None:
        """Point out attributes that are not among these; `conditions`: whether it can have an `if`."""
        known = [*attributes, *(CONDITIONS if conditions else ())]
        for name in self.element.attributes:
            if name not in known and not name.startswith("xmlns"):
                near = closest(name, known)
                suggestion = f"; did you mean {near!r}?" if near else ""
                self.notice("wrong", f"attribute {name!r} is unknown and has no effect{suggestion}")

    def children(self, known: Collection[str]) -> Iterator[Tag]:
        """The tags inside, in order; those that are not known are pointed out."""
        for element in self.element.children:
            self.scope.launch.count(self)
            if element.tag in known:
                yield Tag(element, self.scope)
            else:
                near = closest(element.tag, known)
                suggestion = f"; did you mean <{near}>?" if near else ""
                Tag(element, self.scope).notice("wrong", f"is unknown in <{self.name}> and has no effect{suggestion}")

    def notice(self, verdict: str, text: str) -> None:
        """Say something about the tag that is no error."""
        self.plan.notice(verdict, self.place, self.element.title, text)
