#!/usr/bin/env bash
# Loads the monitor with 10,000 cycles/s in batches and 1,000 cycles/s one by one, attacks it, and kills it with signal 9 every
# minute for half an hour: the measurements of docs/results/monitor.md. Every acknowledged cycle must be stored once, and every
# alarm must reach a receiver that refuses 20 % of the requests.
#
#   scripts/monitor_load.sh                                     all of it, with a release build
#   ROBOGATE_COMMAND=PATH scripts/monitor_load.sh --seconds 5 --minutes 2 --kill-every 10
set -euo pipefail
cd "$(dirname "$0")/.."
if [ -z "${ROBOGATE_COMMAND:-}" ]; then
    cargo build --release --locked
    ROBOGATE_COMMAND=${CARGO_TARGET_DIR:-target}/release/robogate
fi
exec python3 scripts/monitor_load.py "$ROBOGATE_COMMAND" "$@"
