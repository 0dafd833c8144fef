#!/usr/bin/env bash
# Tests the files of scripts/release.sh: installs the wheel and the Debian package of this architecture into fresh places without Rust,
# and compares the bytes of a campaign with those of the build by cargo. Takes minutes, so .ci/run does not include it.
#
# Usage: scripts/check_release.sh [REFERENCE]       a robogate that cargo built; default: builds it with `cargo build --release`
#
# ROBOGATE_CHECK_ROOTFS names folders, separated by spaces, with root file systems of other distributions (for example made with
# debootstrap, with python3-venv). Needs root: the wheel and the package are installed there and must agree. With another glibc than
# that of this machine they may differ from the build by cargo, because its mathematical functions round differently.
# With qemu-aarch64-static and the C library for it, the command for aarch64 runs, too: ROBOGATE_AARCH64_ROOT names the folder of the
# library (default: /usr/aarch64-linux-gnu).
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh

root=$PWD
target=${CARGO_TARGET_DIR:-target}
target=$(cd "$target" && pwd)
files=$target/release-files
architecture=$(uname -m)
declare -A debian_name=([x86_64]=amd64 [aarch64]=arm64)
library=$(sed -n 's/^pub const LIBRARY: &str = "\(.*\)";$/\1/p' crates/mujoco-loader/src/lib.rs)
glibc=$(sed -n 's/^glibc=//p' scripts/release.sh)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# The campaign that all installations run: uniform and active stage, all failure modes.
campaign=(run -n 100 --seed 1)

reference=${1:-}
if [ -z "$reference" ]; then
    cargo build --release --locked
    reference=$target/release/robogate
fi

sums() {
    (cd "$files" && sha256sum --check --quiet SHA256SUMS) || return 1
    echo "SHA256SUMS: $(wc -l < "$files/SHA256SUMS") files are correct"
    if [ -f "$files/SHA256SUMS.sig" ]; then
        ssh-keygen -Y check-novalidate -n robogate-release -s "$files/SHA256SUMS.sig" < "$files/SHA256SUMS"
    fi
}

