#!/usr/bin/env bash
# The sliding block: up, to the middle, down. No sleep anywhere: every command returns when its effect is true,
# and `wait` blocks in simulated time until the block is where it should be.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/slide"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT

slidectl daemon start --rtf "${RTF:-1}"
slidectl spawn slider --controllers config/slider_control.yaml
slidectl controller spawn joint_state_controller joint1_position_controller

for target in 1.0 0.0 -1.0; do
    slidectl pub command "$target"
    slidectl wait 'joint_states/position[0]' --near "$target" --tol 0.02 --for 0.5 --within 30
done

slidectl echo joint_states -n 1
slidectl controller switch --stop joint1_position_controller
slidectl service call /slider/controller_manager/list_controllers
