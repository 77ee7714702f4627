"""A bench for the hardware of one robot: its world, its graph, its log, and cycles without controllers."""

from __future__ import annotations

from typing import Any

from slidectl.control.hardware_interface import (
    EffortJointInterface,
    JointHandle,
    PositionJointInterface,
    VelocityJointInterface,
)
from slidectl.description.robot import Robot
from slidectl.physics import MujocoRobotHW, World
from slidectl.simulation.graph import Graph

NAMESPACE = "/robot"
PERIOD = 0.001


class Bench:
    """Put a robot on it with `take`, then run cycles and look at its handles."""

    def __init__(self) -> None:
        self.world = World(gravity=(0.0, 0.0, 0.0), ground=False)
        self.graph = Graph()
        self.log: list[tuple[str, str]] = []
        self.graph.log.sink = lambda severity, _node, text, _time: self.log.append((severity, text))
        self.hardware: MujocoRobotHW

    def take(self, robot: Robot, **parameters: Any) -> MujocoRobotHW:
        """Attach the robot and bring its hardware up; parameters are those of its namespace."""
        self.graph.parameters.set(NAMESPACE, parameters)
        body = self.world.attach(robot, "robot")
        self.hardware = MujocoRobotHW(self.world, body, robot, self.graph.node(NAMESPACE), NAMESPACE)
        return self.hardware

    def handle(self, joint: str = "joint1") -> JointHandle:
        """The joint's handle for commands, of whichever interface has it."""
        for kind in (EffortJointInterface, VelocityJointInterface, PositionJointInterface):
            interface = self.hardware.get(kind)
            if interface is not None and joint in interface.names():
                return interface.get_handle(joint)
        raise AssertionError(f"no command handle {joint}")

    def cycle(self, times: int = 1, **commands: float) -> None:
        """Read, set the commands (joint1=0.5), write, step; and read at last, to see what came of it."""
        for _ in range(times):
            self.hardware.read(0, PERIOD)
            for joint, command in commands.items():
                self.handle(joint).command = command
            self.hardware.write(0, PERIOD)
            self.world.step()
        self.hardware.read(0, PERIOD)
