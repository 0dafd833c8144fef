#!/usr/bin/env bash
# Reproduces docs/results/four-robots.md: runs 10,000 episodes on each built-in robot and compares them.
# Usage: scripts/four_robots.sh [FOLDER]. Existing runs are resumed.
set -euo pipefail
cd "$(dirname "$0")/.."

out=${1:-runs/four-robots}
cargo build --release --locked -p robogate
robogate=target/release/robogate
for robot in ur3e ur5e ur10e franka; do
    if [ -f "$out/$robot/plan.json" ]; then
        "$robogate" resume "$out/$robot"
        continue
    fi
    # The paper's spaces and tolerance, and its surface gripper; the Franka has fingers.
    paper=(--set tolerance_m=0.03 --set contact_force_limit_n=1000000 --space ur --set suction=surface)
    [ "$robot" = franka ] && paper=(--set tolerance_m=0.03 --set contact_force_limit_n=1000000 --space franka)
    "$robogate" run --robot "$robot" --plan docs/results/four-robots.toml "${paper[@]}" --out "$out/$robot"
done
"$robogate" compare "$out"/{ur3e,ur5e,ur10e,franka} --out "$out/comparison.html" --md "$out/comparison.md"
