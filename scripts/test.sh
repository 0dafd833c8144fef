#!/usr/bin/env bash
# Installs the dependencies of the tests and runs all tests: Rust (with cargo-nextest if it is installed), documentation examples,
# and the Python suites of python/ and bridges/. The run continues after failures, and lists failed and skipped tests at the end.
#
# Usage: scripts/test.sh [ARGUMENTS...]; arguments go to the Rust tests only, for example `-p robogate-stats` or a part of a name.
#
# ROBOGATE_TESTS_STRICT=1 makes a skipped test a failure; ROBOGATE_TESTS_OPTIONAL lists tools that may be missing even then.
# The Python environments are in the build folder. These variables select others: ROBOGATE_TEST_PYTHON, ROBOGATE_BRIDGE_PYTHON,
# ROBOGATE_POLICY_PYTHON, ROBOGATE_NEWTON_PYTHON, ROBOGATE_METAWORLD_PYTHON, ROBOGATE_FETCH_PYTHON.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh

target=${CARGO_TARGET_DIR:-target}
mkdir -p "$target"
target=$(cd "$target" && pwd)
work=$(mktemp --directory)
export ROBOGATE_SKIPPED_FILE=${ROBOGATE_SKIPPED_FILE:-$work/skipped}
touch "$ROBOGATE_SKIPPED_FILE"

# Processes beside this one, and the process group of the other suites.
beside=() others=
# Ctrl-C does not reach these processes, and the other suites would keep cargo's lock.
end() {
    if [ -n "$others" ]; then
        kill -- "-$others" 2> /dev/null || true
    fi
    kill "${beside[@]}" 2> /dev/null || true
    rm -rf "$work"
}
trap end EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

# Records one of the other suites that cannot run: skipped SUITE REASON.
skipped() {
    echo "skipped: $1: $2" | tee -a "$ROBOGATE_SKIPPED_FILE" >&2
    if strict; then
        echo "$1 (skipped: $2)" >> "$suites/failed"
    fi
}

# The monitor is tested with a real MQTT broker, pages in a real browser, videos by ffmpeg, printed pages by pdftotext, and the live
# view in tmux. npm brings the checker of accessibility. MuJoCo's renderer uses EGL, which Mesa provides without a GPU.
programs() {
    local missing=() program
    for program in mosquitto chromium npm ffmpeg pdftotext tmux; do
        PATH=$PATH:/usr/sbin command -v "$program" > /dev/null || missing+=("$program")
    done
    if ! ldconfig -p | grep -q 'libEGL\.so\.1' || ! ldconfig -p | grep -q 'libGL\.so\.1' || ! compgen -G '/usr/lib/*/dri/swrast_dri.so' > /dev/null; then
        missing+=(libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri)
    fi
    if [ "${#missing[@]}" -gt 0 ]; then
        debian "${missing[@]/pdftotext/poppler-utils}"
    fi
}

# Creates a Python environment in the build folder, once for its locks with hashes (scripts/lock_python.sh):
# environment NAME LOCKS...
environment() {
    local venv=$target/$1
    shift
    # The marker is written last, so an interrupted setup is repeated.
    if ! cat "$@" | cmp -s - "$venv/installed.txt"; then
        rm -rf "$venv"
        python3 -m venv "$venv" &&
            "$venv/bin/pip" install --quiet --disable-pip-version-check --require-hashes "${@/#/--requirement=}" &&
            cat "$@" > "$venv/installed.txt"
    fi
}

# The environments under construction: the process and the name for each variable.
declare -A creating

# Starts to create the environment of VARIABLE, unless the caller set it: python VARIABLE NAME LOCKS...
python() {
    local variable=$1
    shift
    if [ -z "${!variable:-}" ]; then
        environment "$@" &
        creating[$variable]="$! $1"
    fi
}

# Waits for these environments, and sets each variable to the Python of its own.
await_pythons() {
    local variable process name
    for variable in "${!creating[@]}"; do
        read -r process name <<< "${creating[$variable]}"
        if wait "$process"; then
            export "$variable=$target/$name/bin/python"
        else
            echo "note: the Python environment for $variable cannot be created" >&2
        fi
    done
}

# Runs cargo-nextest if it is installed, otherwise cargo test: rust ARGUMENTS...
rust() {
    case " $* " in
        *" -p robogate "*) set -- --features full "$@" ;;
        *" -p "* | *" --package "*) ;;
        *) set -- --workspace "${full[@]}" "$@" ;;
    esac
    if command -v cargo-nextest > /dev/null; then
        # Two more than the processors, because many tests wait for a browser or another process.
        cargo nextest run --no-fail-fast --locked --test-threads $(($(nproc) + 2)) "$@"
    else
        cargo test --no-fail-fast --locked --lib --bins --tests --examples "$@"
    fi
}

# Runs one of the suites beside the Rust tests, and keeps its output: suite NAME COMMAND...
suite() {
    failed=()
    step "$@" >> "$suites/output" 2>&1
    printf '%s\n' "${failed[@]}" >> "$suites/failed"
}

