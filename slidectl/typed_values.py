"""Reads values that a user types, and documents of a file or a pipe: YAML 1.1 as the ROS tools read it.

`1e-3` and `-.5` are numbers. Numbers, booleans, words and JSON are read without PyYAML, whose import takes longer than
a whole command should. Values that JSON cannot hold (dates, sets, keys that are not text) are refused. Values are not
checked against message types.
"""

from __future__ import annotations

import itertools
import json
import math
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from typing import Any, TextIO

from slidectl.errors import BadFile, UsageError
from slidectl.input_files import opened_text
from slidectl.wire.json_lines import LONGEST_LINE

_WORDS = re.compile(r"[A-Za-z_/][A-Za-z0-9_/.-]*( [A-Za-z0-9_/.-]+)*\Z")
# `data: 1.0`, `{data: 1.0}` and `name: 'a controller'`, as in every tutorial. No escapes, nothing nested.
_PAIR = re.compile(
    r"(?P<open>\{?) *(?P<key>[A-Za-z_][A-Za-z0-9_]*): +"
    r"(?:'(?P<single>[ !#-&(-~]*)'|\"(?P<double>[ !#-&(-\[\]-~]*)\"|(?P<bare>[^:#,{}\[\]'\"&*!|>%@`]+?))"
    r" *(?P<close>\}?)\Z"
)
_NUMERIC = frozenset("0123456789.+-eE")
_CONSTANTS: dict[str, Any] = {
    "": None, "~": None, "null": None, "Null": None, "NULL": None,
    **{sign + word: float(sign + "inf") for sign in ("", "+", "-") for word in (".inf", ".Inf", ".INF")},
    ".nan": math.nan, ".NaN": math.nan, ".NAN": math.nan,
}  # fmt: skip
_BOOLEANS = {"yes": True, "true": True, "on": True, "no": False, "false": False, "off": False}
# YAML 1.1 requires a point and a signed exponent in a float, and no sign before a bare point; users do not write so.
_FLOAT_WITHOUT_POINT = r"[-+]?(?:[0-9][0-9_]*\.?[0-9_]*[eE][-+]?[0-9]+|\.[0-9][0-9_]*(?:[eE][-+]?[0-9]+)?)$"
_SHORT = 4096
_MOST_NODES = 1_000_000
_LONGEST_TEXT = 64 * 1024 * 1024
_ENDS = ("---", "...")

_UNKNOWN: Any = object()


# --- one value ------------------------------------------------------------------------------------------------------


def read(text: str) -> Any:
    """The value of one argument. Raises UsageError for text that is not YAML, or a value that no message can hold."""
    stripped = text.strip(" ")
    for attempt in (_scalar, _pair, _json):
        value = attempt(stripped)
        if value is not _UNKNOWN:
            return value
    return read_yaml(text, shown(text))


def shown(text: str) -> str:
    """The name of a typed value in error messages."""
    return f"value {text if len(text) <= 60 else text[:57] + '...'!r}"


