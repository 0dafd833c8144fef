#!/usr/bin/env bash
# Makes a Python environment in which robogate_bridge can be imported: bridges/common/setup.sh FOLDER [REQUIREMENTS...]
# Further requirements files are installed beside its own. A second call does nothing where nothing changed.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
if [ $# -lt 1 ]; then
    echo "usage: $0 FOLDER [REQUIREMENTS...]" >&2
    exit 2
fi
venv=$1
shift
requirements=("$here/requirements.txt" "$@")

# The marker is written last: an interrupted set-up is done again.
if ! cat "${requirements[@]}" | cmp -s - "$venv/installed.txt"; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check "${requirements[@]/#/--requirement=}"
    # The package as it lies here, so that a change in it needs no new installation.
    "$venv/bin/python" -c "import sysconfig; print(sysconfig.get_path('purelib'))" | while read -r site; do
        echo "$here" > "$site/robogate_bridge.pth"
    done
    cat "${requirements[@]}" > "$venv/installed.txt"
fi
