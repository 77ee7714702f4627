"""Control: joint handles and interfaces, PID, limits, transmissions, controllers and their manager.

After ros_control, ros_controllers and control_toolbox (ROS 1 Noetic), whose arithmetic it keeps to the bit.
A controller sees handles and a node; nothing here knows the physics, sockets or the command line.
"""
