#!/usr/bin/env bash
# Runs all tests several times in a row, to find tests whose result depends on chance or on the load of the machine. Prints one line
# for each run (UTC date, seconds, passed, failed and skipped tests, mean load of the last minute), and at the end each test that
# failed, with the number of its failures.
#
# Usage: scripts/repeat_tests.sh TIMES [--loaded] [ARGUMENTS...]
#   --loaded   beside one busy process for each processor
#   ARGUMENTS  go to scripts/test.sh, for example `-p robogate-remote`
#
# The output of each run is in repeat-tests/RUN.log in the build folder.
set -euo pipefail
cd "$(dirname "$0")/.."

usage() {
    echo "usage: scripts/repeat_tests.sh TIMES [--loaded] [ARGUMENTS...]; TIMES is an integer of at least 1" >&2
    exit 2
}
times=${1:-}
case $times in
    '' | *[!0-9]* | 0*) usage ;;
esac
shift
busy=()
loaded=no
if [ "${1:-}" = --loaded ]; then
    loaded=yes
    shift
fi

logs=${CARGO_TARGET_DIR:-target}/repeat-tests
rm -rf "$logs"
mkdir -p "$logs"
end_busy() {
    [ "${#busy[@]}" -eq 0 ] || kill "${busy[@]}" 2> /dev/null || true
}
trap end_busy EXIT
if [ "$loaded" = yes ]; then
    for _ in $(seq "$(nproc)"); do
        # Ends with this script, even if that is killed.
        bash -c 'while [ -e "/proc/$1" ]; do for ((i = 0; i < 200000; i++)); do :; done; done' busy $$ &
        busy+=($!)
    done
fi

# The passed and failed tests of a run, from the summaries of cargo-nextest, cargo test and unittest.
counts() {
    awk '
        / Summary \[/ || /^test result: / {
            for (i = 2; i <= NF; i++) {
                if ($i ~ /^passed/) passed += $(i - 1)
                if ($i ~ /^(failed|timed)/) failed += $(i - 1)
            }
        }
        /^Ran [0-9]+ tests? in / { ran = $2 }
        /^OK( \(.*\))?$/ || /^FAILED \(/ {
            wrong = 0
            skipped = 0
            line = $0
            while (match(line, /(failures|errors|skipped)=[0-9]+/)) {
                split(substr(line, RSTART, RLENGTH), pair, "=")
                if (pair[1] == "skipped") skipped = pair[2]; else wrong += pair[2]
                line = substr(line, RSTART + RLENGTH)
            }
            passed += ran - wrong - skipped
            failed += wrong
            ran = 0
        }
        END { printf "%d %d\n", passed, failed }
    ' "$1"
}

# The names of the tests that failed in a run, and of the steps without a named test.
failures() {
    # cargo-nextest repeats each failure at the end.
    sed -n -E \
        -e 's/^ *(FAIL|TIMEOUT|ABORT|SIG[A-Z]+) \[[^]]*\] (\([^)]*\) )?(.*)$/\3/p' \
        -e 's/^test (.*) \.\.\. FAILED$/\1/p' \
        -e 's/^(FAIL|ERROR): (.*)$/\2/p' \
        -e 's/^failed: (.*)$/step \1/p' \
        -e 's/^error: (could not compile.*)$/\1/p' "$1" | sort -u
}

wrong=0
for run in $(seq "$times"); do
    log=$logs/$run.log
    ROBOGATE_SKIPPED_FILE=$PWD/$log.skipped
    case $log in /*) ROBOGATE_SKIPPED_FILE=$log.skipped ;; esac
    export ROBOGATE_SKIPPED_FILE
    : > "$ROBOGATE_SKIPPED_FILE"
    begun=$SECONDS
    code=0
    ./scripts/test.sh "$@" > "$log" 2>&1 || code=$?
    [ "$code" = 0 ] || wrong=$((wrong + 1))
    failures "$log" > "$log.failed" || true
    read -r passed failed <<< "$(counts "$log")"
    read -r load _ < /proc/loadavg
    printf '%s run %d of %d: %d s, %d passed, %d failed, %d skipped, load %s, exit code %d\n' "$(date -u +%Y-%m-%dT%H:%M:%SZ)" "$run" \
        "$times" $((SECONDS - begun)) "$passed" "$failed" "$(wc -l < "$ROBOGATE_SKIPPED_FILE")" "$load" "$code"
done

if [ "$wrong" -eq 0 ]; then
    echo "no test failed in $times runs"
    exit 0
fi
printf '\n%d of %d runs failed:\n' "$wrong" "$times"
cat "$logs"/*.failed | sort | uniq -c | sort -rn
exit 1
