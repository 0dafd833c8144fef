#!/usr/bin/env bash
# Injects faults into the calls of every writing verb, and checks what is left (scripts/faults/faults.py). Not part of the tests: it
# takes half an hour. ROBOGATE=COMMAND tests another build.
#
# Usage: scripts/faults.sh [--per-cell N] [--seed S] [--commands "a;b"] [--minutes M] [--out docs/results/faults.md]
set -euo pipefail
cd "$(dirname "$0")/.."

target=${CARGO_TARGET_DIR:-target}
if [ -z "${ROBOGATE:-}" ]; then
    cargo build --release --package robogate --locked
    ROBOGATE=$target/release/robogate
fi
mkdir -p "$target/faults"
cc -O1 -shared -fPIC -Wall -Wno-format-truncation -o "$target/faults/shim.so" scripts/faults/shim.c -ldl
exec python3 scripts/faults/faults.py "$ROBOGATE" "$target/faults/shim.so" "$@"
