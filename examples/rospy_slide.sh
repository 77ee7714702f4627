#!/usr/bin/env bash
# A rospy node slides the block and moves the arm. slidectl is its ROS master; ROS 1 has to be installed.
set -euo pipefail

if ! /usr/bin/python3 -c 'import rospy, actionlib, sensor_msgs' 2>/dev/null; then
    echo "rospy is not installed: this example needs it"
    exit 0
fi
folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/rospy" ROS_HOME="$folder/ros" ROS_HOSTNAME=localhost
trap 'slidectl -q gateway ros1 stop; slidectl -q daemon stop; rm -r "$folder"' EXIT

slidectl daemon start  # as fast as the clock on the wall: the node has to keep up
slidectl spawn slider --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller
slidectl spawn arm --at 0 3 0 --controllers config/arm_control.yaml --start joint_state_controller arm_controller
ROS_MASTER_URI="$(slidectl -o json gateway ros1 start --port 0 | python3 -c 'import json, sys; print(json.load(sys.stdin)["address"])')"
export ROS_MASTER_URI
/usr/bin/python3 "$(dirname "${BASH_SOURCE[0]}")/rospy_slide.py"
