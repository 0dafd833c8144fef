#!/usr/bin/env bash
# Builds the release of the present commit in clones with different paths, and compares the SHA-256 sums of all files. Takes the time of
# the releases, so .ci/run does not include it.
#
# Usage: scripts/check_reproducible.sh [--against FOLDER] [ARCHITECTURE...]       architectures as for scripts/release.sh
#
# Two builds are compared with each other. With --against, one build is compared with the files of an existing release of this commit,
# for example with those that were published.
#
# Exit codes: 0 the sums agree; 1 they differ, and the output lists the lines that do.
set -euo pipefail
cd "$(dirname "$0")/.."

target=${CARGO_TARGET_DIR:-target}
mkdir -p "$target"
work=$(mktemp -d "$(cd "$target" && pwd)/reproducible-XXXXXX")
trap 'rm -rf "$work"' EXIT

commit=$(git rev-parse HEAD)
copies=(one another/folder)
if [ "${1:-}" = --against ]; then
    cp -r "$2" "$work/files-one"
    copies=(another/folder)
    shift 2
fi
for copy in "${copies[@]}"; do
    mkdir -p "$work/$copy"
    git clone --quiet . "$work/$copy/source"
    git -C "$work/$copy/source" checkout --quiet "$commit"
    # The tools are pinned, and are not part of what is compared.
    mkdir "$work/$copy/target"
    if [ -d "$target/release-tools" ]; then
        ln -s "$(cd "$target/release-tools" && pwd)" "$work/$copy/target/release-tools"
    fi
    (cd "$work/$copy/source" && CARGO_TARGET_DIR=$work/$copy/target scripts/release.sh "$@") > "$work/log" 2>&1 || {
        tail -n 30 "$work/log" >&2
        exit 1
    }
    mv "$work/$copy/target/release-files" "$work/files-${copy%%/*}"
    rm -rf "${work:?}/$copy"
done

echo "commit $commit"
# The other release may have more architectures, which were not built here.
names=$(cut -d ' ' -f 3 "$work/files-another/SHA256SUMS")
if diff <(grep --fixed-strings "$names" "$work/files-one/SHA256SUMS") "$work/files-another/SHA256SUMS"; then
    cat "$work/files-another/SHA256SUMS"
    echo "two builds in different folders: the same bytes"
else
    mkdir -p "$target/reproducible"
    cp -r "$work/files-one" "$work/files-another" "$target/reproducible/"
    echo "two builds in different folders differ; their files are in $target/reproducible" >&2
    exit 1
fi
