"""The ROS 1 gateway: a master (or registration at an existing one), the slave API of slidectl's nodes, and TCPROS."""
