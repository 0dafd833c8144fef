#!/usr/bin/env bash
# Tests a build without MuJoCo: it must link no foreign library except the C library, and run a campaign.
set -euo pipefail
cd "$(dirname "$0")/.."

build=(--package robogate --no-default-features --locked)
cargo clippy "${build[@]}" --features rapier -- -D warnings
cargo build "${build[@]}" --features rapier,onnx
binary=${CARGO_TARGET_DIR:-target}/debug/robogate

if ldd "$binary" | grep -v -E 'linux-vdso|ld-linux|libc\.|libm\.|libgcc_s\.|libpthread\.|libdl\.|librt\.'; then
    echo "error: a build with Rapier only links the foreign libraries listed above" >&2
    exit 1
fi
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
"$binary" run -n 30 --seed 1 --out "$out/run"
# Unsupported requests are usage errors that name the missing feature.
code=0
"$binary" robots check franka 2> "$out/refused" || code=$?
grep -q 'robots are checked with MuJoCo' "$out/refused" && [ "$code" = 2 ]
code=0
"$binary" run --engine mujoco -n 30 --out "$out/refused-run" 2> "$out/refused" || code=$?
grep -q 'build with --features mujoco' "$out/refused" && [ "$code" = 2 ]
echo "a build with Rapier only runs a campaign and links no foreign library"