# Prints what an ELF file needs, and fails if that is newer than the floor, or if it has a run path: elf FILE
elf() {
    local newest needed
    newest=$(readelf --version-info --wide "$1" | grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -n 1)
    needed=$(readelf --dynamic --wide "$1" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p' | tr '\n' ' ')
    echo "$(basename "$1"): needs $newest at most; libraries: $needed"
    if [ "$(printf '%s\n' "${newest#GLIBC_}" "$glibc" | sort -V | tail -n 1)" != "$glibc" ]; then
        echo "error: $1 needs $newest. Expected $glibc or older" >&2
        return 1
    fi
    if readelf --dynamic --wide "$1" | grep -E 'RPATH|RUNPATH' | grep -v ORIGIN; then
        echo "error: $1 has the run path above" >&2
        return 1
    fi
}

# Fails if a file names a folder of this machine: anonymous FILE
anonymous() {
    local path found
    strings --all "$1" > "$work/strings.txt"
    for path in "$root" "$target" "${CARGO_HOME:-$HOME/.cargo}" "$(rustc --print sysroot)" "$HOME/"; do
        # A home of / would match every path.
        if [ "${#path}" -gt 2 ] && found=$(grep --fixed-strings --max-count=1 -- "$path" "$work/strings.txt"); then
            echo "error: $1 contains the path $path of this machine: $found" >&2
            return 1
        fi
    done
    echo "$(basename "$1"): no path of this machine"
}

# Shows the output of a command only if it fails: quiet COMMAND...
quiet() {
    "$@" > "$work/log.txt" 2>&1 || { cat "$work/log.txt" >&2 && return 1; }
}

# Checks the contents of a wheel and leaves them in $work/wheel-ARCHITECTURE: wheel FILE ARCHITECTURE
wheel() {
    local bytes pinned folder=$work/wheel-$2 name
    bytes=$(stat --format=%s "$1")
    echo "$(basename "$1"): $bytes bytes"
    [ "$bytes" -le 30000000 ] || { echo "error: more than 30 MB" >&2 && return 1; }
    python3 -m zipfile --extract "$1" "$folder" || return 1
    elf "$folder"/*.data/scripts/robogate && anonymous "$folder"/*.data/scripts/robogate || return 1
    elf "$folder"/*.data/data/lib/robogate/"$library" || return 1
    pinned=$(sed -n "s/.*(\"$2\", \"\([0-9a-f]*\)\").*/\1/p" crates/mujoco-loader/src/find.rs)
    echo "$pinned  $(echo "$folder"/*.data/data/lib/robogate/"$library")" | sha256sum --check --quiet || return 1
    for name in LICENSE mujoco-LICENSE mujoco-LICENSES_THIRD_PARTY.md rust-crates-LICENSES.txt rust-library-COPYRIGHT.html zig-LICENSE zig-libunwind-LICENSE.TXT; do
        [ -n "$(find "$folder"/*.dist-info/licenses -name "$name" -size +0)" ] || { echo "error: no licence file $name" >&2 && return 1; }
    done
}

# Compares a campaign with that of the reference: same NAME FOLDER
same() {
    local file
    for file in dictionary.parquet active.json; do
        cmp "$work/reference/$file" "$2/$file" || return 1
    done
    echo "$1: same bytes as the build by cargo: $(sha256sum < "$work/reference/dictionary.parquet" | cut -c 1-16)... dictionary.parquet"
}

# Runs without Rust, without the cache of this machine and without a network download: lonely COMMAND...
lonely() {
    env --ignore-environment HOME="$(mktemp --directory --tmpdir="$work")" PATH="$path" ROBOGATE_CACHE_DIR=/dev/null/none "$@"
}

pip() {
    local venv=$work/venv path=$work/venv/bin:/usr/bin:/bin
    python3 -m venv "$venv" && "$venv/bin/pip" install --quiet --no-index --disable-pip-version-check "$1" || return 1
    if lonely sh -c 'command -v cargo'; then
        echo "error: cargo is in PATH" >&2
        return 1
    fi
    lonely robogate --version || return 1
    quiet lonely robogate "${campaign[@]}" --out "$work/pip" || return 1
    same "pip" "$work/pip" || return 1
    lonely python -m robogate_eval --version || return 1
    lonely python -c 'import robogate_eval as r; print("robogate_eval", r.__version__, r.run_command("--version").returncode)' || return 1
    # An altered library is rejected before it is loaded.
    local code=0
    printf '\0' >> "$venv/lib/robogate/$library"
    lonely robogate "${campaign[@]}" --out "$work/altered" > "$work/altered.txt" 2>&1 || code=$?
    grep -m 1 'SHA-256' "$work/altered.txt" && [ "$code" -ne 0 ] || { cat "$work/altered.txt" && return 1; }
    "$venv/bin/pip" uninstall --quiet --yes robogate-eval && [ ! -e "$venv/lib/robogate/$library" ]
}

deb() {
    local path=/usr/bin:/bin
    dpkg-deb --info "$1" | sed -n 's/^ \(Package\|Version\|Architecture\|Depends\|Installed-Size\):/\1:/p'
    dpkg-deb --extract "$1" "$work/deb" || return 1
    cmp "$work/deb/usr/bin/robogate" "$work/wheel-$architecture"/*.data/scripts/robogate || return 1
    [ -s "$work/deb/usr/share/doc/robogate/copyright" ] || return 1
    quiet lonely "$work/deb/usr/bin/robogate" "${campaign[@]}" --out "$work/debian" || return 1
    same "Debian package" "$work/debian"
}

# Installs the wheel and the package into another root file system: other ROOTFS WHEEL DEB
other() {
    local there=/tmp/robogate-check code=0
    rm -rf "$1$there"
    mkdir -p "$1$there"
    cp "$2" "$3" "$1$there/"
    env --ignore-environment HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin chroot "$1" sh -ec "
        . /etc/os-release
        echo \"\$PRETTY_NAME, \$(ldd --version | head -n 1)\"
        mountpoint -q /proc 2>/dev/null || mount -t proc proc /proc
        trap 'umount /proc' EXIT
        cd $there
        if python3 -m venv venv 2> /dev/null; then
            python3 --version
            venv/bin/pip install --quiet --no-index --disable-pip-version-check $(basename "$2")
            ROBOGATE_CACHE_DIR=/dev/null/none venv/bin/robogate ${campaign[*]} --out pip > /dev/null 2>&1
        fi
        dpkg --install $(basename "$3") > /dev/null
        ROBOGATE_CACHE_DIR=/dev/null/none robogate ${campaign[*]} --out deb > /dev/null 2>&1
        dpkg --purge robogate > /dev/null
    " || code=1
    if [ "$code" -eq 0 ] && [ -d "$1$there/pip" ]; then
        cmp "$1$there/pip/dictionary.parquet" "$1$there/deb/dictionary.parquet" && echo "wheel and Debian package: same bytes" || code=1
    fi
    if [ "$code" -eq 0 ] && cmp --quiet "$work/reference/dictionary.parquet" "$1$there/deb/dictionary.parquet"; then
        echo "same bytes as on this machine"
    elif [ "$code" -eq 0 ]; then
        echo "other bytes than on this machine ($(ldd --version | head -n 1))"
    fi
    rm -rf "$1$there"
    return "$code"
}

# Runs the command for aarch64 in an emulator: emulated COMMAND
emulated() {
    qemu-aarch64-static -L "${ROBOGATE_AARCH64_ROOT:-/usr/aarch64-linux-gnu}" "$1" --version || return 1
    quiet env ROBOGATE_CACHE_DIR=/dev/null/none qemu-aarch64-static -L "${ROBOGATE_AARCH64_ROOT:-/usr/aarch64-linux-gnu}" "$1" run -n 8 --seed 1 --out "$work/emulated" || return 1
    echo "8 episodes ran in the emulator"
}

quiet "$reference" "${campaign[@]}" --out "$work/reference"
step "sums" sums
for file in "$files"/robogate_eval-*.whl; do
    case $file in
        *x86_64.whl) this=x86_64 ;;
        *) this=aarch64 ;;
    esac
    step "contents of the wheel for $this" wheel "$file" "$this"
done
own_wheel=$(echo "$files"/robogate_eval-*_"$architecture".whl)
own_deb=$(echo "$files"/robogate_*_"${debian_name[$architecture]}".deb)
step "wheel in a new environment" pip "$own_wheel"
step "Debian package" deb "$own_deb"
for rootfs in ${ROBOGATE_CHECK_ROOTFS:-}; do
    step "installation in $(basename "$rootfs")" other "$rootfs" "$own_wheel" "$own_deb"
done
if [ -d "$work/wheel-aarch64" ] && [ "$architecture" = x86_64 ] && command -v qemu-aarch64-static > /dev/null; then
    mkdir -p "$work/aarch64/bin"
    cp "$work"/wheel-aarch64/*.data/scripts/robogate "$work/aarch64/bin/"
    cp -r "$work"/wheel-aarch64/*.data/data/lib "$work/aarch64/"
    chmod +x "$work/aarch64/bin/robogate"
    step "aarch64 in an emulator" emulated "$work/aarch64/bin/robogate"
fi
finish
