"""Controllers: what each costs a cycle, in the interpreter and as machine code, and whole cycles of robots that follow
trajectories or drive, beside bare `mj_step`.

The cost of a controller is the difference of cycles with it and without it, taken in turns in one run.
"""

from __future__ import annotations

import copy
import math
import statistics
from typing import Any

import mujoco
import yaml

from benchmarks import cycles, robots
from benchmarks.harness import Row
from slidectl.control import Columns, Compiled, LawTables, Parts, law
from slidectl.control.controllers.forward import ForwardEffortController
from slidectl.control.hardware_interface import JointHandle
from slidectl.control.registry import controller
from slidectl.description import load
from slidectl.paths import share
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

ROUNDS = 9
CYCLES = {"plain": 1500, "compiled": 30_000}
FOLLOWER_JOINTS = (1, 6, 10, 100)
ARM_GOAL, CART_GOAL, MOTOR_GOAL_US, OWN_LAW_GOAL = 0.85, 0.8, 1.0, 1.05
GAINS = {"p": 1.0, "i": 0.0, "d": 0.1}
LONG_S = 4000
BARE_ROUNDS, MOMENT = 400, 100


def measure() -> list[Row]:
    """Each type on both engines, then the robots, compiled."""
    rows = []
    for engine in ("plain", "compiled") if object_file.is_possible() else ("plain",):
        for name, interface, joints, own in types():
            simulation = comb(interface, joints, {"it": own}, engine)
            rows.append(Row(f"{name}, {engine}: cost a cycle", cost_ns(simulation, engine), "ns"))
    if object_file.is_possible():
        rows += [arm_follows("Effort"), arm_follows("Position"), cart_drives(), own_law()]
    return rows


def types() -> list[tuple[str, str, int, dict[str, Any]]]:
    """Name, interface, number of joints, and parameters."""
    found: list[tuple[str, str, int, dict[str, Any]]] = [
        ("JointStateController of 6 joints", "Effort", 6, {"type": cycles.STATES, "publish_rate": 50}),
    ]
    for kind in ("Position", "Velocity", "Effort"):
        own = {"type": f"effort_controllers/Joint{kind}Controller", "joint": "joint0", "pid": GAINS}
        found.append((f"effort_controllers/Joint{kind}Controller", "Effort", 1, own))
    for kind in ("Position", "Effort"):
        pids = {joint: {"pid": GAINS} for joint in names(6)}
        group = {"type": f"effort_controllers/JointGroup{kind}Controller", "joints": names(6), **pids}
        found.append((f"effort_controllers/JointGroup{kind}Controller of 6 joints", "Effort", 6, group))
    for interface, joints in (*(("Effort", count) for count in FOLLOWER_JOINTS), ("Velocity", 6), ("Position", 6)):
        name = f"{interface.lower()}_controllers/JointTrajectoryController"
        found.append((f"{name} of {joints} joints, on its way", interface, joints, follower(interface, names(joints))))
    gripper = {"type": "effort_controllers/GripperActionController", "joint": "joint0", "gains": {"joint0": GAINS}}
    found.append(("effort_controllers/GripperActionController", "Effort", 1, gripper))
    base = {
        "type": "diff_drive_controller/DiffDriveController",
        "left_wheel": "joint0",
        "right_wheel": "joint1",
        "wheel_separation": 0.4,
        "wheel_radius": 0.1,
        "pose_covariance_diagonal": [0.1] * 6,
        "twist_covariance_diagonal": [0.1] * 6,
    }
    return [*found, ("DiffDriveController of 2 wheels", "Velocity", 2, base)]


def names(joints: int) -> list[str]:
    return [f"joint{number}" for number in range(joints)]


def follower(interface: str, joints: list[str], gains: dict[str, Any] | None = None) -> dict[str, Any]:
    """The parameters of a trajectory controller."""
    kind = f"{interface.lower()}_controllers/JointTrajectoryController"
    return {"type": kind, "joints": joints, "gains": gains or dict.fromkeys(joints, GAINS)}


