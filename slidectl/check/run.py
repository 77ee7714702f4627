"""One check from what the user typed: finds out what the file is, and has it checked with what belongs to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from slidectl.check import controllers, kinds, model
from slidectl.check.findings import Findings
from slidectl.description import models
from slidectl.description.missing import Missing
from slidectl.description.packages import Packages, is_file, shown
from slidectl.errors import UsageError


def check(
    words: Sequence[str],
    arguments: Mapping[str, str],
    packages: Packages,
    parameter_files: Sequence[Path] = (),
    text: bytes | None = None,
    ask_others: bool = False,
    strict: bool = False,
    missing: Missing | None = None,
) -> Findings:
    """Everything that there is to say of a file.

    Args:
        words: a path, the name of a shipped model or launch file, or package and file; one that says what to call
            `text`, when that is given.
        arguments: of xacro or of the launch file.
        parameter_files: files of controllers for a model.
        text: the file's content, when it came from elsewhere.
        ask_others: whether yourdfpy is asked about models too.
        strict: whether masses, inertias and shapes of models that spawn would mend are refused.
        missing: takes in what the files name and is not there.

    Raises:
        BadFile: no such file. UnknownName: no such model, or no such file in the package. UnknownPackage. UsageError:
            arguments that do not go with the file.
    """
    findings = Findings(missing)
    words = _out_of_package(words, packages)
    source = words[0]
    kind = _kind(words, text)
    if kind != "model" and parameter_files:
        raise UsageError(f"--controllers goes with a model; {source} is a file of {kind}")
    if kind == "launch":
        from slidectl.check import launch_check

        launch_check.check(words, arguments, packages, findings, text, ask_others, strict)
        return findings
    if kind == "controllers":
        _refuse_arguments(source, arguments)
        controllers.check(source, None, findings, text)
        return findings
    title = source if text is not None else None
    robot = model.check(_model(source, text), arguments, packages, findings, ask_others, title, strict)
    findings.is_drivable = robot is not None
    for path in parameter_files:
        controllers.check(path, robot, findings)
    findings.tell_missing()
    return findings


def _out_of_package(words: Sequence[str], packages: Packages) -> Sequence[str]:
    """The path instead of package and file, where the file is no launch file; those are found as launch finds them."""
    if not _begins_with_package(words) or kinds.of_name(words[1]) in ("launch", None):
        return words
    from slidectl.launch import files

    return [shown(files.find_in_package(words[0], words[1], packages)), *words[2:]]


def _begins_with_package(words: Sequence[str]) -> bool:
    return len(words) > 1 and words[0] not in models.shipped() and not is_file(Path(words[0]))


def _kind(words: Sequence[str], text: bytes | None) -> kinds.Kind:
    """What the words mean; a name that nothing has is an unknown model.

    Raises:
        UsageError: words that only launch files can have after them. BadFile: XML of neither kind.
    """
    kind = "launch" if _begins_with_package(words) else _kind_of_one(words, text)
    if kind != "launch" and len(words) > 1:
        raise UsageError(f"{words[1]!r} is not KEY:=VALUE", "slidectl check --help shows the order of arguments")
    return kind


def _kind_of_one(words: Sequence[str], text: bytes | None) -> kinds.Kind:
    if text is not None:
        return kinds.of_text(text, words[0])
    path = Path(words[0]).expanduser()
    if words[0] in models.shipped():
        return "model"
    if is_file(path) or path.suffix:
        return kinds.of_file(path)
    from slidectl.launch import files

    return "launch" if words[0] in files.shipped() else "model"


def _model(source: str, text: bytes | None) -> str:
    """What to read: the text, or a path, which of a shipped model is the shortest that leads there."""
    if text is not None:
        return text.decode("utf-8", "replace")
    path = models.shipped().get(source)
    return source if path is None else shown(path)


def _refuse_arguments(source: str, arguments: Mapping[str, str]) -> None:
    for name in arguments:
        raise UsageError(f"{name}:= has no meaning for {source}, a file of parameters")
