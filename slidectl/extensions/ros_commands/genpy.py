"""Messages and requests from the YAML of a command line, a file or stdin, with the error texts of genpy and PyYAML.

slidectl.typed_values reads the values, msgs.fill fills them in. After an error, PyYAML reads the text again for its
report, and this module walks the types to find genpy's error. Field names are genpy's paths: `pose.position.x`,
`position[]`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from io import StringIO
from itertools import chain
from typing import TYPE_CHECKING, Any, TextIO

from slidectl import typed_values
from slidectl.errors import BadMessage, SlidectlError
from slidectl.msgs.schema import FLOATS, INTEGER_RANGES, TIMES, Field, Schema, Typedefs, from_typedefs
from slidectl.typed_values import bounded

if TYPE_CHECKING:
    from slidectl.cli.context import Context

Message = dict[str, Any]


class NotYaml(Exception):
    """Text that is not YAML, or has values that no message can hold."""


class WrongStructure(Exception):
    """Values whose number, names or nesting do not fit the type."""


class WrongType(Exception):
    """A value of the wrong kind, or out of its range."""


# --- reading ----------------------------------------------------------------------------------------------------------


def read(text: str) -> Any:
    """The value of one document. Raises NotYaml."""
    try:
        return typed_values.read(text)
    except SlidectlError as error:
        raise _report(text.rstrip("\n"), error) from None


def read_file(text: str, name: str) -> list[Any]:
    """The values of all documents of a file of that name. Raises NotYaml."""
    try:
        return list(typed_values.read_documents(text, "file"))
    except SlidectlError as error:
        file = StringIO(text)
        file.name = name  # PyYAML tells it
        raise _report(file, error) from None


def documents(file: TextIO) -> Iterator[Sequence[Any]]:
    """Yield the values of each document as soon as its `---` comes; the last needs none. Raises NotYaml, BadFile.

    A document that is a list has one value for each field.
    """
    pending: list[str] = []
    for line in chain(bounded(file, "stdin"), ["---"]):
        if line.rstrip() != "---":
            pending.append(line)
            continue
        if any(each.strip() for each in pending):
            document = read("".join(pending))
            yield document if isinstance(document, list) else [document]
        pending = []


def _report(source: str | TextIO, error: SlidectlError) -> NotYaml:
    """PyYAML's error for the text, or for the file, which it names; `error` when PyYAML accepts the text."""
    import yaml

    try:
        list(yaml.safe_load_all(source))
    except (yaml.YAMLError, ValueError, RecursionError) as problem:
        return NotYaml(str(problem))
    return NotYaml(str(error))


# --- filling ----------------------------------------------------------------------------------------------------------


def filled(ctx: Context, typedefs: Typedefs, values: Sequence[Any]) -> Message:
    """The message with these values; fields that are not named are left out.

    Raises:
        WrongStructure, WrongType: with genpy's text. BadMessage: values that genpy accepts and a message cannot hold.
    """
    from slidectl.msgs.fill import fill, mentions_clock

    schema = from_typedefs(typedefs)
    values = [_without_nulls(value) for value in values]
    if None in _leaves(values):  # genpy reads an empty argument as null, which fits no field
        explain(schema, values)
    now = None
    if mentions_clock(values):
        time = ctx.call("/rosapi/get_time")["time"]
        now = time["secs"], time["nsecs"]
    try:
        return fill(schema.fields, schema.root, values, now)
    except BadMessage:
        explain(schema, values)
        raise


def _without_nulls(value: Any) -> Any:
    """The value with '' for each name without a value: `{frame_id: }`."""
    if isinstance(value, Mapping):
        return {name: "" if each is None else _without_nulls(each) for name, each in value.items()}
    return [_without_nulls(each) for each in value] if isinstance(value, list | tuple) else value


