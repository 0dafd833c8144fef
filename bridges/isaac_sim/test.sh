#!/usr/bin/env bash
# Sets up and runs the Isaac Sim server's tests, without Isaac Sim. Arguments go to unittest.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=${ROBOGATE_ISAAC_TEST_VENV:-$here/.venv}
"$here/../common/setup.sh" "$venv" "$here/tests/requirements.lock" >&2
export PYTHONPATH=$here:$here/../common${PYTHONPATH:+:$PYTHONPATH}
exec "$venv/bin/python" "$here/../../scripts/run_unittests.py" "$here/tests" "$@"
