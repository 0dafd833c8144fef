#!/usr/bin/env bash
# Compares the uniform, two-stage and active design with real physics: runs the campaigns, and scores each learner on one test set. Points
# of the test set run a second time with other draws, which measures the noise floor and the excess error.
#
#   scripts/discovery.sh OUT [ROBOT] [TEST] [REPEATS] [SIZES] [PAIRS] [TASK]
#
# OUT gets the runs of one task, ROBOT.md and, for pick and place with the Franka, franka-collisions.md. Defaults: franka, 12000 test episodes, 10 repeats,
# sizes "250 500 1000 2000", 4000 pairs, pick_place. An episode costs 0.04 to 0.15 s of one core: the defaults run about 130,000 episodes, 1.6 to
# 5.4 CPU hours. Campaigns that exist in OUT are resumed or kept, so the script can be interrupted and repeated.
set -euo pipefail
out=$1 robot=${2:-franka} test=${3:-12000} repeats=${4:-10} sizes=${5:-250 500 1000 2000} pairs=${6:-4000} task=${7:-pick_place}
cd "$(dirname "$0")/.."
# BUILT: a folder with robogate and examples/discovery, in place of a release build.
if [ -z "${BUILT:-}" ]; then
    cargo build --release -p robogate --example discovery --bin robogate
    BUILT=${CARGO_TARGET_DIR:-target}/release
fi
robogate=$BUILT/robogate
mkdir -p "$out"

# The cell of the paper for its task: tolerance and space.
paper=() space_of_paper=()
if [ "$task" = pick_place ]; then
    paper=(--set tolerance_m=0.03 --set contact_force_limit_n=1000000)
    case $robot in ur*) space_of_paper=(--space ur) ;; *) space_of_paper=(--space franka) ;; esac
fi

# campaign NAME ARGUMENT...: runs, resumes or keeps a campaign.
campaign() {
    local dir="$out/$robot-$1"
    shift
    local own=("${space_of_paper[@]}")
    case " $* " in *" --space "* | *" --suite "*) own=() ;; esac
    [ -f "$dir/summary.json" ] && return
    if [ -f "$dir/plan.json" ]; then "$robogate" resume "$dir" >/dev/null; else "$robogate" run --task "$task" --robot "$robot" "${paper[@]}" "${own[@]}" --out "$dir" "$@" >/dev/null; fi
}

# A plan with one uniform stage and independent points.
uniform() {
    printf 'sampler = "uniform"\n[uniform]\nepisodes = %s\n' "$1" >"$out/uniform-$1.toml"
    echo "$out/uniform-$1.toml"
}

campaign test --plan "$(uniform "$test")" --seed 900000
example=$BUILT/examples/discovery
"$example" points "$out/$robot-test" "$pairs" >"$out/$robot-partners.toml"
campaign partners --suite "$out/$robot-partners.toml" --seed 910000
runs=()
for ((repeat = 1; repeat <= repeats; repeat++)); do
    for n in $sizes; do
        campaign "uniform-$n-$repeat" --plan "$(uniform "$n")" --design uniform --seed "$((100000 + repeat))"
        campaign "two-stage-$n-$repeat" --design two-stage -n "$n" --seed "$((200000 + repeat))"
        campaign "active-$n-$repeat" --design active -n "$n" --seed "$((300000 + repeat))"
        runs+=("$out/$robot-uniform-$n-$repeat" "$out/$robot-two-stage-$n-$repeat" "$out/$robot-active-$n-$repeat")
    done
done
"$example" score "$out/$robot-test" "$out/$robot-partners" "${runs[@]}" | tee "$out/$robot.md"

[ "$task-$robot" = pick_place-franka ] || exit 0
# Collisions of the Franka without obstacles: a rare failure. Episodes until ten of them, for uniform points and for points that seek them.
space=$out/$robot-free.toml
awk 'BEGIN { RS = ""; ORS = "\n\n" } !/name = "obstacles"/' "assets/spaces/$robot.toml" | sed "0,/^name = /s/^name = .*/name = \"$robot-free\"/" >"$space"
campaign free --plan "$(uniform 1500)" --design uniform --space "$space" --seed 400000
runs=("$out/$robot-free")
for ((repeat = 1; repeat <= repeats; repeat++)); do
    campaign "seek-$repeat" --seek collision -n 300 --space "$space" --seed "$((400000 + repeat))"
    runs+=("$out/$robot-seek-$repeat")
done
"$example" until collision 10 "${runs[@]}" | tee "$out/$robot-collisions.md"
