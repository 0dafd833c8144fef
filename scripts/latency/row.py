"""Prints one row of docs/results/latency.md: row.py MODE MILLISECONDS SUMMARY GATE."""

import json
import sys

mode, milliseconds, summary, gate = sys.argv[1:]
with open(summary) as file:
    stage = json.load(file)["stages"][0]
with open(gate) as file:
    verdict = json.load(file)["verdict"]
low, high = (100 * bound for bound in stage["interval_95"])
failures = ", ".join(f"{mode['mode']} {mode['episodes']}" for mode in stage["failure_modes"] if mode["episodes"])
rate = 100 * stage["success_rate"]
print(f"| {mode} | {milliseconds} ms | {stage['successes']} of {stage['valid']} | {rate:.1f} % ({low:.1f} to {high:.1f}) | {failures or '-'} | {verdict} |", flush=True)
