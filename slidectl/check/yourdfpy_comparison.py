"""Compares a robot with the reading of yourdfpy, an independent parser.

It compares the tree, masses and limits, and only adds remarks: the simulation uses our reading. yourdfpy is a heavy
import, so it is imported only when asked for.
"""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Iterator

from slidectl.check.findings import Findings
from slidectl.description.robot import Robot
from slidectl.description.xml_tree import Element


def tell(xml: str, robot: Robot, root: Element, findings: Findings) -> None:
    """Add a finding for each difference, or one that there is none. `xml` is the text that `root` was read from."""
    whole = f"robot {robot.name!r}"
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)  # yourdfpy logs, and it prints
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            remarks = list(_differences(robot, xml, whole))
    except Exception as error:  # any exception of its parsers means that it cannot read the file
        remarks = [(whole, f"cannot read it: {' '.join(str(error).split()) or type(error).__name__}")]
    finally:
        logging.disable(before)
    for subject, text in remarks or [(whole, "reads the same tree, masses and limits")]:
        findings.add("used", subject, f"note: yourdfpy {text}", root.file, root.line)


def _differences(robot: Robot, xml: str, whole: str) -> Iterator[tuple[str, str]]:
    """Subject and text of each difference between the two readings."""
    import yourdfpy

    other = yourdfpy.URDF.load(io.BytesIO(xml.encode()), load_meshes=False)
    if other.base_link != robot.root:
        yield whole, f"takes {other.base_link!r} for the root, not {robot.root!r}"
    for error in other.errors if not other.validate() else ():
        yield whole, f"says: {error}"
    for link in robot.links.values():
        theirs = other.link_map.get(link.name)
        mass = theirs.inertial.mass if theirs is not None and theirs.inertial is not None else None
        if mass != (link.inertial.mass if link.inertial is not None else None):
            yield f"link {link.name!r}", f"reads a mass of {mass}"
    for joint in robot.joints.values():
        theirs = other.joint_map.get(joint.name)
        if theirs is None or (theirs.parent, theirs.child, theirs.type) != (joint.parent, joint.child, joint.type):
            yield f"joint {joint.name!r}", f"does not read it as a {joint.type} joint of the same two links"
        elif joint.limit is not None and joint.type != "continuous":
            pair = (theirs.limit.lower or 0.0, theirs.limit.upper or 0.0)
            if sorted(pair) != [joint.limit.lower, joint.limit.upper]:
                yield f"joint {joint.name!r}", f"reads the limits {pair[0]:g} and {pair[1]:g}"