def _leaves(value: Any) -> Iterator[Any]:
    """The scalars in nested lists and mappings."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if not isinstance(value, list | tuple):
        yield value
        return
    for each in value:
        yield from _leaves(each)


def as_yaml(typedefs: Typedefs, message: Message) -> str:
    """The message as `-v` shows it; fields that were not given have their defaults."""
    from slidectl import msgs
    from slidectl.msgs.message_text import YamlForm

    schema = from_typedefs(typedefs)
    return YamlForm(schema).printer(schema.root)(msgs.check(schema.root, message))


# --- why values do not fit --------------------------------------------------------------------------------------------


def explain(schema: Schema, values: Sequence[Any]) -> None:
    """Raise WrongStructure or WrongType with genpy's text; return when genpy accepts the values."""
    root: Any = values[0] if len(values) == 1 and isinstance(values[0], Mapping) else list(values)
    wrong = list(
        _wrong(schema, schema.root, root, "")
    )  # read to the end: any WrongStructure has priority over a wrong type
    if wrong:
        raise WrongType(wrong[0])


def _wrong(schema: Schema, type_name: str, given: Any, prefix: str) -> Iterator[str]:
    """Yield an error text for each value of a wrong type. Raises WrongStructure."""
    for field, value in _paired(schema, type_name, given, prefix):
        name = _plain(prefix) + field.name
        if field.array >= 0 and not isinstance(value, list | tuple):
            raise WrongStructure(f"Field [{name}] must be a list or tuple instead of: {type(value).__name__}")
        if field.array > 0 and len(value) != field.array:
            raise WrongStructure(f"Field [{name}] has incorrect number of elements: {len(value)} != {field.array}")
        path = prefix + field.name + ("[]" if field.array >= 0 else "")
        for each in value if field.array >= 0 else [value]:
            if field.type not in TIMES and not schema.fields(field.type):
                trouble = _trouble(field.type, each)
                if trouble is not None:
                    yield f"field {path} {trouble}"
            elif isinstance(each, str):
                if each != {"std_msgs/Header": "auto", "time": "now"}.get(field.type):
                    raise WrongStructure(f"No key named [{each}]")
            elif field.type not in TIMES or not isinstance(each, int) or isinstance(each, bool):
                yield from _wrong(schema, field.type, each, f"{path}.")


def _plain(prefix: str) -> str:
    """The prefix without `[]`: genpy omits it in errors about names and counts."""
    return prefix.replace("[]", "")


def _paired(schema: Schema, type_name: str, given: Any, prefix: str) -> Iterator[tuple[Field, Any]]:
    """Yield each field that has a value, with the value. Raises WrongStructure."""
    # The parts of a time are whole numbers of any size: what is too large for one may be carried over to the other.
    parts = [part._replace(type="int64") for part in TIMES.get(type_name, ())]
    fields = parts or schema.fields(type_name)
    names = [field.name for field in fields]
    if isinstance(given, Mapping):
        for name, value in given.items():
            if name not in names:
                raise WrongStructure(f"No field name [{_plain(prefix)}{name}]")
            yield fields[names.index(name)], value
    elif isinstance(given, list | tuple):
        if len(given) != len(names):
            trouble = "Too many" if len(given) > len(names) else "Not enough"
            raise WrongStructure(f"{trouble} arguments:\n * Given: {list(given)}\n * Expected: {names}")
        yield from zip(fields, given, strict=True)
    else:
        raise WrongStructure(f"invalid msg_args type: {given}")


def _trouble(type_name: str, value: Any) -> str | None:
    """The error text for a value of a primitive type; None when it fits."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    if type_name in FLOATS:
        return None if whole or isinstance(value, float) else "must be float type"
    if type_name == "bool":
        return None if isinstance(value, bool) or value in (0, 1) else "is not a bool"
    if type_name not in INTEGER_RANGES:
        return None if isinstance(value, str) else "must be of type bytes or an ascii string"
    lowest, highest = INTEGER_RANGES[type_name]
    if not whole or value < 0 == lowest:
        return "must be an integer type" if lowest else "must be unsigned integer type"
    return None if lowest <= value <= highest else f"exceeds specified width [{type_name}]"
