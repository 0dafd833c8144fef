#!/usr/bin/env bash
# Measures docs/results/tasks.md: the scripted controllers of the built-in tasks for an arm, on their industrial suites.
#
# Usage: scripts/tasks.sh [ROUNDS] [RAPIER_ROUNDS] > docs/results/tasks.md; by default 1 round of each suite in each
# engine. A run whose folder exists is resumed. TASKS, ROBOTS and ENGINES select a part.
set -euo pipefail
cd "$(dirname "$0")/.."

rounds=${1:-1}
rapier_rounds=${2:-1}
robogate=${ROBOGATE:-target/release/robogate}
out=${OUT:-runs/tasks}
threads=${THREADS:-$(nproc)}
mkdir -p "$out"

runs=()
for task in ${TASKS:-pick_place stacking insertion}; do
    case $task in
        pick_place) suite=industrial-68 ;;
        *) suite=$task-40 ;;
    esac
    for engine in ${ENGINES:-mujoco rapier}; do
        for robot in ${ROBOTS:-franka ur5e ur10e}; do
            # The parts of industrial-68 need fingers: sizes below the diameter of a cup, and friction of the pads.
            if [ "$task" = pick_place ] && [ "$robot" != franka ]; then
                continue
            fi
            dir=$out/$task-$robot-$engine
            count=$rounds
            [ "$engine" = rapier ] && count=$rapier_rounds
            if [ -f "$dir/summary.json" ]; then
                :
            elif [ -f "$dir/plan.json" ]; then
                "$robogate" resume "$dir" >&2
            else
                "$robogate" run --task "$task" --robot "$robot" --engine "$engine" --suite "$suite" --rounds "$count" \
                    --seed 2026 --threads "$threads" --out "$dir" >&2
            fi
            runs+=("$task-$robot-$engine")
        done
    done
done
python3 scripts/tasks.py "$robogate" "$out" "${runs[@]}"
