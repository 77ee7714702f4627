#!/usr/bin/env bash
# Runs every example as fast as the machine can, and stops at the first that fails.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

export RTF=max
for script in slide.sh rrbot.sh two_robots.sh gravity.sh sine.sh trajectory.sh cart.sh cartpole.sh car.sh wrist.sh \
    rospy_slide.sh roslibpy.sh; do
    echo "== examples/$script"
    bash "$script"
done
echo "all examples ran"
