"""Which node is what here: counterparts by `pkg/type`, and programs of the user's for all others.

Modules of families are imported when a plan has a node of theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from slidectl.description.packages import Packages
from slidectl.errors import BadFile, NotThere
from slidectl.launch.plan import Node, Plan
from slidectl.launch.task import Task

_GAZEBO = ("gazebo", "gzserver", "debug", "perf")

_COUNTERPARTS = {
    **{("gazebo_ros", kind): "gazebo:Gazebo" for kind in _GAZEBO},
    ("gazebo_ros", "gzclient"): "gazebo:Window",
    ("gazebo_ros", "spawn_model"): "spawn_model:SpawnModel",
    ("controller_manager", "spawner"): "spawner:Spawner",
    ("controller_manager", "unspawner"): "spawner:Unspawner",
    ("controller_manager", "controller_manager"): "manager_scripts:ManagerScript",
    ("controller_manager", "controller_group"): "manager_scripts:GroupScript",
    ("robot_state_publisher", "robot_state_publisher"): "state_publishers:RobotStatePublisher",
    ("robot_state_publisher", "state_publisher"): "state_publishers:RobotStatePublisher",
    ("joint_state_publisher", "joint_state_publisher"): "state_publishers:JointStatePublisher",
    ("joint_state_publisher_gui", "joint_state_publisher_gui"): "state_publishers:JointStatePublisher",
    ("tf", "static_transform_publisher"): "static_transform:StaticTransform",
    ("tf2_ros", "static_transform_publisher"): "static_transform:StaticTransform",
}
_TOOLS = ("rostopic", "rosservice", "rosparam")
_VIEWERS = ("rviz", "rqt")
_VIEWER = "viewers:Viewer"
_WORLDS = ("gazebo:Gazebo", "gazebo:Window")
# Scripts that were once installed with their suffix.
_SUFFIXES = (".py",)


def tasks(plan: Plan, packages: Packages, gather: bool = False, nodes: Sequence[Node] | None = None) -> list[Task]:
    """What to do for each node of the plan, or for some `nodes` of it, in order. Nothing is started.

    Nodes that can neither be done nor run, or whose arguments need what is not there, are left out and noted as
    missing; with `gather` the caller refuses that, after looking for more.

    Raises:
        BadFile: a node whose arguments make no sense. NotThere: such nodes.
    """
    found = []
    for node in plan.nodes if nodes is None else nodes:
        try:
            _need_arguments(node)
            found.append(_counterpart(node, plan) or _program(node, plan, packages))
        except NotThere as error:
            plan.missing.note(error, f"the node {node.full_name} is left out", is_node=not node.absent)
        except BadFile:
            plan.missing.refuse()
            raise
    if not gather:
        plan.missing.refuse()
    return found


def _need_arguments(node: Node) -> None:
    """Raise NotThere when a package in the arguments is not there, but for nodes that do without."""
    entry = _entry(node.package, node.type)
    if node.absent and entry not in (_VIEWER, *_WORLDS):
        raise node.absent[0]


def counterparts() -> list[tuple[str, str]]:
    """Package and type of the nodes that have one, without the windows, which are all those of rviz and rqt."""
    return list(_COUNTERPARTS)


def has_counterpart(package: str, kind: str) -> bool:
    """Whether such a node is something here, and not a program to run."""
    return _entry(package, kind) is not None


def _entry(package: str, kind: str) -> str | None:
    if package.startswith(_VIEWERS):
        return _VIEWER
    found = (_COUNTERPARTS.get((package, kind.removesuffix(suffix))) for suffix in ("", *_SUFFIXES))
    return next((entry for entry in found if entry is not None), None)


def _counterpart(node: Node, plan: Plan) -> Task | None:
    entry = _entry(node.package, node.type)
    if entry is None:
        return None
    if entry != _VIEWER:
        _point_out(node, plan)
    return _made(entry, node, plan)


def _made(entry: str, node: Node, plan: Plan) -> Task:
    module, name = entry.split(":")
    kind: type[Task] = getattr(import_module(f"slidectl.launch.nodes.{module}"), name)
    return kind(node, plan)


def _point_out(node: Node, plan: Plan) -> None:
    """Attributes that mean something for a process only."""
    given = {
        "respawn": node.respawn,
        "launch-prefix": bool(node.launch_prefix),
        "cwd": node.cwd is not None,
    }
    for attribute, is_given in given.items():
        if is_given:
            text = f"{attribute} has no effect: the node is part of the simulation here"
            plan.notice("ignored", node.place, node.full_name, text)


def _program(node: Node, plan: Plan, packages: Packages) -> Task:
    from slidectl.launch.nodes.process import Process
    from slidectl.launch.nodes.tools import Tool

    kind = Tool if (node.package, node.type) in ((tool, tool) for tool in _TOOLS) else Process
    return kind(node, plan, packages.starting_at(_folder(node)))


def _folder(node: Node) -> str:
    return node.file.rpartition("/")[0] or "/"
