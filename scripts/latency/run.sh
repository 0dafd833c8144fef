#!/usr/bin/env bash
# Reproduces docs/results/latency.md: the shipped network with latencies in three execution modes.
# Usage: scripts/latency/run.sh [FOLDER] [EPISODES]. Existing runs are resumed. ROBOGATE names the command; default: a release build.
set -euo pipefail
cd "$(dirname "$0")/../.."

out=${1:-runs/latency}
episodes=${2:-48}
if [ -z "${ROBOGATE:-}" ]; then
    cargo build --release --locked -p robogate
    ROBOGATE=${CARGO_TARGET_DIR:-target}/release/robogate
fi
mkdir -p "$out"
printf 'seed = 7401\n[uniform]\nepisodes = %s\n' "$episodes" > "$out/plan.toml"

printf 'seed = 7402\n[uniform]\nepisodes = %s\n' "$((4 * episodes))" > "$out/varied.toml"

# make NAME PLAN ARGUMENTS...
make() {
    local dir=$out/$1 plan=$out/$2.toml
    shift 2
    if [ -f "$dir/plan.json" ]; then
        "$ROBOGATE" resume "$dir" > /dev/null
    else
        "$ROBOGATE" run --plan "$plan" --space learned --set tolerance_m=0.03 --set contact_force_limit_n=1000000 --policy assets/policies/learned.onnx --profile learned "$@" --out "$dir" > /dev/null
    fi
}

# The same scenarios at each latency, and the verdict. The verdict's exit codes are not errors here.
for mode in hold queue overlap; do
    for ms in 0 50 100 150 200 400 600 800; do
        make "$mode-$ms" plan --latency "fixed:${ms}ms" --execution "$mode"
        "$ROBOGATE" gate --run "$out/$mode-$ms" --requirements scripts/latency/requirements.toml --json > "$out/$mode-$ms.json" || true
        python3 scripts/latency/row.py "$mode" "$ms" "$out/$mode-$ms/summary.json" "$out/$mode-$ms.json"
    done
done

# The latency as a parameter among the others.
make varied varied --latency varied:0ms,1000ms
"$ROBOGATE" report "$out/varied"
