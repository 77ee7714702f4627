#!/usr/bin/env bash
# Builds the wheel, installs it into bare environments, with the lowest and with the newest versions of its dependencies,
# and runs the slider and the samples' launch files from a folder that knows no checkout.
# PYTHON builds and runs it; that of the checkout's own environment unless it is set.
set -euo pipefail
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
work="$(mktemp -d)"
export XDG_RUNTIME_DIR="$work/run"
mkdir -m 700 "$XDG_RUNTIME_DIR"
slidectl="$work/venv/bin/slidectl"
trap '"$slidectl" -q daemon stop >/dev/null 2>&1 || true; rm -rf "$work"' EXIT

python="${PYTHON:-$root/.venv/bin/python}"
"$python" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$work" "$root"
"$python" - "$root/pyproject.toml" > "$work/lowest.txt" <<'END'
import re
import sys
import tomllib

with open(sys.argv[1], "rb") as file:
    for dependency in tomllib.load(file)["project"]["dependencies"]:
        name, lowest = re.match(r"([\w-]+)>=([\d.]+),", dependency).groups()
        print(f"{name}=={lowest}")
END
cd "$work"
slide() {
  "$slidectl" daemon start --rtf max
  "$slidectl" spawn slider --controllers config/slider_control.yaml
  "$slidectl" controller spawn joint_state_controller joint1_position_controller
  "$slidectl" pub command 1.0
  "$slidectl" wait 'joint_states/position[0]' --near 1.0 --tol 0.02 --within 15
  "$slidectl" daemon stop
}

install() {  # the constraints of pip
  rm -rf "$work/venv"
  "$python" -m venv "$work/venv"
  "$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$@" "$work"/slidectl-*.whl
}

install --constraint "$work/lowest.txt"
"$slidectl" version
slide

install
"$slidectl" version
if "$work/venv/bin/python" -c "import pytest" 2>/dev/null; then echo "the wheel brings pytest unasked" >&2; exit 1; fi
test -f "$work"/venv/lib/python3*/site-packages/slidectl/py.typed
test -f "$work/venv/share/man/man1/slidectl-spawn.1"
slide

"$slidectl" launch my_slider slider.launch --detach
"$slidectl" pub command -0.1
"$slidectl" wait 'joint_states/position[0]' --near -0.1 --tol 0.02 --within 15
"$slidectl" daemon stop
"$slidectl" launch rrbot_gazebo rrbot_world.launch --detach
"$slidectl" launch rrbot_control rrbot_control.launch --detach
"$slidectl" launch rrbot_control rrbot_rqt.launch
"$slidectl" controller list
"$slidectl" daemon stop

# A package of one's own, at a path with blanks and letters of all kinds, that includes a sample's file.
mkdir -p "$work/größe und weite/mine/launch"
echo '<package format="2"><name>mine</name></package>' > "$work/größe und weite/mine/package.xml"
echo '<launch><include file="$(find my_slider)/launch/slider.launch" pass_all_args="true"/></launch>' \
  > "$work/größe und weite/mine/launch/all.launch"
SLIDECTL_PACKAGE_PATH="$work/größe und weite" "$slidectl" launch mine all.launch --detach
"$slidectl" daemon stop

# The extra for tests: scenarios run, and pytest finds the plugin by itself.
echo 'steps: [spawn slider, robots]' > "$work/robot.yaml"
if "$slidectl" test "$work/robot.yaml" 2> "$work/refused"; then echo "scenarios run without pytest" >&2; exit 1; fi
grep -q "pip install '.*\[test\]'" "$work/refused"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$(echo "$work"/slidectl-*.whl)[test]"
"$slidectl" test "$work/robot.yaml"
"$slidectl" test "$work/robot.yaml" "$work/robot.yaml" -n 2
cat > "$work/test_robot.py" <<'END'
def test_robot(slidectl_client):
    slidectl_client.spawn("slider")
    assert slidectl_client.step(1000) == 1.0
END
"$work/venv/bin/python" -m pytest -q "$work/test_robot.py"
echo "the wheel works from any folder"
