"""Parameters of controllers: their types, the reading of them, what a controller declares, and changes judged by that.

They are read by the rules of roscpp: a value of the wrong type counts as not set. Unlike roscpp this says so: a value
that is passed over is a warning on the log. Who looks at a file before anything runs reads the declarations; a test
holds them against what is read. Nothing here sets a parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from math import ceil, floor, isfinite
from typing import Any, Generic, NamedTuple, TypeVar

from slidectl import names
from slidectl.control.node_handle import MISSING, NodeHandle, ParameterChange
from slidectl.description.parameter_trees import leaves
from slidectl.errors import Refused, UnknownName, listing

T = TypeVar("T")


class BadParameter(Refused):
    """A parameter that is needed is not set, or is of another type."""

    def __init__(self, node: NodeHandle, name: str, wanted: str) -> None:
        where = names.join(node.namespace, name)
        value = node.get_param(name, None)
        if value is None:
            super().__init__(f"parameter {where} is not set; it must be {wanted}", f"slidectl param set {where} VALUE")
        else:
            super().__init__(f"parameter {where} must be {wanted}, not {described(value)}")


def as_number(value: Any) -> float | None:
    """An int or a float as a float. A YAML boolean or a string is no number."""
    return None if isinstance(value, bool) else _as_float(value)


def _as_float(value: Any) -> float | None:
    try:
        return float(value) if isinstance(value, int | float) else None
    except OverflowError:  # an int of hundreds of digits
        return None


def as_integer(value: Any) -> int | None:
    """An int, or a float rounded half up."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if isinstance(value, int):
        return value
    if not isfinite(value):
        return None
    return floor(value) if value - floor(value) < 0.5 else ceil(value)


def as_boolean(value: Any) -> bool | None:
    """Only a true YAML boolean: 1, 0 and "true" are none."""
    return value if isinstance(value, bool) else None


def as_texts(value: Any) -> list[str] | None:
    """A list of nothing but strings."""
    return list(value) if isinstance(value, list) and all(isinstance(item, str) for item in value) else None


def as_numbers(value: Any) -> list[float] | None:
    """A list of numbers; booleans count as 0 and 1 here."""
    if not isinstance(value, list):
        return None
    numbers = [_as_float(item) for item in value]
    return None if None in numbers else [number for number in numbers if number is not None]


class Kind(NamedTuple, Generic[T]):
    """A type of parameters: how messages name it, and what makes a value of it (None when it is none)."""

    words: str
    convert: Callable[[Any], T | None]


NUMBER = Kind("a number", as_number)
INTEGER = Kind("an integer", as_integer)
BOOLEAN = Kind("true or false", as_boolean)
TEXT = Kind("a string", lambda value: value if isinstance(value, str) else None)
TEXTS = Kind("a list of strings", as_texts)
NUMBERS = Kind("a list of numbers", as_numbers)
LIST = Kind("a list", lambda value: value if isinstance(value, list) else None)
FLOAT = Kind("a float, as 0.0", lambda value: value if isinstance(value, float) else None)


def number(node: NodeHandle, name: str) -> float | None:
    """The parameter as a number, None when it is not one."""
    return read(node, name, NUMBER)


def integer(node: NodeHandle, name: str) -> int | None:
    """The parameter as an integer, None when it is not one."""
    return read(node, name, INTEGER)


def boolean(node: NodeHandle, name: str) -> bool | None:
    """The parameter as a boolean, None when it is not one."""
    return read(node, name, BOOLEAN)


def text(node: NodeHandle, name: str) -> str | None:
    """The parameter as a string, None when it is not one."""
    return read(node, name, TEXT)


def texts(node: NodeHandle, name: str) -> list[str] | None:
    """The parameter as a list of strings, None when it is not one."""
    return read(node, name, TEXTS)


def numbers(node: NodeHandle, name: str) -> list[float] | None:
    """The parameter as a list of numbers, None when it is not one."""
    return read(node, name, NUMBERS)


def needed_number(node: NodeHandle, name: str) -> float:
    """The parameter as a number. Raises BadParameter when it is not one."""
    return needed(node, name, NUMBER)


