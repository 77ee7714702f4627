"""What the compiled cycle needs to know of control: which functions are laws, and which attributes are their state.

A law is a plain function of numbers and of objects with plain attributes. The interpreter calls it with controllers,
PIDs and handles; the compiler with rows of tables that have columns of the same names. Nothing is compiled here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from struct import Struct
from typing import Any, NamedTuple, Self, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

LAWS: list[Callable[..., Any]] = []
"""All functions that run in the interpreter and compiled, those that others call first."""


def law(function: F) -> F:
    """Decorator: the function is a law. It is returned as it is.

    It may use numbers, attributes of its arguments, tuples, functions of `math`, and other laws; no divisions by zero.
    """
    LAWS.append(function)
    return function


PUBLISH, LEAVE = 1, 2
"""What the law of a controller's update may return besides 0: `publish` is due; or nothing was changed, and the
interpreter is to make this update."""


class LawTables(NamedTuple):
    """What the law of a controller's update finds beside the controller's own row."""

    joints: Any
    """The rows of all joints: position, velocity, effort and command of each, as a handle has them."""
    pids: Any
    """The rows of all PIDs."""
    members: Any
    """The rows of the controller's members, in their order; each tells its `joint` and `pid`."""
    numbers: Any
    """The controller's block of numbers."""


class Columns:
    """Attributes of an object that make a row: floats and whole numbers, those that laws change first.

    `places` are columns that only a row has: indices into other tables, flags, bounds.
    """

    def __init__(
        self,
        changing: str = "",
        fixed: str = "",
        places: str = "",
        whole: str = "",
    ) -> None:
        """Names parted by blanks; `whole` are those of the others that are whole numbers or truth values.

        `part.name` is an attribute of an attribute; its column is called `name`.
        """
        self._written = changing, fixed, whole
        self.changing = tuple(changing.split())
        self.attributes = (*self.changing, *fixed.split())
        paths = (*self.attributes, *places.split())
        self.names = tuple(path.rpartition(".")[2] for path in paths)
        self.kinds = "".join("q" if path in whole.split() else "d" for path in paths)
        self.size = 8 * len(self.names)
        self._all = Struct("=" + self.kinds)
        self._changing = Struct("=" + self.kinds[: len(self.changing)])
        self._values = _getter(self.attributes)
        self._targets = [path.rpartition(".")[::2] for path in self.changing]

    def with_places(self, places: str) -> Self:
        """The same columns, and places behind them that are whole numbers."""
        changing, fixed, whole = self._written
        return type(self)(changing, fixed, places, f"{whole} {places}")

    def fill(self, rows: bytearray, row: int, source: object, *places: float) -> None:
        """Write the whole row: the attributes of `source`, then the places."""
        self._all.pack_into(rows, row * self.size, *self._values(source), *places)

    def give(self, rows: bytearray, row: int, target: object) -> None:
        """Set the attributes of `target` that laws change to what the row holds."""
        values = self._changing.unpack_from(rows, row * self.size)
        for (owner, name), value in zip(self._targets, values, strict=True):
            setattr(attrgetter(owner)(target) if owner else target, name, value)


def _getter(names: Sequence[str]) -> Callable[[object], tuple[Any, ...]]:
    if len(names) == 1:
        return lambda source: (getattr(source, names[0]),)
    return attrgetter(*names) if names else lambda _: ()
