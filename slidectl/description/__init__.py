"""A robot on paper: xacro and URDF files into plain data with the file and line of each thing.

`load` runs on the side of who owns the files (packages, xacro, meshes), `parse` anywhere. No physics, no mujoco.
Heavy modules are imported by the functions that need them.
"""

from __future__ import annotations

from slidectl.description.document import (
    Document,
    declared_arguments,
    load,
    with_root_fixed,
    with_root_free,
    with_transmissions,
    written,
)
from slidectl.description.packages import Packages, UnknownPackage
from slidectl.description.parser import parse
from slidectl.description.robot import Notice, Robot, namespace_of

__all__ = [
    "Document",
    "Notice",
    "Packages",
    "Robot",
    "UnknownPackage",
    "declared_arguments",
    "load",
    "namespace_of",
    "parse",
    "with_root_fixed",
    "with_root_free",
    "with_transmissions",
    "written",
]
