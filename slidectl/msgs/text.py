"""Types as text and their md5 sums, as `rosmsg` and `rossrv` print them.

The sum is ROS 1's: over the definition without comments, constants first, nested types replaced by their own sum
(genmsg's `compute_md5_text`).
"""

from __future__ import annotations

from functools import cache

from slidectl.msgs.catalogue import definition_of, service_of
from slidectl.msgs.parsing import Definition
from slidectl.msgs.schema import PRIMITIVES


def definition(type_name: str) -> str:
    """The text of the type's `.msg` file. Raises UnknownName."""
    return definition_of(type_name).text


def service_definition(name: str) -> str:
    """The text of the service's `.srv` file. Raises UnknownName."""
    return service_of(name).text


@cache
def md5(type_name: str) -> str:
    """The 32 hexadecimal digits that ROS 1 peers compare. Raises UnknownName."""
    return _digest(_md5_text(definition_of(type_name)))


@cache
def service_md5(name: str) -> str:
    """As `md5`, of a service. Raises UnknownName."""
    service = service_of(name)
    return _digest(_md5_text(service.request) + _md5_text(service.response))


def show(type_name: str) -> str:
    """The type with its nested types, two blanks a level, constants as NAME=value; no newline at the end."""
    return "\n".join(_lines(definition_of(type_name), ""))


def show_service(name: str) -> str:
    """Request, `---`, response, each as `show` prints it."""
    service = service_of(name)
    return "\n".join([*_lines(service.request, ""), "---", *_lines(service.response, "")])


def _digest(text: str) -> str:
    from hashlib import md5 as new_md5

    return new_md5(text.encode(), usedforsecurity=False).hexdigest()


def _constant_lines(of: Definition) -> list[str]:
    return [f"{c.type} {c.name}={text}" for c, text in zip(of.constants, of.constant_texts, strict=True)]


def _md5_text(of: Definition) -> str:
    fields = [f"{f.type_text if f.type in PRIMITIVES else md5(f.type)} {f.name}" for f in of.fields]
    return "\n".join(_constant_lines(of) + fields)


def _lines(of: Definition, indent: str) -> list[str]:
    lines = [indent + line for line in _constant_lines(of)]
    for field in of.fields:
        lines.append(f"{indent}{field.type_text} {field.name}")
        if field.type not in PRIMITIVES:
            lines += _lines(definition_of(field.type), indent + "  ")
    return lines
