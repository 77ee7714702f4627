"""Small robots and files of controllers for the tests of the check room, and findings as lines."""

from __future__ import annotations

from collections.abc import Callable

from urdf_parts import INERTIAL, LIMIT

from slidectl.check import Findings

Check = Callable[..., "Lines"]


class Lines:
    """The findings of one check, a line each: `verdict line subject: text`."""

    def __init__(self, findings: Findings) -> None:
        self.findings = findings
        self.all = [f"{n.verdict} {n.line} {n.subject}: {n.text}" for n in findings.sorted()]

    def of(self, *verdicts: str) -> list[str]:
        return [line for line in self.all if line.split()[0] in verdicts]

    def about(self, *words: str) -> list[str]:
        """The lines that hold all of these words."""
        return [line for line in self.all if all(word in line for word in words)]


BALL = '<collision><geometry><sphere radius="0.2"/></geometry></collision>'
PLUGIN = (
    '<gazebo><plugin name="c" filename="libgazebo_ros_control.so">'
    "<robotNamespace>/bot</robotNamespace></plugin></gazebo>"
)

CONTROLLERS = """bot:
  slide_controller:
    type: effort_controllers/JointPositionController
    joint: slide
    pid: {p: 10.0, i: 1.0, d: 1.0, i_clamp: 2.0}
"""


def transmission(joint: str = "slide", interface: str = "hardware_interface/EffortJointInterface") -> str:
    return (
        f'<transmission name="t_{joint}"><type>transmission_interface/SimpleTransmission</type>'
        f'<joint name="{joint}"><hardwareInterface>{interface}</hardwareInterface></joint>'
        '<actuator name="m"><mechanicalReduction>1</mechanicalReduction></actuator></transmission>'
    )


def cart(*more: str, link: str = INERTIAL + BALL, joint: str = LIMIT, kind: str = "prismatic") -> str:
    """A cart on a rail: line 2 the world, line 3 the cart, line 4 the joint `slide`; further parts from line 5 on."""
    parts = [
        '<robot name="bot">',
        '<link name="world"/>',
        f'<link name="cart">{link}</link>',
        f'<joint name="slide" type="{kind}"><parent link="world"/><child link="cart"/>{joint}</joint>',
        *more,
        "</robot>",
    ]
    return "\n".join(parts)


def driven_cart(*more: str, **parts: str) -> str:
    """The same with a transmission in line 5 and the plugin in line 6."""
    return cart(transmission(), PLUGIN, *more, **parts)
