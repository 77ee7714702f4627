"""Angles in YAML, as rosparam reads them: `deg(90)` and `rad(pi/2)` without quotes, and the tags !degrees and !radians.

`deg` takes one number, `rad` an expression; text with brackets inside the brackets stays text.
"""

from __future__ import annotations

import math
import re
from typing import Any

DEGREES, RADIANS = "!degrees", "!radians"
PATTERNS = ((DEGREES, re.compile(r"^deg\([^()]*\)$"), ["d"]), (RADIANS, re.compile(r"^rad\([^()]*\)$"), ["r"]))
"""Tag, pattern of the form without a tag, and its first letters: the arguments of add_implicit_resolver."""

_MAY_BE = re.compile(r"!degrees|!radians|(?:deg|rad)\(")


def add_to(loader_or_dumper: Any) -> None:
    """Add the forms to a class of PyYAML. A dumper with them writes a text that looks like an angle in quotes."""
    for tag, pattern, first in PATTERNS:
        loader_or_dumper.add_implicit_resolver(tag, pattern, first)


def may_be_in(text: str) -> bool:
    """True when a text may contain an angle."""
    return _MAY_BE.search(text) is not None


def angle(text: str, tag: str) -> float:
    """The angle in rad. Raises ValueError or ArithmeticError when the text is not an angle."""
    if tag == DEGREES:
        try:
            return float(_inside(text, "deg")) * math.pi / 180.0
        except ValueError:
            raise ValueError("expected one number of degrees; rad(...) takes a sum") from None
    from slidectl.expressions import ExpressionError, evaluate, parsed

    try:
        value = evaluate(parsed(_inside(text, "rad")), {"pi": math.pi})
    except (SyntaxError, NameError, TypeError, ExpressionError):
        raise ValueError("expected an expression of numbers and pi") from None
    if type(value) not in (int, float):
        raise ValueError("expected an expression of numbers and pi")
    if not math.isfinite(value):
        raise OverflowError("the result is not finite")
    return float(value)


def _inside(text: str, word: str) -> str:
    stripped = text.strip()
    return stripped[4:-1] if stripped.startswith(f"{word}(") and stripped.endswith(")") else stripped
