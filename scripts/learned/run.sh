#!/usr/bin/env bash
# Reproduces docs/results/learned-policy.md: record, train, find failures, record demonstrations of them, train again, measure.
# Usage: scripts/learned/run.sh [FOLDER]. Steps with existing results are skipped.
set -euo pipefail
cd "$(dirname "$0")/../.."

out=${1:-runs/learned}
mkdir -p "$out"
python=$out/venv/bin/python
if [ ! -x "$python" ]; then
    python3 -m venv "$out/venv"
    "$out/venv/bin/pip" install --quiet --require-hashes --requirement scripts/learned/requirements.lock
fi
cargo build --release --locked -p robogate --features full
robogate=${CARGO_TARGET_DIR:-target}/release/robogate
wide=scripts/learned/wide.toml

# Runs the command that creates a folder, unless the folder exists.
make() {
    local folder=$1
    shift
    if [ -f "$folder/plan.json" ]; then "$robogate" resume "$folder"; else "$robogate" run "$@" --out "$folder"; fi
}

if [ ! -f "$out/learned.onnx" ]; then
    [ -f "$out/demos/meta/info.json" ] || "$robogate" demos --out "$out/demos" -n 1000 --push 0.012
    "$python" scripts/learned/train.py "$out/demos" --out "$out/learned.onnx"
fi
"$robogate" list profiles learned > "$out/learned.toml"
sed 's/^name = "learned"/name = "learned-wide"/' "$out/learned.toml" > "$out/learned-wide.toml"

if [ ! -f "$out/learned-wide.onnx" ]; then
    make "$out/campaign" --space "$wide" --plan scripts/learned/campaign.toml --policy "$out/learned.onnx" --profile "$out/learned.toml"
    [ -f "$out/more/meta/info.json" ] || "$robogate" demos --failed-in "$out/campaign" --out "$out/more" -n 500 --push 0.012 --seed 7002
    "$python" scripts/learned/train.py "$out/demos" "$out/more" --out "$out/learned-wide.onnx"
fi

for policy in learned learned-wide; do
    guest=(--policy "$out/$policy.onnx" --profile "$out/$policy.toml")
    for engine in mujoco rapier; do
        make "$out/$policy-$engine" --space learned --plan scripts/learned/fresh.toml --engine "$engine" "${guest[@]}"
    done
    make "$out/$policy-over-wide" --space "$wide" --plan scripts/learned/fresh.toml "${guest[@]}"
    make "$out/$policy-suite" --suite industrial-68 --rounds 2 "${guest[@]}"
done
make "$out/scripted-mujoco" --space learned --plan scripts/learned/fresh.toml
make "$out/scripted-over-wide" --space "$wide" --plan scripts/learned/fresh.toml
make "$out/scripted-suite" --suite industrial-68 --rounds 2
make "$out/random-suite" --suite industrial-68 --rounds 2 --policy random

guest=(--policy "$out/learned-wide.onnx" --profile "$out/learned-wide.toml")
make "$out/wide-few-mujoco" --space learned --plan scripts/learned/few.toml "${guest[@]}"
make "$out/wide-few-egl" --space learned --plan scripts/learned/few.toml --renderer egl "${guest[@]}"
guest=(--policy "$out/learned.onnx" --profile "$out/learned.toml")
make "$out/few-egl" --space learned --plan scripts/learned/few.toml --renderer egl "${guest[@]}"
for engine in mujoco rapier; do
    make "$out/few-$engine" --space learned --plan scripts/learned/few.toml --engine "$engine" "${guest[@]}"
done
if [ ! -f "$out/few-steel/summary.json" ]; then
    bridges/newton/start.sh --solver steel --port 5893 &
    trap "kill $!" EXIT
    # The first start installs Newton.
    until (: < /dev/tcp/127.0.0.1/5893) 2> /dev/null; do sleep 2; done
    "$robogate" run --space learned --plan scripts/learned/few.toml --simulator tcp://127.0.0.1:5893 "${guest[@]}" --out "$out/few-steel"
fi

"$robogate" compare --paired "$out"/learned-{mujoco,rapier}
for other in rapier steel egl; do
    "$robogate" compare --paired "$out"/few-{mujoco,$other}
done
"$robogate" compare --paired "$out"/wide-few-{mujoco,egl}
"$robogate" compare --paired "$out"/{learned,learned-wide}-over-wide
"$robogate" leaderboard "$out"/{scripted,learned,learned-wide,random}-suite --format md
