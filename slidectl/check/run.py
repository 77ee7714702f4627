"""One check from what the user typed: finds out what the file is, and has it checked with what belongs to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from slidectl.check import controllers, kinds, model
from slidectl.check.findings import Findings
from slidectl.description import models
from slidectl.description.packages import Packages
from slidectl.errors import UsageError


def check(
    source: str,
    arguments: Mapping[str, str],
    packages: Packages,
    parameter_files: Sequence[Path] = (),
    text: bytes | None = None,
    ask_others: bool = True,
) -> Findings:
    """Everything that there is to say of a file.

    Args:
        source: path, or name of a shipped model; what to call `text` when that is given.
        arguments: of xacro or of the launch file.
        parameter_files: files of controllers for a model.
        text: the file's content, when it came from elsewhere.
        ask_others: whether yourdfpy is asked about models too.

    Raises:
        BadFile: no such file. UnknownName: no such model. UsageError: arguments that do not go with the file.
    """
    findings = Findings()
    kind = _kind(source, text)
    if kind != "model" and parameter_files:
        raise UsageError(f"--controllers goes with a model; {source} is a file of {kind}")
    if kind == "controllers":
        _refuse_arguments(source, arguments)
        controllers.check(source, None, findings, text)
        return findings
    robot = model.check(text.decode("utf-8", "replace") if text else source, arguments, packages, findings, ask_others)
    for path in parameter_files:
        controllers.check(path, robot, findings)
    return findings


def _kind(source: str, text: bytes | None) -> kinds.Kind:
    if text is not None:
        return kinds.of_text(text, source)
    if source in models.shipped():
        return "model"
    path = Path(source).expanduser()
    return kinds.of_file(path) if path.exists() or path.suffix else "model"


def _refuse_arguments(source: str, arguments: Mapping[str, str]) -> None:
    for name in arguments:
        raise UsageError(f"{name}:= has no meaning for {source}, a file of parameters")
