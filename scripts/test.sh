#!/usr/bin/env bash
# Sets up and runs all tests: cargo test, with a Python beside it in which the dictionary is read by
# pyarrow, pandas and DuckDB, and evidence by securesystemslib, another with libzmq for the bridge, and one with Newton and one with USD. Where such a Python cannot be set
# up, its tests are skipped and say so.
# Arguments go to cargo test.
set -euo pipefail
cd "$(dirname "$0")/.."

# The monitor is tested against a real MQTT broker and in a real browser.
for tool in mosquitto chromium; do
    PATH=$PATH:/usr/sbin command -v "$tool" > /dev/null && continue
    if [ "$(id -u)" -eq 0 ] && command -v apt-get > /dev/null; then
        { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$tool"; } > /dev/null || true
    fi
    PATH=$PATH:/usr/sbin command -v "$tool" > /dev/null || echo "note: no $tool; the tests that need it are skipped" >&2
done

# MuJoCo's own renderer draws by EGL; Mesa has it without a GPU.
mesa=(libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri)
if ! ldconfig -p | grep -q 'libEGL\.so\.1' || ! ldconfig -p | grep -q 'libGL\.so\.1' || ! compgen -G '/usr/lib/*/dri/swrast_dri.so' > /dev/null; then
    if [ "$(id -u)" -eq 0 ] && command -v apt-get > /dev/null; then
        { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${mesa[@]}"; } > /dev/null || true
    fi
    ldconfig -p | grep -q 'libEGL\.so\.1' || echo "note: no EGL; the tests of MuJoCo's own renderer are skipped" >&2
fi

requirements=(crates/robogate-dictionary/tests/requirements.txt crates/robogate-gate/tests/evidence-requirements.txt)
venv=${CARGO_TARGET_DIR:-target}/readers-venv
if [ -z "${ROBOGATE_TEST_PYTHON:-}" ]; then
    # The marker is written last: an interrupted set-up is done again.
    if ! cat "${requirements[@]}" | cmp -s - "$venv/installed.txt"; then
        rm -rf "$venv"
        if python3 -m venv "$venv" &&
            "$venv/bin/pip" install --quiet --disable-pip-version-check "${requirements[@]/#/--requirement=}"; then
            cat "${requirements[@]}" > "$venv/installed.txt"
        else
            echo "note: no Python with pyarrow, pandas, duckdb and securesystemslib; the tests that need them are skipped" >&2
        fi
    fi
    if [ -f "$venv/installed.txt" ]; then
        ROBOGATE_TEST_PYTHON=$(cd "$venv/bin" && pwd)/python
        export ROBOGATE_TEST_PYTHON
    fi
fi
if [ -z "${ROBOGATE_BRIDGE_PYTHON:-}" ]; then
    bridges=${CARGO_TARGET_DIR:-target}/bridges-venv
    if bridges/common/setup.sh "$bridges"; then
        ROBOGATE_BRIDGE_PYTHON=$(cd "$bridges/bin" && pwd)/python
        export ROBOGATE_BRIDGE_PYTHON
    else
        echo "note: no Python with pyzmq and msgpack; the bridge's tests that need it are skipped" >&2
    fi
fi
if [ -n "${ROBOGATE_BRIDGE_PYTHON:-}" ]; then
    PYTHONPATH=bridges/common "$ROBOGATE_BRIDGE_PYTHON" -m unittest discover -s bridges/common/tests
fi
# The cell in Newton: a Python of its own, and kernels that are compiled once. Nothing of Rust waits for it.
newton=${CARGO_TARGET_DIR:-target}/newton-venv
if bridges/common/setup.sh "$newton" bridges/newton/requirements.txt; then
    ROBOGATE_NEWTON_VENV=$(cd "$newton" && pwd) bridges/newton/test.sh
else
    echo "note: no Python with Newton; the tests of bridges/newton are skipped" >&2
fi
# The cell in Isaac Sim, as far as it can be tested without.
isaac=${CARGO_TARGET_DIR:-target}/isaac-venv
if bridges/common/setup.sh "$isaac" bridges/isaac_sim/tests/requirements.txt; then
    ROBOGATE_ISAAC_TEST_VENV=$isaac bridges/isaac_sim/test.sh
else
    echo "note: no Python with USD; the tests of bridges/isaac_sim are skipped" >&2
fi
if [ -z "${ROBOGATE_POLICY_PYTHON:-}" ]; then
    wanted=crates/robogate-policy/tests/requirements.txt
    policies=${CARGO_TARGET_DIR:-target}/policies-venv
    if ! cmp -s "$wanted" "$policies/installed.txt"; then
        rm -rf "$policies"
        if python3 -m venv "$policies" &&
            "$policies/bin/pip" install --quiet --disable-pip-version-check --requirement "$wanted"; then
            cp "$wanted" "$policies/installed.txt"
        else
            echo "note: no Python with openpi-client and vla-eval; the policies' tests that need it are skipped" >&2
        fi
    fi
    if [ -f "$policies/installed.txt" ]; then
        ROBOGATE_POLICY_PYTHON=$(cd "$policies/bin" && pwd)/python
        export ROBOGATE_POLICY_PYTHON
    fi
fi
cargo test --workspace --locked "$@"
# MuJoCo's own renderer is a feature of its own: what it adds, with the same dependencies as above.
exec cargo test --workspace --locked --features robogate/egl --test egl
