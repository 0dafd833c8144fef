# shellcheck shell=bash
# Shared by scripts and .ci/run: source it from the root of the repository.

# rust-toolchain.toml pins a release. Where the default toolchain is that release under another name, use it: nothing has to be
# downloaded then.
pin=$(sed -n 's/^channel = "\(.*\)"$/\1/p' rust-toolchain.toml)
if [ -z "${RUSTUP_TOOLCHAIN:-}" ] && command -v rustup > /dev/null && ! rustup toolchain list | grep -q "^$pin-"; then
    default=$(rustup default | cut -d ' ' -f 1)
    case $(RUSTUP_TOOLCHAIN=$default rustc --version) in
        "rustc $pin "*) export RUSTUP_TOOLCHAIN=$default ;;
    esac
fi

failed=()
# Runs a step and goes on where it fails, so that one run reports all failures: step NAME COMMAND...
step() {
    local name=$1
    shift
    printf '\n== %s\n' "$name"
    local begun=$SECONDS
    if "$@"; then
        printf -- '-- %s: %d s\n' "$name" $((SECONDS - begun))
    else
        printf -- '-- %s: failed after %d s\n' "$name" $((SECONDS - begun))
        failed+=("$name")
    fi
}

# Ends the script: lists the steps that failed. Exit code 1 where there is one.
finish() {
    if [ "${#failed[@]}" -gt 0 ]; then
        printf '\nfailed: %s\n' "${failed[@]}"
        exit 1
    fi
}

# Whether a run may skip no test.
strict() {
    [ "${ROBOGATE_TESTS_STRICT:-}" = 1 ]
}

# Installs Debian packages, where that is possible. The caller checks whether the program came: debian PACKAGE...
debian() {
    if [ "$(id -u)" -eq 0 ] && command -v apt-get > /dev/null; then
        { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@"; } > /dev/null || true
    fi
}
