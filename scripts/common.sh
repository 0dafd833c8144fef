# shellcheck shell=bash
# Shared by scripts and .ci/run: source it from the root of the repository.

# rust-toolchain.toml pins a release. If the default toolchain is that release under another name, use it, so that nothing is
# downloaded.
pin=$(sed -n 's/^channel = "\(.*\)"$/\1/p' rust-toolchain.toml)
if [ -z "${RUSTUP_TOOLCHAIN:-}" ] && command -v rustup > /dev/null && ! rustup toolchain list | grep -q "^$pin-"; then
    default=$(rustup default | cut -d ' ' -f 1)
    case $(RUSTUP_TOOLCHAIN=$default rustc --version) in
        "rustc $pin "*) export RUSTUP_TOOLCHAIN=$default ;;
    esac
fi

# The features of the tests, and all features, for lints and documentation.
full=(--features robogate/full)
every=(--features robogate/full,robogate/object-store,robogate/print)

failed=()
# Runs a step and continues after a failure, so that one run reports all failures: step NAME COMMAND...
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

# Ends the script: lists the failed steps, with exit code 1 if there are any.
finish() {
    if [ "${#failed[@]}" -gt 0 ]; then
        printf '\nfailed: %s\n' "${failed[@]}"
        exit 1
    fi
}

# Whether skipped tests are failures.
strict() {
    [ "${ROBOGATE_TESTS_STRICT:-}" = 1 ]
}

# Installs Debian packages, if possible. The caller checks whether the program is available: debian PACKAGE...
debian() {
    if [ "$(id -u)" -eq 0 ] && command -v apt-get > /dev/null; then
        { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@"; } > /dev/null || true
    fi
}
