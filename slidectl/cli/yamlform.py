"""Messages as `rostopic echo` prints them: the YAML layout of genpy, byte for byte.

A printer is put together once for a type and then run for each message. It writes the common forms itself; PyYAML
is loaded only for text that needs folding or quoting rules.
"""

from __future__ import annotations

import re
from binascii import a2b_base64
from collections.abc import Callable
from typing import Any

from slidectl.cli.schema import BYTES, FLOATS, INTEGERS, TIMES, Field, Schema

Printer = Callable[[Any], str]

# Text that PyYAML writes without quotes: no number, no word of YAML's own, nothing that begins like a structure.
_PLAIN_WORD = re.compile(r"[A-Za-z_/][A-Za-z0-9_/]*\Z")
_YAML_WORDS = frozenset(("yes", "no", "true", "false", "on", "off", "null"))
_SIMPLE_TEXT = re.compile(r"[ !#-\[\]-~]+\Z")
_ESCAPES = {
    "\0": "\\0", "\a": "\\a", "\b": "\\b", "\t": "\\t", "\n": "\\n", "\v": "\\v", "\f": "\\f", "\r": "\\r",
    "\x1b": "\\e", '"': '\\"', "\\": "\\\\", "\x85": "\\N", "\xa0": "\\_", "\u2028": "\\L", "\u2029": "\\P",
}  # fmt: skip
# PyYAML folds a quoted scalar when the column passes 80; shorter text stays on its line.
_LONGEST_UNFOLDED = 78


def quoted(text: str) -> str:
    """The text as a double-quoted YAML scalar; `''` when empty."""
    if not text:
        return "''"
    inside = text if _SIMPLE_TEXT.match(text) else "".join(map(_escaped, text))
    return f'"{inside}"' if len(inside) <= _LONGEST_UNFOLDED else _dumped(text, '"')


def _escaped(char: str) -> str:
    if char in _ESCAPES:
        return _ESCAPES[char]
    if " " <= char <= "~":
        return char
    code = ord(char)
    return f"\\x{code:02X}" if code <= 0xFF else f"\\u{code:04X}" if code <= 0xFFFF else f"\\U{code:08X}"


def _dumped(value: Any, style: str | None = None) -> str:
    import yaml

    text: str = yaml.dump(value, default_style=style)
    return text.rstrip("\n")


def is_plain(text: str) -> bool:
    """True for text that PyYAML surely writes as it is, without quotes and in one line."""
    return bool(_PLAIN_WORD.match(text)) and text.lower() not in _YAML_WORDS and len(text) < _LONGEST_UNFOLDED


def _block(texts: list[str]) -> list[str]:
    """The lines of a list of strings in block style."""
    if all(map(is_plain, texts)):
        return [f"- {text}" for text in texts]
    return _dumped(texts).splitlines()


def byte_values(value: Any) -> list[int]:
    """A uint8[] or char[] field as numbers, from base64 text or a list."""
    return list(a2b_base64(value)) if isinstance(value, str) else list(value)


class YamlForm:
    """Prints values of the types of one schema.

    `width`: characters of a number (`rostopic echo -w`). `arrays` and `strings` False: only their type and length. As
    with rostopic what is in a list that is printed is in full.
    `offset_ns` is subtracted from every time; set it before each message.
    """

    def __init__(self, schema: Schema, width: int | None = None, arrays: bool = True, strings: bool = True) -> None:
        self.schema = schema
        self.width = width
        self.arrays = arrays
        self.strings = strings
        self.offset_ns = 0
        self._printers: dict[tuple[str, int, str, bool], Printer] = {}

    def printer(self, type_name: str, depth: int = 0, full: bool = False) -> Printer:
        """The printer of a value of this type, wrapped in `depth` lists. The text has no `---` and no last newline.

        `full`: a list or text by itself is printed, whatever `arrays` and `strings` say.
        """
        return self._printer(type_name, depth, "", full and (depth > 0 or type_name == "string"))

    def _printer(self, type_name: str, depth: int, indent: str, full: bool) -> Printer:
        key = (type_name, depth, indent, full)
        if key not in self._printers:
            make = self._list if depth else self._single
            self._printers[key] = make(type_name, depth, indent, full)
        return self._printers[key]

    def _single(self, type_name: str, _depth: int, indent: str, full: bool) -> Printer:
        if type_name in FLOATS:
            return self._fixed_float if self.width is not None else _float
        if type_name in INTEGERS:
            return str if self.width is None else f"%{self.width}d".__mod__
        if type_name in TIMES:
            return self._time(type_name, indent)
        if type_name == "string":
            return quoted if self.strings or full else _string_length
        return str if type_name == "bool" else self._message(type_name, indent, full)

    def _fixed_float(self, value: float | None) -> str:
        width = self.width or 0
        text = f"{_number(value):.{width}f}"
        return text[: max(text.find("."), width)]

    def _time(self, type_name: str, indent: str) -> Printer:
        number = "%d" if self.width is None else f"%{self.width}d"
        padded = "%9d" if self.width is None else number
        layout = f"\n{indent}secs: {number}\n{indent}nsecs: {padded}"

        def text(value: dict[str, int]) -> str:
            if self.offset_ns and type_name == "time":
                return layout % divmod(value["secs"] * 10**9 + value["nsecs"] - self.offset_ns, 10**9)
            return layout % (value["secs"], value["nsecs"])

        return text

    def _message(self, type_name: str, indent: str, full: bool) -> Printer:
        parts = [
            (field.name, f"{indent}{field.name}: ", self._field(field, indent + "  ", full))
            for field in self.schema.fields(type_name)
        ]
        start = "\n" if indent else ""

        def text(message: dict[str, Any]) -> str:
            return start + "\n".join([label + printer(message[name]) for name, label, printer in parts])

        return text

    def _field(self, field: Field, indent: str, full: bool) -> Printer:
        if field.array > 0 and not (self.arrays or full):
            return _length_of(f"{field.type}[{field.array}", field.type)  # sic: rostopic shows one bracket
        return self._printer(field.type, int(field.array >= 0), indent, full)

    def _list(self, type_name: str, depth: int, indent: str, full: bool) -> Printer:
        if not full and (not self.arrays or (type_name == "string" and not self.strings)):
            return _length_of(type_name, type_name)
        if depth == 1 and type_name == "string":
            return lambda texts: "".join([f"\n{indent}{line}" for line in _block(texts)]) or "[]"
        if depth == 1 and (type_name in FLOATS or type_name in INTEGERS or type_name == "bool"):
            return self._inline(type_name)
        inner = self._printer(type_name, depth - 1, indent + "  ", True)
        return lambda values: "".join([f"\n{indent}- {inner(value)}" for value in values]) or "[]"

    def _inline(self, type_name: str) -> Printer:
        inner = self._single(type_name, 0, "", True)
        return lambda values: f"[{', '.join([inner(value) for value in _elements(type_name, values)])}]"


def _float(value: float | None) -> str:
    return repr(_number(value))


def _number(value: float | None) -> float:
    # What is no number travels as null.
    return float("nan") if value is None else float(value)


def _elements(type_name: str, values: Any) -> Any:
    return byte_values(values) if type_name in BYTES else values


def _length_of(shown: str, type_name: str) -> Printer:
    return lambda values: f'"<array type: {shown}, length: {len(_elements(type_name, values))}>"'


def _string_length(text: str) -> str:
    return f'"<string length: {len(text)}>"'