def trajectory(joints: list[str], pose: tuple[float, ...]) -> dict[str, Any]:
    """To and fro about a pose for longer than anybody measures, a point a second."""
    rest = [0.0] * len(joints)
    points = [
        {
            "positions": [angle + 0.1 * math.sin(second) for angle in pose],
            "velocities": rest,
            "accelerations": rest,
            "time_from_start": {"secs": second, "nsecs": 0},
        }
        for second in range(1, LONG_S)
    ]
    return {"joint_names": joints, "points": points}


def comb(interface: str, joints: int, controllers: dict[str, dict[str, Any]], engine: str) -> Simulation:
    """So many damped hinges side by side, without limits or gravity, and these controllers running."""
    simulation = Simulation(ground=False, engine=engine, gravity=(0.0, 0.0, 0.0))
    if engine == "compiled":
        simulation.engine.complete()
    hinges = "".join(map(cycles.hinge, names(joints)))
    hinges = hinges.replace("'revolute'", "'continuous'").replace("Effort", interface)
    hinges = hinges.replace("<axis", "<dynamics damping='1'/><axis")
    states = {"type": cycles.STATES, "publish_rate": 50}
    simulation.parameters.set("/comb", {"states": states, **controllers})
    simulation.spawn(f"<robot name='comb'><link name='world'/>{hinges}</robot>", "comb", "/comb")
    cycles.start(simulation, "comb", ("states", *controllers))
    if engine == "compiled":
        simulation.engine.complete()
    return simulation


def cost_ns(simulation: Simulation, engine: str) -> float:
    """Of the controller `it`, a cycle."""
    count = CYCLES[engine] // max(1, len(simulation.robots.get("comb").hardware.driven()) // 6)
    services = simulation.graph.services
    joints = [joint.handle.name for joint in simulation.robots.get("comb").hardware.driven()]
    simulation.driven = True
    differences = []
    for _ in range(ROUNDS):
        taken = []
        for change in ("stop", "start"):
            request = {f"{change}_controllers": ["it"], "strictness": 1}
            services.call("/comb/controller_manager/switch_controller", request)
            simulation.step(2)
            if change == "start" and "/comb/it/query_state" in services.names():
                simulation.publish("/comb/it/command", trajectory(joints, (0.0,) * len(joints)))
            simulation.step(200)
            taken.append(min(cycles.cpu_s(lambda: simulation.step(count)) for _ in range(2)) / count)
        differences.append(taken[1] - taken[0])
    return 1e9 * statistics.median(differences)


def arm_follows(interface: str) -> Row:
    """An arm of six joints on its way, by efforts or by motors without gains."""
    simulation = Simulation(engine="compiled")
    simulation.engine.complete()
    joints = list(robots.ARM_JOINTS)
    gains = {joint: {"p": p, "i": 0.0, "d": d} for joint, (p, d) in zip(joints, robots.ARM_GAINS, strict=True)}
    own = {"states": {"type": cycles.STATES, "publish_rate": 50}, "follower": follower(interface, joints, gains)}
    simulation.parameters.set("/arm", own)
    simulation.spawn(robots.arm(f"{interface}JointInterface"), "arm", "/arm")
    cycles.start(simulation, "arm", ("states", "follower"))
    simulation.publish("/arm/follower/command", trajectory(joints, robots.ARM_POSE))
    simulation.driven = True
    simulation.step(cycles.SETTLING_CYCLES)
    ratio, mine, theirs = beside_bare(simulation, brakes=interface == "Position")
    note = f"{1e6 * mine:.3g} us a cycle; bare {1e6 * theirs:.3g} us"
    name = f"arm of 6 joints by {'efforts' if interface == 'Effort' else 'motors'}, on a trajectory, compiled"
    if interface == "Effort":
        return Row(f"{name}: ratio to bare mj_step", ratio, "", ARM_GOAL, better="higher", note=note)
    return Row(f"{name}: above bare, a joint", 1e6 * (mine - theirs) / len(joints), "us", MOTOR_GOAL_US, note=note)


