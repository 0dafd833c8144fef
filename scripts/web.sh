#!/usr/bin/env bash
# Builds the scripts of the pages from web/. The built files are committed, so cargo needs no Node.
#
# Usage: scripts/web.sh [--check | --install]
#   --check    fail if a committed file differs from a new build; without Node, say so and succeed
#   --install  only install the pinned packages
set -euo pipefail
cd "$(dirname "$0")/../web"

if ! command -v npm > /dev/null; then
    echo "Node and npm are not installed: the scripts of the pages are not built"
    [ "${1:-}" = --check ] && exit 0
    exit 1
fi
# The lock file holds the hashes of the packages. A marker saves a second installation.
if ! cmp -s package-lock.json node_modules/installed.json; then
    npm ci --ignore-scripts --no-audit --no-fund --loglevel=error
    cp package-lock.json node_modules/installed.json
fi
if [ "${1:-}" = --install ]; then
    exit 0
fi
node build.mjs "$@"
