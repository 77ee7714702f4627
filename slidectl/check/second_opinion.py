"""What yourdfpy makes of the same robot: an independent reader, against which ours is held.

Compares the tree, masses and limits. It only remarks: where readers differ, the simulation goes by ours. yourdfpy is
imported only when it is asked, as it is heavy.
"""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Iterator
from typing import Any

from slidectl.check.findings import Findings
from slidectl.description.robot import Robot
from slidectl.description.xml_tree import Element

_NAME = "yourdfpy"


def tell(xml: str, robot: Robot, root: Element, findings: Findings) -> None:
    """What the other reader reads differently, or that it agrees. `xml` is the text that `root` was read from."""
    try:
        with _silence():
            remarks = list(_differences(robot, _read(xml)))
    except Exception as error:  # whatever its parsers raise says the same: it cannot read the file
        remarks = [(f"robot {robot.name!r}", f"cannot read it: {' '.join(str(error).split()) or type(error).__name__}")]
    for subject, text in remarks or [(f"robot {robot.name!r}", "reads the same tree, masses and limits")]:
        findings.add("used", subject, f"note: {_NAME} {text}", root.file, root.line)


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """It prints, and it logs."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    finally:
        logging.disable(before)


def _read(xml: str) -> Any:
    import yourdfpy

    return yourdfpy.URDF.load(io.BytesIO(xml.encode()), load_meshes=False)


def _differences(robot: Robot, other: Any) -> Iterator[tuple[str, str]]:
    """Subject and text of each thing that the two read differently."""
    if other.base_link != robot.root:
        yield f"robot {robot.name!r}", f"takes {other.base_link!r} for the root, not {robot.root!r}"
    for error in other.errors if not other.validate() else ():
        yield f"robot {robot.name!r}", f"says: {error}"
    for link in robot.links.values():
        theirs = other.link_map.get(link.name)
        mass = theirs.inertial.mass if theirs is not None and theirs.inertial is not None else None
        if mass != (link.inertial.mass if link.inertial is not None else None):
            yield f"link {link.name!r}", f"reads a mass of {mass}"
    yield from _joint_differences(robot, other)


def _joint_differences(robot: Robot, other: Any) -> Iterator[tuple[str, str]]:
    for joint in robot.joints.values():
        theirs = other.joint_map.get(joint.name)
        if theirs is None or (theirs.parent, theirs.child, theirs.type) != (joint.parent, joint.child, joint.type):
            yield f"joint {joint.name!r}", f"does not read it as a {joint.type} joint of the same two links"
        elif joint.limit is not None and joint.type != "continuous":
            pair = (theirs.limit.lower or 0.0, theirs.limit.upper or 0.0)
            if sorted(pair) != [joint.limit.lower, joint.limit.upper]:
                yield f"joint {joint.name!r}", f"reads the limits {pair[0]:g} and {pair[1]:g}"
