"""How large a number, a text or a list of an expression may be, so that each step of one comes to an end soon.

Python computes `9**9**9` or `'a' * 10**10` in one step that listens to nobody: what would be larger is never begun.
"""

from __future__ import annotations

import re

MOST_BITS = 4096
"""Of a whole number."""
MOST_LENGTH = 100_000
"""Letters of a text, items of a list."""
_WIDE = re.compile(r"\d{4}")


class TooLargeError(ValueError):
    """What would be made is too large."""


def check_bits(bits: int) -> None:
    """Raises TooLargeError when a whole number would have more than MOST_BITS."""
    if bits > MOST_BITS:
        raise TooLargeError("a number is too large")


def check_length(count: int) -> None:
    """Raises TooLargeError when a text or list would be longer than MOST_LENGTH."""
    if count > MOST_LENGTH:
        raise TooLargeError("a text or list is too long")


def check_widths(spec: str, star: bool = False) -> None:
    """Raises TooLargeError when a format asks for a width that fits on no line; with `star`, by `*` for any width."""
    if _WIDE.search(spec) or (star and "*" in spec):
        raise TooLargeError("the width of something formatted is too large")
