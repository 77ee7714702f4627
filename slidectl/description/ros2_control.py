"""`<ros2_control>`: which joints of a robot of ROS 2 are commanded and measured, through which interfaces.

After the parser of hardware_interface. The simulation replaces the hardware that a tag names, whatever it is; what has
no effect there is reported. What drives the joints is in physics/ros2_robot_hw.py.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from slidectl.description import interfaces
from slidectl.description.element_values import child_text, parse_number, required, unknown
from slidectl.description.interfaces import JointInterface, Quantity
from slidectl.description.report import Report
from slidectl.description.robot import MOVING, Joint, Mimic
from slidectl.description.xml_tree import Element
from slidectl.errors import listing

TAG = "ros2_control"
_TYPES = ("system", "actuator", "sensor")
_PARTS = ("hardware", "properties", "joint", "sensor", "gpio", "transmission")
_SIMULATED = (
    "gz_ros2_control/GazeboSimSystem", "ign_ros2_control/IgnitionSystem", "gazebo_ros2_control/GazeboSystem",
    "mujoco_ros2_control/MujocoSystemInterface", "mujoco_ros2_control/MujocoSystem", "mock_components/GenericSystem",
    "fake_components/GenericSystem",
)  # fmt: skip
"""Plugins of simulated hardware."""
_QUANTITIES: dict[str, Quantity] = {
    "position": "position", "position_pid": "position", "velocity": "velocity", "velocity_pid": "velocity",
    "effort": "effort", "torque": "effort", "force": "effort",
}  # fmt: skip
"""Names of interfaces for what simulated joints take and measure."""
_OF_QUANTITY = {"position": interfaces.POSITION, "velocity": interfaces.VELOCITY, "effort": interfaces.EFFORT}
_ACCELERATION = "acceleration"
_GAINS = ("kp", "ki", "kd", "max_integral_error")
_PREFIXES: dict[str, Quantity] = {"pos_": "position", "vel_": "velocity"}
PLUGINS = (
    "libgz_ros2_control-system", "gz_ros2_control-system", "libign_ros2_control-system", "ign_ros2_control-system",
    "libgazebo_ros2_control",
)  # fmt: skip
"""Gazebo's plugins with a controller manager of ROS 2."""
_OF_PLUGIN = (
    "parameters", "hold_joints", "ros", "controller_manager_name", "controller_manager_prefix_node_name",
    "position_proportional_gain", "robot_param", "robot_param_node",
)  # fmt: skip


@dataclass(frozen=True)
class Interface:
    """A command or state interface; None where a parameter is missing. Units are those of the joint."""

    name: str
    minimum: float | None = None
    maximum: float | None = None
    initial: float | None = None
    is_limited: bool = True


@dataclass(frozen=True)
class PidGains:
    """Gains of gazebo_ros2_control, in N or N·m per error; `most` bounds the integral term."""

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    most: float | None = None


@dataclass(frozen=True)
class ControlledJoint:
    """A `<joint>` of `<ros2_control>`."""

    name: str
    commands: Mapping[str, Interface]
    """By name, as written."""
    states: Mapping[str, Interface]
    gains: Mapping[Quantity, PidGains] = field(default_factory=dict)
    is_limited: bool = True
    line: int | None = None
    file: str | None = None

    def interfaces(self) -> list[JointInterface]:
        """The interfaces of simulated joints through which it takes commands.

        With position and velocity also both at once, as a joint trajectory controller may claim them.
        """
        quantities = dict.fromkeys(_QUANTITIES[name] for name in self.commands if name in _QUANTITIES)
        found = [_OF_QUANTITY[quantity] for quantity in quantities]
        if interfaces.POSITION in found and interfaces.VELOCITY in found:
            found.append(interfaces.POS_VEL)
            if _ACCELERATION in self.commands:
                found.append(interfaces.POS_VEL_ACC)
        return found

    def command(self, quantity: Quantity) -> Interface | None:
        """The command interface of a quantity."""
        return next((one for name, one in self.commands.items() if _QUANTITIES.get(name) == quantity), None)

    @property
    def start(self) -> float | None:
        """Where the joint starts: the initial value of its position, rad or m."""
        return self.states["position"].initial if "position" in self.states else None


