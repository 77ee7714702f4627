"""The sensors of a model as data, and how they are read: `<sensor>` tags of links and joints, plugins of gazebo_ros.

Defaults are those of the plugins. features/sensor_topics.py publishes the measurements.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from slidectl.description.element_values import (
    LACKS_ANGLES,
    child_count,
    child_number,
    child_rate,
    child_text,
    lacks_angles,
    parse_number,
    pose_numbers,
)
from slidectl.description.report import Report
from slidectl.description.robot import Pose, Vector
from slidectl.description.xml_tree import Element, below
from slidectl.entry_points import PartError, Registry

_GAUSSIAN = "gaussian"
_FORCE_PLUGIN = "libgazebo_ros_ft_sensor"
_FORCE_TORQUE = {"frame": ("child", "parent"), "measure_direction": ("child_to_parent", "parent_to_child")}
"""Tags of `<force_torque>` with their values; the first value is the default."""
_OF_LINK = {
    "ray": ("libgazebo_ros_laser", "libgazebo_ros_gpu_laser"),
    "gpu_ray": ("libgazebo_ros_gpu_laser", "libgazebo_ros_laser"),
    "imu": ("libgazebo_ros_imu_sensor",),
    "contact": ("libgazebo_ros_bumper",),
    "camera": ("libgazebo_ros_camera",),
}
"""Maps the type of a `<sensor>` to the plugins that publish it."""
INSTALLED = Registry("slidectl.sensors", "sensor", lambda: {*_OF_LINK, "force_torque"})
"""The kinds of sensors of links that installed packages add. Each is a SensorKind of simulation/sensor_kinds.py."""
OF_MODEL = (
    "libgazebo_ros_p3d", "libgazebo_ros_imu", "libhector_gazebo_ros_imu", "libgazebo_ros_joint_state_publisher",
    _FORCE_PLUGIN,
)  # fmt: skip
"""Sensor plugins of a model."""
_KNOWN_TAGS = {
    "visualize", "always_on", "update_rate", "pose", "plugin", "topic", "ray", "imu", "contact", "camera",
    "force_torque",
}  # fmt: skip
_ENCODINGS = {
    "R8G8B8": "rgb8", "RGB_INT8": "rgb8", "B8G8R8": "bgr8", "BGR_INT8": "bgr8", "L8": "mono8", "L_INT8": "mono8",
}  # fmt: skip
"""Maps pixel formats to encodings of sensor_msgs/Image."""
_CAMERA_TOPICS = (("imageTopicName", "image_raw"), ("cameraInfoTopicName", "camera_info"))
_DISTORTIONS = ("distortionK1", "distortionK2", "distortionK3", "distortionT1", "distortionT2")


@dataclass(frozen=True)
class Sensor:
    """The common fields of all kinds of sensors."""

    name: str
    link: str
    """The link that carries it."""
    topic: str
    """Relative to the robot's namespace, unless it begins with a slash. Empty: only controllers read the sensor."""
    frame: str
    rate_hz: float
    """Rate, Hz; 0: in each step of the world."""
    origin: Pose
    """The sensor's pose in the link's frame."""
    noise: float
    """Standard deviation of the Gaussian noise, in the unit of what is measured."""
    mean: float = 0.0
    """Mean of the noise."""


@dataclass(frozen=True)
class OtherSensor(Sensor):
    """A sensor of a kind that an installed package adds."""

    kind: str = ""
    """Its `type`."""
    tags: Element = field(default_factory=lambda: Element("sensor", {}, "", 0))


@dataclass(frozen=True)
class Laser(Sensor):
    """A planar laser scanner: `<sensor type="ray">` with libgazebo_ros_laser.so. sensor_msgs/LaserScan."""

    samples: int = 640
    min_angle: float = 0.0
    """Angle of the first ray, rad, about the sensor's z axis from its x axis."""
    max_angle: float = 0.0
    min_range: float = 0.0
    """Shortest distance, m."""
    max_range: float = math.inf


