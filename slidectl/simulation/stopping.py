"""What joints do when nobody is to move them: `/slidectl/estop` and `/slidectl/rest_joints`.

The emergency stop is that of DefaultRobotHWSim; the topic that a robot's plugin names sets the same flag. A stopped
controller leaves its last command with the hardware, as in ros_control; `rest_joints` sets another one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.hardware_interface import EffortJointInterface, PositionJointInterface, VelocityJointInterface
from slidectl.control.node_handle import Message
from slidectl.errors import Refused, SlidectlError, UnknownName
from slidectl.simulation.assembly import SpawnedRobot

if TYPE_CHECKING:
    from slidectl.simulation.graph import Graph
    from slidectl.simulation.robots import Robots

NODE = "/slidectl"
_COMMANDS = ("zero", "hold")

Claim = tuple[str, str]
"""An interface and a joint."""


def advertise(graph: Graph, robots: Robots) -> None:
    """Provide them."""
    node = graph.node(NODE, NODE)
    node.advertise_service("estop", "slidectl/EmergencyStop", lambda request: _stop(robots, request))
    node.advertise_service("rest_joints", "slidectl/RestJoints", lambda request: _rest(robots, request))


def _stop(robots: Robots, request: Message) -> Message:
    """All of them in one cycle, or none where a name is unknown."""
    try:
        meant = [_robot(robots, name) for name in dict.fromkeys(request["names"])] or list(robots)
        if not meant:
            raise Refused("no robots in the world")
    except SlidectlError as error:
        return {"success": False, "message": str(error), "robots": []}
    for robot in meant:
        robot.emergency_stop = request["stop"]
    names = [robot.name for robot in meant]
    what = "emergency stop" if request["stop"] else "released"
    return {"success": True, "message": f"{', '.join(names)}: {what}", "robots": names}


def _rest(robots: Robots, request: Message) -> Message:
    try:
        if request["command"] not in _COMMANDS:
            raise UnknownName("command", request["command"], list(_COMMANDS))
        robot = _robot(robots, request["robot"])
        claims = _claims(robot, request)
        hardware, hold = robot.hardware, request["command"] == "hold"
        if not request["check_only"]:
            robot.look()
        commands = hardware.resting_commands(claims, hold)
        if not request["check_only"]:
            hardware.command(commands)
    except SlidectlError as error:
        return {"success": False, "message": str(error), "joints": []}
    joints = list(dict.fromkeys(joint for _, joint in commands))
    text = "; ".join(f"{joint} keeps {_QUANTITIES[kind]} {value:g}" for (kind, joint), value in commands.items())
    return {"success": True, "message": text or "no joint is concerned", "joints": joints}


_QUANTITIES = {
    EffortJointInterface.type_name: "an effort of",
    VelocityJointInterface.type_name: "a velocity of",
    PositionJointInterface.type_name: "the position",
}


def _claims(robot: SpawnedRobot, request: Message) -> list[Claim]:
    """What the controllers claim and nobody else does. Raises UnknownName, Refused (one runs)."""
    loaded = {one["name"]: one for one in robot.manager.list()}
    for name in (*request["controllers"], *request["left_to"]):
        if name not in loaded:
            raise UnknownName("controller", name, list(loaded), f"of robot {robot.name!r}")
    asked = set(request["controllers"])
    running = [name for name in loaded if name in asked and loaded[name]["state"] == "running"]
    if running and not request["check_only"]:
        raise Refused(f"{', '.join(running)} runs and writes its own commands", "stop it first")
    others = {name for name in loaded if loaded[name]["state"] == "running" and name not in asked}
    taken = {joint for name in others | set(request["left_to"]) for _, joint in _claimed_by(loaded[name])}
    found = (claim for name in request["controllers"] for claim in _claimed_by(loaded[name]))
    return [claim for claim in dict.fromkeys(found) if claim[1] not in taken]


def _claimed_by(controller: Message) -> list[Claim]:
    return [
        (claim["hardware_interface"], joint)
        for claim in controller["claimed_resources"]
        for joint in claim["resources"]
    ]


def _robot(robots: Robots, name: str) -> SpawnedRobot:
    """By its name, or by its namespace. Raises UnknownName."""
    return next((robot for robot in robots if name == robot.namespace), None) or robots.get(name)
