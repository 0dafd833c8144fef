#!/usr/bin/env bash
# Measures docs/results/environments.md: ten Meta-World tasks with their experts, Fetch, overhead, and faults.
#
# Usage: scripts/environments.sh [EPISODES]; 200 episodes for each task by default. Needs `robogate env setup metaworld` and
# `robogate env setup fetch`, and no other load: it measures times. A task whose folder exists is not run again.
set -euo pipefail
cd "$(dirname "$0")/.."

episodes=${1:-200}
robogate=${ROBOGATE:-target/release/robogate}
out=${OUT:-runs/environments}
threads=${THREADS:-$(nproc)}
mkdir -p "$out"

tasks=(drawer-open-v3 push-v3 pick-place-v3 door-open-v3 button-press-v3 window-open-v3 faucet-open-v3 drawer-close-v3 plate-slide-v3 sweep-into-v3)
for task in "${tasks[@]}"; do
    [ -f "$out/$task/summary.json" ] ||
        "$robogate" run --env "metaworld:$task" -n "$episodes" --seed 2026 --threads "$threads" --out "$out/$task"
done
[ -f "$out/fetch/summary.json" ] ||
    "$robogate" run --env fetch:FetchPickAndPlace-v4 -n "$episodes" --seed 2026 --threads "$threads" --out "$out/fetch"

# Replays: the hash of every state must be that of the run.
for task in drawer-open-v3 push-v3; do
    "$robogate" replay "$out/$task" 7 > "$out/$task-replay.txt"
done

python3 scripts/environments.py "$robogate" "$out" "${tasks[@]}" > docs/results/environments.md
