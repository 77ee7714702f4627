"""The places of the values in a tree of parameters, and the plain judgement of one value.

What trees mean is for controllers.py and hardware.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from slidectl import names
from slidectl.check.findings import Findings
from slidectl.control.params import Parameter, described
from slidectl.description.robot import Verdict
from slidectl.errors import NotThere

_LONGEST = 60


@dataclass
class ParameterFile:
    """Where the parameters of a tree were written; `namespace` is where the root of the tree is loaded.

    A tree comes from one file most often; `file` is that, or the first of several.
    """

    file: str
    places: Mapping[str, tuple[str, int | None]]
    """File and line by the path in the tree, as `/slider/c/pid/p` or `/slider/c/extra_joints[0]/name`."""
    findings: Findings
    namespace: str = "/"

    def place(self, path: str) -> tuple[str, int | None]:
        """Of a path in the tree, or of the nearest one above it, or of the first below it."""
        above = path
        while above:
            if above in self.places:
                return self.places[above]
            above = above[: max(above.rfind("/"), above.rfind("["), 0)]
        below = (place for name, place in self.places.items() if name.startswith(f"{path}/"))
        return next(below, (self.file, 1))

    def add(self, verdict: Verdict, path: str, text: str) -> None:
        """A finding on a path."""
        self.findings.add(verdict, self.full(path), text, *self.place(path))

    def absent(self, path: str, message: str, hint: str, thing: str) -> None:
        """A finding on a path that names what is not there: wrong, or left out like all else that is not there."""
        if self.findings.missing.keeps_going:
            file, line = self.place(path)
            error = NotThere(f"{self.full(path)}: {message}", file, line, hint, thing)
            self.findings.missing.note(error, "it is left out")
        else:
            self.add("wrong", path, f"{message} {hint}")

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
