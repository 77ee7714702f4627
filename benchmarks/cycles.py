"""Free-running cycles: the whole control cycle beside bare `mj_step` on the same model, taken in turns in one run.

Ratios are of processor time, median of rounds in which both start from the same state; a noisy neighbour hits both.
"""

from __future__ import annotations

import copy
import re
import statistics
import time
from collections.abc import Callable
from typing import Any

import mujoco

from benchmarks import robots
from benchmarks.harness import RRBOT_CONTROLLERS, SLIDER_CONTROLLERS, Row
from slidectl.control.controller_interface import Controller
from slidectl.control.hardware_interface import JointStateInterface
from slidectl.control.node_handle import NodeHandle
from slidectl.control.registry import controller
from slidectl.description import load
from slidectl.description.controllers_file import read
from slidectl.paths import share
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

ROUNDS = 15
ROUND_S = 0.15
CROWDS = (1, 10, 100, 200)
JOINTS = (1, 6, 30)
COMPILED_GOAL, CROWD_GOAL, PLAIN_GOAL = 0.90, 0.85, 0.25
OWN_IMPORT_GOALS = (("rrbot", RRBOT_CONTROLLERS, 1.2), ("slider", SLIDER_CONTROLLERS, 1.45))
STATES = "joint_state_controller/JointStateController"
SPACING_M = 5.0
ORIGIN = (0.0, 0.0, 0.0)
MOTORS_GOALS = {"cart": 30.0, "arm": 100.0}
"""Times real time."""
SETTLING_CYCLES = 1500


def measure() -> list[Row]:
    """Both tutorials' robots on both engines, a controller in Python among them, and crowds of RRBots."""
    rows = []
    for engine in ("compiled", "plain") if object_file.is_possible() else ("plain",):
        goal = COMPILED_GOAL if engine == "compiled" else PLAIN_GOAL
        for model, controllers in (("slider", SLIDER_CONTROLLERS), ("rrbot", RRBOT_CONTROLLERS)):
            rows += compared(f"{model}, {engine}", build(model, controllers, engine), goal)
            rows += compared(f"{model}, its state topics heard, {engine}", heard(model, controllers, engine), None)
        rows += beside_real_time(engine)
        rows += compared(f"rrbot and a watcher in Python, {engine}", watched(engine), None)
    if object_file.is_possible():
        for model, controllers, own_goal in OWN_IMPORT_GOALS:
            rows.append(beside_own_import(model, controllers, own_goal))
        for joints in JOINTS:
            rows += compared(f"one robot of {joints} joints, compiled", comb(joints), None, joints, "a joint")
        for count in CROWDS:
            crowd = build("rrbot", RRBOT_CONTROLLERS, "compiled", count)
            rows += compared(f"{count} RRBots, compiled", crowd, CROWD_GOAL if count >= 100 else None, count)
    return rows


