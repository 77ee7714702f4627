#!/usr/bin/env bash
# The cart drives by velocities of its base, and tells by odometry where it is.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/cart"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT

slidectl daemon start --rtf "${RTF:-1}"
slidectl spawn cart

# The plugin diff_drive holds a command until the next one comes.
slidectl pub /cart/cmd_vel geometry_msgs/Twist '{linear: {x: 0.5}}'
slidectl wait /cart/odom/pose/pose/position/x --above 0.5 --within 5
slidectl pub /cart/cmd_vel geometry_msgs/Twist '{}'
slidectl echo /cart/odom -n 1

# The same cart by diff_drive_controller: a command counts for half a second, so it comes ten times a second.
slidectl delete cart
slidectl spawn cart drive:=controller --controllers config/cart_control.yaml --start joint_state_controller base_controller
slidectl pub /cart/base_controller/cmd_vel geometry_msgs/Twist '{linear: {x: 0.5}, angular: {z: 0.2}}' -r 10 -n 20
slidectl wait /cart/base_controller/odom/pose/pose/position/x --above 0.1 --within 5
slidectl echo /cart/base_controller/odom -n 1
