"""A sine generator: one joint gets a command that swings, in the unit of the interface.

slidectl controller load sine --from examples/sine.py:Sine
"""

from math import pi, sin

from slidectl.control import NUMBER, TEXT, Controller, EffortJointInterface, Parameter, params

JOINT = Parameter("joint", TEXT, "the joint that it drives", default="joint1", names_joints=True)
AMPLITUDE = Parameter("amplitude", NUMBER, "the greatest command", "N", 1.0)
FREQUENCY = Parameter("frequency", NUMBER, "how often a second", "Hz", 0.5)


class Sine(Controller):
    """command = amplitude * sin(2 pi frequency t), where t counts from the start; it is published on ~command."""

    interface_type = EffortJointInterface
    parameters = (JOINT, AMPLITUDE, FREQUENCY)

    def init(self, interface, node):
        self.joint = interface.get_handle(params.value_of(node, JOINT))
        self.amplitude = params.value_of(node, AMPLITUDE)
        self.frequency = params.value_of(node, FREQUENCY)
        self.told = node.advertise("command", "std_msgs/Float64")

    def starting(self, time_ns):
        self.begin_ns = time_ns

    def update(self, time_ns, period_s):
        self.joint.command = self.amplitude * sin(2 * pi * self.frequency * (time_ns - self.begin_ns) * 1e-9)
        if self.told.wanted:
            self.told.publish({"data": self.joint.command})
