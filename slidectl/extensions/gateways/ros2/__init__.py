"""The ROS 2 gateway: the daemon's nodes, topics, services and parameters in ROS 2, by rclpy."""

MOST_DOMAIN = 232
"""The highest ROS_DOMAIN_ID: DDS has no ports for higher ones."""
