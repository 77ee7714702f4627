"""Replays a recorded run of a controller: a controller manager on a graph, with joints that move as the record says.

The order of a cycle and the plants are those that the records' own notes describe. Numbers agree within TOLERANCE.
A record is followed up to a command of nan or infinity that is refused here (docs/deviations.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from math import isfinite
from operator import attrgetter
from typing import Any

from slidectl.control.controller_interface import ControllerBase
from slidectl.control.controller_manager import ControllerManager
from slidectl.control.duration import from_seconds, to_stamp
from slidectl.control.hardware_interface import (
    EffortJointInterface,
    ForceTorqueData,
    ForceTorqueSensorInterface,
    ImuData,
    ImuSensorInterface,
    JointHandle,
    JointStateInterface,
    PositionJointInterface,
    PosVelAccJointInterface,
    PosVelJointInterface,
    RobotHW,
    SensorHandle,
    VelocityJointInterface,
)
from slidectl.errors import SlidectlError
from slidectl.features.action_server import ActionServer
from slidectl.simulation.graph import Graph

Case = dict[str, Any]
Comparison = tuple[str, Any, Any]
"""Where, what was recorded, what came out."""

TOLERANCE = 1e-9
START_NS = 100_000_000_000
ROOT = "/robot"
CONTROLLER = f"{ROOT}/ctrl"
HOST = "/host"
ACTIONS = {"GripperActionController": "gripper_cmd", "JointTrajectoryController": "follow_joint_trajectory"}
IGNORES_NON_FINITE = {"DiffDriveController", "FourWheelSteeringController"}
"""Controllers of which upstream ignores such commands too."""
NOT_KEPT = {"limited.lin_y"}
"""Columns of members that upstream stores and never uses."""
INTERFACES: dict[str, tuple[type[Any], type[Any]]] = {
    "position": (PositionJointInterface, JointHandle),
    "velocity": (VelocityJointInterface, JointHandle),
    "effort": (EffortJointInterface, JointHandle),
    "pos_vel": (PosVelJointInterface, JointHandle),
    "pos_vel_acc": (PosVelAccJointInterface, JointHandle),
}

SENSORS: dict[str, tuple[type[Any], type[Any]]] = {
    "imu": (ImuSensorInterface, ImuData),
    "force_torque": (ForceTorqueSensorInterface, ForceTorqueData),
}


def numbers_in(value: Any) -> Any:
    """A recorded message; non-finite numbers are strings."""
    if isinstance(value, dict):
        return {key: numbers_in(item) for key, item in value.items()}
    if isinstance(value, list):
        return [numbers_in(item) for item in value]
    return float(value) if value in ("nan", "inf", "-inf") else value


def is_finite(value: Any) -> bool:
    """No number in a message is nan or infinite."""
    if isinstance(value, dict | list):
        return all(map(is_finite, value.values() if isinstance(value, dict) else value))
    return not isinstance(value, float) or isfinite(value)


def last_cycle(case: Case) -> int:
    """The last cycle of a case that is followed: that before a command that is refused here alone, else its last."""
    refused = [
        event["cycle"] - 1
        for event in case["events"]
        if event["kind"] in ("command", "goal")
        and case["type"].rpartition("/")[2] not in IGNORES_NON_FINITE
        and not is_finite(numbers_in(event["msg"]))
    ]
    return int(min([case["cycles"], *refused]))


class Plant:
    """One joint: its handle, and how it moves by the command."""

    def __init__(self, recorded: Case, dt_s: float) -> None:
        self.interface = recorded["interface"]
        self.kind = recorded.get("plant", self.interface)
        self.alpha = recorded.get("alpha", 0.0)
        self.dt_s = dt_s
        self.handle = INTERFACES[self.interface][1](recorded["name"], position=recorded["position"])
        self.blocked = False
        if "pos" in self.interface:
            self.handle.command = recorded["position"]

    def move(self) -> None:
        """One period."""
        joint, dt = self.handle, self.dt_s
        before = joint.position
        if self.blocked:
            joint.velocity = 0.0
        elif self.kind in ("pos_vel", "pos_vel_acc"):
            joint.position, joint.velocity = joint.command, joint.command_velocity
        elif self.kind == "velocity":
            joint.velocity = joint.command
            joint.position += joint.command * dt
        elif self.kind == "effort":
            joint.velocity += (joint.command - 0.5 * joint.velocity) * dt
            joint.position += joint.velocity * dt
        else:
            joint.position = (
                joint.command if self.kind == "position" else before + self.alpha * (joint.command - before)
            )
            joint.velocity = (joint.position - before) / dt


class Replay:
    """One case, cycle by cycle."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.cycle = 0
        self.dt_ns = from_seconds(case["dt"])
        self.plants = {joint["name"]: Plant(joint, case["dt"]) for joint in case["joints"]}
        self.graph = Graph()
        self.graph.serve_actions(ActionServer)
        self.graph.clock.time_ns = START_NS
        self.logged: list[tuple[int, str]] = []
        self.graph.log.sink = lambda severity, *_: self.logged.append((self.cycle, severity))
        self.graph.parameters.set(CONTROLLER, {**case["params"], "type": case["type"]})
        if "urdf" in case:
            self.graph.parameters.set(f"{ROOT}/robot_description", case["urdf"])
        self.measured: dict[str, Any] = {}
        self.manager = ControllerManager(self._hardware(), self.graph.node(ROOT))
        self.loaded = self.manager.load("ctrl")
        self.controller: ControllerBase | None = self.manager.get("ctrl")
        self.published: dict[str, list[tuple[int, Any]]] = {}
        for topic in case.get("published", {}):
            self._record(topic, topic if topic == "/tf" else f"{ROOT}{topic}")
        word = case["type"].rpartition("/")[2]
        self.action = f"{CONTROLLER}/{ACTIONS.get(word, '')}"
        if word in ACTIONS and self.loaded:
            self._record("result", f"{self.action}/result")
            self._record("feedback", f"{self.action}/feedback")
        self.queries: list[Case] = []

    def _hardware(self) -> RobotHW:
        hw = RobotHW()
        plants = self.plants.values()
        hw.register_interface(JointStateInterface(plant.handle for plant in plants))
        for name in dict.fromkeys(plant.interface for plant in plants):
            hw.register_interface(INTERFACES[name][0](plant.handle for plant in plants if plant.interface == name))
        for key, (interface, kind) in SENSORS.items():
            for sensor in self.case.get(f"{key}s", ()):
                self._measure(kind, sensor)
            handles = (
                SensorHandle(sensor["name"], sensor["frame_id"], partial(self.measured.__getitem__, sensor["name"]))
                for sensor in self.case.get(f"{key}s", ())
            )
            hw.register_interface(interface(handles))
        return hw

    def _measure(self, kind: type[Any], values: Case) -> None:
        """From now on the sensor measures this; what is not given stays."""
        given = {name: tuple(value) for name, value in values.items() if name in kind._fields}
        before = self.measured.get(values["name"])
        self.measured[values["name"]] = kind(**given) if before is None else before._replace(**given)

    def _record(self, key: str, topic: str) -> None:
        messages = self.published.setdefault(key, [])
        if self.graph.topics.exists(topic):
            self.graph.topics.subscribe(topic, None, HOST, lambda message: messages.append((self.cycle, message)))

    def run(self) -> Iterator[Comparison]:
        """Everything that was recorded."""
        case = self.case
        yield "init", case["init_ok"], self.loaded
        if not self.loaded or self.controller is None:
            return
        for claim in case["claimed"]:
            own = {claimed.hardware_interface: list(claimed.resources) for claimed in self.controller.claimed_resources}
            yield "claims", claim["resources"], own.get(claim["hardware_interface"], [])
        rows = {row[0]: row for row in case["rows"]}
        end = last_cycle(case)
        for self.cycle in range(end + 1):
            self._run_cycle()
            if self.cycle in rows:
                yield from self._compare_row(rows[self.cycle])
            for plant in self.plants.values():
                plant.move()
        yield from self._compare_published(end)
        yield from self._compare_actions(end)

    def _run_cycle(self) -> None:
        clock = self.graph.clock
        clock.time_ns = START_NS + self.cycle * self.dt_ns
        events = [event for event in self.case["events"] if event["cycle"] == self.cycle]
        for event in events:
            if event["kind"] in ("block", "unblock", "set_state"):
                self._change_plant(event)
        for event in events:
            if handler := getattr(self, f"_on_{event['kind']}", None):
                try:
                    handler(event)
                except SlidectlError:
                    self.logged.append((self.cycle, "error"))  # upstream logs it; the answer says it here
        for kind in ("start", "stop"):
            if any(event["kind"] == kind for event in events):
                assert self.manager.request_switch(**{"start": [], "stop": [], kind: ["ctrl"]}, strictness=2)
        self.manager.update(clock.time_ns, self.case["dt"])
        self.graph.timers.fire()

    def _change_plant(self, event: Case) -> None:
        plant = self.plants[event["joint"]]
        if event["kind"] == "set_state":
            plant.handle.position, plant.handle.velocity = event["position"], event["velocity"]
        else:
            plant.blocked = event["kind"] == "block"

    def _on_imu(self, event: Case) -> None:
        self._measure(ImuData, event)

    def _on_force_torque(self, event: Case) -> None:
        self._measure(ForceTorqueData, event)

    def _on_command(self, event: Case) -> None:
        self._publish(f"{CONTROLLER}/{event['topic']}", event["msg_type"], numbers_in(event["msg"]))

    def _on_goal(self, event: Case) -> None:
        goal_id = {"id": event["goal"], "stamp": to_stamp(self.graph.clock.time_ns)}
        self._publish(f"{self.action}/goal", None, {"goal_id": goal_id, "goal": numbers_in(event["msg"])})

    def _on_cancel(self, event: Case) -> None:
        self._publish(f"{self.action}/cancel", None, {"id": event["goal"]})

    def _publish(self, topic: str, type_name: str | None, message: Case) -> None:
        self.graph.topics.publish(topic, type_name, message, HOST)

    def _on_reconfigure(self, event: Case) -> None:
        values = event["config"]
        flags = [{"name": name, "value": value} for name, value in values.items() if isinstance(value, bool)]
        doubles = [{"name": name, "value": value} for name, value in values.items() if not isinstance(value, bool)]
        request = {"config": {"bools": flags, "doubles": doubles}}
        self.graph.services.call(f"{CONTROLLER}/set_parameters", request).result()

    def _on_query_state(self, event: Case) -> None:
        answer: Case = {"ok": False}
        self.queries.append(answer)
        call = self.graph.services.call(f"{CONTROLLER}/query_state", {"time": event["time"]})
        answer.update(call.result(), ok=True)

    def _compare_row(self, row: list[Any]) -> Iterator[Comparison]:
        for column, recorded in zip(self.case["columns"][1:], row[1:], strict=True):
            if column in NOT_KEPT:
                continue
            yield f"cycle {self.cycle}, {column}", recorded, self._value(column)

    def _value(self, column: str) -> Any:
        name, _, what = column.rpartition(".")
        if name not in self.plants:
            return COLUMNS[column](self.controller)
        handle = self.plants[name].handle
        if what in ("pos", "vel"):
            return handle.position if what == "pos" else handle.velocity
        if what.startswith("cmd"):
            names = {"cmd_vel": "command_velocity", "cmd_acc": "command_acceleration"}
            return getattr(handle, names.get(what, "command"))
        return JOINT_COLUMNS[what](self.controller)[self.case["params"]["joints"].index(name)]

    def _compare_published(self, end: int) -> Iterator[Comparison]:
        for topic, recorded in self.case.get("published", {}).items():
            messages = self.published[topic]
            cycles = recorded["cycles"]
            first, last = cycles["every"] if isinstance(cycles, dict) else (0, -1)
            expected = list(range(first, last + 1)) or cycles
            yield f"cycles of {topic}", [k for k in expected if k <= end], [cycle for cycle, _ in messages]
            for cycle, message in recorded["messages"]:
                if cycle <= end:
                    found = next((own for at, own in messages if at == cycle), None)
                    yield from compare_trees(f"{topic} in cycle {cycle}", message, found)

    def _compare_actions(self, end: int) -> Iterator[Comparison]:
        if "results" in self.case:
            own = [
                {"goal": m["status"]["goal_id"]["id"], "cycle": cycle, "status": m["status"]["status"]}
                | {"status_text": m["status"]["text"], **m["result"]}
                for cycle, m in self.published["result"]
            ]
            wanted = [dict(result) for result in self.case["results"] if result["cycle"] <= end]
            yield "number of results", len(wanted), len(own)
            for recorded, result in zip(wanted, own, strict=False):
                recorded.pop("decided_cycle")
                yield from compare_trees(f"result of {recorded['goal']}", recorded, result)
            feedback = [entry for entry in self.case["feedback"] if entry[0] <= end]
            given = [[cycle, m["status"]["goal_id"]["id"]] for cycle, m in self.published["feedback"]]
            yield "feedback", [entry[:2] for entry in feedback], given
            for entry, (_, message) in zip(feedback, self.published["feedback"], strict=False):
                if len(entry) > 2:
                    yield from compare_trees(f"feedback in cycle {entry[0]}", entry[2], message["feedback"])
        for recorded, answer in zip(self.case.get("queries", ()), self.queries, strict=True):
            wanted = {key: value for key, value in recorded.items() if key in answer}
            yield from compare_trees(f"query in cycle {recorded['cycle']}", wanted, answer)
        loud = {cycle for cycle, severity in self.logged if severity in ("warn", "error")}
        for cycle, _, text, *_ in self.case.get("logs", ()):
            if cycle <= end:
                yield f"a line on the log in cycle {cycle}, as {text!r}", True, cycle in loud


