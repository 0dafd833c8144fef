#!/usr/bin/env bash
# Measures whether demonstrations at the failures that an active campaign finds are worth more than the same number at uniform points: records
# both for the first network of scripts/learned/run.sh, trains a network with each, and judges both on the same new scenarios.
#
# Usage: scripts/learned/closed_loop.sh FOLDER [DEMONSTRATIONS] [STEPS] [SEED...]; defaults: 200 demonstrations, 30000 steps of training, seed 2026.
# FOLDER is that of scripts/learned/run.sh, with its first network and its demonstrations; this script records them if they are missing. Steps
# with existing results are skipped. A training run takes 20 to 30 minutes of one core for 30,000 steps.
set -euo pipefail
out=$1 count=${2:-200} steps=${3:-30000}
seeds=("${@:4}")
[ "${#seeds[@]}" -gt 0 ] || seeds=(2026)
cd "$(dirname "$0")/../.."

python=$out/venv/bin/python
if [ ! -x "$python" ]; then
    python3 -m venv "$out/venv"
    "$out/venv/bin/pip" install --quiet --require-hashes --requirement scripts/learned/requirements.lock
fi
# BUILT: a folder with robogate, in place of a release build.
if [ -z "${BUILT:-}" ]; then
    cargo build --release --locked -p robogate
    BUILT=${CARGO_TARGET_DIR:-target}/release
fi
robogate=$BUILT/robogate
wide=scripts/learned/wide.toml

# demonstrations NAME ARGUMENT...: records a dataset, unless it exists.
demonstrations() {
    [ -f "$out/$1/meta/info.json" ] || "$robogate" demos --out "$out/$1" --push 0.012 "${@:2}"
}

# campaign NAME ARGUMENT...: runs, resumes or keeps a campaign.
campaign() {
    if [ -f "$out/$1/plan.json" ]; then "$robogate" resume "$out/$1"; else "$robogate" run --out "$out/$1" "${@:2}"; fi
}

first=assets/policies/learned.onnx
[ ! -f "$out/learned.onnx" ] || first=$out/learned.onnx
"$robogate" list profiles learned > "$out/learned.toml"
demonstrations demos -n 1000
campaign active --space "$wide" -n 900 --seed 7001 --policy "$first" --profile "$out/learned.toml"
demonstrations "more-active-$count" --failed-in "$out/active" -n "$count" --seed 7002
demonstrations "more-uniform-$count" --space "$wide" -n "$count" --seed 7003

campaign first-over-wide --space "$wide" --plan scripts/learned/fresh.toml --policy "$first" --profile "$out/learned.toml"
for seed in "${seeds[@]}"; do
    for choice in active uniform; do
        name=$choice-$count-$steps-$seed
        [ -f "$out/$name.onnx" ] ||
            "$python" scripts/learned/train.py "$out/demos" "$out/more-$choice-$count" --steps "$steps" --seed "$seed" --out "$out/$name.onnx"
        campaign "$name-over-wide" --space "$wide" --plan scripts/learned/fresh.toml --policy "$out/$name.onnx" --profile "$out/learned.toml"
    done
    "$robogate" compare --paired "$out"/{uniform,active}-"$count-$steps-$seed"-over-wide
done
