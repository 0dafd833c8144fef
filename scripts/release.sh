#!/usr/bin/env bash
# Builds a release in target/release-ARCHITECTURE: the wheel, the Debian package, the SBOM, SHA-256 sums, and a signature of the sums
# where a key is given.
#
# Usage: scripts/release.sh [x86_64|aarch64]        default: the architecture of this machine
#
# ROBOGATE_SIGNING_KEY names an OpenSSH private key for the signature. Check a release with
#   sha256sum -c SHA256SUMS
#   ssh-keygen -Y verify -f allowed_signers -I NAME -n robogate-release -s SHA256SUMS.sig < SHA256SUMS
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh

architecture=${1:-$(uname -m)}
target=${CARGO_TARGET_DIR:-target}
mkdir -p "$target"
target=$(cd "$target" && pwd)
out=$target/release-$architecture
triple=$architecture-unknown-linux-gnu
# The oldest glibc on which the wheel runs: Debian 10, Ubuntu 20.04, RHEL 8.
glibc=2.28

rm -rf "$out"
mkdir -p "$out"
venv=$target/release-venv
if ! cmp -s scripts/release/requirements.txt "$venv/installed.txt"; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check --requirement scripts/release/requirements.txt
    cp scripts/release/requirements.txt "$venv/installed.txt"
fi
PATH=$venv/bin:$PATH

python3 scripts/release/mujoco.py "$architecture"

# The command contains no path of this machine.
cargo_home=${CARGO_HOME:-$HOME/.cargo}
export RUSTFLAGS="--remap-path-prefix=$PWD=robogate --remap-path-prefix=$cargo_home=cargo --remap-path-prefix=$(rustc --print sysroot)=rust"
export CARGO_TARGET_DIR=$target/release-build
maturin build --release --zig --target "$triple" --compatibility "manylinux_${glibc/./_}" --out "$out" --manifest-path crates/robogate/Cargo.toml
