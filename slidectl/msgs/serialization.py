"""Fast conversion of messages to ROS 1 bytes and back: two generated Python functions per type.

Consecutive numbers are packed by one Struct, also across nested messages.
"""

from __future__ import annotations

import math
from binascii import a2b_base64, b2a_base64
from collections.abc import Callable
from struct import Struct, pack, unpack_from
from typing import Any

from slidectl.msgs.schema import BYTES, CODES, FLOATS, SCALAR, TIMES, Field, FieldsOf

Message = dict[str, Any]

_MOST_LINES = 20_000
"""Limit of a generated function: types that nest others many times could make it grow without bound."""


def packer(name: str, fields_of: FieldsOf) -> Callable[[Message], bytes]:
    """A function that serializes complete messages of the type. Raises ValueError: the type is too large."""
    return _Packer(name, fields_of).function()


def unpacker(name: str, fields_of: FieldsOf, most_elements: int | None = None) -> Callable[[bytes], Message]:
    """A function that deserializes messages; for invalid bytes it raises struct.error or ValueError.

    `most_elements` limits the elements of all lists of a message, byte arrays excluded; None for the number of bytes.
    Text that is not UTF-8 is decoded with replacement characters. Raises ValueError: the type is too large.
    """
    return _Unpacker(name, fields_of, most_elements).function()


def _numbers(values: list[Any]) -> list[Any]:
    """Floats for `pack`: null becomes nan."""
    return [math.nan if value is None else value for value in values] if None in values else values


class _Source:
    """The source text of a function, and its Structs. Format codes collect in `_codes` until a Struct is made."""

    def __init__(self, name: str, fields_of: FieldsOf) -> None:
        self._type = name
        self._fields_of = fields_of
        self._lines: list[str] = []
        self._indent = 1
        self._codes = ""
        self._count = 0
        self._names: dict[str, Any] = {
            "pack": pack, "unpack_from": unpack_from, "a2b": a2b_base64, "b2a": b2a_base64, "numbers": _numbers,
            "nan": math.nan,
        }  # fmt: skip

    def _line(self, text: str) -> None:
        if len(self._lines) >= _MOST_LINES:
            raise ValueError(f"{self._type} is too large")
        self._lines.append("    " * self._indent + text)

    def _name(self) -> str:
        self._count += 1
        return f"v{self._count}"

    def _struct(self) -> str:
        """Make a Struct of the collected codes and return its name."""
        name = f"s{self._codes.replace('?', 'x')}"
        self._names[name] = Struct("<" + self._codes)
        self._codes = ""
        return name

    def _compiled(self, name: str) -> Callable[[Any], Any]:
        exec(
            compile("\n".join(self._lines), f"<{name}>", "exec"), self._names
        )  # of our own words alone: names of fields are quoted
        function: Callable[[Any], Any] = self._names["function"]
        return function


class _Packer(_Source):
    """Generates `function(m)`, which returns the bytes of a message."""

    def __init__(self, name: str, fields_of: FieldsOf) -> None:
        super().__init__(name, fields_of)
        self._values: list[str] = []

    def function(self) -> Callable[[Message], bytes]:
        self._lines += ["def function(m):", "    out = []", "    add = out.append"]
        self._fields(self._type, "m")
        self._flush()
        self._line("return b''.join(out)")
        return self._compiled(self._type)

    def _flush(self) -> None:
        if self._codes:
            self._line(f"add({self._struct()}.pack({', '.join(self._values)}))")
            self._values = []

    def _number(self, code: str, value: str) -> None:
        self._codes += code
        self._values.append(value)

    def _fields(self, type_name: str, message: str) -> None:
        for field in TIMES.get(type_name) or self._fields_of(type_name):
            value = f"{message}[{field.name!r}]"
            if field.array == SCALAR:
                self._one(field.type, value)
            else:
                self._list(field, value)

    def _one(self, kind: str, value: str) -> None:
        if kind in FLOATS:
            self._number(CODES[kind], f"nan if (f := {value}) is None else f")
        elif kind in CODES:
            self._number(CODES[kind], value)
        elif kind == "string":
            text = self._name()
            self._line(f"{text} = {value}.encode()")
            self._number("I", f"len({text})")
            self._flush()
            self._line(f"add({text})")
        else:
            inner = self._name()
            self._line(f"{inner} = {value}")
            self._fields(kind, inner)

    def _list(self, field: Field, value: str) -> None:
        values = self._name()
        self._line(f"{values} = {value}")
        if field.type in BYTES:
            self._line(f"{values} = a2b({values}) if {values}.__class__ is str else bytes({values})")
        if not field.array:
            self._number("I", f"len({values})")
        self._flush()
        if field.type in BYTES:
            self._line(f"add({values})")
        elif field.type in CODES:
            given = f"numbers({values})" if field.type in FLOATS else values
            self._line(f"add(pack('<%d{CODES[field.type]}' % len({values}), *{given}))")
        else:
            element = self._name()
            self._line(f"for {element} in {values}:")
            self._indent += 1
            before = len(self._lines)
            self._one(field.type, element)
            self._flush()
            if len(self._lines) == before:
                self._line("pass")  # a type without fields
            self._indent -= 1


