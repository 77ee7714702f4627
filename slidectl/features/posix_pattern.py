"""POSIX extended regular expressions with bounded cost: a client's pattern must not block the world.

Python's `re` has another grammar, and some patterns take exponential time in it. Here each part of a pattern maps all
its possible start positions to all its possible end positions: no path through the text is followed twice, and the
positions are counted.
"""

from __future__ import annotations

import string
from collections.abc import Callable

from slidectl.errors import UsageError, quoted

MOST_STEPS = 200_000
"""The most steps of one pattern, over all texts: some tenths of a second."""
_MOST_REPEATS = 255
_CLASSES = {
    "alpha": str.isalpha,
    "digit": lambda sign: sign in string.digits,
    "alnum": str.isalnum,
    "upper": str.isupper,
    "lower": str.islower,
    "space": str.isspace,
    "blank": lambda sign: sign in " \t",
    "punct": lambda sign: sign in string.punctuation,
    "xdigit": lambda sign: sign in string.hexdigits,
    "print": str.isprintable,
    "graph": lambda sign: sign.isprintable() and not sign.isspace(),
    "cntrl": lambda sign: ord(sign) < 32 or ord(sign) == 127,
}
Accepts = Callable[[str], bool]
"""True when a single character matches."""
Part = Callable[[str, set[int]], set[int]]
"""A part of the pattern: maps start positions in a text to end positions. 0 is before the first character."""


class PosixPattern:
    """A compiled pattern, searched for in texts. Raises UsageError: it is invalid, or too large."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._steps = 0
        try:
            self._whole = self._alternatives()
        except RecursionError:
            raise self._too_large() from None
        if self._at < len(text):
            raise self._error("')' without '('")

    def is_in(self, text: str) -> bool:
        """True when some part of the text matches. Raises UsageError: it takes too long, or is too large."""
        try:
            return bool(self._whole(text, set(range(len(text) + 1))))
        except RecursionError:
            raise self._too_large() from None

    def _count(self, starts: set[int]) -> None:
        self._steps += 1 + len(starts)
        if self._steps > MOST_STEPS:
            raise UsageError(f"the pattern {quoted(self._text)} takes too long", "write a simpler one")

    def _too_large(self) -> UsageError:
        return UsageError(f"the pattern {quoted(self._text)} is too large", "write a simpler one")

    def _error(self, why: str) -> UsageError:
        return UsageError(f"{quoted(self._text)} is not a POSIX extended regular expression: {why}")

    # The grammar

    def _peek(self) -> str:
        return self._text[self._at : self._at + 1]

    def _next(self) -> str:
        self._at += 1
        return self._text[self._at - 1 : self._at]

    def _alternatives(self) -> Part:
        branches = [self._branch()]
        while self._peek() == "|":
            self._at += 1
            branches.append(self._branch())
        return lambda text, starts: set().union(*(branch(text, starts) for branch in branches))

    def _branch(self) -> Part:
        parts: list[Part] = []
        while (sign := self._peek()) and sign not in "|)":
            if sign in "*+?{":
                raise self._error(f"nothing before {sign!r} to repeat")
            part = self._atom()
            while (sign := self._peek()) and sign in "*+?{":
                self._at += 1
                least, most = {"*": (0, None), "+": (1, None), "?": (0, 1)}.get(sign) or self._counts()
                part = self._times(part, least, most)
            parts.append(part)

        def ends(text: str, places: set[int]) -> set[int]:
            for part in parts:
                places = part(text, places)
            return places

        return ends

    def _atom(self) -> Part:
        sign = self._next()
        if sign == "(":
            inside = self._alternatives()
            if self._next() != ")":
                raise self._error("'(' without ')'")
            return inside
        if sign == "^":
            return lambda _, starts: starts & {0}
        if sign == "$":
            return lambda text, starts: starts & {len(text)}
        if sign == "[":
            return self._one(self._bracket())
        if sign == ".":
            return self._one(lambda _: True)
        if sign == "\\" and not (sign := self._next()):
            raise self._error("it ends with '\\'")
        return self._one(sign.__eq__)

    def _bracket(self) -> Accepts:
        """The content of `[...]`."""
        is_other = self._peek() == "^"
        self._at += is_other
        accepted: list[Accepts] = []
        while self._peek() != "]" or not accepted:
            sign = self._next()
            if not sign:
                raise self._error("'[' without ']'")
            if sign == "[" and self._peek() in (":", ".", "="):
                accepted.append(self._named())
            elif self._peek() == "-" and self._text[self._at + 1 : self._at + 2] not in ("]", ""):
                self._at += 1
                accepted.append(self._range(sign, self._next()))
            else:
                accepted.append(sign.__eq__)
        self._at += 1
        return lambda sign: any(one(sign) for one in accepted) is not is_other

    def _named(self) -> Accepts:
        kind = self._next()
        name, end, _ = self._text[self._at :].partition(f"{kind}]")
        if kind != ":" or not end or name not in _CLASSES:
            raise self._error(f"classes of characters are {', '.join(f'[:{one}:]' for one in _CLASSES)}")
        self._at += len(name) + 2
        return _CLASSES[name]

    def _range(self, first: str, last: str) -> Accepts:
        if last < first:
            raise self._error(f"the range {first}-{last} is the wrong way round")
        return lambda sign: first <= sign <= last

    def _counts(self) -> tuple[int, int | None]:
        """The content of `{...}`."""
        text, end, _ = self._text[self._at :].partition("}")
        least, comma, most = text.partition(",")
        numbers = [least] if not comma else [least, most or "0"]
        if not end or not all(one.isascii() and one.isdigit() and len(one) < 4 for one in numbers):
            raise self._error("a number of times is {N}, {N,} or {N,M}")
        low, high = int(least), int(most) if most else None if comma else int(least)
        if max(low, high or 0) > _MOST_REPEATS or (high is not None and high < low):
            raise self._error(f"{{{text}}} is not a number of repetitions up to {_MOST_REPEATS}")
        self._at += len(text) + 1
        return low, high

    # Matching

    def _one(self, accepts: Accepts) -> Part:
        """A part that matches a single character."""

        def ends(text: str, starts: set[int]) -> set[int]:
            self._count(starts)
            return {at + 1 for at in starts if at < len(text) and accepts(text[at])}

        return ends

    def _times(self, part: Part, least: int, most: int | None) -> Part:
        def ends(text: str, places: set[int]) -> set[int]:
            for _ in range(least):
                if not places:
                    break
                self._count(places)  # count empty matches too
                places = part(text, places)
            reached, left = places, None if most is None else most - least
            while places and left != 0:
                self._count(places)
                places = part(text, places) - reached
                reached = reached | places
                left = left and left - 1
            return reached

        return ends
