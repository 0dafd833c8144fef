#!/usr/bin/env bash
# Creates a Python environment with robogate_bridge: bridges/common/setup.sh FOLDER [REQUIREMENTS...]
# Installs further requirements files in addition to its own. Does nothing if the environment is up to date.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
if [ $# -lt 1 ]; then
    echo "usage: $0 FOLDER [REQUIREMENTS...]" >&2
    exit 2
fi
venv=$1
shift
requirements=("$here/requirements.txt" "$@")

# The marker is written last, so an interrupted setup is repeated.
if ! cat "${requirements[@]}" | cmp -s - "$venv/installed.txt"; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check "${requirements[@]/#/--requirement=}"
    # Refers to the package in this repository, so that its changes need no new installation.
    "$venv/bin/python" -c "import sysconfig; print(sysconfig.get_path('purelib'))" | while read -r site; do
        echo "$here" > "$site/robogate_bridge.pth"
    done
    cat "${requirements[@]}" > "$venv/installed.txt"
fi
