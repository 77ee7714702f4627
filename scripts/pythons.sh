#!/usr/bin/env bash
# Runs `make units` with each Python that slidectl supports, is on this machine, and is not the one of `make test`, which
# PYTHON names (python3). Each has an environment of its own, .venv-3.x. They are looked for on the PATH and among those of
# pyenv. Those that are not here are named in one line, and are no failure.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

is_python() {  # $1 starts, is of the version $2, and can make environments
  "$1" -c "import ensurepip, sys, venv; sys.exit('%d.%d' % sys.version_info[:2] != '$2')" >/dev/null 2>&1
}

export PIP_NO_COMPILE=1  # each environment is used once, by two processes
missing=()
for version in 3.11 3.12 3.13 3.14; do
  ! is_python "${PYTHON:-python3}" "$version" || continue
  found=""
  for python in "$(command -v "python$version" || true)" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$version".*/bin/python3; do
    if [ -x "$python" ] && is_python "$python" "$version"; then
      found="$python"
      break
    fi
  done
  if [ -n "$found" ]; then
    bash scripts/gate_tests.sh PYTHON="$found" VENV=".venv-$version" units
  else
    missing+=("$version")
  fi
done
[ "${#missing[@]}" = 0 ] || echo "not tested, since they are not on this machine: Python ${missing[*]}"
