#!/usr/bin/env bash
# RRBot as in the ros_control tutorial: load, switch, publish, stop, with the services under their full names.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/rrbot"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT

slidectl daemon start --rtf "${RTF:-1}"
slidectl spawn rrbot --controllers config/rrbot_control.yaml
slidectl controller spawn joint_state_controller

slidectl service call /rrbot/controller_manager/load_controller "name: 'joint1_position_controller'"
slidectl service call /rrbot/controller_manager/load_controller "name: 'joint2_position_controller'"
slidectl service call /rrbot/controller_manager/switch_controller \
    "{start_controllers: ['joint1_position_controller','joint2_position_controller'], stop_controllers: [], strictness: 2}"

slidectl pub /rrbot/joint1_position_controller/command std_msgs/Float64 "data: 1.5"
slidectl pub /rrbot/joint2_position_controller/command std_msgs/Float64 "data: 1.0"

# These gains have no integral action, so the arm hangs a little below its set points.
slidectl wait '/rrbot/joint1_position_controller/state/error' --near 0 --tol 0.2 --for 1 --within 20
slidectl wait '/rrbot/joint2_position_controller/state/error' --near 0 --tol 0.2 --for 1 --within 20
slidectl controller list --cm /rrbot

slidectl service call /rrbot/controller_manager/switch_controller \
    "{start_controllers: [], stop_controllers: ['joint1_position_controller','joint2_position_controller'], strictness: 2}"
slidectl controller list --cm /rrbot
