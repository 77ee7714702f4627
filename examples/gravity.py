"""Gravity compensation for RRBot: each joint carries the weight of the links behind it, so that the arm floats.

slidectl controller load gravity --from examples/gravity.py:Gravity
"""

from math import sin

from slidectl.control import NUMBER, Controller, EffortJointInterface, Parameter, params

MASS = Parameter("mass", NUMBER, "the mass of each of the two links", "kg", 1.0)
LENGTH = Parameter("length", NUMBER, "from the first joint to the second", "m", 0.9)
MIDDLE = Parameter("middle", NUMBER, "from a joint to the middle of its link", "m", 0.45)
G = 9.8


class Gravity(Controller):
    """Efforts on joint1 and joint2; an angle of 0 is upright."""

    interface_type = EffortJointInterface
    parameters = (MASS, LENGTH, MIDDLE)

    def init(self, interface, node):
        self.joints = [interface.get_handle(name) for name in ("joint1", "joint2")]
        self.mass, self.length, self.middle = (params.value_of(node, each) for each in self.parameters)

    def update(self, time_ns, period_s):
        first, second = self.joints
        lean = -self.mass * G * self.middle * sin(first.position + second.position)
        first.command = lean - self.mass * G * (self.middle + self.length) * sin(first.position)
        second.command = lean
