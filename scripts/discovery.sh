#!/usr/bin/env bash
# Compares the uniform, two-stage and active design with real physics: runs the campaigns, and scores each learner on one test set.
#
#   scripts/discovery.sh OUT [ROBOT] [TEST] [REPEATS] [SIZES]
#
# OUT gets the runs and ROBOT.tsv. Defaults: franka, 12000 test episodes, 10 repeats, sizes "250 500 1000 2000". An episode costs about 0.15 s of
# one core: the defaults run about 125,000 episodes, 5 CPU hours. Campaigns that exist in OUT are resumed or kept, so the script can be
# interrupted and repeated.
set -euo pipefail
out=$1 robot=${2:-franka} test=${3:-12000} repeats=${4:-10} sizes=${5:-250 500 1000 2000}
cd "$(dirname "$0")/.."
# BUILT: a folder with robogate and examples/discovery, in place of a release build.
if [ -z "${BUILT:-}" ]; then
    cargo build --release -p robogate --example discovery --bin robogate
    BUILT=${CARGO_TARGET_DIR:-target}/release
fi
robogate=$BUILT/robogate
mkdir -p "$out"

# campaign NAME ARGUMENT...: runs, resumes or keeps a campaign.
campaign() {
    local dir="$out/$robot-$1"
    shift
    [ -f "$dir/summary.json" ] && return
    if [ -f "$dir/plan.json" ]; then "$robogate" resume "$dir" >/dev/null; else "$robogate" run --robot "$robot" --out "$dir" "$@" >/dev/null; fi
}

# A plan with one uniform stage and independent points.
uniform() {
    printf 'sampler = "uniform"\n[uniform]\nepisodes = %s\n' "$1" >"$out/uniform-$1.toml"
    echo "$out/uniform-$1.toml"
}

campaign test --plan "$(uniform "$test")" --seed 900000
runs=()
for ((repeat = 1; repeat <= repeats; repeat++)); do
    for n in $sizes; do
        campaign "uniform-$n-$repeat" --plan "$(uniform "$n")" --design uniform --seed "$((100000 + repeat))"
        campaign "two-stage-$n-$repeat" --design two-stage -n "$n" --seed "$((200000 + repeat))"
        campaign "active-$n-$repeat" --design active -n "$n" --seed "$((300000 + repeat))"
        runs+=("$out/$robot-uniform-$n-$repeat" "$out/$robot-two-stage-$n-$repeat" "$out/$robot-active-$n-$repeat")
    done
done
example=$BUILT/examples/discovery
printf '%s\n' "${runs[@]}" | xargs -P "$(nproc)" -n 4 "$example" "$out/$robot-test" >"$out/lines.$robot"
{ printf 'run\tepisodes\tlearner\tbrier\tlog_loss\n'; grep -v '^run' "$out/lines.$robot" | sort; } >"$out/$robot.tsv"
# Mean Brier score over the repeats, by design, size and learner.
awk -F '\t' 'NR > 1 && $4 != "-" { name = $1; sub(/.*\//, "", name); sub(/-[0-9]+$/, "", name); key = name "\t" $3; sum[key] += $4; n[key]++ }
    END { for (key in sum) printf "%s\t%.4f\t%d\n", key, sum[key] / n[key], n[key] }' "$out/$robot.tsv" | sort -V
