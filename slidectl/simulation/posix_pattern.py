"""POSIX extended regular expressions, within bounds: a pattern of a client's must not hold up the world.

Python's `re` has another grammar, and patterns that take it for ever. This goes through the text once, with all states
that are possible at a time, and counts what it does.
"""

from __future__ import annotations

import string
from collections.abc import Callable
from typing import NamedTuple

from slidectl.errors import UsageError, quoted

MOST_INSTRUCTIONS = 2000
MOST_STEPS = 100_000
"""Of one pattern, over all texts: some tenths of a second."""
_MOST_REPEATS = 255
_DEEPEST = 50
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
"""Whether a single character is one of those that are meant."""


class _Instruction(NamedTuple):
    """What `accepts` takes a character and leads to the next one; any other leads `to` others, if `place` is here."""

    accepts: Accepts | None = None
    to: tuple[int, ...] = ()
    place: str = ""
    """`^`: only at the beginning of the text. `$`: only at its end."""


Part = Callable[[], None]
"""Writes the instructions of a part of the pattern."""


class PosixPattern:
    """A pattern, made to look for it in texts. Raises UsageError: it is none, or too large."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._depth = 0
        self._steps = 0
        self._program: list[_Instruction] = []
        whole = self._alternatives()
        if self._at < len(text):
            raise self._error("')' without '('")
        whole()

    def is_in(self, text: str) -> bool:
        """Whether some part of the text matches. Raises UsageError: it takes too long to say."""
        states: set[int] = set()
        for at in range(len(text) + 1):
            states = self._reached({0, *states}, at == 0, at == len(text))
            if len(self._program) in states:
                return True
            if at < len(text):
                states = {state + 1 for state in states if self._takes(state, text[at])}
        return False

    def _takes(self, state: int, sign: str) -> bool:
        accepts = self._program[state].accepts
        return accepts is not None and accepts(sign)

    def _reached(self, states: set[int], is_begin: bool, is_end: bool) -> set[int]:
        """These states and all that follow from them without a character."""
        reached, open_ = set(states), list(states)
        while open_:
            self._steps += 1
            if self._steps > MOST_STEPS:
                raise UsageError(f"the pattern {quoted(self._text)} takes too long", "write a simpler one")
            state = open_.pop()
            if state == len(self._program):
                continue
            instruction = self._program[state]
            if (instruction.place == "^" and not is_begin) or (instruction.place == "$" and not is_end):
                continue
            new = set(instruction.to) - reached
            reached |= new
            open_ += new
        return reached

    # The grammar

    def _error(self, why: str) -> UsageError:
        return UsageError(f"{quoted(self._text)} is no POSIX extended regular expression: {why}")

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

        def write() -> None:
            jumps = []
            for branch in branches[:-1]:
                fork = self._write(_Instruction())
                branch()
                jumps.append(self._write(_Instruction()))
                self._program[fork] = _Instruction(to=(fork + 1, len(self._program)))
            branches[-1]()
            for jump in jumps:
                self._program[jump] = _Instruction(to=(len(self._program),))

        return write

    def _branch(self) -> Part:
        parts: list[Part] = []
        while (sign := self._peek()) and sign not in "|)":
            if sign in "*+?{":
                raise self._error(f"nothing before {sign!r} to repeat")
            parts.append(self._repeated(self._atom()))

        def write() -> None:
            for part in parts:
                part()

        return write

    def _atom(self) -> Part:
        sign = self._next()
        if sign == "(":
            self._depth += 1
            if self._depth > _DEEPEST:
                raise self._error(f"more than {_DEEPEST} brackets in each other")
            inside = self._alternatives()
            if self._next() != ")":
                raise self._error("'(' without ')'")
            self._depth -= 1
            return inside
        if sign in "^$":
            return lambda: self._place(sign)
        if sign == "[":
            return self._one(self._bracket())
        if sign == ".":
            return self._one(lambda _: True)
        if sign == "\\" and not (sign := self._next()):
            raise self._error("it ends with '\\'")
        return self._one(sign.__eq__)

    def _bracket(self) -> Accepts:
        """What stands between `[` and `]`."""
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

    def _repeated(self, part: Part) -> Part:
        while (sign := self._peek()) and sign in "*+?{":
            self._at += 1
            least, most = {"*": (0, None), "+": (1, None), "?": (0, 1)}.get(sign) or self._counts()
            part = self._times(part, least, most)
        return part

    def _counts(self) -> tuple[int, int | None]:
        """What stands behind `{`."""
        text, end, _ = self._text[self._at :].partition("}")
        least, comma, most = text.partition(",")
        numbers = [least] if not comma else [least, most or "0"]
        if not end or not all(one.isascii() and one.isdigit() and len(one) < 4 for one in numbers):
            raise self._error("a number of times is {N}, {N,} or {N,M}")
        low, high = int(least), int(most) if most else None if comma else int(least)
        if max(low, high or 0) > _MOST_REPEATS or (high is not None and high < low):
            raise self._error(f"{{{text}}} is no number of times; {_MOST_REPEATS} is the most")
        self._at += len(text) + 1
        return low, high

    # The instructions

    def _write(self, instruction: _Instruction) -> int:
        if len(self._program) >= MOST_INSTRUCTIONS:
            raise UsageError(f"the pattern {quoted(self._text)} is too large", "write a simpler one")
        self._program.append(instruction)
        return len(self._program) - 1

    def _one(self, accepts: Accepts) -> Part:

        def write() -> None:
            self._write(_Instruction(accepts))

        return write

    def _place(self, place: str) -> None:
        self._write(_Instruction(to=(len(self._program) + 1,), place=place))

    def _times(self, part: Part, least: int, most: int | None) -> Part:
        def write() -> None:
            for _ in range(least):
                self._place("")  # what is empty counts too
                part()
            if most is None:
                fork = self._write(_Instruction())
                part()
                back = self._write(_Instruction(to=(fork,)))
                self._program[fork] = _Instruction(to=(fork + 1, back + 1))
                return
            forks = []
            for _ in range(most - least):
                forks.append(self._write(_Instruction()))
                part()
            for fork in forks:
                self._program[fork] = _Instruction(to=(fork + 1, len(self._program)))

        return write
