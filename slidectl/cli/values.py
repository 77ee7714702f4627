"""Values as a person types them: YAML 1.1 as the ROS tools read it, with `1e-3` and `-.5` being numbers.

Numbers, booleans, words and JSON are read without PyYAML, which costs more time to load than a whole command may
take. What JSON cannot carry (dates, sets, keys that are no text) is refused here.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from slidectl.errors import BadFile, UsageError

# Patterns that an everyday command does not need are compiled when they are.
_NUMERIC = frozenset("0123456789.+-eE")
_WORDS = r"[A-Za-z_/][A-Za-z0-9_/.-]*( [A-Za-z0-9_/.-]+)*\Z"
_PAIR = r"(?P<open>\{?)[ ]*(?P<key>[A-Za-z_][A-Za-z0-9_]*):[ ]+(?P<value>[^:#,{}\[\]'\"&*!|>%@`]+?)[ ]*(?P<close>\}?)\Z"
_QUOTED_PAIR = (
    r"(?P<open>\{?)[ ]*(?P<key>[A-Za-z_][A-Za-z0-9_]*):[ ]+"
    r"(?P<value>'[ !#-&(-~]*'|\"[ !#-&(-\[\]-~]*\")[ ]*(?P<close>\}?)\Z"
)
_CONSTANTS = {
    "": None, "~": None, "null": None, "Null": None, "NULL": None,
    ".inf": float("inf"), ".Inf": float("inf"), ".INF": float("inf"), "+.inf": float("inf"), "-.inf": float("-inf"),
    ".nan": float("nan"), ".NaN": float("nan"), ".NAN": float("nan"),
}  # fmt: skip
_BOOLEANS = {"yes": True, "true": True, "on": True, "no": False, "false": False, "off": False}
# YAML 1.1 wants a point and a signed exponent in a float, and no sign before a bare point; people do not.
_FLOAT_WITHOUT_POINT = r"[-+]?(?:[0-9][0-9_]*\.?[0-9_]*[eE][-+]?[0-9]+|\.[0-9][0-9_]*(?:[eE][-+]?[0-9]+)?)$"
_SHORT = 4096
_MOST_NODES = 1_000_000

_UNKNOWN: Any = object()


def read(text: str) -> Any:
    """The value of one argument. Raises UsageError for text that is no YAML, or holds what a message cannot."""
    stripped = text.strip(" ")
    for attempt in (_scalar, _pair, _json):
        value = attempt(stripped)
        if value is not _UNKNOWN:
            return value
    return read_yaml(text, shown(text))


class LostQuotes(UsageError):
    """One value that the shell took apart at its blanks. The hint is the line to type."""

    def __init__(self, words: Sequence[str], whole: str) -> None:
        super().__init__(f"the shell made {len(words)} words of one value: it needs quotes", _retyped(words, whole))


def check_quotes(words: Sequence[str], fields: Iterable[str] = ()) -> None:
    """Raises LostQuotes for `data: 1.0` and `{data: 1.0}` in two words. `fields` are those of the message."""
    if len(words) < 2:
        return
    first, whole = words[0], " ".join(words)
    is_field = first.endswith(":") and first[:-1] in fields
    is_open = first[:1] in ("{", "[") and _depth(first) > 0 and _depth(whole) == 0
    if not is_field and not is_open:
        return
    if is_field and len(words) > 2 and not _is_yaml(whole):
        whole = "{" + re.sub(r"\s(?=\w+:(\s|$))", ", ", whole) + "}"
    raise LostQuotes(words, whole)


def _depth(text: str) -> int:
    """How many brackets stay open."""
    return sum(text.count(mark) for mark in "{[") - sum(text.count(mark) for mark in "}]")


def _is_yaml(text: str) -> bool:
    try:
        read_yaml(text)
    except UsageError:
        return False
    return True


def _retyped(words: Sequence[str], whole: str) -> str:
    """The command line of this process with `whole` in quotes in the place of the words."""
    from shlex import quote

    typed = sys.argv[1:]
    for start in range(len(typed) - len(words) + 1):
        if typed[start : start + len(words)] == list(words):
            before, after = typed[:start], typed[start + len(words) :]
            program = [] if before[:1] == ["ros"] else ["slidectl"]
            before = before[1:] if before[:1] == ["ros"] else before
            return "type: " + " ".join([*program, *map(quote, before), quote(whole), *map(quote, after)])
    return f"type it as: {quote(whole)}"


def is_numeric(value: Any) -> bool:
    """True for numbers, booleans, and lists and mappings of these: nothing in them can be an expression or a time."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return all(map(is_numeric, value))
    return isinstance(value, bool | int | float)


