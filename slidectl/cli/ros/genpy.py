"""Messages and requests from the values of a command line, with the errors that genpy and rospy word.

The filling itself is `msgs.fill`'s; what is said here is why values do not fit. Field names are paths as there:
`pose.position.x`, `position[]`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from slidectl.cli.topics import Schema, from_typedefs
from slidectl.errors import BadMessage
from slidectl.msgs.schema import FLOATS, INTEGER_RANGES, TIMES, Field

if TYPE_CHECKING:
    from slidectl.cli.context import Context

Typedefs = Sequence[Mapping[str, Any]]
Message = dict[str, Any]

_KEYWORDS = ("now", "auto")


class Misfit(Exception):
    """Values whose number, names or nesting do not fit the type."""


class WrongType(Exception):
    """A value of the wrong kind, or out of its range."""


def filled(ctx: Context, typedefs: Typedefs, values: Sequence[Any]) -> Message:
    """The message that the values mean; fields that are not named are left out.

    Raises:
        Misfit, WrongType: with genpy's words. BadMessage: what genpy would take and a message cannot hold.
    """
    from slidectl.msgs.fill import fields_from, fill

    values = [_without_nulls(value) for value in values]
    if None in leaves(values):  # an empty argument is null there, and null fits nothing
        _explain(from_typedefs(typedefs), values)
    try:
        return fill(fields_from(typedefs), str(typedefs[0]["type"]), values, _now(ctx, values))
    except BadMessage:
        _explain(from_typedefs(typedefs), values)
        raise


def _now(ctx: Context, values: Sequence[Any]) -> tuple[int, int] | None:
    """The simulated time, when a value may stand for it."""
    if not any(leaf in _KEYWORDS for leaf in leaves(values)):
        return None
    time = ctx.call("/rosapi/get_time")["time"]
    return time["secs"], time["nsecs"]


def _without_nulls(value: Any) -> Any:
    """The value with empty text for each name that has nothing behind it: `{frame_id: }`."""
    if isinstance(value, Mapping):
        return {name: "" if each is None else _without_nulls(each) for name, each in value.items()}
    return [_without_nulls(each) for each in value] if isinstance(value, list | tuple) else value


def leaves(value: Any) -> Iterator[Any]:
    """The scalars in nested lists and mappings."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if not isinstance(value, list | tuple):
        yield value
        return
    for each in value:
        yield from leaves(each)


def paths(typedefs: Typedefs) -> str:
    """All fields, nested ones as `header.seq`, with blanks between: what `Args are: [...]` shows."""
    from slidectl.msgs.fill import field_paths, fields_from

    return " ".join(field_paths(fields_from(typedefs), str(typedefs[0]["type"])))


def complete(schema: Schema, type_name: str, given: Mapping[str, Any]) -> Message:
    """The message with the fields that were not given at their defaults."""
    return {field.name: _completed(schema, field, given.get(field.name)) for field in schema.fields(type_name)}


def _completed(schema: Schema, field: Field, given: Any) -> Any:
    if field.array >= 0:
        if given is None:
            return [_zero(schema, field.type) for _ in range(field.array)]
        return [complete(schema, field.type, each) for each in given] if schema.fields(field.type) else given
    if schema.fields(field.type):
        return complete(schema, field.type, given or {})
    return _zero(schema, field.type) if given is None else given


def _zero(schema: Schema, type_name: str) -> Any:
    if type_name in TIMES:
        return {"secs": 0, "nsecs": 0}
    if type_name in FLOATS or type_name in INTEGER_RANGES:
        return 0.0 if type_name in FLOATS else 0
    if type_name == "bool":
        return False
    return "" if type_name == "string" else complete(schema, type_name, {})


# --- why values do not fit --------------------------------------------------------------------------------------------


def _explain(schema: Schema, values: Sequence[Any]) -> None:
    """Raise Misfit or WrongType with what genpy would say; return when it would take the values."""
    root: Any = values[0] if len(values) == 1 and isinstance(values[0], Mapping) else list(values)
    _check_shape(schema, schema.root, root, "")
    _check_types(schema, schema.root, root, "")


def _check_shape(schema: Schema, type_name: str, given: Any, prefix: str) -> None:
    for field, value in _paired(schema, type_name, given, prefix):
        name = prefix + field.name
        if field.array >= 0 and not isinstance(value, list | tuple):
            raise Misfit(f"Field [{name}] must be a list or tuple instead of: {type(value).__name__}")
        if field.array > 0 and len(value) != field.array:
            raise Misfit(f"Field [{name}] has incorrect number of elements: {len(value)} != {field.array}")
        if field.type in TIMES or schema.fields(field.type):
            for each in value if field.array >= 0 else [value]:
                _check_nested(schema, field, each, name)


def _check_nested(schema: Schema, field: Field, value: Any, name: str) -> None:
    if isinstance(value, str):
        keyword = "auto" if field.type == "std_msgs/Header" else "now" if field.type == "time" else None
        if value != keyword:
            raise Misfit(f"No key named [{value}]")
    elif isinstance(value, int) and not isinstance(value, bool) and field.type in TIMES:
        return
    else:
        _check_shape(schema, field.type, value, f"{name}.")


def _paired(schema: Schema, type_name: str, given: Any, prefix: str) -> Iterator[tuple[Field, Any]]:
    """Each field that a value was given for, with the value."""
    fields = [Field(n, "int32", -1) for n in ("secs", "nsecs")] if type_name in TIMES else schema.fields(type_name)
    names = [field.name for field in fields]
    if isinstance(given, Mapping):
        for name, value in given.items():
            if name not in names:
                raise Misfit(f"No field name [{prefix}{name}]")
            yield fields[names.index(name)], value
    elif isinstance(given, list | tuple):
        if len(given) != len(names):
            trouble = "Too many" if len(given) > len(names) else "Not enough"
            raise Misfit(f"{trouble} arguments:\n * Given: {list(given)}\n * Expected: {names}")
        yield from zip(fields, given, strict=True)
    else:
        raise Misfit(f"invalid msg_args type: {given}")


def _check_types(schema: Schema, type_name: str, given: Any, prefix: str) -> None:
    for field, value in _paired(schema, type_name, given, prefix):
        name = prefix + field.name + ("[]" if field.array >= 0 else "")
        for each in value if field.array >= 0 else [value]:
            if schema.fields(field.type) and not isinstance(each, str):
                _check_types(schema, field.type, each, f"{name}.")
            elif (trouble := _trouble(field.type, each)) is not None:
                raise WrongType(f"field {name} {trouble}")


def _trouble(type_name: str, value: Any) -> str | None:
    """What is wrong with the value of a primitive."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    if type_name in FLOATS:
        return None if whole or isinstance(value, float) else "must be float type"
    if type_name in INTEGER_RANGES:
        return _integer_trouble(type_name, value if whole else None)
    if type_name == "bool":
        return None if isinstance(value, bool) or value in (0, 1) else "is not a bool"
    if type_name == "string":
        return None if isinstance(value, str) else "must be of type bytes or an ascii string"
    return None


def _integer_trouble(type_name: str, value: int | None) -> str | None:
    unsigned = type_name.startswith("uint") or type_name == "char"
    if value is None or (unsigned and value < 0):
        return "must be unsigned integer type" if unsigned else "must be an integer type"
    bits = int(type_name.lstrip("uint") or 8) if "int" in type_name else 8
    limit = 2**bits if unsigned else 2 ** (bits - 1)
    return None if -limit <= value < limit else f"exceeds specified width [{type_name}]"
