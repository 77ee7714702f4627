#!/usr/bin/env bash
# RRBot is brought into a pose, and stays there by a controller of one's own that carries its weight and nothing else.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/gravity"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT
here="$(dirname "${BASH_SOURCE[0]}")"

slidectl daemon start --rtf "${RTF:-1}"
slidectl spawn rrbot --controllers config/rrbot_control.yaml \
    --start joint_state_controller joint1_position_controller joint2_position_controller
slidectl pub /rrbot/joint1_position_controller/command std_msgs/Float64 "data: 0.8"
slidectl pub /rrbot/joint2_position_controller/command std_msgs/Float64 "data: 0.5"
slidectl wait '/rrbot/joint1_position_controller/state/process_value_dot' --near 0 --tol 0.001 --for 1 --within 60

slidectl controller load gravity --from "$here/gravity.py:Gravity"
slidectl controller switch --stop joint1_position_controller joint2_position_controller --start gravity
# Without it the arm would fall in the first second.
slidectl wait 'joint_states/velocity[0]' --near 0 --tol 0.02 --for 3 --within 10
slidectl controller list
