#!/usr/bin/env bash
# Fuzzes every reader of foreign data, and prints how many inputs each was tried with: scripts/fuzz.sh SECONDS [PART_OF_A_NAME]
#
# Each target gets SECONDS (some tests have two targets); as many tests run at a time as there are processors. The readers are built with
# counters of their branches (a build of its own in the build folder), so that inputs that reach new code are kept and changed further.
# ROBOGATE_FUZZ_CORPUS names the folder of the kept inputs (default: fuzz-corpus in the build folder): another run starts with them.
# ROBOGATE_FUZZ_SEED is the number of the first input: another one tries others. A finding is stored as a file, whose name the message has.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh

seconds=$1 part=${2:-.}
target=${CARGO_TARGET_DIR:-target}
mkdir -p "$target/fuzz"
target=$(cd "$target" && pwd)
log=$(mktemp)
trap 'rm -f "$log"' EXIT

# As cargo-fuzz does it, but without a sanitizer, which needs a nightly compiler. With a target named, build scripts and macros that run in
# the compiler are not counted.
cc -O2 -c scripts/fuzz/coverage.c -o "$target/fuzz/coverage.o"
export CARGO_TARGET_DIR=$target/fuzz CARGO_INCREMENTAL=0
export RUSTFLAGS="--cfg robogate_coverage -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=3
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Ccodegen-units=1 -Clink-arg=$target/fuzz/coverage.o"
export ROBOGATE_FUZZ_CORPUS=${ROBOGATE_FUZZ_CORPUS:-$target/fuzz-corpus}

code=0
ROBOGATE_FUZZ_SECONDS=$seconds cargo nextest run --profile fuzz --no-fail-fast --locked --workspace "${full[@]}" --success-output immediate \
    --target "$(rustc -vV | sed -n 's/^host: //p')" -E "test(fuzzed) & test(/$part/)" > "$log" 2>&1 || code=$?
echo "$(date -u +%F), $seconds s for each target, $(nproc) processors, load $(cut -d ' ' -f 1 /proc/loadavg) at the end:"
echo
sed -n 's/^ *\(.*: [0-9]* inputs from .*\)$/\1/p' "$log" | sort -u
grep -E '^ +(FAIL|SIGKILL|SIGSEGV|SIGABRT|TIMEOUT|Summary)' "$log" | sort -u || true
if [ "$code" -ne 0 ]; then
    grep -vE '^ +(PASS|SLOW)' "$log" | tail -60
fi
exit "$code"
