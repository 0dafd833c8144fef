#!/usr/bin/env bash
# Measures docs/results/tasks.md: the scripted controllers of the built-in tasks for an arm on their industrial suites, and the
# experts of the tasks in assets/tasks at nominal and over their ranges.
#
# Usage: scripts/tasks.sh [ROUNDS] [RAPIER_ROUNDS] > docs/results/tasks.md; by default 1 round of each suite in each
# engine. A run whose folder exists is resumed. TASKS, ROBOTS, ENGINES and FILES select a part.
set -euo pipefail
cd "$(dirname "$0")/.."

rounds=${1:-1}
rapier_rounds=${2:-1}
robogate=${ROBOGATE:-target/release/robogate}
out=${OUT:-runs/tasks}
threads=${THREADS:-$(nproc)}
mkdir -p "$out"

# Finishes a run, or starts it with these arguments.
run() {
    local dir=$1
    shift
    if [ -f "$dir/summary.json" ]; then
        :
    elif [ -f "$dir/plan.json" ]; then
        "$robogate" resume "$dir" >&2
    else
        "$robogate" run "$@" --seed 2026 --threads "$threads" --out "$dir" >&2
    fi
}

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
            run "$dir" --task "$task" --robot "$robot" --engine "$engine" --suite "$suite" --rounds "$count"
            runs+=("$task-$robot-$engine")
        done
    done
done

# Nominal values, with errors of the encoders as small as those of a calibrated arm: each round draws others.
cat >"$out/nominal.toml" <<'TOML'
schema = 1
name = "nominal"
version = "1.0.0"
description = "Nominal values with encoder errors of up to 2 mrad."

[[group]]
name = "nominal"
category = "nominal"
description = "Nominal values."
scenarios = [{ id = "nominal-1", encoder_bias_rad = 0.002 }]
TOML
for task in ${FILES-drawer button door lid palletising machine_tending kitting bin_picking pipe_clamp peg_board screw_start}; do
    for robot in franka ur5e; do
        for engine in mujoco rapier; do
            run "$out/file-$task-$robot-$engine" --task "assets/tasks/$task" --robot "$robot" --engine "$engine" \
                --suite "$out/nominal.toml" --rounds 40
            runs+=("file-$task-$robot-$engine")
        done
    done
    run "$out/boundary-$task-franka-mujoco" --task "assets/tasks/$task" --robot franka -n 200
    runs+=("boundary-$task-franka-mujoco")
done
python3 scripts/tasks.py "$robogate" "$out" "${runs[@]}"
