#!/usr/bin/env bash
# The arm follows trajectories, the gripper opens and closes: goals of actions, waited for by --wait.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/arm"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT

slidectl daemon start --rtf "${RTF:-1}" --paused  # until the controllers hold what would fall
slidectl spawn arm --controllers config/arm_control.yaml --start joint_state_controller arm_controller
slidectl spawn gripper --at 1 0 0 --controllers config/gripper_control.yaml --start joint_state_controller gripper_controller
slidectl sim resume

slidectl trajectory plan arm_controller --to joint1=1.5 joint2=-0.4 --duration 2 --wait

cat > "$folder/path.csv" <<'END'
time, joint1, joint2, joint3, joint4, joint5, joint6
1.0,  1.0,    0.2,    0.4,    0.0,    0.3,    0.0
2.5,  0.0,    0.5,    0.8,    0.5,    0.6,    1.0
END
slidectl trajectory send arm_controller "$folder/path.csv" --wait
slidectl trajectory state arm_controller

slidectl action list
slidectl action send gripper_cmd '{command: {position: 0.06, max_effort: 20}}' --wait
slidectl action send gripper_cmd '{command: {position: 0.0, max_effort: 20}}' --wait
