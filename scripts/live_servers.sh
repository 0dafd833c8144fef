#!/usr/bin/env bash
# Runs RoboGate against the server code of other projects, with stub models behind it, and checks what both ends receive.
#
# Usage: scripts/live_servers.sh [--openpi DIR] [--gr00t DIR] [--gr00t-n1.6 DIR] [--gr00t-n1.5 DIR] [--lerobot DIR] [--openvla DIR]
#            [--openvla-oft DIR] [--vla-eval DIR] [--starvla DIR] [--xpolicylab DIR] [--only PART_OF_A_NAME]
#
# Each DIR is a checkout; a server without one is not run. Nothing is downloaded. PYTHON is a Python with the packages of
# scripts/live_servers/requirements.txt, LEROBOT_PYTHON one that also has PyTorch, ROBOGATE the binary, OUT an empty folder for logs
# and records. The table for docs/results/live-servers.md is OUT/results.md.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python3}
out=${OUT:-$(mktemp -d)}
echo "logs and records: $out"
PYTHONPATH=$PWD/python/src PYTHONDONTWRITEBYTECODE=1 "$python" scripts/live_servers/run.py --robogate "${ROBOGATE:-target/release/robogate}" \
    --python "$python" --lerobot-python "${LEROBOT_PYTHON:-$python}" --out "$out" "$@"
