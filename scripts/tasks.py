"""Writes docs/results/tasks.md from the runs of scripts/tasks.sh: tasks.py ROBOGATE OUT RUN..."""

import csv
import io
import json
import subprocess
import sys
from pathlib import Path

SUITES = {"pick_place": "industrial-68", "stacking": "stacking-40", "insertion": "insertion-40"}


def percent(x):
    return f"{100 * x:.1f} %"


def output(*command):
    return subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True).stdout


def rate(found):
    rate = found["success"]["rate"]
    low, high = rate["clopper_pearson_95"]
    return f"{rate['successes']} of {rate['n']} | {percent(rate['rate'])} | {percent(low)} to {percent(high)}"


def modes(found):
    modes = sorted(found["failure_modes"]["modes"], key=lambda mode: -mode["failures"])
    return ", ".join(f"{mode['mode']} {mode['failures']}" for mode in modes if mode["failures"]) or "none"


def rows(robogate, folder):
    return list(csv.DictReader(io.StringIO(output(robogate, "export", folder, "-"))))


def median_time(data):
    times = sorted(float(row["cycle_time_s"]) for row in data if row["outcome"] == "success")
    return f"{times[len(times) // 2]:.1f} s" if times else "-"


def files(robogate, out, found):
    nominal, ranges = ([run for run in found if run.startswith(kind)] for kind in ("file-", "boundary-"))
    if nominal:
        print("\n## Tasks from files\n")
        print("The expert of each task in `assets/tasks`: 40 episodes with nominal values and encoder errors of up to 2 mrad. The target is 95 %.\n")
        print("| task | robot | engine | successes | success | 95 % interval | failures by mode | median time of success |")
        print("|---|---|---|---:|---:|---|---|---:|")
    for run in nominal:
        _, task, robot, engine = run.split("-")
        time = median_time(rows(robogate, out / run))
        print(f"| {task} | {robot} | {engine} | {rate(found[run])} | {modes(found[run])} | {time} |")
    if ranges:
        print("\n## Where the experts of these tasks fail\n")
        print("200 episodes of a Franka over the ranges of all parameters, of which the later ones are chosen where the boundary is uncertain.\n")
    for run in ranges:
        _, task, _, _ = run.split("-")
        headline = found[run]["headline"]
        print(f"- `{task}`: {headline['answer']} {' '.join(headline['where_it_fails'])}")


def main():
    robogate, out = sys.argv[1], Path(sys.argv[2])
    found = {run: json.loads(output(robogate, "analyze", out / run, "--json")) for run in sys.argv[3:]}
    runs = [run for run in found if not run.startswith(("file-", "boundary-"))]
    print("# Tasks in one cell\n")
    print("Written by `scripts/tasks.sh`. The scripted controller of each task on its industrial suite, in rounds with fresh seeds (seed 2026),")
    print("with exact 95 % intervals (Clopper and Pearson). The target is a success rate of 95 % on each suite. Parts of `industrial-68` are narrower than a")
    print("suction cup, so the arms with a cup do not run it.\n")
    print("| task | suite | robot | engine | successes | success | 95 % interval | failures by mode | median time of success |")
    print("|---|---|---|---|---:|---:|---|---|---:|")
    groups = {}
    for run in runs:
        task, robot, engine = run.split("-")
        data = rows(robogate, out / run)
        print(f"| {task} | {SUITES[task]} | {robot} | {engine} | {rate(found[run])} | {modes(found[run])} | {median_time(data)} |")
        for row in data:
            if row["failure_type"] not in ("", "none") and row["outcome"] != "invalid":
                groups.setdefault((task, row["case"]), []).append(f"{robot}/{engine} {row['failure_type']}")
    print("\n## Scenarios with failures\n")
    print("| task | scenario | failures |\n|---|---|---|" if groups else "None.")
    for (task, case), failures in sorted(groups.items()):
        counts = {failure: failures.count(failure) for failure in failures}
        print(f"| {task} | {case} | {', '.join(f'{failure} ({count})' for failure, count in sorted(counts.items()))} |")
    files(robogate, out, found)


if __name__ == "__main__":
    main()
