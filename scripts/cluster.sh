#!/usr/bin/env bash
# The checks of docs/results/cluster.md, which take up to an hour: Ray (kills, two nodes, servers, speed), Slurm, Kubernetes, object
# store, one million episodes. Usage: scripts/cluster.sh [CHECK...], as root for network namespaces and Slurm. The output goes to stdout.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh

target=${CARGO_TARGET_DIR:-target}
checks=("$@")
if [ $# -eq 0 ]; then
    checks=(kills nodes servers speed workers slurm kubernetes object-store million)
fi
cargo build --locked -p robogate --features full,object-store
robogate=$(realpath "$target/debug/robogate")
export ROBOGATE_COMMAND=$robogate PYTHONPATH=$PWD/python/src
# The default of 30 s is too short on a loaded machine.
export RAY_raylet_start_wait_time_s=${RAY_raylet_start_wait_time_s:-200}
venv=$target/cluster-venv
if ! cmp -s scripts/cluster/requirements.lock "$venv/installed.txt"; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check --require-hashes --requirement scripts/cluster/requirements.lock
    cp scripts/cluster/requirements.lock "$venv/installed.txt"
fi
command -v slurmctld > /dev/null || PATH=$PATH:/usr/sbin
for check in "${checks[@]}"; do
    echo "$check ($(date --utc +%F\ %R) UTC, $(nproc) cores, load $(cut -d ' ' -f 1 /proc/loadavg))"
    case $check in
        slurm)
            command -v slurmctld > /dev/null || debian slurm-wlm munge
            step "$check" scripts/cluster/slurm.sh "$robogate"
            ;;
        kubernetes) step "$check" "$venv/bin/python" scripts/cluster/kubernetes.py ;;
        object-store) step "$check" "$venv/bin/python" scripts/cluster/object_store.py "$robogate" ;;
        million) step "$check" scripts/cluster/million.sh "$robogate" ;;
        *) step "$check" "$venv/bin/python" scripts/cluster/ray_checks.py "$check" ;;
    esac
done
finish
