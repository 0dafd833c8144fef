#!/usr/bin/env bash
# Measures docs/results/libero-scene.md: one scene of LIBERO through its environment and through a cell, as a policy sees both.
#
# Usage: scripts/libero_scene.sh [SUITE TASK STATE]; spatial 2 0 by default. Needs LIBERO on PYTHONPATH, LIBERO_PYTHON (the Python of
# `robogate env setup libero`), and PYTHON with msgpack, numpy, pillow and websockets. About two minutes.
set -euo pipefail
cd "$(dirname "$0")/.."

suite=${1:-spatial} task=${2:-2} state=${3:-0}
robogate=${ROBOGATE:-target/release/robogate}
python=${PYTHON:-python3}
out=${OUT:-$(mktemp -d)}
export PYTHONDONTWRITEBYTECODE=1 MUJOCO_GL=${MUJOCO_GL:-egl} PYTHONPATH=$PWD/python/src:${PYTHONPATH:-}
mkdir -p "$out"
children=()
trap 'kill "${children[@]}" 2> /dev/null || true' EXIT

# Starts a server with its output in a file, and waits for a line of it: server LOG PATTERN COMMAND...
server() {
    local log=$1 pattern=$2
    shift 2
    "$@" > "$log" 2>&1 &
    children+=($!)
    for _ in $(seq 600); do
        if grep -q "$pattern" "$log"; then
            return
        fi
        sleep 0.1
    done
    cat "$log" >&2
    return 1
}

# The profile with one action for each request, so that the server sees the state before each action.
"$robogate" list profiles pi05-libero | sed 's/^length = .*//; s/^execute = .*/execute = 1/; s/^name = "pi05-libero"/name = "scene"\nreference = "pi05-libero"/' > "$out/profile.toml"
# Runs one episode of a path: path NAME PORT ARGUMENTS...
path() {
    local name=$1 port=$2
    shift 2
    mkdir -p "$out/$name"
    server "$out/$name.log" listening "$python" scripts/libero_scene/recorder.py "$out/$name" "$port"
    "$robogate" run --policy "ws://127.0.0.1:$port" --profile "$out/profile.toml" --threads 1 --out "$out/run-$name" "$@" > "$out/run-$name.txt" 2>&1 ||
        { cat "$out/run-$name.txt" >&2; return 1; }
}

"$LIBERO_PYTHON" scripts/libero_scene/scene.py reference "$suite" "$task" "$state" "$out/reference.npz" > "$out/reference.log" 2>&1 ||
    { cat "$out/reference.log" >&2; exit 1; }
cat > "$out/suite.toml" <<TOML
schema = 1
name = "one-scene"
version = "1.0.0"
description = "One initial state of one task."
environment = "libero:$suite/$task"

[[group]]
name = "scene"
category = "task"
description = "one initial state"
scenarios = [{ id = "scene-0", initial_state = $state }]
TOML
path environment 18211 --suite "$out/suite.toml" --python "$LIBERO_PYTHON"
server "$out/cell.log" listening "$LIBERO_PYTHON" scripts/libero_scene/scene.py cell "$suite" "$task" "$state"
path scene 18212 -n 1 --simulator "$(sed -n 's/.*"listening": "\([^"]*\)".*/\1/p' "$out/cell.log")"
path cell 18213 -n 1 --seed 1

"$python" scripts/libero_scene/compare.py "$out/reference.npz" "$out/environment" "$out/scene" "$out/cell" | tee "$out/page.md"
