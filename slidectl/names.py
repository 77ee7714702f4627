"""Graph names: which are legal, how a relative name becomes absolute, and how a short name is completed.

The rules are ROS's. In addition, the command line accepts the unique end of a name.
Standard library only.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from slidectl.errors import AmbiguousName, BadName, UnknownName

OWN_NODE = "/slidectl"
"""The node, and the namespace, of topics and services that neither ROS nor Gazebo has."""
LONGEST = 1000
"""The most characters of a name with its namespaces. A longer name is an error or an attack."""

_LEGAL = r"(?a)(?!.*//)(?!.+/\Z)[A-Za-z/~][\w/]*\Z"
_COMPONENT = r"(?a)[A-Za-z]\w*\Z"
_PARAMETER = r"(?=.)/?(?:[^\s\x00-\x1f\x7f/~][^\s\x00-\x1f\x7f/]*(?:/(?!\Z)|\Z))*\Z"


def is_legal(name: str) -> bool:
    """True for a legal graph name (no double or trailing slash; `/` alone is the root; not longer than LONGEST)."""
    return len(name) <= LONGEST and bool(re.match(_LEGAL, name))


def is_component(name: str) -> bool:
    """True for one component of a graph name: a letter, then letters, digits and '_'."""
    return len(name) <= LONGEST and bool(re.match(_COMPONENT, name))


def check(name: str) -> str:
    """Return the name. Raises BadName when it is not legal."""
    if not is_legal(name):
        raise TooLong(name) if len(name) > LONGEST else BadName(name)
    return name


class TooLong(BadName):
    """A name that is longer than LONGEST."""

    def __init__(self, name: str) -> None:
        super().__init__(name, f"name: it has {len(name)} characters, and {LONGEST} is the most")


def check_absolute(name: str, kind: str) -> str:
    """Return the name of a topic or service. Raises BadName unless it begins with a slash and more follows."""
    if not check(name).startswith("/") or name == "/":
        hint = "that is the root of all names" if name == "/" else f"write /{name}"
        raise BadName(name, f"name of a {kind}: it begins with '/', and more follows", hint)
    return name


def check_parameter(name: str) -> str:
    """Return the name of a parameter. Raises BadName unless it is legal: `joint-1.2` is, a name with blanks is not."""
    if len(name) > LONGEST:
        raise TooLong(name)
    if not re.match(_PARAMETER, name):
        raise BadName(name, "name of a parameter: parts without blanks, with a '/' between and no '~' in front")
    return name


def check_robot(name: str) -> str:
    """Return the name of a robot. Raises BadName unless it is one component of a graph name."""
    if len(name) > LONGEST:
        raise TooLong(name)
    if not is_component(name):
        raise BadName(name, "name of a robot: a letter, then letters, digits and '_'", "give it another name (-n NAME)")
    return name


def legal_robot(name: str) -> str:
    """The name of a robot for any text: the text itself if it is legal, else the nearest name that is.

    Gazebo takes any text as the name of a model, and here it is a part of names of topics. Accents are dropped, other
    signs become '_', and a name that does not begin with a letter gets `robot_` before it.

    Raises BadName for no text at all, TooLong.
    """
    if is_component(name) or not name or len(name) > LONGEST:
        return check_robot(name)
    import unicodedata  # needed for odd names alone

    plain = unicodedata.normalize("NFKD", name)
    plain = "".join(sign for sign in plain if not unicodedata.combining(sign))
    plain = re.sub(r"(?a)\W+", "_", plain).strip("_")
    if not plain:
        return "robot"
    return plain[:LONGEST] if plain[0].isalpha() else f"robot_{plain}"[:LONGEST]


def remark_on_robot(name: str) -> str:
    """The remark that the name of a robot was changed by `legal_robot`; empty if it was not."""
    legal = legal_robot(name)
    return "" if legal == name else f"{name!r} cannot be a part of a topic's name: the robot is {legal} here"


def legal_namespace(name: str) -> str:
    """The namespace that a model's name makes, `/name`: each part of the name legal; that of `/` is the root."""
    return "/" + "/".join(legal_robot(part) for part in name.split("/") if part)


def join(namespace: str, name: str) -> str:
    """`name` under `namespace`, absolute; an absolute name stays as it is."""
    if name.startswith("/"):
        return name
    return "/" + "/".join(part for part in (namespace.strip("/"), name.strip("/")) if part)


def parent(name: str) -> str:
    """The namespace of `name`; that of the root is the root."""
    return name.rpartition("/")[0] or "/"


def is_under(name: str, namespace: str) -> bool:
    """True when `name` is `namespace` or lies below it, on whole components."""
    base = namespace.rstrip("/")
    return not base or name == base or name.startswith(base + "/")


def cut_from_field(text: str) -> Iterator[tuple[str, str]]:
    """All ways to cut `TOPIC/field[i]` into topic and field, the longest topic first; an index belongs to the field."""
    plain = text.partition("[")[0]
    end = len(text) if plain == text else plain.rfind("/")
    while end > 0:
        yield text[:end], text[end + 1 :]
        end = text.rfind("/", 0, end)


def resolve(name: str, known: Iterable[str], *, kind: str, namespace: str = "/") -> str:
    """The full name that `name` means: exact if absolute, else under `namespace`, else the unique end of a known name.

    Raises:
        UnknownName: nothing fits. AmbiguousName: several do.
    """
    names = set(known)
    exact = join(namespace, name)
    if exact in names:
        return exact
    if name.startswith("/"):
        raise UnknownName(kind, name, sorted(names))
    matches = sorted(n for n in names if n.endswith("/" + name))
    if not matches:
        raise UnknownName(kind, name, sorted(names))
    inside = [n for n in matches if is_under(n, namespace)] if namespace.strip("/") else []
    matches = inside if len(matches) > 1 and inside else matches
    if len(matches) > 1:
        raise AmbiguousName(kind, name, matches)
    return matches[0]
