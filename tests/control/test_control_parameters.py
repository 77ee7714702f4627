"""What a controller says of its parameters is what it reads: no more, no less."""

from __future__ import annotations

from typing import Any

import pytest
from fake_node import FakeGraph
from fake_robot import COMMAND_INTERFACES, FakeRobot

from slidectl.control import params, registry, ros2_controller
from slidectl.control.controller_interface import ControllerBase
from slidectl.control.controllers import ros2_joint_trajectory
from slidectl.control.controllers.diff_drive import WHEELS
from slidectl.control.controllers.ros2_broadcasters import NINE, NO_FILTERS
from slidectl.control.controllers.ros2_pid_controller import QUANTITIES, QUANTITY
from slidectl.control.controllers.steering import TWO
from slidectl.control.hardware_interface import (
    ForceTorqueData,
    ForceTorqueSensorInterface,
    ImuData,
    ImuSensorInterface,
    SensorHandle,
)
from slidectl.control.limits import LIMITS, limits_from_parameters, soft_limits_from_parameters
from slidectl.control.mobile_base import DIAGONAL
from slidectl.control.params import Parameter
from slidectl.control.ros2_pid import STRATEGY

URDF = """<robot name="bot">
  <link name="joint1"/>
  <link name="arm"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="joint1" type="revolute"><parent link="joint1"/><child link="arm"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""

VALUES = {
    params.NUMBER: 1.0,
    params.INTEGER: 1,
    params.BOOLEAN: False,
    params.TEXT: "joint1",
    params.TEXTS: ["joint1"],
    params.NUMBERS: [1.0],
    params.LIST: [],
    params.FLOAT: 1.0,
    WHEELS: "joint1",
    DIAGONAL: [1.0] * 6,
    TWO: ["joint1", "joint1"],
    STRATEGY: "none",
    QUANTITY: "effort",
    QUANTITIES: ["position"],
    ros2_joint_trajectory.COMMANDS: ["effort"],
    ros2_joint_trajectory.STATES: ["position", "velocity"],
    ros2_controller.NOT_NEGATIVE: 1.0,
    ros2_joint_trajectory.NOT_POSITIVE: -1.0,
    ros2_joint_trajectory.LOWEST: -1.0,
    ros2_controller.RATE: 1.0,
    ros2_joint_trajectory.METHOD: "none",
    ros2_joint_trajectory.INTERFACE_NAME: "",
    NINE: [1.0] * 9,
    NO_FILTERS: None,
}

NAMED = {
    "u_clamp_max": 2.0,
    "i_clamp_min": -1.0,
    "interfaces": ["position"],
    "interface_name": "effort",
    "interface_names": ["effort"],
    "sensor_filter_chain": None,
    "state_interfaces": ["position", "velocity"],
    **{f"interface_names/{quantity}/{axis}": "" for quantity in ("force", "torque") for axis in "xyz"},
    **dict.fromkeys(("min_velocity", "max_deceleration", "max_acceleration_reverse", "min_jerk"), -1.0),
}
"""Values of parameters by their names, or by the ends of these."""

TYPES = [name for name in registry.common.types() if not name.startswith("tests/")]  # whatever other tests define
CLASSES = {registry.common.find(name, for_ros2=for_ros2): None for for_ros2 in (False, True) for name in TYPES}
each_class = pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)


class WatchedGraph(FakeGraph):
    """Notes the name of every parameter that is asked for."""

    def __init__(self, values: dict[str, Any]) -> None:
        self.asked: set[str] = set()
        super().__init__(values)

    def get(self, name: str) -> Any:
        self.asked.add(name)
        return super().get(name)

    def asked_below(self, namespace: str) -> set[str]:
        return {name.removeprefix(f"{namespace}/") for name in self.asked if name.startswith(f"{namespace}/")}


def own(declared: tuple[Parameter, ...]) -> dict[str, Parameter]:
    """By the names that the graph is asked for: entries of lists are read with their list."""
    return {p.name.replace("<joint>", "joint1"): p for p in declared if "[]" not in p.name}


@each_class
def test_a_controller_reads_what_it_says_and_says_what_it_reads(cls: type[ControllerBase]) -> None:
    declared = own(cls.parameters)
    values = {
        f"/bot/c/{name}": NAMED.get(name, NAMED.get(name.rpartition("/")[2], VALUES[parameter.kind]))
        for name, parameter in declared.items()
    }
    graph = WatchedGraph({"/bot/robot_description": URDF, **values})
    robot = FakeRobot(commands=COMMAND_INTERFACES)
    robot.register_interface(ImuSensorInterface([SensorHandle("joint1", "arm", ImuData)]))
    still = ForceTorqueData((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    robot.register_interface(ForceTorqueSensorInterface([SensorHandle("joint1", "arm", lambda: still)]))
    cls().init_request(robot, graph.node("/bot"), graph.node("/bot/c"))
    asked = {name for name in graph.asked_below("/bot/c") if not name.endswith("robot_description")}
    namespaces = {above for name in declared for above in (name.rpartition("/")[0], name.partition("/")[0])}
    assert asked - (namespaces - set(declared)) == set(declared)


@each_class
def test_every_parameter_has_a_meaning_and_a_default_of_its_own_type(cls: type[ControllerBase]) -> None:
    for parameter in cls.parameters:
        assert parameter.meaning, parameter.name
        if parameter.default is not None:
            assert parameter.kind.convert(parameter.default) == parameter.default


def test_joint_limits_are_all_declared() -> None:
    names = [f"/bot/joint_limits/j/{limit.name}" for limit in LIMITS]
    graph = WatchedGraph({name: True if "has_" in name else 1.0 for name in names})
    limits_from_parameters(graph.node("/bot"), "j")
    soft_limits_from_parameters(graph.node("/bot"), "j")
    graph.set("/bot/joint_limits/j/has_position_limits", False)
    limits_from_parameters(graph.node("/bot"), "j")
    assert graph.asked_below("/bot/joint_limits/j") == {limit.name for limit in LIMITS}


def test_an_unknown_type_is_refused_with_the_closest_known_one() -> None:
    with pytest.raises(registry.UnknownType, match="Did you mean 'effort_controllers/JointPositionController'"):
        registry.common.find("effort_controler/JointPositionController")
