"""One exception class per cause, each with its exit code.

An error is one to three lines: what failed, what exists, what to type next. The classes build that text
themselves, so that command line, client, service answer and log say the same. Standard library only.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Iterable, Sequence

EXIT_DONE = 0
EXIT_REFUSED = 1
EXIT_USAGE = 2
EXIT_NO_DAEMON = 3
EXIT_TIMED_OUT = 4
EXIT_INTERRUPTED = 130

# Against: names and texts of clients, of any length.
_LONGEST_SHOWN = 120
_LONGEST_TEXT = 4000
_LONGEST_ERROR = 20_000
_LONGEST_COMPARED = 200
_MOST_COMPARED = 500
_LEAST_WORD = 4
_LEAST_RATIO = 0.5
"""Words of names with at least so many letters are alike from this ratio on."""
_LEAST_WHOLE = 0.8
"""The same for whole names with different numbers of words."""


class Reason(str):
    """A line about a request: at `level` "error" why it was refused, at "warn" a warning."""

    level: str

    def __new__(cls, text: str, level: str = "error") -> Reason:
        reason = super().__new__(cls, text)
        reason.level = level
        return reason


def cut(text: str, most: int = _LONGEST_TEXT) -> str:
    """Return the text; if it is longer than `most` characters, its middle is left out."""
    if len(text) <= most:
        return text
    half = most // 2
    return f"{text[:half]} ... ({len(text) - 2 * half} characters left out) ... {text[-half:]}"


def quoted(name: str) -> str:
    """The name in quotes for an error message; the middle of a long one is left out."""
    return repr(cut(name, _LONGEST_SHOWN))


def closest(name: str, known: Iterable[str]) -> str | None:
    """The known name nearest in spelling, or None. A short name is also compared with the ends of full names.

    Comparing is slow, and the names may be untrusted. So long names are not compared, and of many known names only
    those next to `name` in alphabetical order.
    """
    if len(name) > _LONGEST_COMPARED:
        return None
    from bisect import bisect  # imported here: only errors need these modules, and every command imports this file
    from difflib import SequenceMatcher, get_close_matches

    known = sorted(full for full in known if len(full) <= 2 * _LONGEST_COMPARED)
    begin = max(0, bisect(known, name) - _MOST_COMPARED // 2) if len(known) > _MOST_COMPARED else 0
    known = known[begin : begin + _MOST_COMPARED]
    components = name.count("/") + 1
    by_end: dict[str, str] = {}
    for full in known:
        by_end.setdefault(full, full)
        if not name.startswith("/"):
            by_end.setdefault("/".join(full.split("/")[-components:]), full)
    matches = get_close_matches(name, by_end, n=3, cutoff=0.6)
    if not matches:
        return None
    # Among equally near names the one with the longest common beginning wins: people mistype the end of a name.
    nearest = max(matches, key=lambda match: (SequenceMatcher(None, match, name).ratio(), _common_start(match, name)))
    return by_end[nearest] if _is_near(nearest, name) else None


def _is_near(one: str, other: str) -> bool:
    """True unless the names have words that are not alike: `my_camera` and `his_camera` are not one name mistyped."""
    from difflib import SequenceMatcher

    words, others = (re.split(r"[_/ ]+", name.lower().strip("/_")) for name in (one, other))
    if len(words) != len(others):
        if set(words) <= set(others) or set(others) <= set(words):  # a word was left out, or is too much
            return True
        return SequenceMatcher(None, "".join(words), "".join(others)).ratio() >= _LEAST_WHOLE
    pairs = [pair for pair in zip(words, others, strict=True) if max(map(len, pair)) >= _LEAST_WORD]
    return all(SequenceMatcher(None, *pair).ratio() >= _LEAST_RATIO for pair in pairs)


def _common_start(one: str, other: str) -> int:
    """The number of characters that two names have in common at their beginning."""
    pairs = enumerate(zip(one, other, strict=False))
    return next((at for at, (a, b) in pairs if a != b), min(len(one), len(other)))


def _suggestion(name: str, known: Iterable[str]) -> str:
    near = closest(name, known)
    return f" Did you mean {near!r}?" if near else ""


def listing(known: Iterable[str], most: int = 12) -> str:
    """The sorted names as `a, b, c`; after `most` names the number of the others. `none` when there are no names."""
    names = sorted(known)
    if not names:
        return "none"
    rest = len(names) - most
    return ", ".join(cut(name, _LONGEST_SHOWN) for name in names[:most]) + (f" and {rest} more" if rest > 0 else "")


class SlidectlError(Exception):
    """Base class of all errors that a user may see. `hint` is the last line; it says what to type next."""

    exit_code = EXIT_REFUSED

    def __init__(self, message: str, hint: str | None = None) -> None:
        self.message = cut(message, _LONGEST_ERROR)
        self.hint = None if hint is None else cut(hint, _LONGEST_ERROR)
        super().__init__(self.message)

    def __str__(self) -> str:
        return f"{self.message}\n{self.hint}" if self.hint else self.message


class Refused(SlidectlError):
    """A service refused a request, or a condition is false."""


class UsageError(SlidectlError):
    """The command line or an argument is wrong."""

    exit_code = EXIT_USAGE


class BadFile(SlidectlError):
    """A user's file is missing or broken. The message begins with `file:line:` where these are known."""

    exit_code = EXIT_USAGE

    def __init__(self, message: str, file: str | None = None, line: int | None = None, hint: str | None = None) -> None:
        where = "" if file is None else f"{file}: " if line is None else f"{file}:{line}: "
        super().__init__(where + message, hint)
        self.file = file
        self.line = line
        self.reason = message


