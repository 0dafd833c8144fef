#!/usr/bin/env bash
# Measures docs/results/environments.md: ten Meta-World tasks with their experts, Fetch, overhead, and faults.
#
# Usage: scripts/environments.sh [EPISODES]; 200 episodes for each task by default. Needs `robogate env setup metaworld` and
# `robogate env setup fetch`. A task whose folder exists is not run again.
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
# The same without variation, for comparison: 50 episodes in which only Meta-World's own goal and object positions differ.
printf 'name = "nominal"\n\n[[parameter]]\nname = "action_delay"\nkind = "integer"\nlow = 0\nhigh = 0\n' > "$out/nominal.toml"
printf '[uniform]\nepisodes = 50\n' > "$out/nominal-plan.toml"
for task in "${tasks[@]}"; do
    [ -f "$out/$task-nominal/summary.json" ] ||
        "$robogate" run --env "metaworld:$task" --space "$out/nominal.toml" --plan "$out/nominal-plan.toml" --threads "$threads" \
            --out "$out/$task-nominal"
done
[ -f "$out/fetch/summary.json" ] ||
    "$robogate" run --env fetch:FetchPickAndPlace-v4 -n "$episodes" --seed 2026 --threads "$threads" --out "$out/fetch"

# Replays: the hash of every state must be that of the run.
for task in drawer-open-v3 push-v3; do
    "$robogate" replay "$out/$task" 7 > "$out/$task-replay.txt"
done

# Times need an idle machine: QUIET=1 says that it is one.
if [ "${QUIET:-0}" = 1 ]; then
    python=${PYTHON:-${XDG_CACHE_HOME:-$HOME/.cache}/robogate/environments/metaworld/bin/python}
    "$python" scripts/environments_overhead.py "$robogate" "$python" > "$out/overhead.txt"
fi

python3 scripts/environments.py "$robogate" "$out" "${tasks[@]}" > docs/results/environments.md
