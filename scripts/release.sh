#!/usr/bin/env bash
# Builds a release in target/release-files: for each architecture a wheel, a Debian package and an SBOM; a source distribution; the
# recipe of the container image; SHA-256 sums of all files; a signature of the sums if a key is given.
#
# Usage: scripts/release.sh [ARCHITECTURE...]       x86_64 or aarch64; default: the architecture of this machine
#
# ROBOGATE_SIGNING_KEY names an OpenSSH private key for the signature. docs/guides/installing.md shows how to verify a release, and
# scripts/check_release.sh tests one. Needs Rust with the target of each architecture (`rustup target add`), Python 3.11 with venv,
# and dpkg. Everything else is installed into the build folder.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh

[ $# -gt 0 ] || set -- "$(uname -m)"
for architecture in "$@"; do
    case $architecture in
        x86_64 | aarch64) ;;
        *)
            echo "error: architecture $architecture. Expected x86_64 or aarch64" >&2
            exit 2
            ;;
    esac
    if [ ! -d "$(rustc --print sysroot)/lib/rustlib/$architecture-unknown-linux-gnu/lib" ]; then
        echo "error: Rust has no standard library for $architecture. Hint: rustup target add $architecture-unknown-linux-gnu" >&2
        exit 5
    fi
done
if [ -n "${ROBOGATE_SIGNING_KEY:-}" ] && [ ! -r "$ROBOGATE_SIGNING_KEY" ]; then
    echo "error: ROBOGATE_SIGNING_KEY=$ROBOGATE_SIGNING_KEY: cannot be read. Expected an OpenSSH private key" >&2
    exit 2
fi

root=$PWD
target=${CARGO_TARGET_DIR:-target}
mkdir -p "$target"
target=$(cd "$target" && pwd)
out=$target/release-files
rm -rf "$out"
mkdir -p "$out"

# The oldest glibc on which the command runs. docs/guides/installing.md names the distributions.
glibc=2.28

# Tools, once for each version of the pins.
tools=$target/release-tools
cargo_deb=3.8.0
if ! { cat scripts/release/requirements.lock && echo "cargo-deb $cargo_deb"; } | cmp -s - "$tools/installed.txt"; then
    rm -rf "$tools"
    python3 -m venv "$tools"
    "$tools/bin/pip" install --quiet --disable-pip-version-check --require-hashes --requirement scripts/release/requirements.lock
    cargo install --quiet --locked --root "$tools" "cargo-deb@$cargo_deb"
    { cat scripts/release/requirements.lock && echo "cargo-deb $cargo_deb"; } > "$tools/installed.txt"
fi
PATH=$tools/bin:$PATH

# The same sources give the same command: no path of this machine, no incremental state.
cargo_home=${CARGO_HOME:-$HOME/.cargo}
export CARGO_INCREMENTAL=0
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}
export SOURCE_DATE_EPOCH

# Completions and man pages are the same for every architecture.
rm -rf python/pages
for what in bash zsh fish man; do
    cargo run --quiet --package robogate --locked -- --quiet completions "$what" --out "python/pages/$what"
done

for architecture in "$@"; do
    triple=$architecture-unknown-linux-gnu
    rm -rf python/licenses
    scripts/release/mujoco.py "$architecture"
    scripts/release/licences.py "$architecture"
    # A folder for each architecture: maturin links build scripts with zig if the target is this machine, so that builds for two
    # architectures in one folder would repeat each other's work.
    build=$target/release-build-$architecture
    rustflags=("--remap-path-prefix=$root=/robogate" "--remap-path-prefix=$build=/target" "--remap-path-prefix=$cargo_home=/cargo")
    encoded=$(printf '%s\x1f' "${rustflags[@]}")
    (
        cd python
        export CARGO_TARGET_DIR=$build CARGO_ENCODED_RUSTFLAGS=${encoded%$'\x1f'}
        export CFLAGS="-ffile-prefix-map=$build=/target -ffile-prefix-map=$cargo_home=/cargo"
        maturin build --release --zig --target "$triple" --compatibility "manylinux_${glibc/./_}" --out "$out"
    )
    wheel=$(echo "$out"/robogate_eval-*_"$architecture".whl)
    scripts/release/sbom.py "$wheel" "$out/robogate-$architecture.cdx.json"
    CARGO_TARGET_DIR=$build cargo deb --quiet --package robogate --no-build --no-strip --target "$triple" --output "$out/"
done

scripts/release/sdist.py "$out"
twine check --strict "$out"/*.whl "$out"/*.tar.gz

cp deploy/Containerfile "$out/"
hadolint "$out/Containerfile"

(cd "$out" && sha256sum -- * > ../SHA256SUMS && mv ../SHA256SUMS .)
if [ -n "${ROBOGATE_SIGNING_KEY:-}" ]; then
    ssh-keygen -q -Y sign -f "$ROBOGATE_SIGNING_KEY" -n robogate-release "$out/SHA256SUMS"
fi
echo "$out:"
cat "$out/SHA256SUMS"