def build(model: str, controllers: tuple[str, ...], engine: str = "auto", count: int = 1) -> Simulation:
    """A simulation with robots of `models/`, their controllers running, moving to a command."""
    simulation = Simulation(engine=engine)
    if engine == "compiled":
        simulation.engine.complete()
    parameters, xml = read(share("config") / f"{model}_control.yaml")[model], load(model).xml
    for number in range(count):
        name = model if count == 1 else f"{model}{number}"
        place = (SPACING_M * (number % 20), SPACING_M * (number // 20), 0.0)
        simulation.parameters.set(f"/{name}", parameters)
        simulation.spawn(xml, name, f"/{name}", (place, (0.0, 0.0, 0.0, 1.0)))
        start(simulation, name, controllers)
        for joint in controllers[1:]:
            simulation.publish(f"/{name}/{joint}/command", {"data": 0.5})
    return simulation


def start(simulation: Simulation, name: str, controllers: tuple[str, ...]) -> None:
    for one in controllers:
        simulation.call(f"/{name}/controller_manager/load_controller", {"name": one})
    request = {"start_controllers": list(controllers), "strictness": 2}
    simulation.call(f"/{name}/controller_manager/switch_controller", request)


@controller("benchmarks/Watcher")
class Watcher(Controller[JointStateInterface]):
    """The least that a controller of somebody's own does: looks at a joint."""

    interface_type = JointStateInterface

    def init(self, interface: JointStateInterface, node: NodeHandle) -> None:  # noqa: ARG002
        self.joint = interface.get_handle("joint1")
        self.largest = 0.0

    def update(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002
        if self.joint.effort > self.largest:
            self.largest = self.joint.effort


def heard(model: str, controllers: tuple[str, ...], engine: str) -> Simulation:
    """A robot whose joint states (50 Hz) and controllers' states (100 Hz each) somebody takes, and throws away."""
    simulation = build(model, controllers, engine)
    for topic in ("joint_states", *(f"{name}/state" for name in controllers[1:])):
        simulation.graph.topics.subscribe(f"/{model}/{topic}", None, "/listener", lambda _: None)
    return simulation


def watched(engine: str) -> Simulation:
    """An RRBot with a controller that runs in Python on either engine."""
    simulation = build("rrbot", RRBOT_CONTROLLERS, engine)
    simulation.parameters.set("/rrbot/watcher", {"type": "benchmarks/Watcher"})
    start(simulation, "rrbot", ("watcher",))
    return simulation


def comb(joints: int) -> Simulation:
    """One robot with so many hinges side by side, each with a position controller."""
    simulation = Simulation(ground=False, engine="compiled")
    simulation.engine.complete()
    law = {"type": "effort_controllers/JointPositionController", "pid": {"p": 10.0, "i": 0.0, "d": 1.0}}
    names = [f"joint{number}" for number in range(joints)]
    states: dict[str, Any] = {"type": STATES, "publish_rate": 50}
    simulation.parameters.set("/comb", {"states": states, **{f"of_{name}": {**law, "joint": name} for name in names}})
    simulation.spawn(f"<robot name='comb'><link name='world'/>{''.join(map(hinge, names))}</robot>", "comb", "/comb")
    start(simulation, "comb", ("states", *(f"of_{name}" for name in names)))
    return simulation


def hinge(name: str) -> str:
    return f"""
    <link name='{name}_link'><inertial><origin xyz='0.1 0 0'/><mass value='1'/>
      <inertia ixx='0.01' iyy='0.01' izz='0.01' ixy='0' ixz='0' iyz='0'/></inertial></link>
    <joint name='{name}' type='revolute'><parent link='world'/><child link='{name}_link'/><axis xyz='0 1 0'/>
      <limit lower='-3' upper='3' effort='50' velocity='10'/></joint>
    <transmission name='of_{name}'><type>transmission_interface/SimpleTransmission</type>
      <joint name='{name}'><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
      <actuator name='motor_{name}'><mechanicalReduction>1</mechanicalReduction></actuator></transmission>"""


def beside_real_time(engine: str) -> list[Row]:
    """A cart on four wheels and an arm of six joints, with and without motors: how many times real time they run."""
    wheels, place = dict.fromkeys(robots.WHEELS, 5.0), (0.0, 0.0, robots.CART_HEIGHT)
    pose = dict(zip(robots.ARM_JOINTS, robots.ARM_POSE, strict=True))
    position, effort = "PositionJointInterface", "EffortJointInterface"
    scenes = (
        ("cart", "cart, velocities by motors", robots.cart(), robots.cart_parameters(False), wheels, place),
        ("cart", "cart, velocities by PIDs", robots.cart(), robots.cart_parameters(True), wheels, place),
        ("arm", "arm, positions by motors", robots.arm(position), robots.arm_parameters(position), pose, ORIGIN),
        ("arm", "arm, efforts", robots.arm(effort), robots.arm_parameters(effort), pose, ORIGIN),
    )
    rows = []
    for kind, name, xml, parameters, commands, at in scenes:
        simulation = Simulation(engine=engine)
        if engine == "compiled":
            simulation.engine.complete()
        simulation.parameters.set(f"/{kind}", parameters)
        simulation.spawn(xml, kind, f"/{kind}", (at, (0.0, 0.0, 0.0, 1.0)))
        start(simulation, kind, ("states", *(f"of_{joint}" for joint in commands)))
        for joint, command in commands.items():
            simulation.publish(f"/{kind}/of_{joint}/command", {"data": command})
        simulation.driven = True
        simulation.step(SETTLING_CYCLES)
        cycles = _cycles_of_a_round(simulation)
        taken = min(cpu_s(lambda simulation=simulation, n=cycles: simulation.step(n)) for _ in range(5)) / cycles
        goal = MOTORS_GOALS[kind] if engine == "compiled" and "motors" in name else None
        factor = simulation.world.timestep / taken
        note = f"{1e6 * taken:.3g} us a cycle"
        rows.append(Row(f"{name}, {engine}: times real time", factor, "", goal, better="higher", note=note))
    return rows


def compared(
    name: str, simulation: Simulation, goal: float | None, parts: int = 1, of_what: str = "a robot"
) -> list[Row]:
    """The rows of one simulation, run as a daemon runs it."""
    model = copy.copy(simulation.world.model)
    ratio, mine, theirs = in_turns(simulation, model, lambda: copy.copy(simulation.world.data))
    each = f", {1e6 * mine / parts:.3g} us {of_what}" if parts > 1 else ""
    note = f"{1e6 * mine:.3g} us a cycle{each}; bare {1e6 * theirs:.3g} us"
    return [Row(f"{name}: ratio to bare mj_step", ratio, "", goal, better="higher", note=note)]


def beside_own_import(name: str, controllers: tuple[str, ...], goal: float) -> Row:
    """The compiled cycle beside `mj_step` of the model that MuJoCo itself makes of the URDF, with a ground plane."""
    simulation = build(name, controllers, "compiled")
    spec = mujoco.MjSpec.from_string(_without_instructions(load(name).xml))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    spec.option.timestep, spec.option.gravity = simulation.world.timestep, simulation.world.gravity
    model = spec.compile()

    def start_state() -> Any:
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = simulation.world.data.qpos, simulation.world.data.qvel
        return data

    ratio, mine, theirs = in_turns(simulation, model, start_state)
    note = f"{1e6 * mine:.3g} us a cycle; MuJoCo's own import {1e6 * theirs:.3g} us"
    return Row(f"{name}: ratio to MuJoCo's own import", ratio, "", goal, better="higher", note=note)


def _without_instructions(urdf: str) -> str:
    """MuJoCo reads no XML processing instructions."""
    return re.sub(r"<\?.*?\?>", "", urdf, flags=re.DOTALL)


def in_turns(simulation: Simulation, model: Any, start_state: Callable[[], Any]) -> tuple[float, float, float]:
    """The ratio of a bare step of the model to a cycle of the simulation, and the s of a cycle and of a bare step."""
    simulation.driven = True
    cycles = _cycles_of_a_round(simulation)
    ratios, ours, bare = [], [], []
    for _ in range(ROUNDS):
        data = start_state()
        bare.append(cpu_s(lambda data=data: mujoco.mj_step(model, data, nstep=cycles)) / cycles)
        ours.append(cpu_s(lambda: simulation.step(cycles)) / cycles)
        ratios.append(bare[-1] / ours[-1])
    return statistics.median(ratios), statistics.median(ours), statistics.median(bare)


def _cycles_of_a_round(simulation: Simulation) -> int:
    simulation.step(500)
    taken = cpu_s(lambda: simulation.step(500)) / 500
    return max(200, int(ROUND_S / taken))


def cpu_s(action: Callable[[], Any]) -> float:
    began = time.process_time()
    action()
    return time.process_time() - began
