#!/usr/bin/env bash
# Builds the wheel, installs it into a bare environment and runs the slider from a folder that knows no checkout.
set -euo pipefail
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
work="$(mktemp -d)"
export XDG_RUNTIME_DIR="$work/run"
mkdir -m 700 "$XDG_RUNTIME_DIR"
slidectl="$work/venv/bin/slidectl"
trap '"$slidectl" -q daemon stop >/dev/null 2>&1 || true; rm -rf "$work"' EXIT

"$root/.venv/bin/python" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$work" "$root"
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$work"/slidectl-*.whl

cd "$work"
"$slidectl" version
"$slidectl" daemon start --rtf max
"$slidectl" spawn slider --controllers config/slider_control.yaml
"$slidectl" controller spawn joint_state_controller joint1_position_controller
"$slidectl" pub command 1.0
"$slidectl" wait 'joint_states/position[0]' --near 1.0 --tol 0.02 --within 15
"$slidectl" daemon stop
echo "the wheel works from any folder"
