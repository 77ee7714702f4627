"""One tag of a launch file with its scope: namespace, arguments, remaps, environment, private parameters.

Attributes are returned with all substitutions made, errors have the place. A scope is copied for a group and for an
include, so that changes inside stay inside. No tag is known by name here.
"""

from __future__ import annotations

import os
import re
import shlex
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from slidectl import names
from slidectl.description import xml_tree
from slidectl.description.packages import Packages, UnknownPackage
from slidectl.description.report import MOST_OF_ONE, did_you_mean
from slidectl.description.robot import Verdict
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile, NoFileThere, NotThere, closest
from slidectl.extensions.launch.plan import LaunchPlan, Location, Remap, Setting
from slidectl.extensions.launch.substitution import DEFAULTS, Substitution, SubstitutionError, absent_packages, plain

Parse = Callable[[bytes, str], Element]
"""Parses the text of a file, given its name in messages, into elements. Raises BadFile."""

CONDITIONS = ("if", "unless")
# Against: a launch file that was sent, and is checked or read: arguments and includes that repeat each other.
MOST_TAGS = 20_000
MOST_TEXT = 64 * 2**20
"""The most characters of a launch: of its included files, each time, and of all texts after their substitutions."""
_MOST_WORDS = 64 * 2**10
"""The most characters of a text that is split like a shell. Against: the same; the time for a word is quadratic."""
MOST_SECONDS = 60.0
"""The most time for reading the files, s of processor time, without running commands."""
DEEPEST_INCLUDE = 60
_MOST_INCLUDERS = 3
_ONE_ARGUMENT = re.compile(r"\$\(\s*arg\s+([^\s)]+)\s*\)")
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}


@dataclass
class Launch:
    """The data that all files of one loading share."""

    packages: Packages
    run_commands: bool = True
    parse: Parse = xml_tree.read
    plan: LaunchPlan = field(default_factory=LaunchPlan)
    machines: set[str] = field(default_factory=set)
    """Names of `<machine>` tags for this machine."""
    absent: dict[str, UnknownPackage] = field(default_factory=dict)
    """The missing packages, each with its error."""
    _tags: int = 0
    _text: int = 0
    _began_s: float = field(default_factory=time.process_time)

    def count(self, tag: Tag) -> None:
        """Count a tag. Raises BadFile when there are too many."""
        self._tags += 1
        if self._tags > MOST_TAGS:
            raise tag.error(f"expands to more than {MOST_TAGS} tags", "does a file include itself?")
        if time.process_time() - self._began_s > MOST_SECONDS:
            raise tag.error(f"the launch takes more than {MOST_SECONDS:g} s to read", "does a file include itself?")

    def count_text(self, tag: Tag, text: str | bytes, where: str = "") -> None:
        """Count substituted text, or an included file. Raises BadFile, beginning with `where`, when it is too much."""
        self._text += len(text)
        if self._text > MOST_TEXT:
            hint = "do arguments or includes repeat each other many times over?"
            raise tag.error(f"{where}the launch expands to more than {MOST_TEXT >> 10} KiB of text", hint)


@dataclass
class Scope:
    """The scope of a tag. `file` is the file with the tag."""

    launch: Launch
    file: Path
    namespace: str = "/"
    arguments: dict[str, str] = field(default_factory=dict)
    """The usable arguments, protected: those given to the file (declared or not), and those declared so far.

    With pass_all_args the file also gets arguments that it does not declare: a file that it includes may use them."""
    given: Mapping[str, str] = field(default_factory=dict)
    """The arguments given to the file, protected."""
    lenient: bool = False
    """True with pass_all_args: an argument that is constant or unknown in the file is no error."""
    declared: set[str] = field(default_factory=set)
    """The arguments declared so far in this scope and around it. Sibling groups may declare the same name."""
    everywhere: set[str] = field(default_factory=set)
    """All arguments of the file, including those inside groups."""
    remaps: tuple[Remap, ...] = ()
    environment: tuple[tuple[str, str], ...] = ()
    private: tuple[Setting, ...] = ()
    """Parameters that every later node gets as private ones; names without `~`."""
    anonymous_names: dict[str, str] = field(default_factory=dict)
    """The names that `anon` has made in this file; each included file has its own."""
    trail: tuple[Location, ...] = ()
    """The places of the includes around this file, outermost first."""
    nesting: tuple[tuple[Path, tuple[tuple[str, str], ...]], ...] = ()
    """The files that are being read, each with the arguments given to it."""

    @property
    def packages(self) -> Packages:
        """The lookup of packages, which also searches upwards from the file."""
        return self.launch.packages.starting_at(self.file.parent)

    @property
    def substitution(self) -> Substitution:
        """The substitutions at this point: arguments that are declared later are not known."""
        return Substitution(
            self.packages, {**DEFAULTS, **os.environ}, dict(self.arguments), str(self.file.parent),
            self.anonymous_names, self.launch.absent,
        )  # fmt: skip

    def group(self, namespace: str) -> Scope:
        """A copy of the scope for a group in the same file."""
        return replace(self, namespace=namespace, arguments=dict(self.arguments), declared=set(self.declared))

    def including(self, file: Path, tag: Tag, given: Mapping[str, str], lenient: bool) -> Scope:
        """The scope of an included file. Raises BadFile for endless includes."""
        here = (file, tuple(sorted(given.items())))
        if here in self.nesting:
            raise tag.error(f"{file} includes itself", "does it need another argument each time, and an `if`?")
        if len(self.nesting) >= DEEPEST_INCLUDE:
            raise tag.error(f"includes are nested deeper than {DEEPEST_INCLUDE}", "does a file include itself?")
        return replace(
            self,
            file=file,
            namespace=tag.namespace(),
            arguments=dict(given),
            given=given,
            lenient=lenient,
            declared=set(),
            everywhere=set(),
            anonymous_names={},
            trail=(*self.trail, tag.place),
            nesting=(*self.nesting, here),
        )


