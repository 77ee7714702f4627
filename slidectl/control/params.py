"""Parameters of controllers: types, readers, declarations, and the check of changes against the declarations.

Readers follow roscpp: a value of the wrong type counts as not set. Unlike roscpp, they log a warning for such a value.
Checks of a file before a run use the declarations; a test compares these with the parameters that are read. Nothing
here sets a parameter.
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
    """A required parameter is not set, or has another type."""

    def __init__(self, node: NodeHandle, name: str, wanted: str) -> None:
        where = names.join(node.namespace, name)
        value = node.get_param(name, None)
        if value is None:
            super().__init__(f"parameter {where} is not set; it must be {wanted}", f"slidectl param set {where} VALUE")
        else:
            super().__init__(f"parameter {where} must be {wanted}, not {described(value)}")


def as_number(value: Any) -> float | None:
    """An int or a float as a float; None for other types, also for a boolean or a string."""
    try:
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
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
    """A YAML boolean; None for other values, also for 1, 0 and "true"."""
    return value if isinstance(value, bool) else None


def as_texts(value: Any) -> list[str] | None:
    """A list of strings; None for other values."""
    return list(value) if isinstance(value, list) and all(isinstance(item, str) for item in value) else None


def as_numbers(value: Any) -> list[float] | None:
    """A list of numbers, in which booleans count as 0 and 1; None for other values."""
    if not isinstance(value, list):
        return None
    numbers = [as_number(int(item) if isinstance(item, bool) else item) for item in value]
    return None if None in numbers else [number for number in numbers if number is not None]


class Kind(NamedTuple, Generic[T]):
    """A type of parameters: its name in messages, and a converter that returns None for a value of another type."""

    words: str
    convert: Callable[[Any], T | None]


NUMBER = Kind("a number", as_number)
INTEGER = Kind("an integer", as_integer)
BOOLEAN = Kind("true or false", as_boolean)
TEXT = Kind("a string", lambda value: value if isinstance(value, str) else None)
TEXTS = Kind("a list of strings", as_texts)
NUMBERS = Kind("a list of numbers", as_numbers)
LIST = Kind("a list", lambda value: value if isinstance(value, list) else None)
FLOAT = Kind("a float, such as 0.0", lambda value: value if isinstance(value, float) else None)


def read(node: NodeHandle, name: str, kind: Kind[T]) -> T | None:
    """The parameter as that kind. None when it is not set or of another type, which logs a warning."""
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
    """The value with its type, for messages. For a number that YAML reads as text, the reason is added."""
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
    """The name below the controller's, such as `pid/p`. `extra_joints[]/name` is in each entry of a list; `<joint>` in
    `gains/<joint>/p` stands for any name."""
    kind: Kind[Any]
    meaning: str
    unit: str = ""
    default: Any = None
    """The value used when it is not set; None: no default, or required."""
    required: bool = False
    names_joints: bool = False
    """True: the value is the name of a joint of the robot, or a list of such names."""
    live: bool = False
    """True: a loaded controller follows changes. False: a change takes effect when the controller is loaded again."""
    fixed: bool = False
    """True: a change is refused while the controller is loaded. Never with `live`."""
    unless_positive: str = ""
    """The effect of a number that is not above 0; empty: no special effect."""


def value_of(node: NodeHandle, parameter: Parameter) -> Any:
    """The value of the parameter, or its default. Raises BadParameter when it is required and not set."""
    if parameter.required:
        return needed(node, parameter.name, parameter.kind)
    found = read(node, parameter.name, parameter.kind)
    return parameter.default if found is None else found


def within(prefix: str, parameters: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """The parameters with `prefix/` before their names."""
    return tuple(replace(parameter, name=f"{prefix}/{parameter.name}") for parameter in parameters)


def check_values(node: NodeHandle, declared: Iterable[Parameter], change: ParameterChange) -> list[Parameter]:
    """The declared parameters in the namespace of `node` that a change sets to another value.

    Raises:
        Refused: the change gives one of them a value of another type, or makes it a namespace.
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
    """True when the path has the names of the declared place, in which `<joint>` stands for any name."""
    return len(path) == len(place) and all(
        one == other.removesuffix("[]") or other.startswith("<") for one, other in zip(path, place, strict=True)
    )


def _changed(change: ParameterChange) -> Iterator[tuple[str, Any]]:
    """Name below the namespace and new value of every parameter that the change gives another value."""
    before = dict(leaves(change.before))
    for name, value in leaves(change.after):
        if name not in before or type(before[name]) is not type(value) or before[name] != value:
            yield name, value


def judge(node: NodeHandle, own: tuple[Parameter, ...], change: ParameterChange) -> None:
    """Check a change of the parameters of a loaded controller for unknown names and values of a wrong type.

    Args:
        node: the controller's own node handle.
        own: the controller's declared parameters. When empty, unknown names cause no warning.

    Raises:
        Refused: a value of a wrong type, or of a parameter that is fixed. UnknownName: an unknown name, with
            `change.known_only`.
    """
    declared = (TYPE, UPDATE_BUDGET, *own)
    late = [parameter for parameter in check_values(node, declared, change) if not parameter.live]
    for parameter in late:
        if parameter.fixed:
            name = node.namespace.rpartition("/")[2]
            hint = f"unload it first: slidectl controller unload {name}"
            raise Refused(f"{names.join(node.namespace, parameter.name)} is fixed when the controller is loaded", hint)
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
        node.log("warn", f"{where} takes effect when the controller is loaded again")


TYPE = Parameter("type", TEXT, "the controller's type", required=True)
UPDATE_BUDGET = Parameter(
    "update_budget",
    NUMBER,
    "wall time that an update may take without a warning; 0: no limit",
    "s",
    default=0.0,
    live=True,
    unless_positive="updates may take any time",
)
"""The parameter that the manager reads for every controller."""
JOINT = Parameter("joint", TEXT, "the joint that it drives", required=True, names_joints=True)
JOINTS = Parameter("joints", TEXTS, "the joints that it drives, in this order", required=True, names_joints=True)
