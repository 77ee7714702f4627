"""The ROS 2 gateway: the daemon's nodes, topics, services and parameters in ROS 2, by rclpy."""
