"""A tree of parameters with the places of its values, and the plain judgement of one value.

What trees mean is for controllers.py and hardware.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from slidectl import names
from slidectl.check.findings import Findings
from slidectl.control.parameters import Parameter
from slidectl.control.params import described
from slidectl.description.robot import Verdict

_LONGEST = 60


@dataclass
class ParameterFile:
    """Where the parameters of a tree were written; `namespace` is where the file's root is loaded."""

    file: str
    lines: Mapping[str, int]
    """By the path in the file."""
    findings: Findings
    namespace: str = "/"
    first_line: int = 1

    def line(self, path: str) -> int:
        """Of a path in the file, or of the nearest one above it."""
        while path:
            if path in self.lines:
                return self.lines[path]
            path = path[: max(path.rfind("/"), path.rfind("["), 0)]
        return self.first_line

    def add(self, verdict: Verdict, path: str, text: str, about: str | None = None) -> None:
        """A finding on a path; `about` is a path below it that has no line of its own."""
        self.findings.add(verdict, self.full(about or path), text, self.file, self.line(path))

    def full(self, path: str) -> str:
        """The parameter's name once it is loaded."""
        return names.join(self.namespace, path.strip("/")) if path.strip("/") else self.namespace

    def unknown(self, path: str, text: str, value: Any) -> None:
        """A finding on a parameter that nobody reads, with all that is below it."""
        below = f" (nor has what is below it: {', '.join(map(str, value))})" if isinstance(value, Mapping) else ""
        self.add("ignored", path, text + below)

    def value(self, path: str, value: Any, parameter: Parameter) -> None:
        """A finding on a value that has nothing about it but its type."""
        if parameter.kind.convert(value) is None:
            self.add(
                "wrong", path, f"must be {parameter.kind.words}, not {described(value)}; {_consequence(parameter)}"
            )
        else:
            self.add(
                "used", path, f"{shown(value)}{' ' + parameter.unit if parameter.unit else ''}; {parameter.meaning}"
            )


def _consequence(parameter: Parameter) -> str:
    if "[]/" in parameter.name:
        return "its entry is skipped"
    if parameter.required:
        return "it is required"
    return "it counts as not set" + (f": {shown(parameter.default)}" if parameter.default is not None else "")


def shown(value: Any) -> str:
    """A value as YAML would have it, cut when it is long."""
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, Mapping):
        text = "{" + ", ".join(f"{key}: {shown(item)}" for key, item in value.items()) + "}"
    elif isinstance(value, list):
        text = "[" + ", ".join(map(shown, value)) + "]"
    else:
        text = str(value)
    return text if len(text) <= _LONGEST else text[:_LONGEST] + " ..."