def needed_text(node: NodeHandle, name: str) -> str:
    """The parameter as a string. Raises BadParameter when it is not one."""
    return needed(node, name, TEXT)


def needed_texts(node: NodeHandle, name: str) -> list[str]:
    """The parameter as a list of strings. Raises BadParameter when it is not one."""
    return needed(node, name, TEXTS)


def read(node: NodeHandle, name: str, kind: Kind[T]) -> T | None:
    """The parameter as that kind, None when it is not one; a value that is passed over is a warning."""
    value = node.get_param(name, None)
    if value is None:
        return None
    converted = kind.convert(value)
    if converted is None:
        where = names.join(node.namespace, name)
        node.log("warn", f"parameter {where} has no effect: it must be {kind.words}, not {described(value)}")
    return converted


def needed(node: NodeHandle, name: str, kind: Kind[T]) -> T:
    """The parameter as that kind. Raises BadParameter when it is not one."""
    converted = kind.convert(node.get_param(name, None))
    if converted is None:
        raise BadParameter(node, name, kind.words)
    return converted


def described(value: Any) -> str:
    """The value with its type; a number that YAML took for text gets the reason."""
    if not isinstance(value, str):
        return f"{value!r}"
    try:
        number = float(value)
    except ValueError:
        return f"the string {value!r}"
    if not isfinite(number):
        return f"the string {value!r} (a number must be finite)"
    if "e" in value.lower():
        return f"the string {value!r} (YAML reads a number with an exponent only with a dot in it, as 1.0e-3)"
    return f"the string {value!r} (a number has no quotes)"


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


def value_of(node: NodeHandle, parameter: Parameter) -> Any:
    """The declared parameter, its default when it is not set. Raises BadParameter: it is required and not set."""
    if parameter.required:
        return needed(node, parameter.name, parameter.kind)
    found = read(node, parameter.name, parameter.kind)
    return parameter.default if found is None else found


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
    before = dict(leaves(change.before))
    for name, value in leaves(change.after):
        if name not in before or type(before[name]) is not type(value) or before[name] != value:
            yield name, value


def judge(node: NodeHandle, own: tuple[Parameter, ...], change: ParameterChange) -> None:
    """Judge a change of the parameters of a loaded controller: names that it does not read, values of a wrong type.

    Args:
        node: the controller's own node handle.
        own: what it reads; when that is nothing, nobody knows which names are wrong.

    Raises:
        Refused.
    """
    declared = (TYPE, UPDATE_BUDGET, *own)
    late = [parameter for parameter in check_values(node, declared, change) if not parameter.live]
    if change.deletes or change.after is MISSING:
        return
    known = dict(leaves(change.before))
    readable = [parameter.name for parameter in declared]
    for name, _ in _changed(change):
        path = name.split("/")
        if name in known or any(_fits(path, place.split("/")[: len(path)]) for place in readable):
            continue
        full = names.join(node.namespace, name)
        if change.known_only:
            every = {*known, *(place for place in readable if "[" not in place and "<" not in place)}
            error = UnknownName("parameter", full, [names.join(node.namespace, each) for each in every])
            reads = f"{node.namespace} is a loaded controller; it reads: {listing(every)}"
            error.hint = f"{reads}\n--new sets it all the same"
            raise error
        if own:
            node.log("warn", f"parameter {full} has no effect: the controller does not read it")
    for parameter in late:
        where = names.join(node.namespace, parameter.name)
        node.log("warn", f"{where} counts when the controller is loaded again; until then the old value does")


TYPE = Parameter("type", TEXT, "the controller's type", required=True)
UPDATE_BUDGET = Parameter(
    "update_budget",
    NUMBER,
    "wall time that an update may take without a warning; 0: any",
    "s",
    default=0.0,
    live=True,
    unless_positive="updates may take any time",
)
"""What the manager reads of every controller."""
JOINT = Parameter("joint", TEXT, "the joint that it drives", required=True, names_joints=True)
JOINTS = Parameter("joints", TEXTS, "the joints that it drives, in this order", required=True, names_joints=True)
