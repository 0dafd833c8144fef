# shellcheck shell=bash
# Shared by the scripts of this folder: source it from the root of the repository with the folder of the results in `out`. Installs LeRobot
# into it, builds the command unless ROBOGATE names one, and sets `here` and `bin`.

here=scripts/learned/lerobot
bin=$out/venv/bin
# Nothing is downloaded later: no pretrained weights, no dataset.
export HF_HUB_OFFLINE=1 HF_HOME=$out/cache OMP_NUM_THREADS=${THREADS:-1}
if [ ! -x "$bin/lerobot-train" ]; then
    python3 -m venv "$out/venv"
    "$bin/pip" install --quiet --require-hashes --requirement "$here/requirements.lock"
fi
if [ -z "${ROBOGATE:-}" ]; then
    cargo build --release --locked -p robogate --features full
    ROBOGATE=${CARGO_TARGET_DIR:-target}/release/robogate
fi

# Starts LeRobot's policy server on `port` in the folder of the results, and sets `server` to its process, which ends with the script:
# serve LOG
serve() {
    (cd "$out" && exec "$bin/python" -m lerobot.async_inference.policy_server --host=127.0.0.1 --port="$port" --fps=20 --inference_latency=0 > "$1" 2>&1) &
    server=$!
    trap 'kill "$server" 2> /dev/null || true' EXIT
}
