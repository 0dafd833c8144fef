#!/usr/bin/env bash
# Measures coverage and savings of `robogate transfer`: one simulation of the scripted Franka, and surrogate realities
# whose physics differ. Usage: scripts/transfer.sh [FOLDER]. Existing runs are resumed.
set -euo pipefail
cd "$(dirname "$0")/.."

out=${1:-runs/transfer}
mkdir -p "$out"
cargo build --release --locked -p robogate --features rapier
robogate=${CARGO_TARGET_DIR:-target}/release/robogate

campaign() { # name, seed, episodes, further arguments of `robogate run`
    local plan=$out/$1.toml
    printf 'seed = %s\nsampler = "latin_hypercube"\n[uniform]\nepisodes = %s\n' "$2" "$3" >"$plan"
    if [ -f "$out/$1/plan.json" ]; then
        "$robogate" resume "$out/$1"
    else
        "$robogate" run --set tolerance_m=0.03 --set contact_force_limit_n=1000000 --plan "$plan" --out "$out/$1" "${@:4}"
    fi
}

campaign simulation 11 2000 --space franka
campaign altered 12 1000 --space docs/results/transfer-altered.toml
campaign rapier 13 1000 --space franka --engine rapier
campaign delayed 14 1000 --space franka --latency fixed:10ms
example() { cargo run --release --locked -p robogate-analysis --example transfer -- "$@"; }
example | tee "$out/synthetic.md"
example "$out"/{simulation,altered,rapier,delayed} | tee "$out/surrogate.md"