def shown(text: str) -> str:
    """How errors name a value that was typed."""
    return f"value {text if len(text) <= 60 else text[:57] + '...'!r}"


def read_yaml(text: str, what: str = "value", *, angles: bool = False) -> Any:
    """The value of one YAML document; `angles`: whether deg(90) is one.

    Raises UsageError as `read` does; `what` names the text in it.
    """
    documents = list(read_documents(text, what, angles=angles))
    if len(documents) > 1:
        raise UsageError(f"the {what} holds {len(documents)} YAML documents where one was expected")
    return documents[0] if documents else None


def read_documents(text: str, what: str, file: str | None = None, *, angles: bool = False) -> Iterator[Any]:
    """The values of all YAML documents in a text, in order.

    Raises UsageError as `read` does; what is no YAML in a `file` is BadFile with the line.
    """
    import yaml

    try:
        for value in yaml.load_all(text, _loader(len(text), angles)):
            yield _Checker(what).checked(value)
    except yaml.YAMLError as error:
        if file is not None:
            raise BadFile(*_located(error, file)) from None
        raise UsageError(f"the {what} is not valid YAML: {_explained(error)}") from None
    except RecursionError:
        if file is not None:
            raise BadFile("is nested too deeply", file) from None
        raise UsageError(f"the {what} is nested too deeply") from None
    except (ValueError, ArithmeticError) as error:
        raise UsageError(f"the {what} cannot be read: {error}") from None


def _scalar(text: str) -> Any:
    if text and _NUMERIC.issuperset(text):
        return _number(text)
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if text.lower() in _BOOLEANS and (text.islower() or text.isupper() or text.istitle()):
        return _BOOLEANS[text.lower()]
    return text if re.match(_WORDS, text) else _UNKNOWN


def _number(text: str) -> Any:
    digits = text.lstrip("+-")
    if digits.isdigit() and digits[0] == "0" and digits != "0":
        return _UNKNOWN  # octal in YAML 1.1
    try:
        return int(text) if digits.isdigit() else float(text)
    except ValueError:
        return _UNKNOWN


def _pair(text: str) -> Any:
    """`data: 1.0`, `{data: 1.0}` and `name: 'a controller'`: what every tutorial types."""
    is_quoted = "'" in text or '"' in text
    match = re.match(_QUOTED_PAIR if is_quoted else _PAIR, text)
    if not match or bool(match["open"]) != bool(match["close"]):
        return _UNKNOWN
    value = match["value"][1:-1] if is_quoted else _scalar(match["value"])
    return _UNKNOWN if value is _UNKNOWN or _scalar(match["key"]) != match["key"] else {match["key"]: value}


def _json(text: str) -> Any:
    if not text.startswith(("{", "[", '"')):
        return _UNKNOWN
    try:
        return json.loads(text, parse_constant=_no_json)
    except (ValueError, RecursionError):
        return _UNKNOWN


def _no_json(text: str) -> Any:
    raise ValueError(text)


def _loader(length: int, angles: bool) -> Any:
    import yaml

    # libyaml is faster, and wrong by a line about where an error is.
    fast = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    base = fast if length > _SHORT else yaml.SafeLoader
    loader: Any = type("Loader", (base,), {})
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
        raise ValueError(f"{node.value.strip()!r} is no angle: {error}") from None


def _located(error: Any, file: str) -> tuple[str, str, int | None]:
    """What BadFile wants to know: the problem, the file and the line."""
    mark = getattr(error, "problem_mark", None)
    return f"not valid YAML: {_problem(error)}", file, mark.line + 1 if mark else None


def _explained(error: Any) -> str:
    """One line out of PyYAML's report: the problem and its place."""
    mark = getattr(error, "problem_mark", None)
    return _problem(error) + (f" (line {mark.line + 1}, column {mark.column + 1})" if mark else "")


def _problem(error: Any) -> str:
    return str(getattr(error, "problem", None) or str(error).splitlines()[0])


class _Checker:
    """Copies a value, and raises UsageError for what no message holds and for aliases that multiply without end."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.left = _MOST_NODES

    def checked(self, value: Any) -> Any:
        self.left -= 1
        if self.left < 0:
            raise UsageError(f"the {self.what} unfolds to more than {_MOST_NODES} values")
        if isinstance(value, dict):
            return {self._key(key): self.checked(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [self.checked(item) for item in value]
        if value is None or isinstance(value, bool | int | float | str):
            return value
        kind = "date" if hasattr(value, "isoformat") else type(value).__name__
        raise UsageError(f"{value} in the {self.what} is a {kind} to YAML", "write it in quotes if it is text")

    def _key(self, key: Any) -> str:
        if isinstance(key, str):
            return key
        raise UsageError(f"the key {key!r} in the {self.what} is not text", "write it in quotes")
