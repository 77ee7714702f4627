"""Messages as `rostopic echo -p` prints them: a header line, then one line of numbers for each message.

Only the layout. Text that would break the table (a comma, a line end, a quote in front) is quoted as in RFC 4180, and
a new header line is due when an array has changed its length.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from slidectl.cli.schema import BYTES, FLOATS, TIMES, Schema

_BREAKS_A_TABLE = re.compile(r'[,\r\n]|^"')


class Row(NamedTuple):
    """One message: its header line without line end (it starts with `%time`) and its line of values."""

    header: str
    line: str


class CsvForm:
    """Lays out values of the types of one schema.

    `arrays` and `strings` False leave such columns out. `offset_ns` is subtracted from every time. Arrays of bytes have
    no columns, as with rostopic.
    """

    def __init__(self, schema: Schema, arrays: bool = True, strings: bool = True) -> None:
        self.schema = schema
        self.arrays = arrays
        self.strings = strings
        self.offset_ns = 0

    def row(self, value: Any, type_name: str, depth: int, time_ns: int) -> Row:
        """The row of a value that is wrapped in `depth` lists; `time_ns` is its time in nanoseconds."""
        cells = list(self._chosen(value, type_name, depth))
        names = ",".join(name for name, _ in cells)
        return Row(f"%time,{names}", f"{time_ns - self.offset_ns}," + ",".join(text for _, text in cells))

    def _chosen(self, value: Any, type_name: str, depth: int) -> Iterator[tuple[str, str]]:
        """What was asked for by itself is there, be it a list or text; options are for what is in it."""
        if depth == 0 and type_name == "string":
            yield "field", self._text(value, type_name)
        for index, element in enumerate(value if depth and type_name not in BYTES else ()):
            for name, text in self._chosen(element, type_name, depth - 1):
                yield f"field{index}{name.removeprefix('field')}", text
        if depth == 0 and type_name != "string":
            yield from self._cells(value, type_name, depth, "field")

    def _cells(self, value: Any, type_name: str, depth: int, name: str) -> Iterator[tuple[str, str]]:
        if depth:
            yield from self._elements(value, type_name, depth, name)
        elif type_name in self.schema.types:
            for field in self.schema.types[type_name]:
                yield from self._cells(value[field.name], field.type, int(field.array >= 0), f"{name}.{field.name}")
        elif type_name != "string" or self.strings:
            yield name, self._text(value, type_name)

    def _elements(self, values: Any, type_name: str, depth: int, name: str) -> Iterator[tuple[str, str]]:
        if self.arrays and type_name not in BYTES:
            for index, value in enumerate(values):
                yield from self._cells(value, type_name, depth - 1, f"{name}{index}")

    def _text(self, value: Any, type_name: str) -> str:
        if type_name in FLOATS:
            return "nan" if value is None else repr(float(value))
        if type_name in TIMES:
            nanoseconds = value["secs"] * 10**9 + value["nsecs"]
            return str(nanoseconds - self.offset_ns if type_name == "time" else nanoseconds)
        if type_name == "bool":
            return "1" if value else "0"
        return _cell(value) if type_name == "string" else str(value)


def _cell(text: str) -> str:
    if not _BREAKS_A_TABLE.search(text):
        return text
    doubled = text.replace('"', '""')
    return f'"{doubled}"'
