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
    "$bin/pip" install --quiet --requirement "$here/requirements.txt"
fi
if [ -z "${ROBOGATE:-}" ]; then
    cargo build --release --locked -p robogate --features full
    ROBOGATE=${CARGO_TARGET_DIR:-target}/release/robogate
fi

if [ ! -f "$out/demos/meta/info.json" ]; then
    "$ROBOGATE" demos --out "$out/demos" --space "$here/space.toml" -n 400 --push 0.012 --size 32
    "$bin/python" scripts/check_dataset.py "$out/demos"
fi

# A small ACT without the variational encoder, because one expert has one way to solve a scene. It sees the wrist camera: in 32 pixels the
# front camera does not show the object. The state is not normalised: the hand points down in all demonstrations, so two elements of its
# quaternion have a standard deviation of 0.0005 and 0.0007, and division by that amplifies small tilts. The learning rate decays to the
# end of the training, which LeRobot's preset for ACT does not do.
checkpoint=$out/act/checkpoints/${CHECKPOINT:-002000}/pretrained_model
if [ ! -d "$checkpoint" ]; then
    "$bin/lerobot-train" --dataset.repo_id=local/demos --dataset.root="$out/demos" --output_dir="$out/act" \
        --policy.type=act --policy.device=cpu --policy.push_to_hub=false --policy.pretrained_backbone_weights=null \
        --policy.input_features='{"observation.state": {"type": "STATE", "shape": [15]}, "observation.images.wrist": {"type": "VISUAL", "shape": [3, 32, 32]}}' \
        --policy.chunk_size=10 --policy.n_action_steps=10 --policy.use_vae=false --policy.dim_model=128 --policy.n_heads=4 \
        --policy.dim_feedforward=256 --policy.n_encoder_layers=2 --policy.dropout=0 \
        --policy.normalization_mapping='{"VISUAL": "MEAN_STD", "STATE": "'"${STATE:-IDENTITY}"'", "ACTION": "MEAN_STD"}' \
        --use_policy_training_preset=false --optimizer.type=adamw --optimizer.lr=5e-4 --optimizer.weight_decay=1e-4 \
        --scheduler.type=cosine_decay_with_warmup --scheduler.peak_lr=5e-4 --scheduler.decay_lr=1e-5 \
        --scheduler.num_warmup_steps=200 --scheduler.num_decay_steps="$steps" \
        --batch_size=32 --steps="$steps" --save_freq=2000 --num_workers=0
fi

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
