#!/usr/bin/env bash
# Measures docs/results/environments.md: ten Meta-World tasks with their experts, Fetch, overhead, and faults.
#
# Usage: scripts/environments.sh [EPISODES]; 200 episodes for each task by default. Needs `robogate env setup metaworld` and
# `robogate env setup fetch`. A task whose folder exists is not run again. METAWORLD_PYTHON and FETCH_PYTHON choose other interpreters.
set -euo pipefail
cd "$(dirname "$0")/.."

episodes=${1:-200}
robogate=${ROBOGATE:-target/release/robogate}
out=${OUT:-runs/environments}
threads=${THREADS:-$(nproc)}
metaworld=(${METAWORLD_PYTHON:+--python "$METAWORLD_PYTHON"})
fetch=(${FETCH_PYTHON:+--python "$FETCH_PYTHON"})
mkdir -p "$out"

tasks=(drawer-open-v3 push-v3 pick-place-v3 door-open-v3 button-press-v3 window-open-v3 faucet-open-v3 drawer-close-v3 plate-slide-v3 sweep-into-v3)
for task in "${tasks[@]}"; do
    [ -f "$out/$task/summary.json" ] ||
        "$robogate" run --env "metaworld:$task" "${metaworld[@]}" -n "$episodes" --seed 2026 --threads "$threads" --out "$out/$task"
done
# The same without variation, for comparison: 50 episodes in which only Meta-World's own goal and object positions differ.
printf 'name = "nominal"\n\n[[parameter]]\nname = "action_delay"\nkind = "integer"\nlow = 0\nhigh = 0\n' > "$out/nominal.toml"
printf '[uniform]\nepisodes = 50\n' > "$out/nominal-plan.toml"
for task in "${tasks[@]}"; do
    [ -f "$out/$task-nominal/summary.json" ] ||
        "$robogate" run --env "metaworld:$task" "${metaworld[@]}" --space "$out/nominal.toml" --plan "$out/nominal-plan.toml" --threads "$threads" \
            --out "$out/$task-nominal"
done
[ -f "$out/fetch/summary.json" ] ||
    "$robogate" run --env fetch:FetchPickAndPlace-v4 "${fetch[@]}" -n "$episodes" --seed 2026 --threads "$threads" --out "$out/fetch"

# Replays: the hash of every state must be that of the run.
for task in drawer-open-v3 push-v3; do
    "$robogate" replay "$out/$task" 7 "${metaworld[@]}" > "$out/$task-replay.txt"
done

# What the user reads when an environment breaks.
[ -f "$out/faults.md" ] || ROBOGATE=$robogate PYTHON=${METAWORLD_PYTHON:-python3} scripts/environments_faults.sh > "$out/faults.md"
# A policy of Stable-Baselines3, with an interpreter that has scripts/environments/sb3-requirements.txt.
if [ -n "${SB3_PYTHON:-}" ]; then
    PYTHONPATH=python/src ROBOGATE_COMMAND=$robogate "$SB3_PYTHON" -W ignore scripts/environments_sb3.py "$out/sb3"
    cp "$out/sb3/sb3.md" "$out/sb3.md"
fi

# Times need an idle machine: QUIET=1 says that it is one.
if [ "${QUIET:-0}" = 1 ]; then
    python=${METAWORLD_PYTHON:-${XDG_CACHE_HOME:-$HOME/.cache}/robogate/environments/metaworld/bin/python}
    python3 scripts/environments_overhead.py "$robogate" "$python" 60 --workers > "$out/overhead.txt"
fi

python3 scripts/environments.py "$robogate" "$out" "${tasks[@]}" > docs/results/environments.md
