"""Moves the slider over rosbridge's protocol, with roslibpy: python roslibpy_slide.py ws://localhost:9090"""

import sys
import threading
from urllib.parse import urlsplit

import roslibpy

url = urlsplit(sys.argv[1] if len(sys.argv) > 1 else "ws://localhost:9090")
ros = roslibpy.Ros(url.hostname, url.port)
ros.run(timeout=30)

target = 0.8
arrived = threading.Event()


def look(state):
    if abs(state["position"][0] - target) < 0.02:
        arrived.set()


states = roslibpy.Topic(ros, "/slider/joint_states", "sensor_msgs/JointState", throttle_rate=20, queue_length=1)
states.subscribe(look)
command = roslibpy.Topic(ros, "/slider/joint1_position_controller/command", "std_msgs/Float64")
command.publish({"data": target})
if not arrived.wait(60):
    sys.exit("the slider did not arrive")
manager = roslibpy.Service(
    ros, "/slider/controller_manager/list_controllers", "controller_manager_msgs/ListControllers"
)
names = [one["name"] for one in manager.call(roslibpy.ServiceRequest(), timeout=30)["controller"]]
print(f"the slider is at {target} m; controllers: {', '.join(names)}")
ros.close()