def is_numeric(value: Any) -> bool:
    """True for numbers, booleans, and lists and mappings of these: they contain no expression and no time."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return all(map(is_numeric, value))
    return isinstance(value, bool | int | float)


def _scalar(text: str) -> Any:
    if text and _NUMERIC.issuperset(text):
        digits = text.lstrip("+-")
        if digits.isdigit() and digits[0] == "0" and digits != "0":
            return _UNKNOWN  # octal in YAML 1.1
        try:
            return int(text) if digits.isdigit() else float(text)
        except ValueError:
            return _UNKNOWN
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if text.lower() in _BOOLEANS and (text.islower() or text.isupper() or text.istitle()):
        return _BOOLEANS[text.lower()]
    return text if _WORDS.match(text) else _UNKNOWN


def _pair(text: str) -> Any:
    match = _PAIR.match(text)
    if not match or bool(match["open"]) != bool(match["close"]) or _scalar(match["key"]) != match["key"]:
        return _UNKNOWN
    quoted = match["double"] if match["single"] is None else match["single"]
    value = _scalar(match["bare"]) if quoted is None else quoted
    return value if value is _UNKNOWN else {match["key"]: value}


def _json(text: str) -> Any:
    try:
        return json.loads(text, parse_constant=_no_json) if text.startswith(("{", "[", '"')) else _UNKNOWN
    except (ValueError, RecursionError):
        return _UNKNOWN


def _no_json(text: str) -> Any:
    raise ValueError(text)


def check_quotes(words: Sequence[str], fields: Iterable[str] = ()) -> None:
    """Raise UsageError when the shell has split `data: 1.0` or `{data: 1.0}`. `fields` are those of the message."""
    if len(words) < 2:
        return
    first, whole = words[0], " ".join(words)
    is_field = first.endswith(":") and first[:-1] in fields
    is_open = first[:1] in ("{", "[") and _depth(first) > 0 and _depth(whole) == 0
    if not is_field and not is_open:
        return
    if is_field and len(words) > 2 and not _is_yaml(whole):
        whole = "{" + re.sub(r"\s(?=\w+:(\s|$))", ", ", whole) + "}"
    from shlex import quote

    typed = ["slidectl", *sys.argv[1:]]
    start = next((at for at in range(len(typed)) if typed[at : at + len(words)] == list(words)), None)
    hint = f"type it as: {quote(whole)}"
    if start is not None:
        line = [*typed[:start], whole, *typed[start + len(words) :]]
        hint = "type: " + " ".join(map(quote, line[2:] if line[1] == "ros" else line))
    raise UsageError(f"the shell made {len(words)} words of one value: quote it", hint)


def _depth(text: str) -> int:
    """The number of brackets that are not closed."""
    return sum(text.count(mark) for mark in "{[") - sum(text.count(mark) for mark in "}]")


def _is_yaml(text: str) -> bool:
    try:
        read_yaml(text)
    except UsageError:
        return False
    return True


# --- YAML -----------------------------------------------------------------------------------------------------------


def read_yaml(text: str, what: str = "value", *, angles: bool = False) -> Any:
    """The value of one YAML document; with `angles` also deg(90) and rad(pi/2). `what` names the text in messages.

    Raises UsageError as `read` does.
    """
    documents = list(read_documents(text, what, angles=angles))
    if len(documents) > 1:
        raise UsageError(f"the {what} holds {len(documents)} YAML documents where one was expected")
    return documents[0] if documents else None


def read_documents(text: str, what: str, file: str | None = None, *, angles: bool = False) -> Iterator[Any]:
    """The values of all YAML documents in a text, in order.

    Raises UsageError as `read` does, and BadFile with the line when a `file` is not YAML.
    """
    import yaml

    try:
        for value in yaml.load_all(text, _loader(len(text), angles)):
            left = itertools.count(_MOST_NODES, -1)
            yield _checked(value, what, left)
    except yaml.YAMLError as error:
        from slidectl.description.yaml_tree import is_too_deep

        if is_too_deep(error):
            raise _too_deep(what, file) from None
        mark = getattr(error, "problem_mark", None)
        problem = str(getattr(error, "problem", None) or str(error).splitlines()[0])
        if file is not None:
            raise BadFile(f"not valid YAML: {problem}", file, mark.line + 1 if mark else None) from None
        place = f" (line {mark.line + 1}, column {mark.column + 1})" if mark else ""
        raise UsageError(f"the {what} is not valid YAML: {problem}{place}") from None
    except RecursionError:
        raise _too_deep(what, file) from None
    except (ValueError, ArithmeticError) as error:
        raise UsageError(f"the {what} cannot be read: {error}") from None


def _too_deep(what: str, file: str | None) -> BadFile | UsageError:
    return UsageError(f"the {what} is nested too deeply") if file is None else BadFile("is nested too deeply", file)


def _loader(length: int, angles: bool) -> Any:
    import yaml

    # libyaml is faster, but the line of an error may be wrong by one.
    fast = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    loader: Any = type("Loader", (fast if length > _SHORT else yaml.SafeLoader,), {})
    loader.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(_FLOAT_WITHOUT_POINT), list("-+0123456789."))
    if angles:
        from slidectl.description.angles import DEGREES, RADIANS, add_to

        add_to(loader)
        for tag in (DEGREES, RADIANS):
            loader.add_constructor(tag, _angle)
    return loader


def _angle(loader: Any, node: Any) -> float:
    from slidectl.description.angles import angle

    try:
        return angle(loader.construct_scalar(node), node.tag)
    except (ValueError, ArithmeticError, RecursionError) as error:
        raise ValueError(f"{node.value.strip()!r} is not an angle: {error}") from None


def _checked(value: Any, what: str, left: Iterator[int]) -> Any:
    """A copy of a value. Raises UsageError for types that no message holds, and for too many values by aliases."""
    if next(left) <= 0:
        raise UsageError(f"the {what} expands to more than {_MOST_NODES} values")
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise UsageError(f"the key {key!r} in the {what} is not text", "write it in quotes")
        return {key: _checked(item, what, left) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_checked(item, what, left) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    kind = "date" if hasattr(value, "isoformat") else type(value).__name__
    raise UsageError(f"{value} in the {what} is a {kind} to YAML", "write it in quotes if it is text")


# --- documents of a file or a pipe ----------------------------------------------------------------------------------


def text_of(path: str) -> str:
    """The text of a file; `-` is stdin. Raises BadFile when it cannot be read or is too long."""
    try:
        with nullcontext(sys.stdin) if path == "-" else opened_text(path, _LONGEST_TEXT, pipes=True) as file:
            text = file.read(_LONGEST_TEXT + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise BadFile(getattr(error, "strerror", None) or str(error), path) from None
    if len(text) > _LONGEST_TEXT:
        raise BadFile(f"holds more than {_LONGEST_TEXT >> 20} Mi characters", "stdin" if path == "-" else path)
    return text


def documents_of(path: str) -> list[Any]:
    """The documents of a file, YAML or JSON lines; `-` is stdin. Raises BadFile, UsageError."""
    if path == "-":
        return list(documents_on_stdin())
    text = text_of(path)
    lines = text.splitlines(keepends=True)
    if any(_json_line(line) is not _UNKNOWN for line in lines[:1]):
        return list(split(lines))
    return list(read_documents(text, "file", path))


def documents_on_stdin() -> Iterator[Any]:
    """The documents on stdin as they arrive. Raises UsageError with the number of a document that cannot be read."""
    try:
        yield from split(bounded(sys.stdin, "stdin"))
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot read stdin: {error}") from None


def bounded(file: TextIO, name: str) -> Iterator[str]:
    """The lines of a file. Raises BadFile for a line longer than LONGEST_LINE."""
    for number in itertools.count(1):
        line = file.readline(LONGEST_LINE)
        if not line:
            return
        if len(line) == LONGEST_LINE and line[-1] != "\n":
            raise BadFile(f"a line longer than {LONGEST_LINE} characters", name, number)
        yield line


def split(lines: Iterable[str]) -> Iterator[Any]:
    """The documents in lines of text, each as soon as it is complete; the last one needs no `---`.

    A line that is JSON is a document by itself; null in it means NaN, as in the wire protocol.
    """
    pending: list[str] = []
    size, number, after_json = 0, 1, False
    for line in lines:
        if line.rstrip() in _ENDS:
            if pending:
                yield read_yaml("".join(pending), f"document {number}")
                number += 1
            pending, size, after_json = [], 0, False
        elif not pending and (value := _json_line(line)) is not _UNKNOWN:
            yield value
            number += 1
            after_json = True
        elif line.strip() or not after_json:
            pending.append(line)
            size += len(line)
            if size > LONGEST_LINE:
                raise UsageError(f"the document {number} is longer than {LONGEST_LINE} characters")
    if any(line.strip() for line in pending):
        yield read_yaml("".join(pending), f"document {number}")


def _json_line(line: str) -> Any:
    try:
        return _with_nan(json.loads(line)) if line.strip() else _UNKNOWN
    except (ValueError, RecursionError):
        return _UNKNOWN


def _with_nan(value: Any) -> Any:
    """Replace null by NaN: the wire protocol sends null for it."""
    if value is None:
        return math.nan
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    return [_with_nan(item) for item in value] if isinstance(value, list) else value
