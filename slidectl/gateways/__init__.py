"""What speaks other protocols: ROS 1, WebSocket, Foxglove. Each gateway is a process and a client of the daemon."""