JOINT_COLUMNS: dict[str, Callable[[Any], list[float]]] = {
    "des_pos": lambda controller: [motion.position for motion in controller.motions],
    "des_vel": lambda controller: [motion.velocity for motion in controller.motions],
    "des_acc": lambda controller: [motion.acceleration for motion in controller.motions],
    "err_pos": lambda controller: [motion.position_error for motion in controller.motions],
    "err_vel": lambda controller: [motion.velocity_error for motion in controller.motions],
}
"""The members of a controller that rows show for each joint."""
COLUMNS: dict[str, Callable[[Any], float]] = {
    **{
        f"odom.{name}": attrgetter(f"odometry.{name}")
        for name in ("x", "y", "heading", "linear", "linear_x", "linear_y", "angular")
    },
    **{
        f"odom.{name}": partial(lambda place, controller: controller.odometry.changes[place], place)
        for place, name in enumerate(("linear_acceleration", "linear_jerk", "front_steer_vel", "rear_steer_vel"))
    },
    "command.position": attrgetter("position"),
    "command.max_effort": attrgetter("max_effort"),
    "computed_command": attrgetter("command"),
    **{f"limited.{name}": attrgetter(f"velocity.last_{name}") for name in ("linear", "angular")},
    "limited.lin_x": attrgetter("velocity.last_linear"),
    "limited.ang": attrgetter("velocity.last_angular"),
}
"""The other members that rows show."""


def compare_trees(where: str, recorded: Any, computed: Any) -> Iterator[Comparison]:
    """Every leaf of a recorded message; fields that it lacks do not count."""
    if isinstance(recorded, dict) and isinstance(computed, dict):
        for key, value in recorded.items():
            yield from compare_trees(f"{where}, {key}", value, computed.get(key))
    elif isinstance(recorded, list) and isinstance(computed, list | tuple) and len(recorded) == len(computed):
        for k, (value, own) in enumerate(zip(recorded, computed, strict=True)):
            yield from compare_trees(f"{where}[{k}]", value, own)
    else:
        yield where, recorded, computed


def replay(case: Case) -> Iterator[Comparison]:
    """Every value of one case."""
    yield from Replay(case).run()
