"""ROS 1: a master (or a place at one that is there), the slave API of slidectl's nodes, and TCPROS."""
