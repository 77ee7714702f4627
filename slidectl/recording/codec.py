"""Messages of one type as ROS 1 bytes and back, and the text that tells a reader what the type is made of."""

from __future__ import annotations

import math
import re
from binascii import a2b_base64, b2a_base64
from collections.abc import Callable
from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slidectl import msgs
from slidectl.errors import SlidectlError
from slidectl.msgs.definitions import parse_message
from slidectl.msgs.schema import BYTES, FLOATS, INTEGER_RANGES, PRIMITIVES, SCALAR, TIMES, Field

_SECTION = re.compile(r"^=+\s*\nMSG: *(\S+) *\n", re.MULTILINE)

Convert = Callable[[Any], Any]


class BadDefinition(SlidectlError):
    """The text of a message type cannot be understood."""


class Codec:
    """A message type: `definition` is its text, followed by those of the types in it, as recordings hold it.

    An empty `md5` is made of the definition.

    Raises:
        BadDefinition.
    """

    def __init__(self, type_name: str, definition: str, md5: str) -> None:
        self.type = type_name
        self.definition = definition
        self.texts = definitions(type_name, definition)
        """Each type with its text; the first is the type itself."""
        try:
            parsed = {name: parse_message(text, name) for name, text in self.texts.items()}
            self._store = get_typestore(Stores.EMPTY)
            self._store.register(get_types_from_msg(definition, type_name))
        except Exception as error:  # the library's classes for this are many
            raise BadDefinition(f"the definition of {type_name} cannot be read: {error}") from None
        self.types = {name: tuple(one.fields) for name, one in parsed.items()}
        self._name = _long(type_name)
        self.md5 = md5 or self._store.generate_msgdef(self._name)[1]
        self._build: Convert | None = None

    def encode(self, message: Any) -> bytes:
        """The bytes of a complete message."""
        if self._build is None:
            self._build = self._builder(self.type)
        return bytes(self._store.serialize_ros1(self._build(message), self._name))

    def decode(self, raw: bytes) -> Any:
        """The message. Raises what the library raises about bytes that are none."""
        return self._plain(self.type, self._store.deserialize_ros1(raw, self._name))

    # --- from the wire's shape to the library's objects -------------------------------------------------------------

    def _builder(self, type_name: str) -> Convert:
        if type_name in TIMES:
            cls = self._store.types[f"builtin_interfaces/msg/{type_name.capitalize()}"]
            return lambda value: cls(_signed(value["secs"]), value["nsecs"])
        if type_name in FLOATS:
            return lambda value: math.nan if value is None else value
        if type_name in PRIMITIVES:
            return lambda value: value
        cls = self._store.types[_long(type_name)]
        parts = [(field.name, self._field_builder(field)) for field in self.types[type_name]]
        return lambda value: cls(*[build(value[name]) for name, build in parts])

    def _field_builder(self, field: Field) -> Convert:
        build = self._builder(field.type)
        if field.array == SCALAR:
            return build
        import numpy as np

        if field.type in BYTES:
            return lambda v: np.frombuffer(a2b_base64(v), np.uint8) if isinstance(v, str) else np.array(v, np.uint8)
        if field.type in FLOATS or field.type in INTEGER_RANGES or field.type == "bool":
            kind = np.dtype({"byte": "int8", "char": "uint8"}.get(field.type, field.type))
            return lambda values: np.array(values, kind)
        return lambda values: [build(value) for value in values]

    # --- and back ---------------------------------------------------------------------------------------------------

    def _plain(self, type_name: str, value: Any) -> Any:
        if type_name in TIMES:
            return {"secs": value.sec if type_name == "duration" else value.sec % 2**32, "nsecs": value.nanosec}
        if type_name in PRIMITIVES:
            return value if not hasattr(value, "item") else value.item()
        return {field.name: self._plain_field(field, getattr(value, field.name)) for field in self.types[type_name]}

    def _plain_field(self, field: Field, value: Any) -> Any:
        if field.array == SCALAR:
            return self._plain(field.type, value)
        if field.type in BYTES:
            return b2a_base64(bytes(value), newline=False).decode("ascii")
        if hasattr(value, "tolist"):
            return value.tolist()
        return [self._plain(field.type, each) for each in value]


@cache
def of(type_name: str) -> Codec:
    """The codec of a type that slidectl knows. Raises UnknownName."""
    return Codec(type_name, msgs.full_definition(type_name), msgs.md5(type_name))


def definitions(root: str, text: str) -> dict[str, str]:
    """Type -> definition, out of one in which those of nested types follow, each behind a line of its own."""
    first, *rest = _SECTION.split(text)
    return {root: first, **dict(zip(rest[::2], rest[1::2], strict=True))}


def _long(type_name: str) -> str:
    """As rosbags names it."""
    return type_name.replace("/", "/msg/")


def _signed(secs: int) -> int:
    """rosbags reads and writes both times and durations as signed."""
    return (secs + 2**31) % 2**32 - 2**31
