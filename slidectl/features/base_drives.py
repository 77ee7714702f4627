"""Drives of mobile bases in a model: they receive velocities on a topic and publish odometry on a topic and on /tf.

Motors of the world turn the wheels (diff_drive, skid_steer_drive); planar_move sets the robot's velocity in each step.
Odometry without a subscriber costs nothing, unless it is computed from the wheel positions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from slidectl import names
from slidectl.control.duration import header_of
from slidectl.control.mobile_base import matrix_of, twist_of
from slidectl.control.node_handle import Message
from slidectl.description.robot import BaseDrive, PlanarMove, WheelDrive, namespace_of
from slidectl.errors import MessageRefused
from slidectl.features.gazebo_frames import pose_message, transform_message
from slidectl.features.state_publisher import tf_prefix
from slidectl.rotations import Pose, Vector, from_rpy, to_rpy
from slidectl.simulation.clock import EACH_STEP_NS, SECOND, Timer, period_ns_of
from slidectl.simulation.feature import Feature
from slidectl.simulation.spawned_robots import SpawnedRobot
from slidectl.simulation.topics import PeriodicTopic

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

UNKNOWN = 1e12
"""Variance of the quantities that a planar base does not measure."""
REACHED = 0.01
"""m/s. With a velocity error below this, a wheel gets its velocity at once, without the acceleration limit."""


class RunningDrive:
    """One drive of one robot, until the robot is deleted. An emergency stop or a reset ends its command."""

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, drive: BaseDrive) -> None:
        self._simulation = simulation
        self._world = simulation.world
        self._robot = robot
        self._drive = drive
        # A spawn may set another namespace for the robot than its control plugin does.
        follows = drive.namespace in (None, namespace_of(robot.description, robot.name))
        self._namespace = robot.namespace if follows else str(drive.namespace)
        self._wanted = (0.0, 0.0, 0.0)
        """Commanded velocities: forwards and to the left in m/s, about the vertical in rad/s."""
        self._wanted_ns = 0
        self._topics: list[PeriodicTopic] = []
        self._timer = Timer(0, self._update)
        """Active when an update is to come."""
        self._timer.active = False
        robot.cleanup.callback(lambda: self._timer.cancel())  # lambda: `_timer` may have been replaced by then
        robot.node.subscribe(self._absolute(drive.command_topic), "geometry_msgs/Twist", self._receive)
        if drive.has_odometry:
            self._publish(drive.odometry_topic, "nav_msgs/Odometry", drive.odometry_rate_hz, self._odometry)
        if drive.has_odometry_tf:
            self._publish("/tf", "tf2_msgs/TFMessage", drive.odometry_rate_hz, self._transform)
        robot.on_reset.append(self.reset)

    def _update(self) -> None:
        """Follow the command."""
        raise NotImplementedError

    def _repeat(self, period_ns: int) -> None:
        """Update at each multiple of the period from now on."""
        self._timer = self._simulation.graph.timers.every(period_ns, self._update)

    def reset(self) -> None:
        """Discard the command."""
        self._wanted = (0.0, 0.0, 0.0)

    def _absolute(self, topic: str) -> str:
        return names.join(self._namespace, topic)

    def _publish(self, topic: str, kind: str, rate_hz: float, build: Callable[[], Message]) -> None:
        node, graph = names.join(self._robot.namespace, "gazebo"), self._simulation.graph
        self._topics.append(PeriodicTopic(graph, self._absolute(topic), kind, node, period_ns_of(rate_hz), build))
        self._robot.cleanup.callback(self._topics[-1].close)

    def _receive(self, message: Message) -> None:
        velocities = (message["linear"]["x"], message["linear"]["y"], message["angular"]["z"])
        if not all(map(math.isfinite, velocities)):
            text = f"{self._robot.name} takes no command of nan or infinity: it must have finite numbers"
            self._robot.node.log("warn", text)
            raise MessageRefused(text)
        if not self._robot.emergency_stop:
            self._wanted, self._wanted_ns = velocities, self._simulation.time_ns

    # Odometry.

    def _place(self) -> tuple[Pose, float, float, float]:
        """The pose of the base and its velocities forwards, to the left and about the vertical; from the world."""
        name, root = self._robot.name, self._robot.description.root
        pose, (linear, angular) = self._world.link_pose(name, root), self._world.link_twist(name, root)
        yaw = to_rpy(pose[1])[2]
        forwards = math.cos(yaw) * linear[0] + math.sin(yaw) * linear[1]
        return pose, forwards, math.cos(yaw) * linear[1] - math.sin(yaw) * linear[0], angular[2]

    def _header(self) -> tuple[Message, str]:
        """The header of odometry, and the frame of the base."""
        prefix = tf_prefix(self._simulation, self._robot)
        odometry, base = (
            f"{prefix}/{frame}" if prefix else frame for frame in (self._drive.odometry_frame, self._drive.base_frame)
        )
        return header_of(self._simulation.time_ns, odometry), base

    def _odometry(self) -> Message:
        drive, (pose, forwards, left, turning) = self._drive, self._place()
        header, base = self._header()
        if not drive.tells_height:
            pose = (pose[0][0], pose[0][1], 0.0), pose[1]
        variances = drive.twist_variances
        return {
            "header": header,
            "child_frame_id": base,
            "pose": {"pose": pose_message(pose), "covariance": _covariance(drive.pose_variances)},
            "twist": {
                "twist": twist_of(forwards, left, turning),
                "covariance": _covariance(variances) if variances else [0.0] * 36,
            },
        }

    def _transform(self) -> Message:
        header, base = self._header()
        transform = transform_message(self._place()[0])
        return {"transforms": [{"header": header, "child_frame_id": base, "transform": transform}]}


class WheelMotors(RunningDrive):
    """diff_drive and skid_steer_drive: motors turn the wheels with at most the plugin's torque.

    Commands take effect at the multiples of the plugin's period.
    """

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, drive: WheelDrive) -> None:
        self._wheels = drive
        self._issued = [0.0, 0.0]
        """The last velocity commanded to the wheels of each side while they accelerate, m/s."""
        self._forget_way()
        super().__init__(simulation, robot, drive)
        self._ways = self._measured_ways()
        self._world.add_motors(robot.attached, dict.fromkeys((*drive.left, *drive.right), drive.torque))
        if drive.has_joint_states:
            self._publish("joint_states", "sensor_msgs/JointState", drive.update_rate_hz, self._joint_states)
        robot.on_emergency_stop.append(self._stop)
        if drive.measures_wheels or drive.acceleration:
            self._repeat(period_ns_of(drive.update_rate_hz))

    def reset(self) -> None:
        super().reset()
        self._issued = [0.0, 0.0]
        self._forget_way()
        self._ways = self._measured_ways()

    def _stop(self) -> None:
        self.reset()
        self._turn(0.0, 0.0)

    def _receive(self, message: Message) -> None:
        super()._receive(message)
        if not self._timer.active:
            period_ns, now_ns = period_ns_of(self._wheels.update_rate_hz), self._simulation.time_ns
            due_ns = -(-(now_ns + 1) // period_ns) * period_ns
            self._simulation.graph.timers.arm(self._timer, due_ns)

    def _update(self) -> None:
        """Let the wheels follow the command, and measure their motion."""
        wheels, (forwards, _, turning) = self._wheels, self._wanted
        if wheels.measures_wheels:
            self._measure()
        speeds = [forwards - turning * wheels.separation / 2.0, forwards + turning * wheels.separation / 2.0]
        present = [self._state(joints[0])[1] * wheels.diameter / 2.0 for joints in (wheels.left, wheels.right)]
        gaps = [wanted - now for wanted, now in zip(speeds, present, strict=True)]
        if wheels.acceleration and min(map(abs, gaps)) >= REACHED:
            most = wheels.acceleration * self._period_s
            for side, gap in enumerate(gaps):
                self._issued[side] += max(-most, min(most, gap))
            speeds = self._issued
        self._turn(*speeds)

    def _turn(self, left: float, right: float) -> None:
        """Command these velocities to the wheels of each side, m/s."""
        velocities, body, radius = self._world.views.velocities, self._robot.attached, self._wheels.diameter / 2.0
        for joints, speed in ((self._wheels.left, left), (self._wheels.right, right)):
            for joint in joints:
                velocities[body.place(joint).dof] = speed / radius

    @property
    def _period_s(self) -> float:
        """The time between two updates, s."""
        return max(period_ns_of(self._wheels.update_rate_hz), self._simulation.timestep_ns) / SECOND

    def _state(self, joint: str) -> tuple[float, float, float]:
        return self._world.joint_state(self._robot.name, joint)

    def _joint_states(self) -> Message:
        joints = [*self._wheels.right, *self._wheels.left]
        header = header_of(self._simulation.time_ns)
        positions = [self._state(joint)[0] for joint in joints]
        return {"header": header, "name": joints, "position": positions, "velocity": [], "effort": []}

    # Odometry from the wheels, after Siegwart, Autonomous Mobile Robots, page 337.

    def _forget_way(self) -> None:
        self._x = self._y = self._heading = self._forwards = self._turning = 0.0

    def _measured_ways(self) -> list[float]:
        """The rolled distances of the left and the right wheel, m."""
        sides = (self._wheels.left[0], self._wheels.right[0])
        return [self._state(joint)[0] * self._wheels.diameter / 2.0 for joint in sides]

    def _measure(self) -> None:
        before, self._ways = self._ways, self._measured_ways()
        left, right = (now - then for now, then in zip(self._ways, before, strict=True))
        way, turn = (left + right) / 2.0, (right - left) / self._wheels.separation
        self._x += way * math.cos(self._heading + turn / 2.0)
        self._y += way * math.sin(self._heading + turn / 2.0)
        self._heading += turn
        self._forwards, self._turning = way / self._period_s, turn / self._period_s

    def _place(self) -> tuple[Pose, float, float, float]:
        if not self._wheels.measures_wheels:
            return super()._place()
        pose = (self._x, self._y, 0.0), from_rpy((0.0, 0.0, self._heading))
        return pose, self._forwards, 0.0, self._turning


class PlanarDrive(RunningDrive):
    """planar_move: the root link gets the commanded velocity at the beginning of each step; others are 0.

    A drive based on forces lets the robot fall and tilt as any other.
    """

    def __init__(self, simulation: Simulation, robot: SpawnedRobot, drive: PlanarMove) -> None:
        self._timeout_s, self._falls = drive.timeout_s, drive.falls
        super().__init__(simulation, robot, drive)
        robot.on_emergency_stop.append(self.reset)
        self._repeat(EACH_STEP_NS)

    def _update(self) -> None:
        if 0.0 <= self._timeout_s < (self._simulation.time_ns - self._wanted_ns) / SECOND:
            self.reset()
        forwards, left, turning = self._wanted
        name, root = self._robot.name, self._robot.description.root
        yaw = to_rpy(self._world.link_pose(name, root)[1])[2]
        x = forwards * math.cos(yaw) - left * math.sin(yaw)
        y = left * math.cos(yaw) + forwards * math.sin(yaw)
        upwards, tilting = 0.0, (0.0, 0.0)
        if self._falls:
            linear, angular = self._world.link_twist(name, root)
            upwards, tilting = linear[2], (angular[0], angular[1])
        self._world.set_root_twist(name, ((x, y, upwards), (*tilting, turning)))


def _covariance(variances: Vector) -> list[float]:
    x, y, yaw = variances
    return matrix_of([x, y, UNKNOWN, UNKNOWN, UNKNOWN, yaw])


class Drives(Feature):
    """The drives of all robots."""

    def attach(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def on_spawn(self, robot: SpawnedRobot) -> None:
        """Start the drives of a robot."""
        running: list[RunningDrive] = []
        for drive in robot.description.drives:
            if isinstance(drive, WheelDrive):
                running.append(WheelMotors(self._simulation, robot, drive))
            elif isinstance(drive, PlanarMove) and robot.description.is_fixed_to_world:
                text = f"{robot.name}: it is fixed to the world; the plugin {drive.name!r} has no effect"
                robot.warnings.append(text)
            elif isinstance(drive, PlanarMove):
                running.append(PlanarDrive(self._simulation, robot, drive))
        robot.saved["drives"] = running