def beside_bare(simulation: Simulation, brakes: bool = False) -> tuple[float, float, float]:
    """The ratio of a bare step to a cycle, and the s of a cycle and of a bare step.

    Bare steps go on from where the robot is, only for a moment: without control an arm would fall and a cart stop, and
    the solver has less to do then. Its motors are let go, unless they are to be `brakes`.
    """
    ratios, ours, bare = [], [], []
    for _ in range(BARE_ROUNDS):
        model = mujoco.MjModel.__copy__(simulation.world.model)
        if not brakes:
            model.dof_frictionloss[:] = 0.0
        data = copy.copy(simulation.world.data)
        bare.append(cycles.cpu_s(lambda model=model, data=data: mujoco.mj_step(model, data, nstep=MOMENT)) / MOMENT)
        ours.append(cycles.cpu_s(lambda: simulation.step(MOMENT)) / MOMENT)
        ratios.append(bare[-1] / ours[-1])
    return statistics.median(ratios), statistics.median(ours), statistics.median(bare)


def cart_drives() -> Row:
    """The sample robot with its differential drive."""
    simulation = Simulation(engine="compiled")
    simulation.engine.complete()
    own = yaml.safe_load((share("config") / "cart_control.yaml").read_text(encoding="utf-8"))["cart"]
    own["base_controller"]["cmd_vel_timeout"] = 1e9
    simulation.parameters.set("/cart", own)
    simulation.spawn(load("cart", {"drive": "controller"}).xml, "cart", "/cart")
    cycles.start(simulation, "cart", tuple(own))
    simulation.publish("/cart/base_controller/cmd_vel", {"linear": {"x": 0.4}, "angular": {"z": 0.5}})
    simulation.driven = True
    simulation.step(cycles.SETTLING_CYCLES)
    ratio, mine, theirs = beside_bare(simulation)
    note = f"{1e6 * mine:.3g} us a cycle; bare {1e6 * theirs:.3g} us"
    name = "cart with a differential drive, compiled: ratio to bare mj_step"
    return Row(name, ratio, "", CART_GOAL, better="higher", note=note)


@law
def hand_on(goal: Any, joint: JointHandle) -> None:
    """command = set point: that of `slidectl.control.controllers.forward`."""
    joint.command = goal.set_point


@law
def update_own(goal: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:  # noqa: ARG001
    """The update on rows."""
    hand_on(goal, tables.joints[goal.joint])
    return False


@controller("benchmarks/OwnEffortController")
class OwnEffortController(ForwardEffortController):
    """A user's copy of a controller of ours."""

    compiled = Compiled(update_own, Columns(fixed="set_point"))

    def update(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002
        hand_on(self, self._joint)

    def parts(self) -> Parts:
        return Parts(joint=self._joint)


def own_law() -> Row:
    """Whole cycles with 30 controllers of a user, beside those with 30 of ours."""
    taken: dict[str, list[float]] = {}
    kinds = ("effort_controllers/JointEffortController", "benchmarks/OwnEffortController")
    made = {
        kind: comb("Effort", 30, {f"of_{joint}": {"type": kind, "joint": joint} for joint in names(30)}, "compiled")
        for kind in kinds
    }
    for _ in range(ROUNDS):
        for kind, simulation in made.items():
            simulation.driven = True
            simulation.step(200)
            taken.setdefault(kind, []).append(cycles.cpu_s(lambda one=simulation: one.step(5000)) / 5000)
    ours, own = (min(taken[kind]) for kind in kinds)
    note = f"{1e6 * own:.3g} us a cycle with 30 of them; ours {1e6 * ours:.3g} us"
    return Row("a user's compiled law beside the same law of ours", own / ours, "x", OWN_LAW_GOAL, note=note)