@dataclass(frozen=True)
class Component:
    """One `<ros2_control>`: a hardware component."""

    name: str
    type: str
    plugin: str
    joints: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ros2Control:
    """All hardware components of a robot, and what Gazebo's plugin says of its controller manager."""

    components: tuple[Component, ...]
    joints: Mapping[str, ControlledJoint]
    parameter_files: tuple[str, ...] = ()
    """Paths of the YAML files of the controller manager."""
    holds_joints: bool = True
    """True: a joint that could be commanded and is not is held at rest."""
    namespace: str = "/"


class Ros2ControlReader:
    """Reads all `<ros2_control>` tags of one robot, and then the plugin. `joints` are those of the URDF."""

    def __init__(self, report: Report, joints: dict[str, Joint], knows_all: bool) -> None:
        """`knows_all`: a joint that is not in `joints` does not exist. Mimic joints in `joints` may be changed."""
        self._report = report
        self._joints = joints
        self._knows_all = knows_all
        self._components: dict[str, tuple[Element, Component]] = {}
        self._controlled: dict[str, ControlledJoint] = {}
        self.changed: list[str] = []
        """Joints that follow another one, or follow none any more."""

    @property
    def sensors(self) -> list[str]:
        """The names of all sensors."""
        return [name for _, component in self._components.values() for name in component.sensors]

    def read(self, element: Element) -> bool:
        """Read one tag. Raises BadFile: where ros2_control refuses it, or a joint has an interface twice."""
        name = required(element, "name", TAG)
        place = f"{TAG} {name!r}"
        kind = required(element, "type", place).strip().lower()
        if kind not in _TYPES:
            raise unknown(element, place, "type", kind, _TYPES)
        if name in self._components:
            first, _ = self._components[name]
            raise element.error(f"duplicate {place}; the first is at {first.file}:{first.line}")
        self._report.unknown(element, {"name", "type", "rw_rate", "is_async", "thread_priority"}, _PARTS, place)
        for child in element.children:
            if child.tag not in _PARTS:
                raise unknown(child, place, "tag", child.tag, _PARTS)
        for attribute in ("rw_rate", "is_async", "thread_priority"):
            if attribute in element.attributes:
                text = f"{attribute} has no effect: the simulation is read and written in each of its steps"
                self._report.ignored(element, text, place, attribute)
        plugin = self._hardware(element, place)
        read = (self._report.attempt(self._joint, one, place) for one in element.find_all("joint"))
        joints = tuple(name for name in read if name)
        for one in element.find_all("gpio"):
            self._report.ignored(one, "simulated hardware has no inputs and outputs", f"{place}/{one.title}")
        for one in element.find_all("properties"):
            self._report.ignored(one, "has no effect: the simulation has no threads to set", f"{place}/<properties>")
        for one in element.find_all("transmission"):
            text = "has no effect, as in gz_ros2_control: simulated hardware commands and measures the joint itself"
            self._report.ignored(one, text, f"{place}/{one.title}")
        sensors = tuple(required(one, "name", place) for one in element.find_all("sensor"))
        self._components[name] = element, Component(name, kind, plugin, joints, sensors)
        return True

    def check_sensors(self, known: Collection[str]) -> None:
        """Report sensors without one of the same name among those that Gazebo has."""
        for element, component in self._components.values():
            for sensor in element.find_all("sensor"):
                name = sensor.get("name") or ""
                if name in component.sensors and name not in known:
                    text = (
                        "measures nothing: there is no sensor of this name of type imu in a <gazebo> of a link, or of "
                        "type force_torque in one of a joint"
                    )
                    self._report.ignored(sensor, text, f"{TAG} {component.name!r}/{sensor.title}")

    def result(self, plugin: Element | None) -> Ros2Control | None:
        """What was read; None without any tag."""
        if not self._components:
            if plugin is not None:
                self._report.wrong(plugin, f"has no effect without a <{TAG}> that drives the joints")
            return None
        components = tuple(component for _, component in self._components.values())
        found = Ros2Control(components, self._controlled)
        return found if plugin is None else self._with_plugin(found, plugin)

    def _with_plugin(self, found: Ros2Control, plugin: Element) -> Ros2Control:
        place = f'<plugin name="{plugin.get("name") or ""}">'
        self._report.unknown(plugin, {"name", "filename"}, _OF_PLUGIN, place)
        ros = plugin.find("ros")
        if ros is not None:
            self._report.unknown(ros, (), ("namespace", "remapping", "argument"), f"{place}/<ros>")
            for one in (*ros.find_all("remapping"), *ros.find_all("argument")):
                self._report.ignored(one, "names are not changed here", f"{place}/<ros>/{one.title}")
        gain = plugin.find("position_proportional_gain")
        if gain is not None:
            text = "has no effect: a commanded position is reached in the control period, within the joint's limits"
            self._report.ignored(gain, text, f"{place}/{gain.title}")
        manager = child_text(plugin, "controller_manager_name", "controller_manager")
        if manager != "controller_manager":
            text = f"{manager} is called controller_manager here"
            self._report.ignored(plugin, text, f"{place}/<controller_manager_name>")
        namespace = child_text(ros, "namespace", "/") if ros is not None else "/"
        return replace(
            found,
            parameter_files=tuple(text for one in plugin.find_all("parameters") if (text := one.first_text)),
            holds_joints=child_text(plugin, "hold_joints", "true").lower() != "false",
            namespace="/" + namespace.strip("/"),
        )

    def _hardware(self, element: Element, place: str) -> str:
        """The plugin of the hardware; empty without `<hardware>`."""
        hardware = self._report.only(element, "hardware")
        if hardware is None:
            return ""
        plugin = child_text(hardware, "plugin", "")
        if not plugin:
            raise hardware.error(f"{place}: <hardware> lacks <plugin> with a text")
        self._report.unknown(hardware, (), {"plugin", "group", "param"}, f"{place}/<hardware>")
        if plugin not in _SIMULATED:
            self._report.converted(hardware, f"{plugin} is replaced by the simulation", f"{place}/<hardware>")
        params = [required(one, "name", f"{place}/<hardware>") for one in hardware.find_all("param")]
        if params:
            text = f"has no effect on the simulation: {listing(params)}"
            self._report.ignored(hardware, text, f"{place}/<hardware>/<param>")
        return plugin

    def _joint(self, element: Element, component: str) -> str | None:
        """Read a joint. Returns its name; None when the URDF's joint could not be read."""
        name = required(element, "name", component).strip()
        place = f"{component}/joint {name!r}"
        described = self._joints.get(name)
        if described is None and self._knows_all:
            raise unknown(element, component, "joint", name, self._joints)
        if described is None:
            return None
        if described.type not in MOVING:
            raise element.error(f"{place} is {described.type} and cannot be driven")
        known = ("command_interface", "state_interface", "param", "limits")
        self._report.unknown(element, {"name", "mimic"}, known, place)
        commands = self._interfaces(element, "command_interface", place)
        states = self._interfaces(element, "state_interface", place)
        before = self._controlled.get(name)
        for interface in commands if before is not None else ():
            if before is not None and interface in before.commands:
                raise element.error(f"{place}: {interface} is commanded by the component at line {before.line} already")
        params = {required(one, "name", place): one for one in element.find_all("param")}
        commands = self._follow(element, described, params, commands, place)
        gains = self._gains(params, place)
        for left in params:
            if left not in ("mimic", "multiplier") and not left.startswith(tuple(_PREFIXES)):
                self._report.ignored(params[left], "has no effect on the simulation", f"{place}/<param>, {left}")
        joint = ControlledJoint(
            name, commands, states, gains, self._is_limited(element, place), element.line, element.file
        )
        if before is not None:
            joint = replace(joint, commands={**before.commands, **commands}, states={**before.states, **states},
                            gains={**before.gains, **gains})  # fmt: skip
        self._controlled[name] = joint
        return name

    def _follow(
        self, element: Element, joint: Joint, params: Mapping[str, Element], commands: dict[str, Interface], place: str
    ) -> dict[str, Interface]:
        """Let a joint follow another one, or not. Returns its command interfaces, of which a follower has none."""
        says = (element.get("mimic") or "").strip().lower()
        mimic = joint.mimic
        if says == "false":
            mimic = None
        elif mimic is None and "mimic" in params:  # the form of Humble
            master = params["mimic"].first_text
            if master not in self._joints and self._knows_all:
                raise unknown(params["mimic"], place, "joint", master, self._joints)
            multiplier = params.get("multiplier")
            text = "1" if multiplier is None else multiplier.first_text
            mimic = Mimic(master, parse_number(text, element, f"{place}: multiplier"))
        elif mimic is None and says == "true":
            raise element.error(f"{place}: mimic is true, but the joint has no <mimic>")
        if mimic != joint.mimic:
            self._joints[joint.name] = replace(joint, mimic=mimic)
            self.changed.append(joint.name)
        if mimic is not None and commands:
            text = f"its command interfaces have no effect: it follows {mimic.joint!r}"
            self._report.wrong(element, text, place)
            return {}
        return commands

    def _interfaces(self, element: Element, tag: str, place: str) -> dict[str, Interface]:
        """The interfaces with this tag. One that simulated joints do not have is reported and left out."""
        known = {**_QUANTITIES, _ACCELERATION: None} if tag == "command_interface" else _QUANTITIES
        found: dict[str, Interface] = {}
        for child in element.find_all(tag):
            name = required(child, "name", place).strip()
            where = f"{place}/<{tag}> {name}"
            self._report.unknown(child, {"name", "data_type", "size"}, {"param", "limits"}, where)
            if name in found:
                raise child.error(f"{place} has the <{tag}> {name!r} twice")
            values = {}
            for param in child.find_all("param"):
                key = required(param, "name", where)
                if key in ("min", "max", "initial_value"):
                    values[key] = self._number(param, f"{where}/{key}")
                else:
                    self._report.ignored(param, "has no effect on the simulation", f"{where}/<param>, {key}")
            if name not in known:
                verb = "take" if tag == "command_interface" else "measure"
                text = f"has no effect: simulated joints {verb} position, velocity and effort"
                self._report.ignored(child, text, where)
                continue
            is_limited = self._is_limited(child, where)
            found[name] = Interface(name, values.get("min"), values.get("max"), values.get("initial_value"), is_limited)
        return found

    def _number(self, param: Element, place: str) -> float | None:
        """The number in a parameter; None for an empty text."""
        return parse_number(param.first_text, param, place) if param.first_text else None

    def _is_limited(self, element: Element, place: str) -> bool:
        limits = self._report.only(element, "limits")
        if limits is None:
            return True
        self._report.unknown(limits, {"enable"}, (), f"{place}/<limits>")
        return (limits.get("enable") or "true").strip().lower() != "false"

    def _gains(self, params: Mapping[str, Element], place: str) -> dict[Quantity, PidGains]:
        """The gains that gazebo_ros2_control reads."""
        found: dict[Quantity, PidGains] = {}
        for prefix, quantity in _PREFIXES.items():
            numbers = {
                name: self._number(params[prefix + name], f"{place}/<param>, {prefix}{name}")
                for name in _GAINS
                if prefix + name in params
            }
            if numbers:
                p, i, d, most = (numbers.get(name) for name in _GAINS)
                found[quantity] = PidGains(p or 0.0, i or 0.0, d or 0.0, most)
        return found


def start_positions(control: Ros2Control, joints: Mapping[str, Joint]) -> dict[str, float]:
    """Where joints start, by their initial values, rad or m, within their limits. Followers start where they must."""
    found = {}
    for name, one in control.joints.items():
        joint = joints.get(name)
        if joint is None or one.start is None or joint.mimic is not None:
            continue
        limit = joint.limit if joint.type != "continuous" else None
        found[name] = one.start if limit is None else min(max(one.start, limit.lower), limit.upper)
    return found
