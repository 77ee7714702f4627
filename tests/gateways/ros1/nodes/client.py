"""client.py SERVICE MODEL: calls a service of slidectl, twice on one connection, and tells what it answers."""

import sys

import rospy
import rosservice

rospy.init_node("client", disable_rostime=True)
service, model = sys.argv[1:]
call = rospy.ServiceProxy(service, rosservice.get_service_class_by_name(service), persistent=True)
for name in (model, "nobody"):
    answer = call(model_name=name)
    print(answer.success, answer.status_message, flush=True)
