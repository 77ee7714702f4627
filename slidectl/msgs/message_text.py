"""Text output of messages: the YAML of `rostopic echo`, byte for byte, and its CSV. Layout only.

PyYAML is imported only for text that needs its folding or quoting rules.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from slidectl.msgs.field_path import byte_values
from slidectl.msgs.schema import BYTES, CODES, FLOATS, INTEGER_RANGES, TIMES, Schema, nanoseconds

Printer = Callable[[Any], str]

# Text that PyYAML writes without quotes: no number, no YAML keyword, no start of a structure.
_PLAIN_WORD = re.compile(r"[A-Za-z_/][A-Za-z0-9_/]*\Z")
_YAML_WORDS = frozenset(("yes", "no", "true", "false", "on", "off", "null"))
# PyYAML folds a quoted scalar when the column passes 80; shorter text stays on its line.
_LONGEST_UNFOLDED = 78
_SIMPLE_TEXT = re.compile(rf"[ !#-\[\]-~]{{1,{_LONGEST_UNFOLDED}}}\Z")
_BREAKS_A_TABLE = re.compile(r'[,\r\n]|^"')


def quoted(text: str) -> str:
    """The text as a double-quoted YAML scalar; `''` when empty."""
    if not text:
        return "''"
    return f'"{text}"' if _SIMPLE_TEXT.match(text) else _dumped(text, '"')


def _dumped(value: Any, style: str | None = None) -> str:
    import yaml

    return str(yaml.dump(value, default_style=style)).rstrip("\n")


def is_plain(text: str) -> bool:
    """True for text that PyYAML certainly writes unquoted and in one line."""
    return bool(_PLAIN_WORD.match(text)) and text.lower() not in _YAML_WORDS and len(text) < _LONGEST_UNFOLDED


class YamlForm:
    """Prints values of the types of one schema.

    `width`: characters of a number (`rostopic echo -w`). `arrays` and `strings`: False prints only type and length. As
    with rostopic, the elements of a printed list are printed in full. `offset_ns` is subtracted from every time; set it
    before each message.
    """

    def __init__(self, schema: Schema, width: int | None = None, arrays: bool = True, strings: bool = True) -> None:
        self.schema = schema
        self.arrays = arrays
        self.strings = strings
        self.offset_ns = 0
        self._width = width
        self._integer = "%d" if width is None else f"%{width}d"

    def printer(self, type_name: str, depth: int = 0, full: bool = False) -> Printer:
        """A printer of values of this type nested in `depth` lists. Its text has no `---` and no final newline.

        `full`: a top-level list or text is printed whatever `arrays` and `strings` are.
        """
        full = full and (depth > 0 or type_name == "string")
        return lambda value: self._list(value, type_name, depth, "", full)

    def _list(self, value: Any, type_name: str, depth: int, indent: str, full: bool) -> str:
        if depth == 0:
            return self._single(value, type_name, indent, full)
        if not full and (not self.arrays or (type_name == "string" and not self.strings)):
            return _length_of(type_name, type_name, value)
        if depth == 1 and type_name == "string":
            lines = [f"- {text}" for text in value] if all(map(is_plain, value)) else _dumped(value).splitlines()
            return "".join([f"\n{indent}{line}" for line in lines]) or "[]"
        if depth == 1 and type_name in CODES:
            elements = byte_values(value) if type_name in BYTES else value
            return f"[{', '.join([self._single(element, type_name, '', True) for element in elements])}]"
        inner = indent + "  "
        return "".join([f"\n{indent}- {self._list(each, type_name, depth - 1, inner, True)}" for each in value]) or "[]"

    def _single(self, value: Any, type_name: str, indent: str, full: bool) -> str:
        if type_name in FLOATS:
            return self._float(float("nan") if value is None else float(value))  # NaN is null in JSON
        if type_name in INTEGER_RANGES:
            return str(self._integer % value)
        if type_name in TIMES:
            return self._time(value, type_name, indent)
        if type_name == "string":
            return quoted(value) if self.strings or full else f'"<string length: {len(value)}>"'
        if type_name == "bool":
            return str(value)
        lines = []
        for name, kind, array in self.schema.fields(type_name):
            if array > 0 and not (self.arrays or full):
                text = _length_of(f"{kind}[{array}", kind, value[name])  # sic: rostopic shows one bracket
            else:
                text = self._list(value[name], kind, int(array >= 0), indent + "  ", full)
            lines.append(f"{indent}{name}: {text}")
        return ("\n" if indent else "") + "\n".join(lines)

    def _float(self, value: float) -> str:
        if self._width is None:
            return repr(value)
        text = f"{value:.{self._width}f}"
        return text[: max(text.find("."), self._width)]

    def _time(self, value: dict[str, int], type_name: str, indent: str) -> str:
        secs, nsecs = value["secs"], value["nsecs"]
        if self.offset_ns and type_name == "time":
            secs, nsecs = divmod(nanoseconds(value) - self.offset_ns, 10**9)
        padded = "%9d" if self._width is None else self._integer
        return f"\n{indent}secs: {self._integer % secs}\n{indent}nsecs: {padded % nsecs}"


def _length_of(shown: str, type_name: str, value: Any) -> str:
    return f'"<array type: {shown}, length: {len(byte_values(value) if type_name in BYTES else value)}>"'


class CsvRow(NamedTuple):
    """One message: its header line (it starts with `%time`) and its values, both without line end."""

    header: str
    line: str


class CsvForm:
    """Formats values of the types of one schema as `rostopic echo -p` does.

    `arrays` and `strings`: False omits such columns. `offset_ns` is subtracted from every time. Byte arrays have no
    columns, as with rostopic. Text that would break the table is quoted as in RFC 4180.
    """

    def __init__(self, schema: Schema, arrays: bool = True, strings: bool = True) -> None:
        self.schema = schema
        self.arrays = arrays
        self.strings = strings
        self.offset_ns = 0

    def row(self, value: Any, type_name: str, depth: int, time_ns: int) -> CsvRow:
        """The row of a value nested in `depth` lists; `time_ns` is its time in nanoseconds."""
        cells = list(self._chosen(value, type_name, depth, "field"))
        names = ",".join(name for name, _ in cells)
        return CsvRow(f"%time,{names}", f"{time_ns - self.offset_ns}," + ",".join(text for _, text in cells))

    def _chosen(self, value: Any, type_name: str, depth: int, name: str) -> Iterator[tuple[str, str]]:
        """The cells of the selected value. A selected list or text is always included; options apply to its parts."""
        if depth == 0 and type_name == "string":
            yield name, self._text(value, type_name)
        elif depth == 0:
            yield from self._cells(value, type_name, 0, name)
        elif type_name not in BYTES:
            for index, element in enumerate(value):
                yield from self._chosen(element, type_name, depth - 1, f"{name}{index}")

    def _cells(self, value: Any, type_name: str, depth: int, name: str) -> Iterator[tuple[str, str]]:
        if depth and self.arrays and type_name not in BYTES:
            for index, element in enumerate(value):
                yield from self._cells(element, type_name, depth - 1, f"{name}{index}")
        elif depth:
            return
        elif type_name in self.schema.types:
            for field in self.schema.types[type_name]:
                yield from self._cells(value[field.name], field.type, int(field.array >= 0), f"{name}.{field.name}")
        elif type_name != "string" or self.strings:
            yield name, self._text(value, type_name)

    def _text(self, value: Any, type_name: str) -> str:
        if type_name in FLOATS:
            return "nan" if value is None else repr(float(value))
        if type_name in TIMES:
            return str(nanoseconds(value) - (self.offset_ns if type_name == "time" else 0))
        if type_name == "bool":
            return "1" if value else "0"
        text = str(value)
        if type_name != "string" or not _BREAKS_A_TABLE.search(text):
            return text
        return '"' + text.replace('"', '""') + '"'
