"""Which types there are, and where their definitions come from: the data files here, then the rosbags type system.

The files hold every type that slidectl itself speaks, so that a daemon starts, and answers, without building
rosbags' store (some hundred milliseconds); that one has the other common ROS 1 types. All is read when asked for.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator

from slidectl.errors import UnknownName
from slidectl.msgs.parsing import Constant, Definition, Service, parse_action, parse_message, parse_service
from slidectl.msgs.schema import Field

_DATA = os.path.join(os.path.dirname(__file__), "data")
# Type names come from clients too: nothing but two plain words may become a path.
_LEGAL = re.compile(r"[A-Za-z]\w{0,99}/[A-Za-z]\w{0,99}", re.ASCII)
_LONGEST_SHOWN = 120
_ACTION_PARTS = ("ActionGoal", "ActionResult", "ActionFeedback", "Action", "Goal", "Result", "Feedback")
# What rosbags' ROS 1 store knows beyond the data files lies in these packages; no need to build it for others.
_ROSBAGS_PACKAGES = {
    *("actionlib", "bond", "diagnostic_msgs", "nav_msgs"),
    *("sensor_msgs", "shape_msgs", "stereo_msgs", "visualization_msgs"),
}

_definitions: dict[str, Definition] = {}
_services: dict[str, Service] = {}


def definition_of(type_name: str) -> Definition:
    """The definition of `pkg/Type`. Raises UnknownName."""
    found = _definitions.get(type_name) or _find(type_name)
    if found is None:
        short = type_name[:_LONGEST_SHOWN]
        raise _unknown("message type", short, _siblings_here(short) or type_names())
    return found


def service_of(name: str) -> Service:
    """The service type `pkg/Type`. Raises UnknownName."""
    found = _find_service(name)
    if found is None:
        raise _unknown("service type", name, service_names())
    return found


def fields(type_name: str) -> tuple[Field, ...]:
    """The fields in their order. Raises UnknownName."""
    return definition_of(type_name).fields


def constants(type_name: str) -> tuple[Constant, ...]:
    """The constants (name, type, value) in their order. Raises UnknownName."""
    return definition_of(type_name).constants


def request_type(service: str) -> str:
    """The type of a service's request, `pkg/TypeRequest`: as good as any message type. Raises UnknownName."""
    return service_of(service).request.name


def response_type(service: str) -> str:
    """The type of a service's response, `pkg/TypeResponse`. Raises UnknownName."""
    return service_of(service).response.name


def exists(type_name: str) -> bool:
    """True when `pkg/Type` is a message type that is known."""
    return type_name in _definitions or _find(type_name) is not None


def service_exists(name: str) -> bool:
    """True when `pkg/Type` is a service type that is known."""
    return _find_service(name) is not None


def type_names() -> list[str]:
    """All message types, those of actions too, without the requests and responses of services; sorted."""
    from slidectl.msgs import rosbags_types

    return sorted(_names_here() | set(rosbags_types.names()))


def service_names() -> list[str]:
    """All service types, sorted."""
    return sorted(_names("srv"))


def _names_here() -> set[str]:
    return {*_names("msg"), *(stem + part for stem in _names("action") for part in _ACTION_PARTS)}


def _siblings_here(type_name: str) -> list[str]:
    """The types of its package, when all of them are in files: a slip of the pen must not cost a daemon 0.1 s.

    Of one without a package, all that are in files.
    """
    package = type_name.rpartition("/")[0]
    if package in _ROSBAGS_PACKAGES:
        return []
    if not package:
        return sorted(_names_here())
    return sorted(name for name in _names_here() if name.startswith(f"{package}/"))


def _names(kind: str) -> Iterator[str]:
    for package in os.listdir(_DATA):
        folder = os.path.join(_DATA, package, kind)
        if os.path.isdir(folder):
            yield from (f"{package}/{file.removesuffix('.' + kind)}" for file in os.listdir(folder))


def _unknown(kind: str, name: str, known: list[str]) -> UnknownName:
    """Shows the names of the same package, else those of the same last word, else all."""
    name = name[:_LONGEST_SHOWN]
    package, _, word = name.rpartition("/")
    siblings = [other for other in known if package and other.startswith(package + "/")]
    namesakes = [other for other in known if other.endswith("/" + word)]
    return UnknownName(kind, name, siblings or namesakes or known)


def _find(type_name: str) -> Definition | None:
    if not _LEGAL.fullmatch(type_name):
        return None
    return _from_message(type_name) or _from_service(type_name) or _from_action(type_name) or _from_rosbags(type_name)


def _from_message(type_name: str) -> Definition | None:
    text = _read(type_name, "msg")
    if text is None:
        return None
    found = _definitions[type_name] = parse_message(text, type_name)
    return found


def _from_service(type_name: str) -> Definition | None:
    for suffix in ("Request", "Response"):
        if type_name.endswith(suffix):
            _find_service(type_name.removesuffix(suffix))
    return _definitions.get(type_name)


def _from_action(type_name: str) -> Definition | None:
    for part in _ACTION_PARTS:
        stem = type_name.removesuffix(part)
        text = _read(stem, "action") if stem != type_name else None
        if text is not None:
            _definitions.update(parse_action(text, stem))
            return _definitions[type_name]
    return None


def _from_rosbags(type_name: str) -> Definition | None:
    if type_name.partition("/")[0] not in _ROSBAGS_PACKAGES:
        return None
    from slidectl.msgs import rosbags_types

    found = rosbags_types.definition_of(type_name)
    if found is not None:
        _definitions[type_name] = found
    return found


def _find_service(name: str) -> Service | None:
    if name not in _services and _LEGAL.fullmatch(name):
        text = _read(name, "srv")
        if text is not None:
            service = _services[name] = parse_service(text, name)
            _definitions[service.request.name] = service.request
            _definitions[service.response.name] = service.response
    return _services.get(name)


def _read(name: str, kind: str) -> str | None:
    package, _, word = name.partition("/")
    try:
        with open(os.path.join(_DATA, package, kind, f"{word}.{kind}"), encoding="utf-8") as file:
            return file.read()
    except FileNotFoundError:
        return None
