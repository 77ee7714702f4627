#!/usr/bin/env bash
# A script of roslibpy moves the slider, by the WebSocket gateway. Needs: pip install 'slidectl[websocket]' roslibpy
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/slider"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT

slidectl daemon start --rtf "${RTF:-1}"
slidectl spawn slider --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller
slidectl gateway websocket start --port 0
url="$(slidectl gateway websocket status --json | "${PYTHON:-python3}" -c 'import json, sys; print(json.load(sys.stdin)["address"])')"
"${PYTHON:-python3}" "$(dirname "$0")/roslibpy_slide.py" "$url"
