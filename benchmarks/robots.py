"""Robots that are measured and are no tutorial's: a cart on four wheels, and an arm with the sizes and masses of a UR5.

URDF as text, and the parameters of their controllers.
"""

from __future__ import annotations

import math
from typing import Any

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
ARM_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")

_STATES = {"type": "joint_state_controller/JointStateController", "publish_rate": 50}
_LINKS = (  # mass in kg, radius and length in m, of the cylinders of an arm
    (3.7, 0.06, 0.178),
    (8.393, 0.054, 0.425),
    (2.275, 0.06, 0.392),
    (1.219, 0.06, 0.095),
    (1.219, 0.06, 0.085),
    (0.1879, 0.0375, 0.0305),
)
_ORIGINS = (
    ("0 0 0.089159", "0 0 0"),
    ("0 0.13585 0", f"0 {math.pi / 2} 0"),
    ("0 -0.1197 0.425", "0 0 0"),
    ("0 0 0.39225", f"0 {math.pi / 2} 0"),
    ("0 0.093 0", "0 0 0"),
    ("0 0 0.09465", "0 0 0"),
)
_AXES = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0")
ARM_GAINS = ((800.0, 80.0), (800.0, 80.0), (400.0, 20.0), (50.0, 1.0), (50.0, 0.5), (5.0, 0.02))
ARM_POSE = (0.4, -1.2, 1.0, -0.5, 0.5, 0.5)
"""rad, above the ground."""
_EFFORTS = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)


def cart() -> str:
    """A box of 46 kg on four wheels of 2.6 kg, which stand on the ground when its root is at `CART_HEIGHT`."""
    wheels = "".join(
        f"""
    <link name='{name}_wheel'>{_cylinder(2.637, 0.1651, 0.1143, f"{math.pi / 2} 0 0")}</link>
    <gazebo reference='{name}_wheel'><mu1>1.0</mu1><mu2>1.0</mu2></gazebo>
    <joint name='{name}' type='continuous'><parent link='base'/><child link='{name}_wheel'/>
      <origin xyz='{x} {y} 0.03282'/><axis xyz='0 1 0'/><limit effort='20' velocity='30'/></joint>
    {_transmission(name, "VelocityJointInterface")}"""
        for name, x, y in zip(WHEELS, (0.256, 0.256, -0.256, -0.256), (0.2854, -0.2854) * 2, strict=True)
    )
    return f"""<robot name='cart'>
    <link name='base'><inertial><origin xyz='0 0 0.06'/><mass value='46'/>
      <inertia ixx='0.6' iyy='1.74' izz='2.03' ixy='0' ixz='0' iyz='0'/></inertial>
      <collision><origin xyz='0 0 0.12'/><geometry><box size='0.98 0.57 0.24'/></geometry></collision></link>{wheels}
    </robot>"""


CART_HEIGHT = 0.1651 - 0.03282
"""m, of the root above the ground."""


def arm(interface: str) -> str:
    """Six revolute joints, whose links are cylinders, fixed to the world."""
    links, parent = "", "world"
    for name, size, (xyz, rpy), axis, effort in zip(ARM_JOINTS, _LINKS, _ORIGINS, _AXES, _EFFORTS, strict=True):
        links += f"""
    <link name='{name}_link'>{_cylinder(*size, "0 0 0", size[2] / 2)}</link>
    <joint name='{name}' type='revolute'><parent link='{parent}'/><child link='{name}_link'/>
      <origin xyz='{xyz}' rpy='{rpy}'/><axis xyz='{axis}'/>
      <limit lower='-6.28' upper='6.28' effort='{effort}' velocity='3.15'/></joint>
    {_transmission(name, interface)}"""
        parent = f"{name}_link"
    return f"<robot name='arm'><link name='world'/>{links}</robot>"


def cart_parameters(with_gains: bool) -> dict[str, Any]:
    """A velocity controller for each wheel; with gains the hardware has a PID for it, else a motor."""
    gains = {wheel: {"p": 5.0, "i": 0.0, "d": 0.0} for wheel in WHEELS}
    own = {"gazebo_ros_control": {"pid_gains": gains}} if with_gains else {}
    return _controllers("velocity_controllers/JointVelocityController", WHEELS) | own


def arm_parameters(interface: str) -> dict[str, Any]:
    """A position controller for each joint, which has gains when it commands efforts."""
    if interface == "PositionJointInterface":
        return _controllers("position_controllers/JointPositionController", ARM_JOINTS)
    made = _controllers("effort_controllers/JointPositionController", ARM_JOINTS)
    for joint, (p, d) in zip(ARM_JOINTS, ARM_GAINS, strict=True):
        made[f"of_{joint}"]["pid"] = {"p": p, "i": 0.0, "d": d}
    return made


def _controllers(kind: str, joints: tuple[str, ...]) -> dict[str, Any]:
    return {"states": _STATES, **{f"of_{joint}": {"type": kind, "joint": joint} for joint in joints}}


def _cylinder(mass: float, radius: float, length: float, rpy: str, height: float = 0.0) -> str:
    across, along = mass * (3 * radius**2 + length**2) / 12, mass * radius**2 / 2
    origin = f"<origin xyz='0 0 {height}' rpy='{rpy}'/>"
    return f"""
      <inertial>{origin}<mass value='{mass}'/>
        <inertia ixx='{across}' iyy='{across}' izz='{along}' ixy='0' ixz='0' iyz='0'/></inertial>
      <collision>{origin}<geometry><cylinder radius='{radius}' length='{length}'/></geometry></collision>"""


def _transmission(joint: str, interface: str) -> str:
    return f"""<transmission name='of_{joint}'><type>transmission_interface/SimpleTransmission</type>
      <joint name='{joint}'><hardwareInterface>hardware_interface/{interface}</hardwareInterface></joint>
      <actuator name='motor_{joint}'><mechanicalReduction>1</mechanicalReduction></actuator></transmission>"""
