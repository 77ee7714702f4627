"""Recordings of topics: `.bag` files of ROS 1 (format 2.0) and `.mcap` files with ROS 1 messages in them.

Messages come and go in the shape that they have on the wire, with the simulated time at which they came. Files are
read and written by the libraries `rosbags` and `mcap`, which are imported when a file is opened.
"""
