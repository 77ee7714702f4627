"""The names of the math module, and `round`, for expressions: what grows faster than its arguments is kept small.

Knows numbers and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from slidectl.operators.sizes import MOST_BITS, TooLargeError, check_bits

_MOST_DIGITS = 300
_LARGEST_FACTORIAL = 500
"""Its factorial has 3768 bits."""


def power(base: Any, exponent: Any) -> Any:
    """`base ** exponent`. Raises OverflowError instead of making a number that takes long."""
    if isinstance(base, int) and isinstance(exponent, int) and base.bit_length() * exponent > MOST_BITS:
        raise OverflowError(f"{base} ** {exponent} is too large")
    return base**exponent


def rounded(number: Any, ndigits: int | None = None) -> Any:
    """`round`. Raises TooLargeError for digits that no number has: of a whole number, Python makes 10**digits."""
    if ndigits is not None and abs(ndigits) > _MOST_DIGITS:
        raise TooLargeError("it rounds to too many digits")
    return round(number, ndigits)


def factorial(number: int) -> int:
    """`math.factorial`. Raises TooLargeError."""
    _check_factors(number, _LARGEST_FACTORIAL, MOST_BITS)
    return math.factorial(number)


def comb(number: int, taken: int) -> int:
    """`math.comb`, which is less than 2**number. Raises TooLargeError."""
    _check_factors(number, MOST_BITS, taken)
    return math.comb(number, taken)


def perm(number: int, taken: int | None = None) -> int:
    """`math.perm`. Raises TooLargeError."""
    _check_factors(number, _LARGEST_FACTORIAL, MOST_BITS if taken is None else taken)
    return math.perm(number, taken)


def _check_factors(number: int, harmless: int, factors: int) -> None:
    """Raises TooLargeError for a product of so many factors up to `number`, unless that is `harmless` or less."""
    if isinstance(number, int) and number > harmless and number.bit_length() * factors > MOST_BITS:
        raise TooLargeError(f"too many factors up to {number}")


def prod(values: Iterable[Any], start: Any = 1) -> Any:
    """`math.prod` of numbers. Raises TooLargeError; TypeError when something is no number."""
    for value in values:
        if not isinstance(value, int | float):
            raise TypeError("prod() here multiplies numbers only")
        start = start * value
        if isinstance(start, int):
            check_bits(start.bit_length())
    return start


def lcm(*numbers: int) -> int:
    """`math.lcm`. Raises TooLargeError."""
    result = 1
    for number in numbers:
        result = math.lcm(result, number)
        check_bits(result.bit_length())
    return result


MATH: dict[str, Any] = {name: value for name, value in vars(math).items() if not name.startswith("_")}
"""The names of the math module."""
MATH.update(factorial=factorial, comb=comb, perm=perm, prod=prod, lcm=lcm)
MATH.pop("sumprod", None)  # of Python 3.12; it multiplies texts, too
