"""A robot in memory for controllers under test: joints set by hand, and hardware that switches when told to."""

# ruff: noqa: ARG002 - hooks have their arguments, wanted or not
from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from fake_node import FakeGraph

from slidectl.control.controller_interface import Controller
from slidectl.control.controller_manager import ControllerManager
from slidectl.control.hardware_interface import (
    ControllerInfo,
    EffortJointInterface,
    JointHandle,
    JointStateInterface,
    PositionJointInterface,
    PosVelAccJointInterface,
    PosVelJointInterface,
    RobotHW,
    SwitchState,
    VelocityJointInterface,
)
from slidectl.control.node_handle import NodeHandle
from slidectl.control.registry import controller

STEP_NS = 1_000_000
STEP_S = 0.001
COMMAND_INTERFACES: dict[str, Any] = {
    "effort": EffortJointInterface,
    "velocity": VelocityJointInterface,
    "position": PositionJointInterface,
    "pos_vel": PosVelJointInterface,
    "pos_vel_acc": PosVelAccJointInterface,
}


class FakeRobot(RobotHW):
    """Joints with a state interface and the command interfaces that a test names.

    Each call of `switch_result` answers with the next of `results`, the last one for ever.
    """

    def __init__(self, joints: Iterable[str] = ("joint1",), commands: Iterable[str] = ("effort",)) -> None:
        super().__init__()
        self.joints = {name: JointHandle(name) for name in joints}
        self.register_interface(JointStateInterface(self.joints.values()))
        for name in commands:
            self.register_interface(COMMAND_INTERFACES[name](self.joints.values()))
        self.results = [SwitchState.DONE]
        self.asked: list[str | None] = []
        self.switches: list[tuple[list[str], list[str]]] = []
        self.agrees = True

    def prepare_switch(self, start: Sequence[ControllerInfo], stop: Sequence[ControllerInfo]) -> bool:
        return self.agrees

    def do_switch(self, start: Sequence[ControllerInfo], stop: Sequence[ControllerInfo]) -> None:
        self.switches.append(([info.name for info in start], [info.name for info in stop]))

    def switch_result(self, info: ControllerInfo | None = None) -> SwitchState:
        self.asked.append(info.name if info is not None else None)
        return self.results.pop(0) if len(self.results) > 1 else self.results[0]


class Recorder(Controller[EffortJointInterface]):
    """Claims the joints of its `joints` parameter and writes down which hooks are called."""

    interface_type = EffortJointInterface

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[str] = []

    def init(self, interface: EffortJointInterface, node: NodeHandle) -> None:
        for name in node.get_param("joints", []):
            interface.get_handle(name)

    def starting(self, time_ns: int) -> None:
        self.calls.append("starting")

    def update(self, time_ns: int, period_s: float) -> None:
        self.calls.append("update")

    def stopping(self, time_ns: int) -> None:
        self.calls.append("stopping")

    def waiting(self, time_ns: int) -> None:
        self.calls.append("waiting")

    def aborting(self, time_ns: int) -> None:
        self.calls.append("aborting")


class Bench:
    """A manager on a fake robot in the namespace /bot, with a clock that runs when a test says so."""

    def __init__(self, robot: FakeRobot, controllers: dict[str, Any] | None = None, **classes: Any) -> None:
        """`controllers` maps names to parameters; those without a type are Recorders."""
        parameters = {name: {"type": "test/Recorder", **values} for name, values in (controllers or {}).items()}
        self.graph = FakeGraph({"/bot": parameters})
        self.robot = robot
        self.manager = ControllerManager(robot, self.graph.node("/bot"))
        self.register(**{"Recorder": Recorder, **classes})
        self.answers: list[bool] = []

    def register(self, **classes: Any) -> None:
        """Give these classes the types `test/NAME`; conftest.py takes them back."""
        for name, cls in classes.items():
            controller(f"test/{name}")(cls)

    def load(self, *names: str) -> None:
        """Load, and for a robot of ROS 2 configure."""
        for name in names:
            assert self.manager.load(name), self.graph.lines("error")
            if self.robot.is_of_ros2:
                assert self.manager.configure(name), self.graph.lines("error")

    def start(self, *names: str) -> None:
        """Load and start, in one cycle."""
        self.load(*names)
        assert self.request(start=names), self.graph.lines("error")
        self.run()

    def request(self, start: Sequence[str] = (), stop: Sequence[str] = (), strictness: int = 2, **more: Any) -> bool:
        return self.manager.request_switch(
            list(start),
            list(stop),
            strictness,
            more.get("asap", False),
            more.get("timeout", 0.0),
            self.answers.append,
        )

    def run(self, cycles: int = 1, **more: Any) -> None:
        for _ in range(cycles):
            self.graph.time_ns += STEP_NS
            self.manager.update(self.graph.time_ns, STEP_S, **more)
            self.graph.timers.fire()

    def states(self) -> dict[str, str]:
        return {entry["name"]: entry["state"] for entry in self.manager.list()}

    def calls(self, name: str) -> list[str]:
        controller = self.manager.get(name)
        assert isinstance(controller, Recorder)
        return controller.calls
