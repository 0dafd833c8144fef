#!/usr/bin/env bash
# Runs a campaign in shards on a Slurm cluster. Usage, on a login node:
#
#   robogate.sh DIR SHARDS [OPTIONS OF robogate run...]
#   robogate.sh DIR          # a campaign, gate or sweep that exists
#
# This submits a small job that submits an array with the missing shards, and then itself again after the array. When no shard is
# missing, it merges them. Nothing stays on the login node. The same command continues a campaign that was stopped. DIR must be a folder
# that is visible on all nodes under this path.
#
# Environment: ROBOGATE_COMMAND (default: robogate), ROBOGATE_CPUS (CPUs and threads of each shard, default: 1), and the variables of
# sbatch such as SBATCH_PARTITION, SBATCH_ACCOUNT and SBATCH_TIMELIMIT.
set -euo pipefail

robogate=${ROBOGATE_COMMAND:-robogate}
cpus=${ROBOGATE_CPUS:-1}
# How often Slurm runs a failed shard again at once, and how often an array may end without any new shard.
restarts=3
attempts=3
# Slurm's default MaxArraySize is 1001. More shards follow in the next array.
most=1000

# Submits a call of this script, and prints the number of its job: submit SBATCH_OPTIONS... -- ARGUMENTS...
submit() {
    local options=() job
    while [ "$1" != -- ]; do
        options+=("$1")
        shift
    done
    shift
    # Slurm runs a copy of the script, which does not know the path of the original.
    job=$(sbatch --parsable --job-name=robogate --export=ALL,ROBOGATE_SLURM="$self" "${options[@]}" "$self" "$@") || return
    # With SBATCH_CLUSTERS, the name of the cluster follows.
    echo "${job%%;*}"
}

# Runs the shard of this array task, which is a line of the list: shard LIST
shard() {
    local line code=0
    line=$(sed -n "$((SLURM_ARRAY_TASK_ID + 1))p" "$1")
    # `robogate plan` quotes its lines for a shell.
    eval "\"\$robogate\" ${line#robogate } --threads \"\$cpus\"" || code=$?
    # 5: a policy server or a simulator failed. 130: interrupted.
    if { [ "$code" -eq 5 ] || [ "$code" -ge 128 ]; } && [ "${SLURM_RESTART_COUNT:-0}" -lt "$restarts" ]; then
        scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
    fi
    exit "$code"
}

# Prints the commands of the missing shards: those of the campaign, and those of its nominal twins, whose plans its merge writes. The
# commands of all rounds are equal; the names of the rounds go to stderr: missing DIR
missing() {
    local arm
    "$robogate" plan "$1" --next || return
    # The folders of a sweep are runs.
    if [ ! -f "$1/sweep.json" ]; then
        for arm in "$1/nominal" "$1/families"; do
            if [ -f "$arm/shards/layout.json" ]; then
                "$robogate" plan "$arm" --next || return
            fi
        done
    fi
}

# Writes the missing shards to LIST.part, and their rounds to LIST.rounds: look DIR LIST
look() {
    local code=0
    missing "$1" > "$2.part" 2> "$2.rounds" || code=$?
    cat "$2.rounds" >&2
    return "$code"
}

# Submits the missing shards, or merges if there are none: next DIR ATTEMPT LAST_LIST
next() {
    local dir=$1 attempt=$2 last=$3 list=$1/slurm/next-$SLURM_JOB_ID.txt count job code=0
    look "$dir" "$list"
    if [ ! -s "$list.part" ]; then
        "$robogate" merge "$dir" || code=$?
        # 1, 3 and 4 are verdicts: the nominal twins of a gate follow all the same.
        case $code in
            0 | 1 | 3 | 4) ;;
            *) exit "$code" ;;
        esac
        look "$dir" "$list"
    fi
    head -n "$most" "$list.part" > "$list"
    rm "$list.part"
    count=$(wc -l < "$list")
    if [ "$count" -eq 0 ]; then
        exit "$code"
    fi
    cmp -s "$list" "$last" && cmp -s "$list.rounds" "$last.rounds" || attempt=0
    if [ "$attempt" -ge "$attempts" ]; then
        echo "error: the shards in $list failed $attempt times; see the logs in $dir/slurm" >&2
        exit 5
    fi
    job=$(submit --array="0-$((count - 1))" --requeue --cpus-per-task="$cpus" --output="$dir/slurm/shard-%A-%a.log" --open-mode=append \
        -- shard "$list")
    submit --dependency="afterany:$job" --output="$dir/slurm/next-%j.log" -- next "$dir" $((attempt + 1)) "$list"
}

self=${ROBOGATE_SLURM:-$(realpath "$0")}
case ${1:-} in
    shard | next)
        "$@"
        ;;
    *)
        if [ $# -lt 1 ]; then
            echo "usage: $0 DIR [SHARDS [OPTIONS OF robogate run...]]" >&2
            exit 2
        fi
        case $1 in
            *://*)
                echo "error: $1: expected a folder on a file system that all nodes share. Hint: deploy/kubernetes and robogate-ray use object stores" >&2
                exit 2
                ;;
        esac
        dir=$(realpath -m "$1")
        if [ $# -gt 1 ]; then
            "$robogate" run --divide "$2" --out "$dir" "${@:3}"
        elif [ ! -f "$dir/plan.json" ] && [ ! -f "$dir/sweep.json" ]; then
            echo "error: $dir contains no campaign. Hint: add the number of shards and the options of \`robogate run\`" >&2
            exit 2
        fi
        mkdir -p "$dir/slurm"
        job=$(submit --output="$dir/slurm/next-%j.log" -- next "$dir" 0 "")
        echo "job $job; progress: robogate plan $dir; logs: $dir/slurm"
        ;;
esac