@dataclass(frozen=True)
class Camera(Sensor):
    """`<sensor type="camera">` with libgazebo_ros_camera.so. It looks along its x axis. sensor_msgs/Image, CameraInfo.

    The noise is added to each channel, whose range is 0 to 1.
    """

    MOST_PIXELS: ClassVar[int] = 4096
    """The largest width and height."""
    info_topic: str = "camera_info"
    width: int = 320
    height: int = 240
    field_of_view: float = 1.047
    """Horizontal field of view, rad."""
    near: float = 0.1
    """Near clipping distance, m."""
    far: float = 100.0
    encoding: str = "rgb8"
    baseline: float = 0.0
    """Distance to the first camera of a stereo pair, m."""


@dataclass(frozen=True)
class Imu(Sensor):
    """libgazebo_ros_imu_sensor.so in a `<sensor type="imu">`, or a plugin of a model. sensor_msgs/Imu."""

    feels_gravity: bool = True
    """True when the acceleration includes the reaction to gravity; libgazebo_ros_imu.so leaves it out."""


@dataclass(frozen=True)
class GroundTruth(Sensor):
    """libgazebo_ros_p3d.so: exact position and velocity of a link. nav_msgs/Odometry."""


@dataclass(frozen=True)
class Bumper(Sensor):
    """`<sensor type="contact">` with libgazebo_ros_bumper.so. gazebo_msgs/ContactsState."""


@dataclass(frozen=True)
class ForceTorque(Sensor):
    """`<sensor type="force_torque">` of a joint, or libgazebo_ros_ft_sensor.so. geometry_msgs/WrenchStamped.

    It measures the wrench through the joint, by default in the axes of the child link, which `link` names.
    """

    joint: str = ""
    in_parent: bool = False
    """True: in the axes of the parent link."""
    on_child: bool = False
    """True: the wrench of the parent on the child; False: that of the child on the parent."""


@dataclass(frozen=True)
class JointStates(Sensor):
    """libgazebo_ros_joint_state_publisher.so. sensor_msgs/JointState."""

    joints: tuple[str, ...] = ()


