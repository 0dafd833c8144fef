#!/usr/bin/env bash
# Sets up and starts the Newton server: bridges/newton/start.sh [--solver mujoco|steel] [--robot FOLDER] [--port N].
# `--help` tells the rest. The first start takes a minute or two (packages, kernels), later ones some seconds.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=${ROBOGATE_NEWTON_VENV:-$here/.venv}
"$here/../common/setup.sh" "$venv" "$here/requirements.txt" >&2
# Compiled kernels, kept from one start to the next.
export WARP_CACHE_PATH=${WARP_CACHE_PATH:-$venv/kernels}
export PYTHONPATH=$here${PYTHONPATH:+:$PYTHONPATH}
exec "$venv/bin/python" -m robogate_newton "$@"
