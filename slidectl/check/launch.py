"""Checks launch files: tags, parameters, robots, controllers, and whether what nodes look for is there.

Reads the files as `slidectl launch` does, through its loader, and makes its tasks; it starts nothing and runs no
program.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from slidectl.check import launch_nodes
from slidectl.check.controllers import ControllerCheck, ParameterFile
from slidectl.check.findings import Findings
from slidectl.check.launch_parameters import LaunchParameters
from slidectl.check.launch_tags import LaunchTags
from slidectl.description.packages import Packages
from slidectl.errors import BadFile
from slidectl.launch import loader
from slidectl.launch.files import Source, find, shown


def check(
    words: Sequence[str],
    arguments: Mapping[str, str],
    packages: Packages,
    findings: Findings,
    text: bytes | None = None,
    ask_others: bool = False,
    strict: bool = False,
) -> None:
    """Add what there is to say of launch files, which `words` mean as for `slidectl launch`; `text` is the file itself.

    Raises:
        UsageError, UnknownName, UnknownPackage, BadFile: there is no such file, or no such argument.
    """
    sources = find(words, packages) if text is None else [Source(Path.cwd() / words[0], text, words[0])]
    tags = LaunchTags(arguments)
    try:
        plan = loader.load(sources, arguments, packages, parse=tags.parse, missing=findings.missing)
    except BadFile as error:
        findings.fail("launch file", error)
        return
    findings.begin_with(shown(file) for file in plan.files)
    parameters = LaunchParameters(plan, tags, packages, findings, ask_others, strict)
    nodes = launch_nodes.LaunchNodes(plan, parameters, packages, findings, strict)
    source = ParameterFile(sources[0].shown, parameters.places, findings)
    controllers = ControllerCheck(
        source, [robot.model for robot in nodes.robots if robot.model], nodes.reader, nodes.hint
    )
    controllers.check(parameters.tree)
    nodes.tell(controllers.found, controllers.claims, tags)
    tags.classify(plan, findings)
    findings.tell_missing()
    findings.is_drivable = nodes.has_programs or bool(controllers.found) or any(robot.model for robot in nodes.robots)
