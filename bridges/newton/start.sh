#!/usr/bin/env bash
# Sets up and starts the Newton server: bridges/newton/start.sh [--solver mujoco|steel] [--robot FOLDER] [--port N].
# `--help` lists all options. The first start takes one to two minutes (packages, kernels), later ones a few seconds.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=${ROBOGATE_NEWTON_VENV:-$here/.venv}
"$here/../common/setup.sh" "$venv" "$here/requirements.lock" >&2
# The cache of compiled kernels, which is kept between starts.
export WARP_CACHE_PATH=${WARP_CACHE_PATH:-$venv/kernels}
export PYTHONPATH=$here:$here/../common${PYTHONPATH:+:$PYTHONPATH}
exec "$venv/bin/python" -m robogate_newton "$@"
