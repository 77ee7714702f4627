"""Small robots for the simulation's tests, and what one does with them. Pure helpers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from slidectl.control.controller_interface import Controller
from slidectl.control.hardware_interface import EffortJointInterface
from slidectl.control.node_handle import NodeHandle
from slidectl.control.registry import controller
from slidectl.simulation import Simulation, SpawnedRobot

POSITION = "effort_controllers/JointPositionController"
STATES = "joint_state_controller/JointStateController"


def cart(plugin: str = "", joints: int = 1, damping: float = 1.0) -> str:
    """Carts of 1 kg on rails, side by side, pushed by effort; nothing limits or touches them."""
    parts = "".join(_rail(k + 1, damping) for k in range(joints))
    block = f'<gazebo><plugin name="c" filename="libgazebo_ros_control.so">{plugin}</plugin></gazebo>'
    return f'<robot name="cart"><link name="world"/>{parts}{block}</robot>'


def _rail(number: int, damping: float) -> str:
    return f"""
  <joint name="joint{number}" type="prismatic"><parent link="world"/><child link="box{number}"/>
    <origin xyz="0 {number} 1"/><axis xyz="1 0 0"/><dynamics damping="{damping}"/>
    <limit lower="-100" upper="100" effort="1000" velocity="1000"/></joint>
  <link name="box{number}"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <transmission name="t{number}"><type>transmission_interface/SimpleTransmission</type>
    <joint name="joint{number}"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
    <actuator name="m{number}"/></transmission>"""


def configure(simulation: Simulation, namespace: str = "/cart", joints: int = 1) -> list[str]:
    """Parameters of a joint state controller and a position controller for each joint; their names."""
    simulation.parameters.set(f"{namespace}/states", {"type": STATES, "publish_rate": 50})
    for number in range(1, joints + 1):
        gains = {"p": 100.0, "i": 5.0, "d": 10.0, "i_clamp": 20.0}
        own = {"type": POSITION, "joint": f"joint{number}", "pid": gains}
        simulation.parameters.set(f"{namespace}/position{number}", own)
    return ["states", *(f"position{number}" for number in range(1, joints + 1))]


def drive_up(simulation: Simulation, namespace: str = "/cart", joints: int = 1) -> None:
    """Configure, load and start everything of a robot that is there."""
    names = configure(simulation, namespace, joints)
    for name in names:
        assert simulation.call(f"{namespace}/controller_manager/load_controller", {"name": name})["ok"]
    assert switch(simulation, start=names, namespace=namespace)


def switch(
    simulation: Simulation, start: Any = (), stop: Any = (), namespace: str = "/cart", strictness: int = 2
) -> bool:
    """The answer of switch_controller."""
    request = {"start_controllers": list(start), "stop_controllers": list(stop), "strictness": strictness}
    ok: bool = simulation.call(f"{namespace}/controller_manager/switch_controller", request)["ok"]
    return ok


def running_cart(plugin: str = "", joints: int = 1, timestep: float = 0.001, engine: str = "auto") -> Simulation:
    """A simulation with one cart whose controllers run, at time 0."""
    simulation = Simulation(timestep=timestep, ground=False, engine=engine)
    if engine == "compiled":
        simulation.engine.complete()
    simulation.spawn(cart(plugin, joints), "cart")
    drive_up(simulation, joints=joints)
    return simulation


def command(simulation: Simulation, value: float, topic: str = "/cart/position1/command") -> None:
    """Send a set point."""
    simulation.publish(topic, {"data": value})


def state(simulation: Simulation, name: str = "cart", joint: str = "joint1") -> tuple[float, float, float]:
    """Position, velocity, effort of a joint."""
    return simulation.world.joint_state(name, joint)


def states_of(simulation: Simulation, name: str = "/cart") -> dict[str, str]:
    """Controller name to state."""
    listed = simulation.call(f"{name}/controller_manager/list_controllers")["controller"]
    return {entry["name"]: entry["state"] for entry in listed}


def logged(simulation: Simulation) -> list[tuple[str, str]]:
    """A list to which every line of the log is added: severity, text."""
    lines: list[tuple[str, str]] = []
    simulation.graph.log.sink = lambda severity, _node, text, _time: lines.append((severity, text))
    return lines


class Probe:
    """What a probe controller was asked to do, with times in ns."""

    calls: list[tuple[str, int]]
    periods: list[float]
    act: Callable[[int], None] | None

    def __init__(self) -> None:
        self.calls, self.periods, self.act = [], [], None


@controller("tests/Probe")
class ProbeController(Controller[EffortJointInterface]):
    """Notes its hooks. Its joint is the parameter `joint`."""

    interface_type = EffortJointInterface

    def init(self, interface: EffortJointInterface, node: NodeHandle) -> None:
        interface.get_handle(node.get_param("joint"))
        self.probe = Probe()

    def starting(self, time_ns: int) -> None:
        self.probe.calls.append(("starting", time_ns))

    def update(self, time_ns: int, period_s: float) -> None:
        self.probe.calls.append(("update", time_ns))
        self.probe.periods.append(period_s)
        if self.probe.act is not None:
            self.probe.act(time_ns)

    def stopping(self, time_ns: int) -> None:
        self.probe.calls.append(("stopping", time_ns))


def put_probe(simulation: Simulation, robot: SpawnedRobot, name: str = "probe", joint: str = "joint1") -> Probe:
    """Load a probe controller; it is not started."""
    simulation.parameters.set(f"{robot.namespace}/{name}", {"type": "tests/Probe", "joint": joint})
    assert robot.manager.load(name)
    loaded: Any = robot.manager.get(name)
    probe: Probe = loaded.probe
    return probe
