"""Runs one check of what the user typed: finds the kind of the file, and calls the check for it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from slidectl import names
from slidectl.check import controllers, file_kinds, model, scenes
from slidectl.check.findings import Findings
from slidectl.control import registry
from slidectl.description import controllers_file, models, sdf
from slidectl.description.gazebo_tags import TRANSMISSIONS
from slidectl.description.missing import Missing
from slidectl.description.packages import Packages, is_file, shown
from slidectl.description.parameter_trees import Tree
from slidectl.description.robot import Robot, namespace_of
from slidectl.errors import BadFile, UsageError


def check(
    words: Sequence[str],
    arguments: Mapping[str, str],
    packages: Packages,
    parameter_files: Sequence[Path] = (),
    text: bytes | None = None,
    second_opinion: bool = False,
    strict: bool = False,
    missing: Missing | None = None,
    transmissions: str | None = None,
    imports: Sequence[str] = (),
) -> Findings:
    """Check a file and return all findings.

    Args:
        words: a path, the name of a shipped model or launch file, or package and file. If `text` is given, its name.
        arguments: of xacro or of the launch file.
        parameter_files: files of controllers for a model.
        text: the content of the file, if it is not read from a file.
        second_opinion: compare models with the reading of yourdfpy too.
        strict: refuse masses, inertias and shapes of models that a spawn would correct.
        missing: collects things that the files name and that do not exist.
        transmissions: how a model's transmissions count; overrides the model.
        imports: modules, or files that end with `.py`, with further controllers and hardware.

    Raises:
        BadFile: no such file. UnknownName: no such model, or no such file in the package. UnknownPackage. UsageError:
            arguments that do not fit the file.
    """
    for module in imports:
        registry.common.add_module(module)
    findings = Findings(missing)
    kind, words = _resolved(words, text, packages)
    _refuse_what_does_not_fit(kind, words, arguments, parameter_files)
    source = words[0]
    if kind == "launch":
        from slidectl.extensions.launch import launch_check

        launch_check.check(words, arguments, packages, findings, text, second_opinion, strict)
    elif kind == "controllers":
        controllers.check(source, None, findings, text)
    elif kind == "scene":
        findings.is_drivable = scenes.check(sdf.find(source, packages), packages, findings, text, strict)
        findings.add_missing()
    else:
        title = source if text is not None else None
        read = text.decode("utf-8", "replace") if text is not None else source
        if text is None and (path := models.shipped().get(source)) is not None:
            read = shown(path)  # the path in its shortest form
        texts = {file: models.read_file(file, pipes=True) for file in parameter_files}
        transmission_values = _transmission_values(
            [tree for file, content in texts.items() if (tree := _tree(content, str(file))) is not None]
        )
        robot = model.check(
            read, arguments, packages, findings, second_opinion, title, strict, transmissions, transmission_values
        )
        usable = [controllers.check(file, robot, findings, content) for file, content in texts.items()]
        findings.is_drivable = robot is not None and (any(usable) or not usable)
        findings.add_missing()
    return findings


def _resolved(words: Sequence[str], text: bytes | None, packages: Packages) -> tuple[file_kinds.Kind, Sequence[str]]:
    """The kind and the path for the words. PACKAGE FILE becomes a path, except for a launch file: launch finds that."""
    source = words[0]
    if len(words) > 1 and source not in models.shipped() and not is_file(Path(source)):
        if file_kinds.of_name(words[1]) in ("launch", None):
            return "launch", words
        from slidectl.extensions.launch import files

        words = [shown(files.find_in_package(source, words[1], packages)), *words[2:]]
    return _kind(words[0], text), words


def _refuse_what_does_not_fit(
    kind: file_kinds.Kind, words: Sequence[str], arguments: Mapping[str, str], parameter_files: Sequence[Path]
) -> None:
    """Raise UsageError for words, files and arguments that a file of this kind does not take."""
    source = words[0]
    if kind != "launch" and len(words) > 1:
        hint = "slidectl check --help shows the order of arguments"
        if kind == "model" and file_kinds.of_name(words[1]) == "controllers":
            hint = f"a file of controllers is given with an option: --controllers {words[1]}"
        raise UsageError(f"{words[1]!r} is not KEY:=VALUE", hint)
    if kind != "model" and parameter_files:
        what = "SDF" if kind == "scene" else f"a file of {kind}"
        raise UsageError(f"--controllers goes with a model; {source} is {what}")
    takes_none = {"controllers": f"{source}, a file of parameters", "scene": f"{source}: SDF takes no arguments"}
    if kind in takes_none:
        for name in arguments:
            raise UsageError(f"{name}:= has no meaning for {takes_none[kind]}")


def _transmission_values(trees: Sequence[Tree]) -> model.TransmissionValues:
    """Give the values of TRANSMISSIONS in parameter files, the last file first."""

    def values(robot: Robot) -> Iterator[object]:
        namespace = namespace_of(robot, robot.name)
        for tree in reversed(trees):
            placed, _ = controllers_file.retarget(tree, namespace)
            yield controllers_file.at(placed, names.join(namespace, TRANSMISSIONS))

    return values


def _tree(text: bytes, file: str) -> Tree | None:
    """The parameters of a file; None when it is broken, which its own check reports."""
    from slidectl.description import yaml_tree

    try:
        return controllers_file.plain(yaml_tree.read(text, file))
    except BadFile:
        return None


def _kind(source: str, text: bytes | None) -> file_kinds.Kind:
    """The kind of one word; an unknown name is taken for a model. Raises BadFile: XML of an unknown kind."""
    if text is not None:
        return file_kinds.of_text(text, source)
    if source.startswith(sdf.SCHEME):
        return "scene"
    path = Path(os.path.expanduser(source))
    if source in models.shipped():
        return "model"
    if is_file(path) or path.suffix:
        return file_kinds.of_name(path.name) or file_kinds.of_text(models.read_file(path), str(path))
    from slidectl.extensions.launch import files

    return "launch" if source in files.shipped() else "model"
