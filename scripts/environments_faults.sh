#!/usr/bin/env bash
# Runs an environment that breaks on purpose, and prints what the user reads, in Markdown.
#
# Usage: scripts/environments_faults.sh; PYTHON is an interpreter with gymnasium, numpy, pyzmq and msgpack (default: python3).
set -euo pipefail
cd "$(dirname "$0")/.."

robogate=${ROBOGATE:-target/release/robogate}
python=${PYTHON:-python3}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
plan=$folder/plan.toml
printf '[uniform]\nepisodes = 120\n[boundary]\nepisodes = 0\n' > "$plan"

# Runs with a fault: shown NAME ARGUMENTS...
shown() {
    local code=0
    "$robogate" "${@:2}" > "$folder/$1.txt" 2>&1 || code=$?
    # The messages, without progress, the summary and the paths of this machine.
    sed -e "s#$folder/##g" -e "s#$PWD/##g" -e "s#$python#python3#g" -e 's#tcp://127.0.0.1:[0-9]*#tcp://127.0.0.1:PORT#g' "$folder/$1.txt" |
        grep -vE '^(uniform|RoboGate|starting|[0-9]+ episodes over)' | sed '/^Failures, uniform stage/,$d' | sed '/^ *File "/d;/^ *\^*$/d' |
        awk 'length > 0' | head -n 24
    printf 'exit code %s\n' "$code"
}

for fault in raise hang nan kill; do
    case $fault in
        raise) text="The environment raises an exception" ;;
        hang) text="It hangs (with \`--simulator-timeout 2\`)" ;;
        nan) text="It returns a NaN" ;;
        kill) text="Its process is killed" ;;
    esac
    printf '\n**%s** in 1 of 1,000 control steps:\n\n```\n' "$text"
    FAULT=$fault shown "$fault" run --env scripts/environments/faulty.py --python "$python" --plan "$plan" --threads 2 --simulator-timeout 2 \
        --out "$folder/run-$fault"
    printf '```\n'
    [ -f "$folder/run-$fault/summary.json" ] && continue
    printf '\nThen `robogate resume`, with the fault removed:\n\n```\n'
    FAULT='' shown "$fault-resumed" resume "$folder/run-$fault"
    printf '```\n'
done
printf '\n**It hangs before the first episode** (with `--simulator-timeout 2`):\n\n```\n'
FAULT=start shown start run --env scripts/environments/faulty.py --python "$python" --plan "$plan" --threads 2 --simulator-timeout 2 --out "$folder/run-start"
printf '```\n'
printf '\n**Its package is missing**:\n\n```\n'
printf 'import a_package_that_is_missing\n' > "$folder/mine.py"
shown missing run --env "$folder/mine.py" --python "$python" --out "$folder/run-missing"
printf '```\n'
