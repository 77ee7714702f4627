"""Gateways to other protocols: ROS 1, WebSocket, Foxglove. Each is a process and a client of the daemon."""
