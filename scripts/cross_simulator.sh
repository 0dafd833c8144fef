#!/usr/bin/env bash
# Runs the scripted Franka on the same 2,000 scenarios in MuJoCo and in Rapier, and compares them pair by pair.
# Usage: scripts/cross_simulator.sh [FOLDER]. Existing runs are resumed.
set -euo pipefail
cd "$(dirname "$0")/.."

out=${1:-runs/cross-simulator}
cargo build --release --locked -p robogate --features rapier
robogate=${CARGO_TARGET_DIR:-target}/release/robogate
for engine in mujoco rapier; do
    if [ -f "$out/$engine/plan.json" ]; then
        "$robogate" resume "$out/$engine"
    else
        "$robogate" run --engine "$engine" --space franka --set tolerance_m=0.03 --set contact_force_limit_n=1000000 --plan docs/results/cross-simulator.toml --out "$out/$engine"
    fi
done
"$robogate" compare --paired "$out"/{mujoco,rapier} --out "$out/comparison.html" --md "$out/comparison.md"
