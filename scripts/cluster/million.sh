#!/usr/bin/env bash
# Measures merge, analysis and report of 100,000 and of 1,000,000 synthetic episodes in shards of 1,000, and extrapolates to 10 million.
# Usage: scripts/cluster/million.sh COMMAND [FOLDER]. Shards and merged files that exist in FOLDER are used again.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/common.sh

robogate=$(realpath "$1")
folder=${2:-$(mktemp -d)}
mkdir -p "$folder"

# Prints wall seconds, CPU seconds and peak memory in MB of a command: measure NAME COMMAND...
measure() {
    local name=$1
    shift
    python3 - "$name" "$@" << 'PYTHON'
import resource, subprocess, sys, time
name, command = sys.argv[1], sys.argv[2:]
begin = time.monotonic()
code = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode
wall = time.monotonic() - begin
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(f"{name}\t{wall:.1f}\t{used.ru_utime + used.ru_stime:.1f}\t{used.ru_maxrss / 1e3:.0f}")
sys.exit(0 if code == 0 else f"{name} ended with exit code {code}")
PYTHON
}

test=$(cargo test --locked --no-run -p robogate -p robogate-campaign --features robogate/full --test it --message-format=json 2> /dev/null |
    python3 -c 'import json, sys; print([json.loads(line)["executable"] for line in sys.stdin if "\"executable\":\"" in line][-1])')
printf 'episodes\tstep\twall s\tCPU s\tpeak MB\n'
for episodes in 100000 1000000; do
    dir=$folder/$episodes
    export ROBOGATE_MERGE_DIR=$dir ROBOGATE_MERGE_EPISODES=$episodes ROBOGATE_MERGE_OUT=$dir-merged
    "$test" --ignored --quiet merge_speed::prepare_million_episodes > /dev/null
    rm -rf "$dir-merged"
    {
        measure merge "$test" --ignored merge_speed::merge_million_episodes
        measure analyze "$robogate" analyze "$dir-merged"
        measure report "$robogate" report "$dir-merged" --out "$dir-merged/page.html"
    } | sed "s/^/$episodes\t/" | tee -a "$folder/measured.tsv"
    printf '%s\treport\t%s MB\n' "$episodes" "$(stat -c %s "$dir-merged/page.html" | awk '{print $1 / 1e6}')"
done
python3 - "$folder/measured.tsv" << 'PYTHON'
import sys
rows = [line.rstrip().split("\t") for line in open(sys.argv[1])]
for step in dict.fromkeys(row[1] for row in rows):
    (n0, w0, c0, m0), (n1, w1, c1, m1) = [tuple(float(x) for x in (row[0], *row[2:])) for row in rows if row[1] == step][-2:]
    at = [last + (last - first) / (n1 - n0) * (1e7 - n1) for first, last in ((w0, w1), (c0, c1), (m0, m1))]
    print(f"10000000\t{step}\t{at[0]:.0f}\t{at[1]:.0f}\t{at[2]:.0f}\t(from the slope)")
PYTHON