class _Unpacker(_Source):
    """Generates `function(data)`, which returns the message. It raises struct.error and ValueError."""

    def __init__(self, name: str, fields_of: FieldsOf, most_elements: int | None) -> None:
        super().__init__(name, fields_of)
        self._most = "size" if most_elements is None else str(most_elements)
        self._targets: list[str] = []

    def function(self) -> Callable[[bytes], Message]:
        self._lines += ["def function(data):", "    p, size = 0, len(data)", f"    left = most = {self._most}"]
        message = self._fields(self._type)
        self._flush()
        self._line("if p != size: raise ValueError(f'{size - p} bytes follow')")
        self._line(f"return {message}")
        return self._compiled(self._type)

    def _flush(self) -> None:
        if self._codes:
            size = Struct("<" + self._codes).size
            self._line(f"{', '.join(self._targets)}, = {self._struct()}.unpack_from(data, p)")
            self._line(f"p += {size}")
            self._targets = []

    def _number(self, code: str) -> str:
        self._codes += code
        self._targets.append(self._name())
        return self._targets[-1]

    def _fields(self, type_name: str) -> str:
        """An expression for the message; the lines before it read its parts."""
        parts = []
        for field in TIMES.get(type_name) or self._fields_of(type_name):
            value = self._one(field.type) if field.array == SCALAR else self._list(field)
            parts.append(f"{field.name!r}: {value}")
        return "{" + ", ".join(parts) + "}"

    def _one(self, kind: str) -> str:
        if kind in CODES:
            return self._number(CODES[kind])
        if kind == "string":
            piece = self._piece(self._number("I"))
            return f"{piece}.decode('utf-8', 'replace')"
        return self._fields(kind)

    def _piece(self, length: str) -> str:
        """Generate code that reads `length` bytes; returns the variable's name."""
        self._flush()
        end, piece = self._name(), self._name()
        self._line(f"{end} = p + {length}")
        self._line(f"if {end} > size: raise ValueError(f'{{{end} - size}} bytes are missing')")
        self._line(f"{piece} = data[p:{end}]")
        self._line(f"p = {end}")
        return piece

    def _list(self, field: Field) -> str:
        count = str(field.array) if field.array else self._number("I")
        self._flush()
        if field.type in BYTES:
            return f"b2a({self._piece(count)}, newline=False).decode('ascii')"
        self._line(f"left -= {count}")
        self._line("if left < 0: raise ValueError(f'more than {most} values')")
        values = self._name()
        if field.type in CODES:
            width = Struct("<" + CODES[field.type]).size
            self._line(f"{values} = list(unpack_from('<%d{CODES[field.type]}' % {count}, data, p))")
            self._line(f"p += {width} * {count}")
        else:
            self._line(f"{values} = []")
            self._line(f"for _ in range({count}):")
            self._indent += 1
            element = self._one(field.type)
            self._flush()
            self._line(f"{values}.append({element})")
            self._indent -= 1
        return values
