"""A robot as `/slidectl/list_robots` shows it: links, joints with state and limits, controllers, pose, report.

Only looks; nothing in the world moves by it.
"""

from __future__ import annotations

import math
from typing import Any

from slidectl.control.node_handle import Message
from slidectl.description.robot import Joint, Notice
from slidectl.description.transmissions import driving
from slidectl.physics import World
from slidectl.simulation.assembly import SpawnedRobot

MOVING = ("revolute", "continuous", "prismatic")


def robot_info(robot: SpawnedRobot, world: World) -> Message:
    """slidectl/RobotInfo."""
    paper = robot.paper
    interfaces = _interfaces(robot)
    position, attitude = world.link_pose(robot.name, paper.root)
    return {
        "name": robot.name,
        "namespace": robot.namespace,
        "fixed": paper.is_fixed_to_world,
        "links": list(paper.links),
        "joints": [_joint_info(robot, world, joint, interfaces) for joint in paper.joints.values()],
        "controllers": list(robot.parts.manager.names()),
        "pose": [*map(float, position), *map(float, attitude)],
        "report": [_notice(notice) for notice in paper.report],
        "estop": robot.emergency_stop,
        "process_session": robot.caller,
    }


def _interfaces(robot: SpawnedRobot) -> dict[str, str]:
    """The interface through which each actuated joint is commanded: the first, as the hardware reads it."""
    found = (transmission.joints[0] for transmission in driving(robot.paper.transmissions))
    return {joint.name: joint.hardware_interfaces[0] for joint in found}


def _joint_info(robot: SpawnedRobot, world: World, joint: Joint, interfaces: dict[str, str]) -> Message:
    position, velocity, effort = _state(robot, world, joint)
    limit = joint.limit
    bounded = limit is not None and joint.type in ("revolute", "prismatic")
    return {
        "name": joint.name,
        "type": joint.type,
        "hardware_interface": interfaces.get(joint.name, ""),
        "position": position,
        "velocity": velocity,
        "effort": effort,
        "lower": limit.lower if limit and bounded else math.nan,
        "upper": limit.upper if limit and bounded else math.nan,
        "max_velocity": limit.velocity if limit else math.nan,
        "max_effort": limit.effort if limit else math.nan,
    }


def _state(robot: SpawnedRobot, world: World, joint: Joint) -> tuple[Any, Any, Any]:
    if joint.type not in MOVING:
        return math.nan, math.nan, math.nan
    return world.joint_state(robot.name, joint.name)


def _notice(notice: Notice) -> Message:
    return {
        "verdict": notice.verdict,
        "subject": notice.subject,
        "text": notice.text,
        "file": notice.file,
        "line": notice.line or 0,
    }
