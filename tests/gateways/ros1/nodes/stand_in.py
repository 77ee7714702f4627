"""stand_in.py GRAPH.json NODE: a node that publishes, subscribes and serves what was recorded of a node of slidectl.

Its namespace is ROS_NAMESPACE. What repeats goes out at 50 Hz, with stamps of now; /clock tells the time since the
start. /gazebo sets the parameters.
"""

import json
import sys
import time

import roslib.message
import rospy
from genpy.message import fill_message_args

PERIOD_S = 0.02


def message_of(cls, values):
    message = cls()
    fill_message_args(message, [values])
    return message


def serve(name, service):
    cls = roslib.message.get_service_class(service["type"])
    answers = [(message_of(cls._request_class, asked), answer, error) for asked, answer, error in service["answers"]]

    def handle(request):
        for asked, answer, error in answers:
            if asked == request:
                if error:
                    raise rospy.ServiceException(error)
                return message_of(cls._response_class, answer)
        return cls._response_class()

    rospy.Service(name, cls, handle)


def main():
    with open(sys.argv[1], encoding="utf-8") as file:
        recorded = json.load(file)
    name = sys.argv[2]
    node = recorded["nodes"][name]
    rospy.init_node(name.rpartition("/")[2], disable_rosout="/rosout" not in node["publishes"], disable_rostime=True)
    for service in ("get_loggers", "set_logger_level"):  # every rospy node has these, the daemon's have not
        rospy.impl.registration.get_service_manager().get_service(f"{name}/{service}").shutdown()
    if name == "/gazebo":
        for key, value in recorded["parameters"].items():
            rospy.set_param("/" + key, value)
    repeated = []
    for topic, what in node["publishes"].items():
        if topic != "/rosout":
            cls = roslib.message.get_message_class(what["type"])
            publisher = rospy.Publisher(topic, cls, latch=what["latch"], queue_size=1000)
            if what["message"] is not None:
                message = message_of(cls, what["message"])
                publisher.publish(message)
                if not what["latch"]:
                    repeated.append((publisher, message))
    for topic, type_name in node["subscribes"].items():
        rospy.Subscriber(topic, roslib.message.get_message_class(type_name))
    for service, what in node["services"].items():
        serve(service, what)
    print("ready", flush=True)
    start = time.monotonic()
    while not rospy.is_shutdown():
        now = rospy.Time.from_sec(time.monotonic() - start)
        for publisher, message in repeated:
            if hasattr(message, "header"):
                message.header.stamp = now
            elif hasattr(message, "clock"):
                message.clock = now
            publisher.publish(message)
        time.sleep(PERIOD_S)


main()
