#!/usr/bin/env bash
# Measures docs/results/fleet.md: 20 units of the Franka, each judged by the gate on the suite industrial-68
# with the requirement of docs/results/fleet-requirements.toml.
#
# Usage: scripts/fleet.sh [UNITS] > docs/results/fleet.md. An interrupted fleet is continued. ROBOGATE names the program, OUT the folder of
# the fleet and THREADS the number of threads.
set -euo pipefail
cd "$(dirname "$0")/.."

units=${1:-20}
robogate=${ROBOGATE:-target/release/robogate}
out=${OUT:-runs/fleet}
command=(fleet --units "$units" --robot franka --suite industrial-68 --unit-space docs/results/fleet-units.toml
    --requirements docs/results/fleet-requirements.toml --seed 2026)
"$robogate" "${command[@]}" --threads "${THREADS:-$(nproc)}" --quiet --out "$out" > /dev/null

cat << TEXT
# A fleet of the Franka on industrial-68

Measured on $(date -u +%Y-%m-%d) by \`scripts/fleet.sh\`: \`robogate ${command[*]}\`, $("$robogate" --version). The policy is the scripted
controller. The distribution of the units ([fleet-units.toml](fleet-units.toml)) is RoboGate's choice and not a manufacturer's, so the share of units says how well this
controller tolerates these deviations, not how a manufacturer's robots differ. The requirement ([fleet-requirements.toml](fleet-requirements.toml)) limits the success rate only: with the default requirements, all of 20 units
violated the limit on the cycle time. [Fleets](../fleet.md) explains interval and test: a parameter is named only if its
p-value is at most 5 % after adjustment for all parameters and both forms (value, and distance from the middle of the range).

TEXT
# The page of the fleet without its title.
sed '1d' "$out/fleet.md"