class SensorReader:
    """Reads the sensors of one robot."""

    def __init__(
        self,
        report: Report,
        links: Collection[str],
        joints: Mapping[str, tuple[str, str]],
        of_ros2: Collection[str] = (),
    ) -> None:
        """`joints` has the parent link and the child link of each joint; `of_ros2` are sensors of `<ros2_control>`."""
        self.of_ros2 = of_ros2
        self.report = report
        self.links = links
        self.joints = joints
        self.sensors: list[Sensor] = []

    def of_link(self, link: str, sensor: Element, place: str) -> None:
        """Read a `<sensor>` of `<gazebo reference="link">`; an unsupported one is reported.

        Raises BadFile: a malformed number.
        """
        kind = sensor.get("type") or ""
        if kind not in _OF_LINK:
            try:
                part = INSTALLED.find(kind)
            except PartError as error:
                return self.report.ignored(sensor, f"has no effect: {error.message}", place)
            if part is not None:
                return self._other(link, sensor, kind, place)
            known = ", ".join([*_OF_LINK, *INSTALLED.parts()])
            return self.report.ignored(sensor, f"has no effect: sensors here are {known}, not {kind!r}", place)
        plugin = next((one for one in sensor.find_all("plugin") if library(one) in _OF_LINK[kind]), None)
        if plugin is None and kind == "imu" and sensor.get("name") in self.of_ros2:
            return self._imu_of_ros2(sensor, link, place)
        if plugin is None:
            names = " or ".join(f"{name}.so" for name in _OF_LINK[kind])
            return self.report.ignored(sensor, f"publishes nothing without a <plugin> {names}", place)
        self._report_unknown(sensor, place)
        name = sensor.get("name") or kind
        text = plugin.find("pose") or sensor.find("pose")
        origin = _pose(text, place) if text is not None else Pose()
        if text is not None and lacks_angles(text):
            self.report.wrong(text, LACKS_ANGLES, f"{place}/<pose>")
        rate = child_rate(sensor, "update_rate", 0.0, place)
        common = Sensor(name, link, "", "", rate, origin, 0.0)
        if kind in ("ray", "gpu_ray"):
            self.sensors.append(self._laser(sensor, plugin, common, place))
        elif kind == "imu":
            self.sensors.append(
                Imu(
                    name, link, child_text(plugin, "topicName", "imu"), child_text(plugin, "frameName", link),
                    child_rate(plugin, "updateRateHZ", rate, place), _moved(plugin, origin, place),
                    child_number(plugin, "gaussianNoise", 0.0, place),
                )
            )  # fmt: skip
        elif kind == "camera":
            self.sensors.append(self._camera(sensor, plugin, common, place))
        else:
            topic = child_text(plugin, "bumperTopicName", "bumper_states")
            self.sensors.append(Bumper(name, link, topic, child_text(plugin, "frameName", "world"), rate, origin, 0.0))
        return None

    def _imu_of_ros2(self, sensor: Element, link: str, place: str) -> None:
        """Read an IMU that controllers read through `<ros2_control>`, and that no plugin publishes."""
        self._report_unknown(sensor, place)
        name, pose, rate = sensor.get("name") or "", sensor.find("pose"), child_rate(sensor, "update_rate", 0.0, place)
        origin = Pose() if pose is None else _pose(pose, place)
        noise = below(sensor, "imu", "angular_velocity", "x", "noise")
        self.sensors.append(Imu(name, link, "", link, rate, origin, self._noise(noise, place)[0]))

    def _other(self, link: str, sensor: Element, kind: str, place: str) -> None:
        """Read what sensors of all installed kinds have. Their own tags are read where they measure."""
        name, pose = sensor.get("name") or kind, sensor.find("pose")
        stddev, mean = self._noise(sensor.find("noise"), place)
        self.sensors.append(
            OtherSensor(
                name, link, child_text(sensor, "topic", name), link, child_rate(sensor, "update_rate", 0.0, place),
                Pose() if pose is None else _pose(pose, place), stddev, mean, kind, sensor,
            )
        )  # fmt: skip

    def _report_unknown(self, sensor: Element, place: str) -> None:
        for child in sensor.children:
            if child.tag not in _KNOWN_TAGS:
                self.report.ignored(child, "has no effect in a sensor here", f"{place}/{child.title}")

    def _noise(self, noise: Element | None, place: str, otherwise: float = 0.0) -> tuple[float, float]:
        """Standard deviation and mean of a `<noise>`; `otherwise` is the deviation where it names none.

        The type is a tag, or an attribute; SDF's default for sensors of these kinds is gaussian.
        """
        if noise is None:
            return otherwise, 0.0
        kind = (child_text(noise, "type", "") or noise.get("type") or _GAUSSIAN).strip()
        if kind != _GAUSSIAN:
            if kind != "none":
                text = f"has no effect: noise here is {_GAUSSIAN} or none, not {kind!r}"
                self.report.ignored(noise, text, f"{place}/<noise>")
            return otherwise, 0.0
        return child_number(noise, "stddev", otherwise, place), child_number(noise, "mean", 0.0, place)

    def _laser(self, sensor: Element, plugin: Element, common: Sensor, place: str) -> Laser:
        ray = sensor.find("ray")
        scan = below(ray, "scan", "horizontal")
        extent = below(ray, "range")
        stddev, mean = self._noise(below(ray, "noise"), place, child_number(plugin, "gaussianNoise", 0.0, place))
        vertical = below(ray, "scan", "vertical")
        if vertical is not None and child_count(vertical, "samples", 1, place) > 1:
            self.report.ignored(vertical, "has no effect: a scan has one layer here", f"{place}/<vertical>")
        written = child_number(scan, "samples", 640, place)
        samples = int(written)
        if samples != written:
            text = f"{written:g} is read as {samples}: as in Gazebo, a fraction is cut off"
            self.report.converted(sensor, text, f"{place}/<samples>")
        least, most = child_number(scan, "min_angle", 0.0, place), child_number(scan, "max_angle", 0.0, place)
        nearest = child_number(extent, "min", 0.0, place)
        farthest = child_number(extent, "max", math.inf, place, finite=False)
        if samples < 1 or samples > 100_000 or nearest < 0 or farthest <= nearest:
            raise sensor.error(
                f"{place}: a scan of {samples} samples from {least:g} to {most:g} rad, {nearest:g} to {farthest:g} m",
                "1 to 100000 samples, and a range whose min is below its max",
            )
        if most < least:  # Gazebo turns the other way then
            text = f"the scan goes backwards, from {least:g} down to {most:g} rad"
            self.report.wrong(sensor, text, f"{place}/<horizontal>")
        return Laser(
            common.name, common.link, child_text(plugin, "topicName", "scan"),
            child_text(plugin, "frameName", common.link), common.rate_hz, common.origin,
            stddev, mean, samples, least, most, nearest, farthest,
        )  # fmt: skip

    def _camera(self, sensor: Element, plugin: Element, common: Sensor, place: str) -> Camera:
        camera = sensor.find("camera")
        image, clip = below(camera, "image"), below(camera, "clip")
        stddev, mean = self._noise(below(camera, "noise"), place)
        width, height = (child_count(image, tag, size, place) for tag, size in (("width", 320), ("height", 240)))
        view = child_number(camera, "horizontal_fov", 1.047, place)
        near, far = child_number(clip, "near", 0.1, place), child_number(clip, "far", 100.0, place)
        most = Camera.MOST_PIXELS
        if not (0 < width <= most and 0 < height <= most and 0.0 < view < math.pi and 0.0 < near < far):
            raise sensor.error(
                f"{place}: a camera of {width} x {height} pixels, {view:g} rad wide, {near:g} to {far:g} m",
                f"1 to {most} pixels either way, a horizontal_fov between 0 and pi, near above 0 and below far",
            )
        written = child_text(image, "format", "R8G8B8") if image is not None else "R8G8B8"
        if written not in _ENCODINGS and image is not None:
            known = ", ".join(_ENCODINGS)
            self.report.wrong(image, f"<format> {written} is unknown here, and R8G8B8 is used; known: {known}", place)
        group = child_text(plugin, "cameraName", "")
        topics = [child_text(plugin, tag, default).strip("/") for tag, default in _CAMERA_TOPICS]
        topic, info = (f"{group.rstrip('/')}/{name}" if group else name for name in topics)
        for tag in _DISTORTIONS:
            if child_number(plugin, tag, 0.0, place):
                self.report.ignored(plugin, f"<{tag}> has no effect: pictures here have no distortion", place)
        return Camera(
            common.name, common.link, topic, child_text(plugin, "frameName", "world").lstrip("/"),
            child_rate(plugin, "updateRate", 0.0, place) or common.rate_hz, common.origin,
            stddev, mean, info,
            width, height, view, near, far, _ENCODINGS.get(written, "rgb8"),
            child_number(plugin, "hackBaseline", 0.0, place),
        )  # fmt: skip

    def of_joint(self, joint: str, sensor: Element, place: str) -> None:
        """Read a `<sensor>` of `<gazebo reference="joint">`; an unsupported one is reported.

        Raises BadFile: a malformed number.
        """
        kind = sensor.get("type") or ""
        if kind != "force_torque":
            return self.report.ignored(
                sensor, f"has no effect: sensors of joints are force_torque, not {kind!r}", place
            )
        plugin = next((one for one in sensor.find_all("plugin") if library(one) == _FORCE_PLUGIN), None)
        tags = sensor.find("force_torque")
        words = {tag: known[0] for tag, known in _FORCE_TORQUE.items()}
        for tag, known in _FORCE_TORQUE.items():
            child = below(tags, tag)
            if child is not None and child.first_text in known:
                words[tag] = child.first_text
            elif child is not None:
                text = f"{child.first_text!r} has no effect: it is {words[tag]}, or {known[1]}"
                self.report.ignored(child, text, f"{place}/<{tag}>")
        self._report_unknown(sensor, place)
        topic = child_text(plugin, "topicName", "") if plugin is not None else ""
        stddev, _ = self._noise(below(tags, "force", "x", "noise"), place)
        self._force_torque(
            sensor.get("name") or kind, joint, topic, child_rate(sensor, "update_rate", 0.0, place),
            child_number(plugin, "gaussianNoise", stddev, place),
            words["frame"] == "parent", words["measure_direction"] == "parent_to_child",
        )  # fmt: skip
        return None

    def _force_torque(
        self, name: str, joint: str, topic: str, rate: float, noise: float,
        in_parent: bool = False, on_child: bool = False,
    ) -> None:  # fmt: skip
        parent, child = self.joints[joint]
        frame = parent if in_parent else child
        self.sensors.append(
            ForceTorque(name, child, topic, frame, rate, Pose(), noise, 0.0, joint, in_parent, on_child)
        )

    def of_model(self, plugin: Element, place: str) -> None:
        """Read a plugin of `OF_MODEL`. Raises BadFile: a malformed number."""
        kind = library(plugin)
        name, rate = plugin.get("name") or kind, child_rate(plugin, "updateRate", 0.0, place)
        noise = child_number(plugin, "gaussianNoise", 0.0, place)
        if kind == "libgazebo_ros_joint_state_publisher":
            names = tuple(word.strip() for word in child_text(plugin, "jointName", "").split(",") if word.strip())
            for joint in [joint for joint in names if joint not in self.joints]:
                self.report.wrong(plugin, f"there is no joint {joint!r}; it is left out", place)
            joints = tuple(joint for joint in names if joint in self.joints)
            rate = child_rate(plugin, "updateRate", 100.0, place)
            self.sensors.append(JointStates(name, "", "joint_states", "", rate, Pose(), 0.0, 0.0, joints))
            return None
        if kind == _FORCE_PLUGIN:
            joint, topic = child_text(plugin, "jointName", ""), child_text(plugin, "topicName", "")
            if joint not in self.joints or not topic:
                text = f"there is no joint {joint!r}" if joint not in self.joints else "<topicName> is missing"
                return self.report.wrong(plugin, f"{text}; the plugin has no effect", place)
            return self._force_torque(name, joint, topic, rate, noise)
        link = child_text(plugin, "bodyName", "")
        if link not in self.links:
            return self.report.wrong(plugin, f"<bodyName> {link!r} is not a link; the plugin has no effect", place)
        origin = _moved(plugin, Pose(), place)
        if kind == "libgazebo_ros_p3d":
            topic, frame = child_text(plugin, "topicName", "odom"), child_text(plugin, "frameName", "world")
            if frame not in ("world", "/world", "map", "/map"):
                text = f"<frameName> {frame}: place and velocity are those in the world"
                self.report.ignored(plugin, text, place)
            self.sensors.append(GroundTruth(name, link, topic, frame.lstrip("/"), rate, origin, noise))
        else:
            topic = child_text(plugin, "topicName", "imu")
            frame, feels_gravity = child_text(plugin, "frameName", link), kind != "libgazebo_ros_imu"
            self.sensors.append(Imu(name, link, topic, frame, rate, origin, noise, 0.0, feels_gravity))
        return None


def library(plugin: Element) -> str:
    """The library of a `<plugin>`, without folder and suffix."""
    return (plugin.get("filename") or "").strip().rpartition("/")[2].removesuffix(".so")


def _vector(element: Element, place: str) -> Vector:
    words = element.first_text.replace(",", " ").split()
    if len(words) != 3:
        raise element.error(f"{place}: <{element.tag}> is three numbers, not {element.first_text!r}")
    x, y, z = (parse_number(word, element, f"{place}/<{element.tag}>") for word in words)
    return x, y, z


def _pose(element: Element, place: str) -> Pose:
    return Pose(*pose_numbers(element, f"{place}/<pose>")) if element.first_text else Pose()


def _moved(plugin: Element, origin: Pose, place: str) -> Pose:
    """The pose from xyzOffset(s) and rpyOffset(s); missing parts are those of `origin`."""
    found = {tag: plugin.find(tag) or plugin.find(f"{tag}s") for tag in ("xyzOffset", "rpyOffset")}
    xyz = _vector(found["xyzOffset"], place) if found["xyzOffset"] is not None else origin.xyz
    rpy = _vector(found["rpyOffset"], place) if found["rpyOffset"] is not None else origin.rpy
    return Pose(xyz, rpy)
