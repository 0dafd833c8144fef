#!/usr/bin/env bash
# Compares outcome, time and trajectory hash of 1,096 episodes with recorded ones: 300 default episodes, three suites, four robots, two
# engines. The tests compare a part of them (crates/robogate/tests/it/numerics.rs); this takes a few minutes.
#
# Usage: scripts/numerics.sh [--write]; --write records the episodes after an intended change, which CHANGELOG.md lists under Numerics.
# ROBOGATE names another command than target/debug/robogate with the feature `full`.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh

recorded=scripts/numerics
work=$(mktemp --directory)
trap 'rm -rf "$work"' EXIT
if [ -z "${ROBOGATE:-}" ]; then
    cargo build --quiet --package robogate --features full --locked
    ROBOGATE=${CARGO_TARGET_DIR:-target}/debug/robogate
fi
mkdir -p "$recorded"

# Runs a campaign, and writes or compares its rows: episodes NAME ARGUMENTS...
episodes() {
    local name=$1
    shift
    "$ROBOGATE" --quiet run --out "$work/$name" "$@" > /dev/null
    "$ROBOGATE" --quiet export "$work/$name" "$work/$name.all.csv" > /dev/null
    python3 - "$work/$name.all.csv" > "$work/$name.csv" <<'PYTHON'
import csv
import sys

columns = ["index", "outcome", "cycle_time_s", "ticks", "trajectory_hash"]
print(",".join(columns))
for row in csv.DictReader(open(sys.argv[1], newline="")):
    print(",".join(row[column] for column in columns))
PYTHON
    rm -rf "${work:?}/$name" "$work/$name.all.csv"
    if [ "${write:-}" = 1 ]; then
        cp "$work/$name.csv" "$recorded/$name.csv"
    else
        cmp "$work/$name.csv" "$recorded/$name.csv"
    fi
}

if [ "${1:-}" = --write ]; then
    write=1
fi
step "the Franka in the cell of the paper" episodes franka -n 300 --design two-stage --space franka --set tolerance_m=0.03 --set contact_force_limit_n=1000000
for suite in industrial-68 stacking-40 insertion-40; do
    case $suite in
        stacking-40) task=stacking ;;
        insertion-40) task=insertion ;;
        *) task=pick_place ;;
    esac
    step "$suite" episodes "$suite" --suite "$suite" --task "$task"
    step "$suite, Rapier" episodes "$suite-rapier" --suite "$suite" --task "$task" --engine rapier
done
for robot in ur3e ur5e ur10e; do
    step "$robot" episodes "$robot" -n 100 --design two-stage --robot "$robot" --space ur --set tolerance_m=0.03 --set contact_force_limit_n=1000000
done
for task in stacking insertion; do
    step "$task" episodes "$task" -n 60 --design two-stage --task "$task" --set contact_force_limit_n=1000000
    step "$task on the UR5e" episodes "$task-ur5e" -n 40 --design two-stage --task "$task" --robot ur5e --set contact_force_limit_n=1000000
done
finish
