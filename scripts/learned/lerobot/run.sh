#!/usr/bin/env bash
# Trains an ACT with LeRobot's own trainer on demonstrations of RoboGate, serves it with LeRobot's policy server, and judges it
# (docs/results/learned-policy.md). Usage: scripts/learned/lerobot/run.sh [FOLDER]. Steps with existing results are skipped.
# STEPS sets the number of training steps, CHECKPOINT the one that is judged (a multiple of 2,000, six digits), STATE the normalisation
# of the state (IDENTITY or MEAN_STD), THREADS the threads of training and inference, PORT the port of the server.
set -euo pipefail
cd "$(dirname "$0")/../../.."

mkdir -p "${1:-runs/lerobot}"
# The server runs in another folder.
out=$(realpath "${1:-runs/lerobot}")
steps=${STEPS:-6000}
port=${PORT:-8095}
. scripts/learned/lerobot/common.sh

if [ ! -f "$out/demos/meta/info.json" ]; then
    "$ROBOGATE" demos --out "$out/demos" --space "$here/space.toml" -n 400 --push 0.012 --size 32
    "$bin/python" scripts/check_dataset.py "$out/demos"
fi

checkpoint=$out/act/checkpoints/${CHECKPOINT:-002000}/pretrained_model
[ -d "$checkpoint" ] || "$here/train.sh" "$out/venv" "$out/demos" "$out/act" "$steps" 2000

sed "s|CHECKPOINT|$checkpoint|" "$here/profile.toml" > "$out/act.toml"
serve server.log
served=(--policy "grpc://127.0.0.1:$port" --profile "$out/act.toml")
"$ROBOGATE" policy check "grpc://127.0.0.1:$port" --profile "$out/act.toml" --wait 3m

# Runs the command that creates a folder, unless the folder exists.
make() {
    local folder=$1
    shift
    if [ -f "$folder/plan.json" ]; then
        "$ROBOGATE" resume "$folder"
    else
        "$ROBOGATE" run --space "$here/space.toml" --plan "$here/plan.toml" "$@" --out "$folder"
    fi
}
make "$out/run-act" "${served[@]}"
make "$out/run-learned" --policy assets/policies/learned.onnx --profile learned
make "$out/run-scripted"
"$ROBOGATE" compare --paired "$out/run-learned" "$out/run-act"
# Exit code 1 means that the policy fails.
"$ROBOGATE" gate --run "$out/run-act" || [ $? -le 3 ]
