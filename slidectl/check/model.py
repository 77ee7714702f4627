"""Checks a model: what became of each tag and attribute, and whether the robot makes sense.

Reads the model as `slidectl spawn` does. A part that makes the file useless is a finding, and the rest is looked at as
far as it can be.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from slidectl import description
from slidectl.check import bodies, second_opinion, simulated, unused
from slidectl.check.findings import Findings
from slidectl.check.joints import Joints
from slidectl.check.repair import repair
from slidectl.check.tags import Tags
from slidectl.check.traced import Trace, TracedElement, TracedReport, plain
from slidectl.description import xml_tree
from slidectl.description.mesh_files import MeshFiles
from slidectl.description.packages import Packages, is_file
from slidectl.description.parser import parse_tree
from slidectl.description.robot import Robot
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile, BadName

_MOST_FAULTS = 50


@dataclass(frozen=True)
class Model:
    """A robot that was checked, for the checks of what belongs to it."""

    robot: Robot
    namespace: str
    file: str


def check(
    source: str | Path,
    arguments: Mapping[str, str],
    packages: Packages,
    findings: Findings,
    ask_others: bool = False,
    title: str | None = None,
    strict: bool = False,
) -> Model | None:
    """Add what there is to say of a model (as description.load takes it); the robot, None when it cannot be read.

    `ask_others` asks yourdfpy too, which takes half a second. `title` is what to call a text. `strict` refuses
    impossible masses, inertias and shapes instead of mending them, as `slidectl spawn --strict` does.

    Raises:
        BadFile: there is no such file. UnknownName: no such shipped model.
    """
    try:
        missing = findings.missing
        document = description.load(
            source, arguments, packages, all_meshes=missing.keeps_going, title=title, missing=missing
        )
    except BadFile as error:
        findings.fail("model", error)
        return None
    if not (isinstance(source, str) and (source == "-" or source.lstrip().startswith("<"))):
        _tell_arguments(source, arguments, packages, findings)
    findings.extend(document.report)
    return check_text(document.xml, document.file, findings, ask_others, packages, strict)


def check_text(
    xml: str,
    file: str,
    findings: Findings,
    ask_others: bool = False,
    packages: Packages | None = None,
    strict: bool = False,
) -> Model | None:
    """The same for plain URDF text; `file` is its name in findings, unless the text carries a note of its sources."""
    try:
        root = xml_tree.read(xml, file)
    except BadFile as error:
        findings.fail("model", error)
        return None
    reading = _Reading(root, findings, _meshes(file, packages), strict)
    robot = reading.robot()
    if robot is None:
        return None
    model = Model(robot, reading.namespace(robot), file)
    simulated.tell(robot, root, model.namespace, findings)
    bodies.tell(robot, findings)
    if ask_others and reading.is_whole:
        second_opinion.tell(xml, robot, root, findings)
    return model


def _meshes(file: str, packages: Packages | None) -> MeshFiles:
    base = Path(file).absolute().parent if is_file(Path(file)) else None
    packages = packages or Packages()
    return MeshFiles(packages.starting_at(base) if base is not None else packages, base)


class _Reading:
    """One robot read with a trace; what cannot be read is left out or replaced, if the rest stands then."""

    def __init__(self, root: Element, findings: Findings, meshes: MeshFiles, strict: bool) -> None:
        self.root = root
        self.strict = strict
        self.findings = findings
        self.meshes = meshes
        self.is_whole = True

    def robot(self) -> Robot | None:
        """The robot, after a finding for each of its tags and faults; None when it is beyond repair."""
        for _ in range(_MOST_FAULTS):
            trace = Trace()
            traced, report = TracedElement(self.root, trace), TracedReport(trace)
            try:
                robot = parse_tree(traced, self.meshes, report, self.strict)
            except BadFile as error:
                self.is_whole = False
                self.findings.fail(_subject(trace.culprit), error)
                if not repair(self.root, traced, trace.culprit):
                    self.findings.extend(notice for said in trace.said.values() for _, notice in said)
                    return None
            else:
                simulated.say(robot, traced, report)
                self._classify(traced, trace, robot)
                return robot
        return None

    def _classify(self, traced: TracedElement, trace: Trace, robot: Robot) -> None:
        kept = {(info.file, info.line) for info in robot.transmissions}
        transmissions = [part for part in traced.children if part.tag == "transmission"]
        dead = {id(part) for part in transmissions if (part.file, part.line) not in kept}
        joints = Joints(robot, trace)
        Tags(trace, self.findings, dead, joints.explain).classify(traced)
        joints.tell(self.findings)

    def namespace(self, robot: Robot) -> str:
        """Where its controllers live when it is spawned under its own name."""
        try:
            return description.namespace_of(robot, robot.name)
        except BadName as error:
            text = f"{error.message}; spawn it with -n NAME"
            self.findings.add("wrong", f"robot {robot.name!r}", text, self.root.file, self.root.line)
            return f"/{robot.name}"


def _subject(culprit: Element | None) -> str:
    return plain(culprit).title if culprit is not None else "model"


def _tell_arguments(source: str | Path, arguments: Mapping[str, str], packages: Packages, findings: Findings) -> None:
    """The xacro arguments that the model declares, with the values that they have now, and what nobody uses."""
    for name, element in description.declaring_elements(source, packages).items():
        default = element.get("default") or ""
        text = f"{arguments[name]!r}, as given" if name in arguments else f"{default!r}, by default"
        findings.add("used", f"argument {name}", text, element.file, element.line)
    trees = description.written_trees(source, packages)
    if trees is not None:
        unused.tell(trees, findings)
