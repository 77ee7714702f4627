"""Robot descriptions: xacro and URDF files as plain data with the file and line of each element.

`load` runs in the client's process, which has the files (packages, xacro, meshes); `parse` runs anywhere. No physics,
no mujoco. Heavy modules are imported by the functions that need them.
"""

from __future__ import annotations

from slidectl.description.document import (
    Document,
    load,
    takes_namespace,
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
    "load",
    "namespace_of",
    "parse",
    "takes_namespace",
    "with_root_fixed",
    "with_root_free",
    "with_transmissions",
    "written",
]