class NotThere(BadFile):
    """A user's file names a package, file, program or type that does not exist. `thing` names it in few words."""

    def __init__(
        self, message: str, file: str | None = None, line: int | None = None, hint: str | None = None, thing: str = ""
    ) -> None:
        super().__init__(message, file, line, hint)
        self.thing = thing or str(self.message)


class NoFileThere(NotThere):
    """A file that a user's file includes or reads does not exist. roslaunch and xacro refuse that, too."""


class NoDaemon(SlidectlError):
    """No daemon answers on the socket."""

    exit_code = EXIT_NO_DAEMON


class TimedOut(SlidectlError):
    """The answer did not arrive within the wall-clock timeout."""

    exit_code = EXIT_TIMED_OUT


class NoDescriptors(SlidectlError):
    """The process has reached its limit of open files and sockets."""

    ERRNOS = (errno.EMFILE, errno.ENFILE)

    def __init__(self, who: str) -> None:
        super().__init__(
            f"{who} cannot open more files: the limit is too low, or it has too many open", "raise it: ulimit -n 1024"
        )


def _plural(word: str) -> str:
    if word.endswith("s"):
        return word
    return f"{word[:-1]}ies" if word.endswith("y") and word[-2:-1] not in "aeiou" else f"{word}s"


class UnknownName(SlidectlError):
    """A name that does not exist. The error suggests the closest name and lists the existing ones."""

    kind = name = ""
    known: Sequence[str] = ()

    def __init__(self, kind: str, name: str, known: Sequence[str], where: str = "") -> None:
        inside = f" {where}" if where else ""
        plural = ", ".join(map(_plural, kind.replace(" or ", ", ").split(", ")))
        super().__init__(f"no {kind} {quoted(name)}{inside}.{_suggestion(name, known)}", f"{plural}: {listing(known)}")
        self.kind = kind
        self.name = name
        self.known = list(known)


class AmbiguousName(UsageError):
    """A short name that fits more than one full name."""

    def __init__(
        self, kind: str, name: str, matches: Sequence[str], hint: str = "write the full name, or give --ns"
    ) -> None:
        super().__init__(f"{quoted(name)} fits more than one {kind}: {listing(matches)}", hint)
        self.matches = list(matches)


class Unused(Refused):
    """A topic that exists, but has no publisher or no subscriber (`role` is `publishers` or `subscribers`)."""

    def __init__(self, role: str, topic: str, used: Sequence[str]) -> None:
        verb = "publishes" if role == "publishers" else "subscribes to"
        super().__init__(f"nobody {verb} {topic}.{_suggestion(topic, used)}", f"topics with {role}: {listing(used)}")


class BadName(UsageError):
    """Text that is not a legal graph name."""

    def __init__(self, name: str, rule: str = "", hint: str | None = None) -> None:
        rule = rule or "name: letters, digits, '_' and '/', and the first is a letter, '/' or '~'"
        if hint is None and " " in name:  # as a printed page has it, or a reader who copies from one
            hint = f"names have no spaces: did you mean {quoted('_'.join(name.split()))}?"
        super().__init__(f"{quoted(name)} is not a legal {rule}", hint)


class BadMessage(UsageError):
    """A message that does not fit its type. `path` is the field, as `pose.position.x`."""

    def __init__(self, message: str, path: str = "", hint: str | None = None) -> None:
        super().__init__(message, hint)
        self.path = path


class MessageRefused(Refused):
    """A subscriber refuses a message that fits its type, for example a command that is not a number."""
