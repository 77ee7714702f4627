"""What `$(eval ...)` of launch files may compute, and what is said when it cannot.

The walk over the expression is that of slidectl/expressions.py, which all languages of expressions here share.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slidectl.expressions import FUNCTIONS, MATH, ExpressionError, compute

__all__ = ["ExpressionError", "evaluate"]

LONGEST = 4000
_NAMES = {**MATH, **FUNCTIONS, "true": True, "false": False}


def evaluate(text: str, names: Mapping[str, Any]) -> Any:
    """The value of an expression. It may use `names`, the math module's names, and Python's own functions.

    Raises:
        ExpressionError: with the reason, without the place.
    """
    if "__" in text:
        raise ExpressionError("may not contain double underscores")
    if len(text) > LONGEST:
        raise ExpressionError(f"is longer than {LONGEST} characters")
    try:
        return compute(text, {**_NAMES, **names})
    except ExpressionError:
        raise
    except SyntaxError as error:
        raise ExpressionError(f"is not valid: {error.msg}") from None
    except NameError as error:
        raise ExpressionError(f"there is no name {error.name!r}; {_known(names)}") from None
    except (ArithmeticError, ValueError, TypeError, LookupError, RecursionError) as error:
        raise ExpressionError(f"cannot be computed: {_reason(error)}") from None


def _known(names: Mapping[str, Any]) -> str:
    return f"there are {', '.join(sorted(names))}, and the names of the math module"


def _reason(error: Exception) -> str:
    return f"no key {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
