"""Hardware that makes a robot one of ROS 2, for a daemon that imports this file."""

from slidectl.physics import MujocoRobotHW


class Ros2Hardware(MujocoRobotHW):
    is_of_ros2 = True
