"""talker.py NAME: a node that says its name on ~said and answers ~answer; ~fail fails."""

import sys

import rospy
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerResponse


def fail(_request):
    raise rospy.ServiceException("the motor is on fire")


rospy.init_node(sys.argv[1])
publisher = rospy.Publisher("~said", String, queue_size=1, latch=True)
publisher.publish(sys.argv[1])
rospy.Service("~answer", Trigger, lambda _: TriggerResponse(success=True, message=sys.argv[1]))
rospy.Service("~fail", Trigger, fail)
print("ready", flush=True)
rospy.spin()
