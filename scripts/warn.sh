#!/bin/bash
# Reproduces docs/results/warn.md: detectors for three policies, each checked on fresh episodes.
# Usage: scripts/warn.sh FOLDER [ROBOGATE]. ROBOGATE_METAWORLD_PYTHON is a Python with Meta-World. Steps with existing results are skipped.
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:?folder}
robogate=${2:-target/release/robogate}
mkdir -p "$out"

# run NAME EPISODES SEED ARGUMENTS...
run() {
    local name=$1 n=$2 seed=$3
    shift 3
    [ -f "$out/$name/summary.json" ] || "$robogate" run -n "$n" --seed "$seed" --design uniform --nominal-episodes 0 \
        --record-signals --out "$out/$name" -q "$@"
}
# detector NAME FILE OPTIONS...: trained with NAME-a, checked on NAME-b
detector() {
    local name=$1 file=$2
    shift 2
    "$robogate" warn train "$out/$name-a" "$@" --out "$out/$file.json" > "$out/$file.train.txt"
    "$robogate" warn check "$out/$file.json" "$out/$name-b" > "$out/$file.check.txt" || [ $? -ne 2 ]
}

run scripted-a 1600 1
run scripted-b 1400 2
detector scripted scripted
detector scripted scripted-parameters --parameters all
detector scripted scripted-successes --successes-only

learned=(--policy assets/policies/learned.onnx --profile learned --space scripts/learned/wide.toml)
run learned-a 1200 101 "${learned[@]}"
run learned-b 1200 102 "${learned[@]}"
detector learned learned
detector learned learned-successes --successes-only
run learned-rapier 220 104 "${learned[@]}" --engine rapier
"$robogate" warn check "$out/learned.json" "$out/learned-rapier" > "$out/learned.rapier.txt" || [ $? -ne 2 ]

push=(--env metaworld:push-v3 ${ROBOGATE_METAWORLD_PYTHON:+--python "$ROBOGATE_METAWORLD_PYTHON"})
run push-a 400 201 "${push[@]}"
run push-b 300 202 "${push[@]}"
detector push push
detector push push-successes --successes-only
