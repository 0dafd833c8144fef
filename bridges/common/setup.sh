#!/usr/bin/env bash
# Creates a Python environment with robogate_bridge: bridges/common/setup.sh FOLDER [LOCKS...]
# Installs further requirements with hashes (scripts/lock_python.sh) in addition to its own. Does nothing if the environment is up to date.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
if [ $# -lt 1 ]; then
    echo "usage: $0 FOLDER [LOCKS...]" >&2
    exit 2
fi
venv=$1
shift
locks=("$here/requirements.lock" "$@")

# The marker is written last, so an interrupted setup is repeated.
if ! cat "${locks[@]}" | cmp -s - "$venv/installed.txt"; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check --require-hashes "${locks[@]/#/--requirement=}"
    # Refers to the package in this repository, so that its changes need no new installation.
    "$venv/bin/python" -c "import sysconfig; print(sysconfig.get_path('purelib'))" | while read -r site; do
        echo "$here" > "$site/robogate_bridge.pth"
    done
    cat "${locks[@]}" > "$venv/installed.txt"
fi
