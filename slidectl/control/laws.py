"""Laws, which are functions that also run compiled, and the attributes of their state.

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
"""All functions that run both interpreted and compiled. A function comes after those that it calls."""


def law(function: F) -> F:
    """Decorator: register the function as a law and return it unchanged.

    It may use numbers, attributes of its arguments, tuples, functions of `math`, and other laws. No divisions by zero.
    """
    LAWS.append(function)
    return function


PUBLISH, LEAVE = 1, 2
"""Return values of the law of a controller's update, besides 0. PUBLISH: `publish` is due. LEAVE: the law changed
nothing, and the interpreter must run this update."""


class LawTables(NamedTuple):
    """The tables that the law of a controller's update gets besides the controller's row."""

    joints: Any
    """The rows of all joints: position, velocity, effort and command, in the units of the handle."""
    pids: Any
    """The rows of all PIDs."""
    members: Any
    """The rows of the controller's members, in their order; each has the indices `joint` and `pid`."""
    numbers: Any
    """The controller's block of numbers."""


class Columns:
    """The attributes of an object that form a row of a table: floats and integers. Those that laws change come first.

    `places` are columns that exist only in the row: indices into other tables, flags, bounds.
    """

    def __init__(
        self,
        changing: str = "",
        fixed: str = "",
        places: str = "",
        whole: str = "",
    ) -> None:
        """Each argument is a list of names separated by blanks. `whole` repeats those that are integers or booleans.

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
        """A copy of these columns, followed by integer columns `places`."""
        changing, fixed, whole = self._written
        return type(self)(changing, fixed, places, f"{whole} {places}")

    def fill(self, rows: bytearray, row: int, source: object, *places: float) -> None:
        """Write a row: the attributes of `source`, then the values of `places`."""
        self._all.pack_into(rows, row * self.size, *self._values(source), *places)

    def give(self, rows: bytearray, row: int, target: object) -> None:
        """Copy the columns that laws change from the row to the attributes of `target`."""
        values = self._changing.unpack_from(rows, row * self.size)
        for (owner, name), value in zip(self._targets, values, strict=True):
            setattr(attrgetter(owner)(target) if owner else target, name, value)


def _getter(names: Sequence[str]) -> Callable[[object], tuple[Any, ...]]:
    if len(names) == 1:
        return lambda source: (getattr(source, names[0]),)
    return attrgetter(*names) if names else lambda _: ()
