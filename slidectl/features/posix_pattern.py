"""POSIX extended regular expressions of clients, by Python's `re`, with a limit on time.

Against: a client whose pattern takes exponential time, and would block the world. `re` looks for signals while it
matches, so a timer of processor time ends it; that timer is not the one of the limit on users' code.
"""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from slidectl.errors import UsageError, quoted

MOST_S = 0.2
"""Processor time of one search, s."""
_LONGEST = 1000
_MOST_REPEATS = 255
_CLASSES = {
    "alpha": "a-zA-Z", "digit": "0-9", "alnum": "a-zA-Z0-9", "upper": "A-Z", "lower": "a-z", "space": r"\s",
    "blank": r" \t", "punct": r"!-/:-@\[-`{-~", "xdigit": "0-9a-fA-F", "print": " -~", "graph": "!-~",
    "cntrl": r"\x00-\x1f\x7f",
}  # fmt: skip
_TOKEN = re.compile(
    r"\\(?P<sign>.)"
    r"|\[(?P<other>\^?)(?P<bracket>\]?(?:\[:\w*:\]|[^]])*)\]"
    r"|(?P<repeat>[*+?]|\{\d{1,3}(?:,\d{0,3})?\})"
    r"|(?P<plain>[^\\[{])",
    re.DOTALL,
)
_IN_BRACKET = re.compile(r"\[:(?P<name>\w*):\]|(?P<sign>[^-])|-", re.DOTALL)
_SIGNS = {"(": "(?:", "^": r"\A", "$": r"\Z", ".": ".", "|": "|", ")": ")"}


class PosixPattern:
    """A compiled pattern, searched for in texts. Raises UsageError: it is invalid, or too large."""

    def __init__(self, text: str) -> None:
        self._text = text
        if len(text) > _LONGEST:
            raise UsageError(f"the pattern {quoted(text)} is longer than {_LONGEST} characters", "write a simpler one")
        try:
            with _limited():
                self._pattern = re.compile(self._translated(), re.DOTALL)
        except (re.error, OverflowError) as error:
            raise self._error(str(error)) from None
        except (RecursionError, TimeoutError):
            raise UsageError(f"the pattern {quoted(text)} is too large", "write a simpler one") from None

    def is_in(self, text: str) -> bool:
        """True when some part of the text matches. Raises UsageError: it takes too long."""
        try:
            with _limited():
                return self._pattern.search(text) is not None
        except (MemoryError, TimeoutError):
            raise UsageError(f"the pattern {quoted(self._text)} takes too long", "write a simpler one") from None

    def _error(self, why: str) -> UsageError:
        return UsageError(f"{quoted(self._text)} is no POSIX extended regular expression: {why}")

    def _translated(self) -> str:
        """The pattern for Python, which has other classes of characters, anchors and escapes."""
        parts: list[str] = []
        at = 0
        is_repeated = False
        while at < len(self._text):
            token = _TOKEN.match(self._text, at)
            if token is None:
                raise self._error(f"nothing ends what begins with {self._text[at : at + 10]!r}")
            at = token.end()
            if token["repeat"]:
                if any(int(count) > _MOST_REPEATS for count in re.findall(r"\d+", token["repeat"])):
                    raise self._error(f"{_MOST_REPEATS} is the most times")
                if is_repeated:  # POSIX leaves open what it means; in Python it means something else
                    raise self._error(f"a repeat of a repeat: {token['repeat']}")
                parts.append(token["repeat"])
            elif token["bracket"] is not None:
                parts.append(f"[{token['other']}{_IN_BRACKET.sub(self._bracket_part, token['bracket'])}]")
            elif token["sign"]:
                parts.append(re.escape(token["sign"]))
            else:
                parts.append(_SIGNS.get(token["plain"]) or re.escape(token["plain"]))
            is_repeated = bool(token["repeat"])
        return "".join(parts)

    def _bracket_part(self, part: re.Match[str]) -> str:
        if part["name"] is not None:
            if part["name"] not in _CLASSES:
                raise self._error(f"classes of characters are {', '.join(f'[:{one}:]' for one in _CLASSES)}")
            return _CLASSES[part["name"]]
        return re.escape(part["sign"]) if part["sign"] else "-"


@contextmanager
def _limited() -> Iterator[None]:
    """Raise TimeoutError inside after MOST_S. Without effect outside of the main thread, which the daemon has alone."""
    try:
        before = signal.signal(signal.SIGVTALRM, _end)
    except ValueError:
        yield
        return
    signal.setitimer(signal.ITIMER_VIRTUAL, MOST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def _end(_number: int, _frame: FrameType | None) -> None:
    raise TimeoutError
