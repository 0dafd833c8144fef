#!/usr/bin/env bash
# Trains an ACT with LeRobot's own trainer on demonstrations of RoboGate, serves it with LeRobot's policy server, and judges it
# (docs/results/learned-policy.md). Usage: scripts/learned/lerobot/run.sh [FOLDER]. Steps with existing results are skipped.
# STEPS sets the number of training steps, CHECKPOINT the one that is judged (a multiple of 2,000, six digits), STATE the normalisation
# of the state (IDENTITY or MEAN_STD), THREADS the threads of training and inference, PORT the port of the server.
set -euo pipefail
cd "$(dirname "$0")/../../.."

here=scripts/learned/lerobot
mkdir -p "${1:-runs/lerobot}"
# The server runs in another folder.
out=$(realpath "${1:-runs/lerobot}")
steps=${STEPS:-6000}
port=${PORT:-8095}
# Nothing is downloaded: no pretrained weights, no dataset.
export HF_HUB_OFFLINE=1 HF_HOME=$out/cache OMP_NUM_THREADS=${THREADS:-1}
bin=$out/venv/bin
if [ ! -x "$bin/lerobot-train" ]; then
    python3 -m venv "$out/venv"
    "$bin/pip" install --quiet --require-hashes --requirement "$here/requirements.lock"
fi
if [ -z "${ROBOGATE:-}" ]; then
    cargo build --release --locked -p robogate --features full
    ROBOGATE=${CARGO_TARGET_DIR:-target}/release/robogate
fi

if [ ! -f "$out/demos/meta/info.json" ]; then
    "$ROBOGATE" demos --out "$out/demos" --space "$here/space.toml" -n 400 --push 0.012 --size 32
    "$bin/python" scripts/check_dataset.py "$out/demos"
fi

checkpoint=$out/act/checkpoints/${CHECKPOINT:-002000}/pretrained_model
[ -d "$checkpoint" ] || "$here/train.sh" "$out/venv" "$out/demos" "$out/act" "$steps" 2000

sed "s|CHECKPOINT|$checkpoint|" "$here/profile.toml" > "$out/act.toml"
(cd "$out" && exec "$bin/python" -m lerobot.async_inference.policy_server --host=127.0.0.1 --port="$port" --fps=20 --inference_latency=0 > server.log 2>&1) &
trap "kill $!" EXIT
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
