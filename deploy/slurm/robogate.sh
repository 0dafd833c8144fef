#!/usr/bin/env bash
# Runs a campaign in shards on a Slurm cluster. Usage, on a login node:
#
#   robogate.sh DIR SHARDS [OPTIONS OF robogate run...]
#
# This submits a small job that submits an array with the missing shards of the open round, and then itself again after the array.
# When no shard is missing, it merges them. Nothing stays on the login node. The same command continues a campaign that was stopped;
# the options may then be left out. DIR must be visible on all nodes under this path.
#
# Environment: ROBOGATE_COMMAND (default: robogate), ROBOGATE_CPUS (CPUs and threads of each shard, default: 1), and the variables of
# sbatch such as SBATCH_PARTITION, SBATCH_ACCOUNT and SBATCH_TIMELIMIT.
set -euo pipefail

robogate=${ROBOGATE_COMMAND:-robogate}
cpus=${ROBOGATE_CPUS:-1}
# How often Slurm runs a failed shard again at once, and how often an array may end without any new shard.
restarts=3
attempts=3

# Submits a call of this script: submit SBATCH_OPTIONS... -- ARGUMENTS...
submit() {
    local options=()
    while [ "$1" != -- ]; do
        options+=("$1")
        shift
    done
    shift
    # Slurm runs a copy of the script, which does not know the path of the original.
    sbatch --parsable --job-name=robogate --export=ALL,ROBOGATE_SLURM="$self" "${options[@]}" "$self" "$@"
}

# Runs the shard of this array task: shard DIR SHARDS
shard() {
    local code=0
    "$robogate" run --shard "$SLURM_ARRAY_TASK_ID/$2" --out "$1" --threads "$cpus" || code=$?
    # 5: a policy server or a simulator failed. 130: interrupted.
    if { [ "$code" -eq 5 ] || [ "$code" -ge 128 ]; } && [ "${SLURM_RESTART_COUNT:-0}" -lt "$restarts" ]; then
        scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
    fi
    exit "$code"
}

# Submits the missing shards of the open round, or merges: next DIR SHARDS ATTEMPT LAST
next() {
    local dir=$1 shards=$2 attempt=$3 last=$4 commands missing job
    commands=$("$robogate" plan "$dir" --next)
    missing=$(sed -n 's/^robogate run --shard \([0-9]*\)\/.*/\1/p' <<< "$commands" | paste -sd,)
    if [ -z "$missing" ]; then
        "$robogate" merge "$dir"
        return
    fi
    [ "$missing" = "$last" ] || attempt=0
    if [ "$attempt" -ge "$attempts" ]; then
        echo "error: the shards $missing failed $attempt times; see $dir/slurm" >&2
        exit 5
    fi
    job=$(submit --array="$missing" --requeue --cpus-per-task="$cpus" --output="$dir/slurm/shard-%A-%a.log" --open-mode=append \
        -- shard "$dir" "$shards")
    submit --dependency="afterany:$job" --output="$dir/slurm/next-%j.log" -- next "$dir" "$shards" $((attempt + 1)) "$missing"
}

self=${ROBOGATE_SLURM:-$(realpath "$0")}
case ${1:-} in
    shard | next)
        "$@"
        ;;
    *)
        if [ $# -lt 2 ]; then
            echo "usage: $0 DIR SHARDS [OPTIONS OF robogate run...]" >&2
            exit 2
        fi
        dir=$(realpath -m "$1")
        shards=$2
        shift 2
        if [ $# -gt 0 ] || [ ! -e "$dir/plan.json" ]; then
            "$robogate" run --divide "$shards" --out "$dir" "$@"
        fi
        mkdir -p "$dir/slurm"
        job=$(submit --output="$dir/slurm/next-%j.log" -- next "$dir" "$shards" 0 "")
        echo "job $job; progress: robogate status $dir; logs: $dir/slurm"
        ;;
esac
