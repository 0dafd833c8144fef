#!/usr/bin/env bash
# Fuzzes every reader of foreign data, and prints how many inputs each was tried with: scripts/fuzz.sh SECONDS [PART_OF_A_NAME]
#
# Each target gets SECONDS (some tests have two targets); as many tests run at a time as there are processors. ROBOGATE_FUZZ_SEED is the number of the
# first input: another one continues an earlier run. A finding is kept as a file, whose name the message has.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh

seconds=$1 part=${2:-.}
log=$(mktemp)
trap 'rm -f "$log"' EXIT
code=0
ROBOGATE_FUZZ_SECONDS=$seconds cargo nextest run --profile fuzz --no-fail-fast --locked --workspace "${full[@]}" --success-output immediate \
    -E "test(fuzzed) & test(/$part/)" > "$log" 2>&1 || code=$?
echo "$(date -u +%F), $seconds s for each target, $(nproc) processors, load $(cut -d ' ' -f 1 /proc/loadavg) at the end:"
echo
sed -n 's/^ *\(.*: [0-9]* inputs from .*\)$/\1/p' "$log" | sort -u
grep -E '^ +(FAIL|SIGKILL|SIGSEGV|SIGABRT|TIMEOUT|Summary)' "$log" | sort -u || true
if [ "$code" -ne 0 ]; then
    grep -vE '^ +(PASS|SLOW)' "$log" | tail -60
fi
exit "$code"
