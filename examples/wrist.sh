#!/usr/bin/env bash
# Two motors share two joints through a differential: what one joint takes, the other lacks.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/wrist"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT

slidectl daemon start --rtf "${RTF:-1}" --paused  # until the controllers hold what would fall
slidectl spawn wrist --transmissions real --controllers config/wrist_control.yaml \
    --start joint_state_controller wrist_controller
slidectl sim resume

slidectl trajectory plan wrist_controller --to pitch=0.6 roll=1.0 --duration 1 --wait
# Both motors have turned by 50 (0.6 + 1.0), and 50 (0.6 - 1.0).
slidectl echo /wrist/actuator_states -n 1
slidectl trajectory plan wrist_controller --to pitch=-0.6 roll=0.0 --duration 1 --wait
slidectl echo /wrist/joint_states -n 1
