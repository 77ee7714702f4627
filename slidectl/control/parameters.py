"""What a controller says of its parameters: name, type, meaning, unit, default; and changes judged by that.

Whoever looks at a file before anything runs reads the declarations. While the controller is loaded its guard reads
them. The reading itself is params.py; a test holds the two against each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from slidectl import names
from slidectl.control.node import MISSING, NodeHandle, ParameterChange
from slidectl.control.params import BOOLEAN, INTEGER, NUMBER, NUMBERS, TEXT, TEXTS, Kind, described
from slidectl.errors import Refused, UnknownName, listing

__all__ = [
    "BOOLEAN",
    "FLOAT",
    "INTEGER",
    "LIST",
    "NUMBER",
    "NUMBERS",
    "TEXT",
    "TEXTS",
    "Guard",
    "Parameter",
    "check_values",
    "within",
]

LIST = Kind("a list", lambda value: value if isinstance(value, list) else None)
FLOAT = Kind("a float, as 0.0", lambda value: value if isinstance(value, float) else None)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a controller."""

    name: str
    """Below the controller's name: `pid/p`; `extra_joints[]/name` in each entry of a list; in `gains/<joint>/p` any
    name may stand for `<joint>`."""
    kind: Kind[Any]
    meaning: str
    unit: str = ""
    default: Any = None
    """What counts when it is not set; None: nothing does, or it is required."""
    required: bool = False
    names_joints: bool = False
    """Its value is the name of a joint of the robot, or a list of such."""
    live: bool = False
    """A loaded controller follows it; else it counts when the controller is loaded again."""
    unless_positive: str = ""
    """What becomes of a number that is not above 0; empty: such a number is like any other."""


def within(prefix: str, parameters: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """The same parameters below a name."""
    return tuple(replace(parameter, name=f"{prefix}/{parameter.name}") for parameter in parameters)


def check_values(node: NodeHandle, declared: Iterable[Parameter], change: ParameterChange) -> list[Parameter]:
    """The declared parameters in the namespace of `node` that a change sets to another value.

    Raises:
        Refused: one of them would be a value of another type, or a namespace; then the reader has no use for it.
    """
    if change.deletes or change.after is MISSING:
        return []
    if not isinstance(change.after, dict):
        raise _no_namespace(node.namespace, change.after)
    changed = dict(_changed(change))
    found = []
    for parameter in declared:
        place = parameter.name.split("/")
        for name, value in changed.items():
            path = name.split("/")
            if _fits(path, place[: len(path)]) and len(path) < len(place) and not isinstance(value, dict):
                if not place[len(path) - 1].endswith("[]"):
                    raise _no_namespace(names.join(node.namespace, name), value)
            elif _fits(path[: len(place)], place):
                full = names.join(node.namespace, "/".join(path[: len(place)]))
                value = value if len(path) == len(place) else {}
                if parameter.kind.convert(value) is None:
                    raise Refused(f"parameter {full} must be {parameter.kind.words}, not {described(value)}")
                found.append(parameter)
    return found


def _no_namespace(full: str, value: Any) -> Refused:
    return Refused(
        f"{full} is a namespace of parameters that a loaded controller reads; it cannot be {described(value)}"
    )


def _fits(path: list[str], place: list[str]) -> bool:
    """True for the names of a declared place; `<joint>` in it stands for any name."""
    return len(path) == len(place) and all(
        one == other.removesuffix("[]") or other.startswith("<") for one, other in zip(path, place, strict=True)
    )


def _changed(change: ParameterChange) -> Iterator[tuple[str, Any]]:
    """Name below the namespace, and value, of every parameter that the change sets to something else."""
    before = dict(_leaves(change.before))
    for name, value in _leaves(change.after):
        if name not in before or type(before[name]) is not type(value) or before[name] != value:
            yield name, value


def _leaves(tree: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items() if isinstance(tree, dict) else ():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{above}{key}/")
        else:
            yield f"{above}{key}", value


class Guard:
    """Judges changes of the parameters of one loaded controller: names that it does not read, values of a wrong type.

    Args:
        node: the controller's own node handle.
        declared: what it reads; when that is nothing, nobody knows which names are wrong.
    """

    def __init__(self, node: NodeHandle, declared: Iterable[Parameter]) -> None:
        self._node = node
        self._declared = (TYPE, *declared)

    def judge(self, change: ParameterChange) -> None:
        """A control.node.ParameterJudge."""
        late = [parameter for parameter in check_values(self._node, self._declared, change) if not parameter.live]
        if change.deletes or change.after is MISSING:
            return
        self._check_names(change)
        for parameter in late:
            where = names.join(self._node.namespace, parameter.name)
            self._node.log("warn", f"{where} counts when the controller is loaded again; until then the old value does")

    def _check_names(self, change: ParameterChange) -> None:
        known = dict(_leaves(change.before))
        readable = [parameter.name for parameter in self._declared]
        for name, _ in _changed(change):
            if name in known or any(self._reads(name, place) for place in readable):
                continue
            full = names.join(self._node.namespace, name)
            if change.known_only:
                every = {*known, *(place for place in readable if "[" not in place and "<" not in place)}
                error = UnknownName("parameter", full, [names.join(self._node.namespace, each) for each in every])
                reads = f"{self._node.namespace} is a loaded controller; it reads: {listing(every)}"
                error.hint = f"{reads}\n--new sets it all the same"
                raise error
            if len(readable) > 1:
                self._node.log("warn", f"parameter {full} has no effect: the controller does not read it")

    def _reads(self, name: str, place: str) -> bool:
        path, parts = name.split("/"), place.split("/")
        return _fits(path, parts[: len(path)])


TYPE = Parameter("type", TEXT, "the controller's type", required=True)
"""What the manager reads of every controller."""
JOINT = Parameter("joint", TEXT, "the joint that it drives", required=True, names_joints=True)
