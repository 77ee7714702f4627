"""Recordings of topics: `.bag` files of ROS 1 (format 2.0) and `.mcap` files with ROS 1 messages.

Messages have the shape that they have in the wire protocol, with the simulated time at which they were received. The
libraries `rosbags` and `mcap` read and write the files; they are imported when a file is opened.
"""
