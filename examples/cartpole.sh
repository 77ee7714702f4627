#!/usr/bin/env bash
# A controller of one's own balances a pole on a cart, from an angle of 0.2 rad, and after a push.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/cartpole"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT
here="$(dirname "${BASH_SOURCE[0]}")"

slidectl daemon start --rtf "${RTF:-1}" --import "$here/cartpole.py"
slidectl spawn cartpole --controllers config/cartpole_control.yaml --start joint_state_controller lqr
slidectl service call /gazebo/set_model_configuration \
    "{model_name: cartpole, joint_names: [pole_joint], joint_positions: [0.2]}"
slidectl wait 'joint_states/position[1]' --near 0 --tol 0.001 --for 1 --within 20

# 1 N on the pole for 0.2 s, in a paused world, so that the end of the push can be seen.
slidectl sim pause
slidectl service call /gazebo/apply_body_wrench \
    "{body_name: 'cartpole::pole', wrench: {force: {x: 1.0}}, duration: {nsecs: 200000000}}"
slidectl sim step 0.2s
slidectl robots cartpole
slidectl sim resume
slidectl wait 'joint_states/position[1]' --near 0 --tol 0.001 --for 1 --within 20
slidectl wait 'joint_states/position[0]' --near 0 --tol 0.01 --within 20
slidectl controller list -v
