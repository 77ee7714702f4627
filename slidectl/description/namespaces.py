"""The namespace of a robot: topics, services and parameters of its controllers live in there.

Its control plugin says which, else its name does.
"""

from __future__ import annotations

from slidectl import names
from slidectl.description.robot import Robot


def namespace_of(robot: Robot, name: str) -> str:
    """The plugin's `robotNamespace` with a leading slash, else `/name`. An empty one is the root, `/`.

    Raises:
        BadName: a `name` that cannot be a namespace.
    """
    written = robot.plugin.robot_namespace if robot.plugin is not None else None
    return names.check("/" + (name if written is None else written).strip("/"))
