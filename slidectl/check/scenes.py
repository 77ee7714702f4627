"""Checks SDF files and Gazebo worlds: how their models and world settings are converted."""

from __future__ import annotations

from pathlib import Path

from slidectl import description
from slidectl.check import bodies
from slidectl.check.findings import Findings
from slidectl.description import models, sdf
from slidectl.description.packages import Packages, shown
from slidectl.errors import BadFile


def check(path: Path, packages: Packages, findings: Findings, text: bytes | None = None, strict: bool = False) -> bool:
    """Add the findings on a file, or on `text` instead of its content. Returns True when it has a model."""
    from slidectl.extensions.launch.nodes import gazebo

    content = models.read_file(path) if text is None else text
    base = Path.cwd() if text is not None else path.absolute().parent
    try:
        scene = sdf.parse(content, shown(path), packages.starting_at(base), base, findings.missing)
        world = gazebo.parse_world(content, shown(path))
    except BadFile as error:
        findings.fail("SDF", error)
        return False
    if world is not None:
        findings.extend(world.notices)
        for name, value in vars(world.settings).items():
            if value is not None and name != "paused":  # a file cannot set that
                said = f"{value}" if name != "ground" else "a plane" if value else "none"
                findings.add("used", f"{name} of the world", said, world.file, 1)
    check_scene(scene, findings, strict)
    return bool(scene.models)


def check_scene(scene: sdf.Scene, findings: Findings, strict: bool = False) -> None:
    """Add findings on each model: how it is converted, and whether it makes sense."""
    findings.extend(scene.notices)
    for model in scene.models:
        x, y, z = model.pose[0]
        kind = "static" if model.is_static else "free, or held by its joints"
        where = f"{kind}; its root is at {x:g} {y:g} {z:g}"
        findings.add("used", f"model {model.name!r}", where, model.file, model.line)
        try:
            robot = description.parse(model.xml, model.file, strict=strict)
        except BadFile as error:
            findings.fail(f"model {model.name!r}", error)
            continue
        findings.extend(robot.report)
        bodies.check(robot, findings)
