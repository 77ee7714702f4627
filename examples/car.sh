#!/usr/bin/env bash
# A car whose four wheels are steered drives a curve, then goes sideways, and tells by odometry where it is.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/car"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT

slidectl daemon start --rtf "${RTF:-1}"
slidectl spawn car --controllers config/car_control.yaml --start joint_state_controller base_controller

# A command counts for half a second, so it comes ten times a second. A twist is for the base as a whole.
slidectl pub /car/base_controller/cmd_vel geometry_msgs/Twist '{linear: {x: 0.5}, angular: {z: 0.4}}' -r 10 -n 20
slidectl wait /car/base_controller/odom/pose/pose/position/y --above 0.05 --within 5

# The other kind of command has the angle of each axle: with both the same, the car does not turn.
slidectl pub /car/base_controller/cmd_four_wheel_steering \
    '{speed: 0.5, front_steering_angle: 0.8, rear_steering_angle: 0.8}' -r 10 -n 20
slidectl echo /car/base_controller/odom_steer -n 1
slidectl echo /car/base_controller/odom -n 1
