#!/usr/bin/env bash
# Two sliders side by side and RRBot behind them, in one world: names, namespaces and places keep them apart.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/two"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT

slidectl daemon start --rtf "${RTF:-1}"
slidectl spawn slider -n left  --at 0  1 0 --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller
slidectl spawn slider -n right --at 0 -1 0 --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller
slidectl spawn rrbot --at -3 0 0 --controllers config/rrbot_control.yaml --start joint_state_controller joint1_position_controller joint2_position_controller
slidectl robots

slidectl pub left/joint1_position_controller/command 0.5
slidectl --ns /right pub command -0.5
slidectl pub rrbot/joint1_position_controller/command 0.3

slidectl wait '/left/joint_states/position[0]'  --near  0.5 --tol 0.02 --for 0.5 --within 20
slidectl wait '/right/joint_states/position[0]' --near -0.5 --tol 0.02 --for 0.5 --within 20

slidectl delete rrbot
slidectl robots
