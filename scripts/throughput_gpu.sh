#!/usr/bin/env bash
# Throughput and validity of many worlds in MuJoCo Warp, beside MuJoCo on all cores (docs/results/throughput.md).
#
#   scripts/throughput_gpu.sh prepare FOLDER [PYTHON_VERSION]   collects everything in a folder, with network (default: 3.12)
#   FOLDER/throughput_gpu.sh measure OUT [SECONDS]              measures on a machine with a GPU, without network (default: 280)
#
# The machine needs that version of Python with numpy, absl-py and etils. FOLDER/kernels keeps compiled kernels: bring it back after a
# first run, and a second one does not compile. DEVICE=cpu and a small EPISODES try the script without a GPU.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

prepare() {
    local folder=$1 version=${2:-3.12}
    mkdir -p "$folder/site" "$folder/kernels"
    local wheels
    wheels=$(mktemp -d)
    python3 -m pip download -q --no-deps --only-binary=:all: --python-version "$version" --implementation cp \
        --platform manylinux_2_28_x86_64 --platform manylinux_2_27_x86_64 --platform manylinux_2_17_x86_64 \
        -d "$wheels" warp-lang==1.19.0 mujoco==3.17.0 mujoco-warp==3.17.0
    for wheel in "$wheels"/*.whl; do python3 -m zipfile -e "$wheel" "$folder/site"; done
    rm -r "$wheels"
    # The compiler of Warp's CPU device and what only tests, viewers and examples need: 130 MB.
    (cd "$folder/site" && rm -rf warp/bin/warp-clang.so warp/tests warp/examples mujoco/experimental mujoco/include mujoco/usd \
        mujoco/sysid mujoco/testdata mujoco/_render_filament* mujoco_warp/test_data)
    cp -r "$here/../python/src/robogate_worlds" "$folder/site/"
    (cd "$here/.." && cargo build --release --no-default-features --features mujoco -p robogate-tasks --bench worlds --locked)
    local bench
    bench=$(find "$here/../target/release/deps" -name 'worlds-*' -type f -executable -printf '%T@ %p\n' | sort -n | tail -1 | cut -d' ' -f2)
    strip -o "$folder/worlds" "$bench"
    cp "$here/throughput_gpu.sh" "$folder/"
    du -sh "$folder"
}

measure() {
    local out=$1 seconds=${2:-280} began
    began=$(date +%s)
    mkdir -p "$out"
    export MUJOCO_GL=disable PYTHONPATH="$here/site${PYTHONPATH:+:$PYTHONPATH}" WARP_CACHE_PATH="$here/kernels"
    export ROBOGATE_MUJOCO_LIB="${ROBOGATE_MUJOCO_LIB:-$here/site/mujoco/libmujoco.so.3.17.0}"
    command -v nvidia-smi > /dev/null && nvidia-smi --query-gpu=name,driver_version --format=csv,noheader | tee "$out/card.txt"
    # part NAME ARGUMENT...: one part, unless the time is over. Its whole output is in OUT/NAME.log.
    part() {
        local name=$1 left=$((seconds - ($(date +%s) - began)))
        shift
        if [ "$left" -lt 15 ]; then echo "$name: no time left"; return; fi
        echo "== $name: $*"
        timeout "$left" "$here/worlds" "python=${PYTHON:-python3}" "device=${DEVICE:-cuda:0}" "threads=$(nproc)" "$@" \
            > "$out/$name.log" 2>&1 || echo "$name ended with $?"
        grep -E '^(mujoco|fast|deterministic)|^  [0-9]|fault|periods' "$out/$name.log" | cut -c1-300 || true
    }
    local episodes=${EPISODES:-4096}
    part warmup episodes=16 worlds=16 runs=1
    part fast "episodes=$episodes" "worlds=$episodes" "paired=$episodes" runs=2
    part deterministic "episodes=$((episodes / 4))" "worlds=$((episodes / 4))" runs=2 modes=deterministic
    for worlds in $((episodes / 4)) $((episodes * 2)); do
        part "worlds-$worlds" "episodes=$((worlds * 2))" "worlds=$worlds" paired=16 runs=1
    done
    for task in stacking insertion; do
        part "$task" "task=$task" "episodes=$((episodes / 8))" "worlds=$((episodes / 8))" runs=1
    done
    part thirty-thousand episodes=30000 "worlds=$episodes" paired=16 runs=1
}

case "${1:-}" in
    prepare) shift; prepare "$@" ;;
    measure) shift; measure "$@" ;;
    *) sed -n '2,9s/^# \{0,1\}//p' "$0"; exit 2 ;;
esac
