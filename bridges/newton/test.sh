#!/usr/bin/env bash
# Sets up and runs the Newton server's tests. Arguments go to unittest.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
export ROBOGATE_NEWTON_VENV=${ROBOGATE_NEWTON_VENV:-$here/.venv}
"$here/../common/setup.sh" "$ROBOGATE_NEWTON_VENV" "$here/requirements.lock" >&2
# The same cache as in start.sh, so that the server of a test finds the kernels that the tests compiled.
export WARP_CACHE_PATH=${WARP_CACHE_PATH:-$ROBOGATE_NEWTON_VENV/kernels}
export PYTHONPATH=$here:$here/../common${PYTHONPATH:+:$PYTHONPATH}
exec "$ROBOGATE_NEWTON_VENV/bin/python" "$here/../../scripts/run_unittests.py" "$here/tests" "$@"
