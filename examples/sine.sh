#!/usr/bin/env bash
# A joint that swings by a controller of one's own; its parameters are changed, and it is reloaded.
set -euo pipefail

folder="$(mktemp -d)"  # a world of its own, of which nothing stays
export SLIDECTL_SOCKET="$folder/sine"
trap 'slidectl -q daemon stop; rm -r "$folder"' EXIT
here="$(dirname "${BASH_SOURCE[0]}")"

slidectl daemon start --rtf "${RTF:-1}"
slidectl spawn slider
slidectl controller load sine --from "$here/sine.py:Sine"
slidectl controller start sine
slidectl wait /slider/sine/command/data --above 0.99 --within 4

slidectl param set /slider/sine/amplitude 3.0 --new
slidectl controller reload sine
slidectl wait /slider/sine/command/data --above 2.97 --within 4
