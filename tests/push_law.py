"""A controller as users write one, for the tests of users' controllers."""

LAW = """
from slidectl.control import NUMBER, TEXT, Controller, EffortJointInterface, Parameter, params

JOINT = Parameter("joint", TEXT, "the joint that it pushes", default="joint1", names_joints=True)
PUSH = Parameter("push", NUMBER, "how hard", unit="N", default=1.0)


class Push(Controller):
    interface_type = EffortJointInterface
    parameters = (JOINT, PUSH)

    def init(self, interface, node):
        self.joint = interface.get_handle(params.value_of(node, JOINT))
        self.push = params.value_of(node, PUSH)
        self.told = node.advertise("told", "std_msgs/Float64")

    def update(self, time_ns, period_s):
        self.joint.command = self.push
        self.told.publish({"data": self.joint.command})
"""
