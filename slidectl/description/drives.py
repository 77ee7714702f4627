"""Reads Gazebo plugins that move a model: gazebo_ros' drives of bases, and mimic joints.

Tags and defaults are those of gazebo_ros_pkgs (noetic) and roboticsgroup_gazebo_plugins. The drives are simulated in
features/base_drives.py; the world treats a joint with a mimic plugin like one with a `<mimic>`.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from slidectl import names
from slidectl.description.element_values import child_number, child_rate, child_text
from slidectl.description.report import Report
from slidectl.description.robot import BaseDrive, Mimic, PlanarMove, WheelDrive
from slidectl.description.xml_tree import Element

DIFF, SKID, PLANAR = "libgazebo_ros_diff_drive", "libgazebo_ros_skid_steer_drive", "libgazebo_ros_planar_move"
MIMIC = (
    "libroboticsgroup_gazebo_mimic_joint_plugin", "libroboticsgroup_upatras_gazebo_mimic_joint_plugin",
    "libgazebo_mimic_joint_plugin",
)  # fmt: skip
FORCE_BASED = (
    "libgazebo_ros_force_based_move", "libhector_gazebo_ros_force_based_move", "libridgeback_ros_force_based_move",
)  # fmt: skip
"""Plugins that push the root link until it has the commanded velocity; here it has that velocity at once."""
DRIVES = (DIFF, SKID, PLANAR, *FORCE_BASED)
_OF_ALL = {"robotNamespace", "commandTopic", "odometryTopic", "odometryFrame", "robotBaseFrame"}
_OF_WHEELS = {"wheelSeparation", "wheelDiameter", "updateRate"}
_OF_DIFF = {
    "publishWheelTF", "publishOdomTF", "publishWheelJointState", "wheelAcceleration", "wheelTorque", "odometrySource",
    "leftJoint", "rightJoint", "legacyMode", "publishTf",
}  # fmt: skip
_SIDES = {"left": ("leftFrontJoint", "leftRearJoint"), "right": ("rightFrontJoint", "rightRearJoint")}
_COVARIANCES = (("covariance_x", 0.0001), ("covariance_y", 0.0001), ("covariance_yaw", 0.01))
_OF_SKID = {"torque", "broadcastTF", *dict(_COVARIANCES), *_SIDES["left"], *_SIDES["right"]}
_OF_PLANAR = {"odometryRate", "cmdTimeout"}
_GAINS = {"yaw_velocity_p_gain", "x_velocity_p_gain", "y_velocity_p_gain"}
_OF_FORCE_BASED = {"odometryRate", "cmdVelTimeOut", "publishOdometryTf"}
_OF_MIMIC = {"joint", "mimicJoint", "multiplier", "offset"}
_DONE_BY_CONSTRAINT = ("hasPID", "maxEffort", "sensitiveness")
_HARMLESS = ("alwaysOn", "rosDebugLevel")
_VARIANCES = (0.00001, 0.00001, 0.001)


class DriveReader:
    """Reads the drive and mimic plugins of one robot."""

    def __init__(self, report: Report, joints: Collection[str]) -> None:
        self.report = report
        self.joints = joints
        self.drives: list[BaseDrive] = []
        self.mimics: dict[str, tuple[Mimic, Element]] = {}
        """By the joint that follows: its mimic, and the plugin element."""

    def read_drive(self, plugin: Element, library: str, place: str) -> None:
        """Read a plugin of `DRIVES`. Raises BadFile: a malformed number, or a size of a wheel that is not above 0."""
        is_force_based = library in FORCE_BASED
        own = _OF_PLANAR if library == PLANAR else _OF_WHEELS | (_OF_DIFF if library == DIFF else _OF_SKID)
        self._report_unknown(plugin, _OF_ALL | (_OF_FORCE_BASED | _GAINS if is_force_based else own), place)
        namespace = plugin.find("robotNamespace")
        common: dict[str, Any] = {
            "name": plugin.get("name") or library,
            "namespace": None if namespace is None else names.join("/", namespace.first_text).rstrip("/") or "/",
            "command_topic": child_text(plugin, "commandTopic", "cmd_vel"),
            "odometry_topic": child_text(plugin, "odometryTopic", "odom"),
            "odometry_frame": child_text(plugin, "odometryFrame", "odom"),
            "base_frame": child_text(plugin, "robotBaseFrame", "base_footprint"),
            "pose_variances": _VARIANCES,
            "twist_variances": None,
        }
        if library == PLANAR or is_force_based:
            rate = child_rate(plugin, "odometryRate", 20.0, place)
            tag, default = ("cmdVelTimeOut", 0.25) if is_force_based else ("cmdTimeout", -1.0)
            timeout_s = child_number(plugin, tag, default, place, finite=False)
            has_frame = rate > 0.0 and (not is_force_based or self._flag(plugin, "publishOdometryTf", True, place))
            for gain in sorted(_GAINS) if is_force_based else ():
                if (child := plugin.find(gain)) is not None:
                    self.report.converted(child, "the robot has the commanded velocity at once", f"{place}/<{gain}>")
            self.drives.append(
                PlanarMove(
                    **common, odometry_rate_hz=rate, has_odometry=rate > 0.0, has_odometry_tf=has_frame,
                    tells_height=False, timeout_s=timeout_s, falls=is_force_based,
                )
            )  # fmt: skip
            return
        wheels = self._diff(plugin, place) if library == DIFF else self._skid(plugin, place)
        separation = 0.34 if library == DIFF else 0.4
        for name, tag, default in (("separation", "wheelSeparation", separation), ("diameter", "wheelDiameter", 0.15)):
            wheels[name] = length = child_number(plugin, tag, default, place)
            if not 0.0 < length < float("inf"):
                raise (plugin.find(tag) or plugin).error(f"{place}: <{tag}> is {length:g} m; it must be above 0")
        unknown = [joint for joint in (*wheels["left"], *wheels["right"]) if joint not in self.joints]
        if unknown:
            self.report.wrong(plugin, f"there is no joint {unknown[0]!r}; the plugin has no effect", place)
            return
        rate = child_rate(plugin, "updateRate", 100.0, place)
        self.drives.append(WheelDrive(**{**common, **wheels, "odometry_rate_hz": rate, "update_rate_hz": rate}))

    def _diff(self, plugin: Element, place: str) -> dict[str, Any]:
        sides = [(child_text(plugin, f"{side}Joint", f"{side}_joint"),) for side in ("left", "right")]
        if self._flag(plugin, "legacyMode", True, place):
            sides.reverse()
            if plugin.find("legacyMode") is None:
                text = "left and right change places without <legacyMode>false</legacyMode>, as in Gazebo"
                self.report.wrong(plugin, text, place)
        self._flag(plugin, "publishWheelTF", False, place)  # read for its notices: /tf has all joints in any case
        source = child_text(plugin, "odometrySource", "world").lower()
        if source not in ("encoder", "world"):
            self.report.wrong(plugin, f"<odometrySource> {source!r} is neither encoder nor world; it is world", place)
        has_odometry = self._flag(plugin, "publishTf", True, place)
        return {
            "left": sides[0],
            "right": sides[1],
            "torque": child_number(plugin, "wheelTorque", 5.0, place, finite=False),
            "acceleration": child_number(plugin, "wheelAcceleration", 0.0, place, finite=False),
            "measures_wheels": source == "encoder",
            "has_odometry": has_odometry,
            "has_odometry_tf": self._flag(plugin, "publishOdomTF", True, place) and has_odometry,
            "tells_height": True,
            "has_joint_states": self._flag(plugin, "publishWheelJointState", False, place),
        }

    def _skid(self, plugin: Element, place: str) -> dict[str, Any]:
        joints = {
            side: (child_text(plugin, front, f"{side}_front_joint"), child_text(plugin, rear, f"{side}_rear_joint"))
            for side, (front, rear) in _SIDES.items()
        }
        variances = tuple(child_number(plugin, tag, default, place) for tag, default in _COVARIANCES)
        return {
            **joints,
            "torque": child_number(plugin, "torque", 5.0, place, finite=False),
            "has_odometry": True,
            "has_odometry_tf": self._flag(plugin, "broadcastTF", False, place),
            "tells_height": False,
            "pose_variances": variances,
            "twist_variances": variances,
        }

    def read_mimic(self, plugin: Element, place: str) -> None:
        """Read a plugin of `MIMIC`. Raises BadFile: a malformed number."""
        self._report_unknown(plugin, {"robotNamespace", *_OF_MIMIC, *_DONE_BY_CONSTRAINT}, place)
        for tag in _DONE_BY_CONSTRAINT:
            if (child := plugin.find(tag)) is not None:
                self.report.ignored(child, "has no effect: a constraint holds the joint", f"{place}/<{tag}>")
        leader, follower = child_text(plugin, "joint", ""), child_text(plugin, "mimicJoint", "")
        for joint in (leader, follower):
            if joint not in self.joints:
                self.report.wrong(plugin, f"there is no joint {joint!r}; the plugin has no effect", place)
                return
        multiplier = child_number(plugin, "multiplier", 1.0, place)
        offset = child_number(plugin, "offset", 0.0, place)
        self.mimics[follower] = Mimic(leader, multiplier, offset), plugin

    def _report_unknown(self, plugin: Element, tags: Collection[str], place: str) -> None:
        self.report.unknown(plugin, {"name", "filename"}, {*tags, *_HARMLESS}, place)
        for tag in _HARMLESS:
            if (child := plugin.find(tag)) is not None:
                self.report.ignored(child, "has no effect", f"{place}/<{tag}>")

    def _flag(self, plugin: Element, tag: str, default: bool, place: str) -> bool:
        text = child_text(plugin, tag, str(default)).lower()
        if text not in ("true", "false", "1", "0"):
            self.report.wrong(plugin.find(tag) or plugin, f"{text!r} is neither true nor false", f"{place}/<{tag}>")
            return default
        return text in ("true", "1")