class Tag:
    """An element with its scope."""

    def __init__(self, element: Element, scope: Scope) -> None:
        self.element = element
        self.scope = scope
        self.name = element.tag
        self.plan = scope.launch.plan
        self.place = Location(element.file, element.line)

    def error(self, message: str, hint: str | None = None) -> BadFile:
        """A BadFile at the tag, to be raised; its hint lists the includes around it."""
        return self.place.error(f"<{self.name}>: {message}", self._with_trail(hint))

    def absence(self, message: str, hint: str | None = None, thing: str = "") -> NotThere:
        """As error, for a missing thing that the tag names."""
        return self.place.absence(f"<{self.name}>: {message}", self._with_trail(hint), thing)

    def no_file(self, message: str, hint: str | None, path: Path) -> NoFileThere:
        """As error, for a file that the tag reads and that is not there."""
        text, place = f"<{self.name}>: {message}", self.place
        return NoFileThere(text, place.file, place.line, self._with_trail(hint), f"file {path}")

    def _with_trail(self, hint: str | None) -> str | None:
        lines = [hint] if hint else []
        lines += [f"included from {place}" for place in self.scope.trail[: -_MOST_INCLUDERS - 1 : -1]]
        return "\n".join(lines) or None

    # --- attributes -----------------------------------------------------------------------------------------------

    def raw(self, attribute: str, keep_absent: bool = False) -> str | None:
        """The attribute with substitutions; paths stay protected. Raises BadFile.

        A missing package is an error, unless `keep_absent`: then the text contains a mark for it.
        """
        text = self.element.get(attribute)
        if text is None or "$(" not in text:
            return text
        return self.substituted(text, self.scope.substitution, f"{attribute}: ", keep_absent)

    def substituted(self, text: str, substitution: Substitution, where: str = "", keep_absent: bool = False) -> str:
        """The text with all substitutions made; paths stay protected. `keep_absent` is as in `raw`. Raises BadFile."""
        try:
            found = substitution.resolve(text)
        except SubstitutionError as error:
            raise self.error(f"{where}{error.message}", error.hint) from None
        self.scope.launch.count_text(self, found, where)
        for package in () if keep_absent else absent_packages(found):
            raise self.absence_of(package)
        return found

    def note_absent(self, attribute: str) -> None:
        """Note missing packages that the attribute names itself, not those in the values of arguments."""
        if "find" in (self.element.get(attribute) or ""):
            for package in absent_packages(self.raw(attribute, keep_absent=True) or ""):
                self.plan.missing.note(self.absence_of(package))

    def absence_of(self, package: str) -> NotThere:
        """The error for a missing package."""
        error = self.scope.launch.absent[package]
        return self.absence(error.message, error.hint, f"package {package}")

    def get(self, attribute: str) -> str | None:
        """The attribute with substitutions, or None. Raises BadFile."""
        text = self.raw(attribute)
        return None if text is None else plain(text)

    def required(self, attribute: str) -> str:
        """A mandatory attribute that must not be empty. Raises BadFile."""
        value = self.get(attribute)
        if value is None or not value.strip():
            there = "is empty" if value is not None else "is missing"
            raise self.error(f"the attribute {attribute!r} {there}{self.mistake([attribute])}")
        return value

    def mistake(self, missing: Collection[str]) -> str:
        """A text ` (...)` about a similar attribute that may be a typing error for a missing one; else empty."""
        for name in self.element.attributes:
            if name not in (*missing, *CONDITIONS) and (near := closest(name, missing)):
                return f" ({name!r} is there: did you mean {near!r}?)"
        return ""

    def words(self, attribute: str, keep_absent: bool = False) -> list[str]:
        """Split the attribute like a POSIX shell, without expansions; `keep_absent` is as in `raw`.

        Raises BadFile: a quotation is not closed, or the text is too long.
        """
        text = self.raw(attribute, keep_absent) or ""
        if len(text) > _MOST_WORDS:
            raise self.error(f"{attribute}: comes to more than {_MOST_WORDS >> 10} KiB of text")
        try:
            return [plain(word) for word in shlex.split(text)]
        except ValueError as error:
            raise self.error(f"{attribute}: {str(error).lower()} in {self.get(attribute)!r}") from None

    def flag(self, attribute: str) -> bool:
        """An attribute that is true or false; a missing one is false. Raises BadFile."""
        text = self.get(attribute)
        if text is not None and text.lower() not in ("true", "false"):
            raise self.error(f"{attribute}: {text!r} is neither true nor false")
        return text is not None and text.lower() == "true"

    @property
    def clears(self) -> bool:
        """The value of `clear_params`; an empty one is false. Raises BadFile."""
        return bool(self.get("clear_params")) and self.flag("clear_params")

    def namespace(self) -> str:
        """The namespace of the scope, changed by the attribute `ns`. Raises BadFile."""
        text = self.get("ns")
        if text == "":
            raise self.error("the attribute 'ns' is empty", "leave it out: the namespace stays")
        return self.scope.namespace if text is None else self.within(self.scope.namespace, text)

    def within(self, namespace: str, name: str) -> str:
        """The absolute name of `name` in `namespace`; repeated slashes are removed. Raises BadFile: not legal."""
        full = re.sub("//+", "/", names.join(namespace, name)).rstrip("/") or "/"
        if name.startswith("~") or not names.is_legal(full):
            raise self.error(f"{name!r} is not a legal name here", legal_names(name))
        return full

    @cached_property
    def applies(self) -> bool:
        """True when `if` and `unless` allow the tag. Raises BadFile when both are set, or one is not a boolean."""
        given = [attribute for attribute in CONDITIONS if self.element.get(attribute) is not None]
        if len(given) > 1:
            raise self.error("'if' and 'unless' exclude each other")
        for attribute in given:
            text = self.get(attribute) or ""
            if (value := boolean(text)) is None:
                raise self.error(f"{attribute}: {self._named(attribute, text)} is neither true nor false")
            return value is (attribute == "if")
        return True

    def _named(self, attribute: str, text: str) -> str:
        """The attribute's text, and the argument whose value it is, if it is that of one argument, for a message."""
        match = _ONE_ARGUMENT.fullmatch((self.element.get(attribute) or "").strip())
        return f"the argument {match[1]!r} is {text!r}, which" if match else repr(text)

    # --- contents -------------------------------------------------------------------------------------------------

    def knows(self, attributes: Collection[str], conditions: bool = True) -> None:
        """Report attributes that are not among `attributes`; with `conditions` `if` and `unless` are known too.

        MOST_OF_ONE are named, and one more notice has the number of the others.
        """
        known = [*attributes, *(CONDITIONS if conditions else ())]
        unknown = [name for name in self.element.attributes if name not in known and not name.startswith("xmlns")]
        for name in unknown[:MOST_OF_ONE]:
            self.notice("wrong", f"attribute {name!r} is unknown and has no effect{did_you_mean(name, known)}")
        if len(unknown) > MOST_OF_ONE:
            self.notice("wrong", f"and {len(unknown) - MOST_OF_ONE} more unknown attributes have no effect")

    def children(self, known: Collection[str]) -> Iterator[Tag]:
        """The known tags inside, in order; unknown ones, and texts that look like tags, are reported."""
        if stray := self.element.stray_text:
            self.notice("wrong", f"the text {stray!r} in it has no effect: is it a tag without its '<'?")
        for element in self.element.children:
            self.scope.launch.count(self)
            tag = Tag(element, self.scope)
            if element.tag in known:
                yield tag
            else:
                hint = did_you_mean(element.tag, known, "<{}>")
                tag.notice("wrong", f"is unknown in <{self.name}> and has no effect{hint}")

    def notice(self, verdict: Verdict, text: str) -> None:
        """Add a notice about the tag."""
        self.plan.notice(verdict, self.place, self.element.title, text)


def legal_names(name: str) -> str:
    """A hint for a name that is not legal."""
    meant = f": did you mean {'_'.join(name.split())!r}?" if " " in name.strip() else ""
    return f"names are letters, digits, '_' and '/'{meant}"


def boolean(text: str) -> bool | None:
    """Read true, false, 1 or 0, as in conditions and parameters; None for anything else."""
    return _BOOLEANS.get(text.strip().lower())