# Runs a suite of a bridge in an environment of its own, whose set-up the process PROCESS has begun:
# bridge NAME PROCESS LOCK VARIABLE
bridge() {
    local venv=$target/$1-venv
    tail --pid="$2" --follow /dev/null
    # Repeats the set-up if it has failed.
    if bridges/common/setup.sh "$venv" "$3"; then
        suite "bridges/$1" env "$4=$venv" "bridges/$1/test.sh"
    else
        skipped "bridges/$1" "no Python environment"
    fi
}

# All suites but the Rust tests, one after the other.
other_suites() {
    # The longest first. Newton compiles its kernels once and caches them in its environment.
    if [ -n "${ROBOGATE_NEWTON_PYTHON:-}" ]; then
        suite bridges/newton env ROBOGATE_NEWTON_VENV="${ROBOGATE_NEWTON_PYTHON%/bin/*}" bridges/newton/test.sh
    else
        skipped bridges/newton "no Python with Newton"
    fi
    bridge isaac_sim "$isaac" bridges/isaac_sim/tests/requirements.lock ROBOGATE_ISAAC_TEST_VENV
    suite "python" env PYTHONPATH="$PWD/python/src" python3 scripts/run_unittests.py python/tests
    if [ -n "${ROBOGATE_POLICY_PYTHON:-}" ]; then
        suite "policies behind a server" env PYTHONPATH="$PWD/python/src" "$ROBOGATE_POLICY_PYTHON" scripts/run_unittests.py python/tests/served
    else
        skipped "policies behind a server" "no Python with openpi-client"
    fi
    if [ -n "${ROBOGATE_BRIDGE_PYTHON:-}" ]; then
        suite "bridges/common" env PYTHONPATH=bridges/common "$ROBOGATE_BRIDGE_PYTHON" scripts/run_unittests.py bridges/common/tests
    else
        skipped bridges/common "no Python with pyzmq and msgpack"
    fi
    local tests variable crate
    for tests in METAWORLD:test_adapter METAWORLD:test_foreign METAWORLD:test_in_flight METAWORLD:test_learned_contract METAWORLD:test_metaworld METAWORLD:test_motion METAWORLD:test_probe METAWORLD:test_libero_files METAWORLD:test_scripted FETCH:test_fetch DM_CONTROL:test_dm_control; do
        variable=ROBOGATE_${tests%%:*}_PYTHON
        if [ -n "${!variable:-}" ]; then
            suite "environments ${tests#*:}" env PYTHONPATH="$PWD/python/src:$PWD/bridges/common" "${!variable}" scripts/run_unittests.py \
                python/tests/environments --pattern "${tests#*:}.py"
        else
            skipped "environments ${tests#*:}" "no Python for ${tests%%:*}"
        fi
    done
    # All crates, as for the Rust tests: with fewer of them, their dependencies would have other features and be compiled again.
    suite "documentation examples" cargo test --doc --no-fail-fast --workspace "${full[@]}" --locked
}

# Waits for the other suites, and shows their output.
await_other_suites() {
    local name
    # Fails if the process was killed.
    wait "$others" || failed+=("other suites")
    others= beside=()
    cat "$suites/output"
    while read -r name; do
        [ -z "$name" ] || failed+=("$name")
    done < "$suites/failed"
}

# The environments of the bridges are needed last, so they are created beside all that follows.
if [ $# -eq 0 ]; then
    # Fakes replace the classes of Isaac Sim.
    bridges/common/setup.sh "$target/isaac_sim-venv" bridges/isaac_sim/tests/requirements.lock &
    isaac=$!
    beside=("$isaac")
fi

programs
python ROBOGATE_TEST_PYTHON readers-venv crates/robogate-dictionary/tests/requirements.lock crates/robogate-gate/tests/evidence-requirements.lock crates/robogate-replay/tests/requirements.lock
python ROBOGATE_POLICY_PYTHON policies-venv crates/robogate-policy/tests/requirements.lock
python ROBOGATE_BRIDGE_PYTHON bridges-venv bridges/common/requirements.lock
python ROBOGATE_NEWTON_PYTHON newton-venv bridges/common/requirements.lock bridges/newton/requirements.lock

for family in metaworld fetch dm_control; do
    python "ROBOGATE_${family^^}_PYTHON" "$family-venv" "scripts/locks/$family.lock"
done
if [ -z "${ROBOGATE_TEST_AXE:-}" ] && ./scripts/web.sh --install; then
    ROBOGATE_TEST_AXE=$PWD/web/node_modules/axe-core/axe.min.js
    export ROBOGATE_TEST_AXE
fi
await_pythons

# Many of the Rust tests wait for a browser or another process, so the other suites run beside them.
if [ $# -eq 0 ]; then
    suites=$work/suites
    mkdir "$suites"
    touch "$suites/output" "$suites/failed"
    # With job control, they have a process group of their own.
    set -m
    other_suites < /dev/null &
    others=$!
    set +m
fi
step "Rust tests" rust "$@"
if [ $# -eq 0 ]; then
    await_other_suites
fi

if [ -s "$ROBOGATE_SKIPPED_FILE" ]; then
    printf '\n%d skipped:\n' "$(wc -l < "$ROBOGATE_SKIPPED_FILE")"
    cat "$ROBOGATE_SKIPPED_FILE"
fi
finish
