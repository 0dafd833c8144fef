#!/usr/bin/env bash
# Measures docs/results/requalify.md: Meta-World, RoboGate's own scene and LIBERO's or robosuite's starts over versions of MuJoCo.
#
# Usage: scripts/requalify.sh DATE. Needs METAWORLD_PYTHON (scripts/environments.sh) and, for RoboGate's own scene, SCENE_PYTHON: a Python with
# mujoco==3.17.0, gymnasium, pyzmq and msgpack. ROBOSUITE_PYTHON adds robosuite. Results that exist are kept. EPISODES, MARGIN, TASKS,
# VERSIONS and THREADS make it shorter.
set -euo pipefail
cd "$(dirname "$0")/.."

date=$1
robogate=$(realpath "${ROBOGATE:-target/release/robogate}")
out=${OUT:-runs/requalify}
episodes=${EPISODES:-60}
threads=${THREADS:-$(nproc)}
margin=${MARGIN:-0.1}
read -ra tasks <<< "${TASKS:-push-v3 pick-place-v3 drawer-open-v3 door-open-v3 button-press-v3 window-open-v3 plate-slide-v3 sweep-into-v3}"
read -ra versions <<< "${VERSIONS:-mujoco==3.3.7 mujoco==3.5.0 mujoco==3.9.0 mujoco==3.12.0 mujoco==3.16.0 mujoco==3.17.0 mujoco-core==4.0.1}"
mkdir -p "$out"
export ROBOGATE_STATE_DIR=$PWD/$out/state ROBOGATE_CACHE_DIR=${CACHE:-$PWD/$out/cache}

# All answers of a run, a file for each version. An exit code above 4 ends the script.
requalify() {
    local run=$1 version code
    shift
    for version in "$@"; do
        [ -s "$out/$run.$version.json" ] && continue
        code=0
        "$robogate" requalify "$out/$run" --env-with "$version" --threads "$threads" --pairs "$episodes" --margin "$margin" --out "$out/$run.$version.html" --json \
            > "$out/$run.$version.json.part" || code=$?
        [ "$code" -le 4 ] && [ "$code" -ne 2 ] || exit "$code"
        mv "$out/$run.$version.json.part" "$out/$run.$version.json"
    done
}

printf '[uniform]\nepisodes = %s\n' "$episodes" > "$out/plan.toml"
printf 'name = "nominal"\n\n[[parameter]]\nname = "action_delay"\nkind = "integer"\nlow = 0\nhigh = 0\n' > "$out/nominal.toml"
if [ -n "${METAWORLD_PYTHON:-}" ]; then
    for task in "${tasks[@]}"; do
        for kind in nominal varied; do
            space=()
            [ "$kind" = nominal ] && space=(--space "$out/nominal.toml")
            [ -f "$out/$task-$kind/summary.json" ] ||
                "$robogate" run --env "metaworld:$task" --python "$METAWORLD_PYTHON" "${space[@]}" --plan "$out/plan.toml" --seed 2026 \
                    --nominal-episodes 0 --threads "$threads" --out "$out/$task-$kind"
            requalify "$task-$kind" "${versions[@]}"
        done
    done
fi

# RoboGate's own scene, exported as MJCF: 20 episodes, from MuJoCo 3.17 to others.
if [ -n "${SCENE_PYTHON:-}" ]; then
    export SCENES=$PWD/$out/scenes
    if [ ! -f "$out/own-scene/summary.json" ]; then
        "$robogate" run -n 20 --seed 2026 --threads "$threads" --out "$out/cell"
        mkdir -p "$SCENES"
        for index in $(seq 0 19); do
            [ -d "$SCENES/$index" ] || "$robogate" export "$out/cell" "$SCENES/$index" --mjcf "$index"
        done
        printf 'name = "scenes"\n\n[[parameter]]\nname = "scene"\nkind = "integer"\nlow = 0\nhigh = 19\n' > "$out/scenes.toml"
        "$robogate" run --env scripts/requalify/own_scene.py --python "$SCENE_PYTHON" --space "$out/scenes.toml" --plan "$out/plan.toml" \
            --seed 2026 --nominal-episodes 0 --threads "$threads" --out "$out/own-scene"
    fi
    requalify own-scene mujoco==3.3.7 mujoco==3.9.0 mujoco==3.14.0 mujoco==3.16.0 mujoco-core==4.0.0 mujoco-core==4.0.1
fi

# robosuite's own pin, and what is above it.
if [ -n "${ROBOSUITE_PYTHON:-}" ]; then
    [ -f "$out/robosuite-lift/summary.json" ] ||
        "$robogate" run --env robosuite:Lift --python "$ROBOSUITE_PYTHON" --policy random --plan "$out/plan.toml" --space "$out/nominal.toml" --seed 2026 \
            --nominal-episodes 0 --threads "$threads" --out "$out/robosuite-lift"
    requalify robosuite-lift "${versions[@]}"
fi

# RoboGate's own edits of a model, in each version that was installed above.
for python in "${METAWORLD_PYTHON:-}" "$ROBOGATE_CACHE_DIR"/requalify/*/bin/python; do
    [ -x "$python" ] || continue
    PYTHONPATH=python/src:bridges/common "$python" -W ignore scripts/requalify/own_hand.py || true
done | sort -u > "$out/own_hand.jsonl"

python3 scripts/requalify/page.py "$out" "$date" "$margin" > docs/results/requalify.md
