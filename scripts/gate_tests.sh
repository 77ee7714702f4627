#!/usr/bin/env bash
# Runs the tests by make, and then, one at a time, those that failed. A test that fails among thousands on a busy machine
# and passes alone has a race: it is named at the end, to be mended, and does not hold up the change. A test that fails
# twice does, and so do more than ten that fail once, since a busy machine does not explain those.
#   scripts/gate_tests.sh [NAME=VALUE...] test|most|units
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
most=10
failed=".pytest_cache/v/cache/lastfailed"
environment=".venv"
for word in "$@"; do
  [ "${word%%=*}" != VENV ] || environment="${word#*=}"
done

[ ! -e "$failed" ] || : >"$failed"
make "$@" && exit
code=$?
[ -s "$failed" ] || exit "$code"
python="$environment/bin/python"
names="$("$python" -c 'import json, sys; print(*json.load(open(sys.argv[1])), sep="\n")' "$failed")" || exit "$code"
count="$(wc -l <<<"$names")"
if [ "$count" -gt "$most" ]; then
  echo "$count tests failed: more than $most are not run again" >&2
  exit "$code"
fi
echo "run once more, one at a time: $count"
"$python" -m pytest --last-failed --last-failed-no-failures none || exit
printf '%s\n' "these failed beside other tests and passed alone; each has a race to be found:" "$names"
