#!/usr/bin/env bash
# Measures docs/results/environments-libero.md: LIBERO's suites and robosuite's Lift with our scripted controllers.
#
# Usage: scripts/environments_libero.sh [STATES] [EPISODES]; 10 of the 50 initial states for each task, and 60 episodes for each
# map of robustness by default. Needs LIBERO on PYTHONPATH, `robogate env setup libero` and `robogate env setup robosuite`. It takes hours:
# an episode takes 4 s on a free core. A run that was interrupted is resumed, a finished one is not run again.
set -euo pipefail
cd "$(dirname "$0")/.."

states=${1:-10}
episodes=${2:-60}
robogate=${ROBOGATE:-target/release/robogate}
out=${OUT:-runs/environments-libero}
threads=${THREADS:-$(nproc)}
suites=(${SUITES:-spatial object goal})
maps=(${MAPS:-libero:spatial/2 libero:object/0 libero:goal/8 robosuite:Lift})
libero=(${LIBERO_PYTHON:+--python "$LIBERO_PYTHON"})
robosuite=(${ROBOSUITE_PYTHON:+--python "$ROBOSUITE_PYTHON"})
mkdir -p "$out"

# Runs or resumes: conduct FOLDER COMMAND...
conduct() {
    local folder=$1
    shift
    if [ -f "$folder/summary.json" ]; then
        return
    elif [ -f "$folder/plan.json" ]; then
        "$robogate" resume "$folder"
    else
        "$robogate" "$@" --threads "$threads" --out "$folder"
    fi
}

# One requirement, because a part of the initial states is too few for the default ones.
printf 'name = "four-of-five"\nmode = "confidence"\n\n[[requirement]]\nmetric = "success"\nat_least = 0.8\n' > "$out/requirements.toml"
for suite in "${suites[@]}"; do
    # The first initial states of each task.
    python3 scripts/environments_libero.py suite "assets/suites/libero-$suite.toml" "$states" > "$out/$suite.toml"
    # A verdict other than "pass" is a result too.
    conduct "$out/$suite" gate --suite "$out/$suite.toml" --requirements "$out/requirements.toml" --rounds 1 --fixed \
        "${libero[@]}" || [ -f "$out/$suite/gate.json" ]
done
for name in "${maps[@]}"; do
    python=("${libero[@]}")
    case $name in robosuite:*) python=("${robosuite[@]}") ;; esac
    conduct "$out/$(echo "$name" | tr ':/' '--')" run --env "$name" -n "$episodes" --seed 2026 "${python[@]}"
done

# Replays: the hash of every state must be that of the run.
for name in "${suites[@]}" "${maps[@]}"; do
    python=("${libero[@]}")
    case $name in robosuite:*) python=("${robosuite[@]}") ;; esac
    folder=$(echo "$name" | tr ':/' '--')
    "$robogate" replay "$out/$folder" 7 "${python[@]}" > "$out/$folder-replay.txt"
done

python3 scripts/environments_libero.py page "$robogate" "$out" "${suites[*]}" "${maps[*]}" > docs/results/environments-libero.md
