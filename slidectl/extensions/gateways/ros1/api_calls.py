"""Methods of ROS's XML-RPC APIs: their arguments, the checks of these, and ROS's error texts.

An answer is [code, message, value]: code 1 for success, 0 for failure, -1 for a caller's error.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any
from urllib.parse import urlsplit

from slidectl import names
from slidectl.errors import Refused, SlidectlError, cut
from slidectl.extensions.gateways.ros1.xmlrpc import XmlRpcFault

Answered = tuple[int, str, Any]
Check = Callable[[Any, str], Any]
"""Takes an argument and the caller's name; returns the converted argument. Raises Invalid."""
Method = Callable[..., Answered | Awaitable[Answered]]

ANY_TYPE = "*"
_LONGEST_URI = 2000


class Invalid(Exception):
    """An argument that is not allowed."""


class Api:
    """A table of methods by name. `add` takes a method, the value of its answer on failure, and the checks of its
    arguments except the first, the caller's name.
    """

    def __init__(self) -> None:
        self._methods: dict[str, tuple[Method, Any, tuple[Check, ...]]] = {}

    def add(self, method: Method, on_failure: Any, *checks: Check) -> None:
        self._methods[method.__name__] = (method, on_failure, checks)

    async def answer(self, name: str, arguments: list[Any], *context: Any) -> Answered:
        """Call a method. It gets `context`, then the caller and the arguments. Raises XmlRpcFault: no such method."""
        if name not in self._methods:
            raise XmlRpcFault(1, f"<class 'Exception'>:method \"{cut(name, 200)}\" is not supported")
        method, on_failure, checks = self._methods[name]
        if not arguments:
            return -1, "missing required caller_id parameter", on_failure
        caller, *rest = arguments
        if len(rest) != len(checks):
            return -1, "Error: bad call arity", on_failure
        if not isinstance(caller, str):
            return -1, "caller_id must be a string", on_failure
        if len(caller) > names.LONGEST:
            return -1, f"caller_id has more than {names.LONGEST} characters", on_failure
        try:
            checked = [check(value, caller) for check, value in zip(checks, rest, strict=True)]
            answered = method(*context, caller, *checked)
            return answered if isinstance(answered, tuple) else await answered
        except Invalid as error:
            return -1, str(error), on_failure
        except Refused as error:
            return -1, str(error), on_failure
        except SlidectlError as error:
            return 0, f"Internal failure: {error}", on_failure


def anything(value: Any, _: str) -> Any:
    return value


def not_none(parameter: str) -> Check:
    def check(value: Any, _: str) -> Any:
        if value is None:
            raise Invalid(f"ERROR: parameter [{parameter}] must be specified")
        return value

    return check


def key(value: Any, caller: str) -> str:
    """Check the name of a parameter and resolve it."""
    if not value:
        raise Invalid("ERROR: parameter [key] must be specified and non-empty")
    if not isinstance(value, str):
        raise Invalid("ERROR: parameter [key] must be a string")
    return resolve(_bounded("key", value), caller)


def search_key(value: Any, caller: str) -> str:
    """Check the name of a parameter; keep it relative."""
    key(value, caller)
    return str(value)


def uri(parameter: str) -> Check:
    def check(value: Any, _: str) -> str:
        if not value or not isinstance(value, str):
            raise Invalid(f"ERROR: parameter [{parameter}] is not an XMLRPC URI")
        if not value.startswith(("http://", "rosrpc://")):
            raise Invalid(f"ERROR: parameter [{parameter}] is not an RPC URI")
        if len(value) > _LONGEST_URI:
            raise Invalid(f"ERROR: parameter [{parameter}] is longer than {_LONGEST_URI} characters")
        return value

    return check


def name(parameter: str, may_be_root: bool = False) -> Check:
    """Check a graph name and resolve it."""

    def check(value: Any, caller: str) -> str:
        if not value or not isinstance(value, str):
            raise Invalid(f"ERROR: parameter [{parameter}] must be a non-empty string")
        if ":" in value or " " in value:
            raise Invalid(f"ERROR: parameter [{parameter}] contains illegal chars")
        if value == "/" and not may_be_root:
            raise Invalid(f"ERROR: parameter [{parameter}] cannot be the global namespace")
        return resolve(_bounded(parameter, value), caller)

    return check


def subgraph(value: Any, caller: str) -> str:
    """Check a namespace and resolve it; empty stays empty."""
    if not isinstance(value, str):
        raise Invalid("ERROR: parameter [subgraph] must be a string")
    return resolve(_bounded("subgraph", value), caller) if value else ""


def type_name(value: Any, _: str) -> str:
    if value == ANY_TYPE:
        return ANY_TYPE
    if not value or not isinstance(value, str):
        raise Invalid("ERROR: parameter [topic_type] must be a non-empty string")
    if len(value.split("/")) != 2:
        raise Invalid("ERROR: parameter [topic_type] is not a valid package resource name")
    return _bounded("topic_type", value)


def publishers(value: Any, _: str) -> list[str]:
    if not isinstance(value, list):
        raise Invalid("ERROR: param [publishers] must be a list")
    for each in value:
        if not isinstance(each, str):
            raise Invalid("ERROR: param [publishers] must be a list of strings")
        try:
            parts = urlsplit(each)
        except ValueError:
            parts = urlsplit("")
        if not parts.scheme or not parts.netloc:
            raise Invalid(f"ERROR: param [publishers] does not contain valid URLs [{cut(each, 120)}]")
    return value


def protocols(value: Any, _: str) -> list[Any]:
    if not value:
        raise Invalid("ERROR: parameter [protocols] must be specified and non-empty")
    if not isinstance(value, list) or not all(isinstance(each, list) and each for each in value):
        raise Invalid("ERROR: parameter [protocols] must be a list of lists")
    return value


def resolve(text: str, caller: str) -> str:
    """The global name of `text` in the node `caller`: `~x` is private to the node, `x` is in the node's namespace."""
    if text.startswith("/"):
        full = text
    elif text.startswith("~"):
        full = f"{caller}/{text[1:]}"
    else:
        full = f"{names.parent(caller.rstrip('/'))}/{text}"
    return "/" + "/".join(part for part in full.split("/") if part)


def _bounded(parameter: str, text: str) -> str:
    if len(text) > names.LONGEST:
        raise Invalid(f"ERROR: parameter [{parameter}] is longer than {names.LONGEST} characters")
    return text
