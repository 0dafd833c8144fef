#!/usr/bin/env bash
# Closes the loop with LeRobot's own trainer (docs/results/learned-policy.md): finds failures of an ACT in a wider space, records
# demonstrations there and the same number at uniform points, continues the training with each, and judges both on the same new
# scenarios. Usage: scripts/learned/lerobot/closed_loop.sh FOLDER [DEMONSTRATIONS] [STEPS]; defaults: 150 demonstrations, 2000 steps.
#
# FOLDER is that of run.sh, with its environment, demonstrations and checkpoint; this script creates what is missing. Steps with existing
# results are skipped. ROBOGATE names the command in place of a release build, CHECKPOINT the first checkpoint (six digits), PORT the
# port of the servers.
set -euo pipefail
cd "$(dirname "$0")/../../.."

mkdir -p "$1"
out=$(realpath "$1") count=${2:-150} steps=${3:-2000} port=${PORT:-8096}
. scripts/learned/lerobot/common.sh
export HF_LEROBOT_HOME=$out

# demonstrations NAME ARGUMENT...: records a dataset, unless it exists. LeRobot looks for datasets in `local`.
mkdir -p "$out/local"
demonstrations() {
    [ -f "$out/$1/meta/info.json" ] || "$ROBOGATE" demos --out "$out/$1" --push 0.012 --size 32 "${@:2}"
    ln -sfn "../$1" "$out/local/$1"
}

# campaign NAME CHECKPOINT ARGUMENT...: runs, resumes or keeps a campaign of a checkpoint behind LeRobot's policy server.
campaign() {
    local name=$1 served=(--policy "grpc://127.0.0.1:$port" --profile "$out/$1.toml")
    [ ! -f "$out/$name/summary.json" ] || return 0
    sed "s|CHECKPOINT|$2|" "$here/profile.toml" > "$out/$name.toml"
    serve "$name.log"
    "$ROBOGATE" policy check "${served[1]}" --profile "$out/$name.toml" --wait 3m
    if [ -f "$out/$name/plan.json" ]; then "$ROBOGATE" resume "$out/$name"; else "$ROBOGATE" run "${served[@]}" --out "$out/$name" "${@:3}"; fi
    kill "$server"
    wait "$server" || true
}

wider=(--space "$here/wider.toml")
demonstrations demos --space "$here/space.toml" -n 400
first=$out/act/checkpoints/${CHECKPOINT:-002000}/pretrained_model
[ -d "$first" ] || "$here/train.sh" "$out/venv" "$out/demos" "$out/act" 2000 2000

campaign active "$first" "${wider[@]}" -n 400 --seed 7401
demonstrations more-active --failed-in "$out/active" -n "$count" --seed 7402
demonstrations more-uniform "${wider[@]}" -n "$count" --seed 7403

campaign first-over-wider "$first" "${wider[@]}" --plan "$here/fresh.toml"
for choice in active uniform; do
    both=$out/local/both-$choice
    [ -d "$both" ] || "$bin/lerobot-edit-dataset" --repo_id "local/both-$choice" --operation.type merge \
        --operation.repo_ids "['local/demos', 'local/more-$choice']"
    checkpoint=$out/act-$choice/checkpoints/$(printf '%06d' "$steps")/pretrained_model
    [ -d "$checkpoint" ] || FROM=$first "$here/train.sh" "$out/venv" "$both" "$out/act-$choice" "$steps" "$steps"
    campaign "$choice-over-wider" "$checkpoint" "${wider[@]}" --plan "$here/fresh.toml"
done
"$ROBOGATE" compare --paired "$out/first-over-wider" "$out/active-over-wider"
"$ROBOGATE" compare --paired "$out/uniform-over-wider" "$out/active-over-wider"
