"""Writes docs/results/environments.md from the runs of scripts/environments.sh: environments.py ROBOGATE OUT TASK..."""

import datetime
import json
import subprocess
import sys
from pathlib import Path


def percent(x):
    return f"{100 * x:.1f} %"


def analysis(robogate, folder):
    return json.loads(subprocess.run([robogate, "analyze", str(folder), "--json"], check=True, capture_output=True).stdout)


def success(found):
    rate = found["success"]["rate"]
    low, high = rate["clopper_pearson_95"]
    return f"{rate['successes']} of {rate['n']}: {percent(rate['rate'])} ({100 * low:.1f} to {100 * high:.1f} %)"


def limits(found):
    """The advice of the analysis: conditions on one parameter that keep the success rate up."""
    out = []
    for advice in found["claims"]["advice"]:
        if advice["kind"] == "keep":
            out.append(f"`{advice['parameter']}` {'above' if advice['above'] else 'below'} {advice['threshold']:.3g}")
    return "; ".join(out) or "none significant"


def thirds(found):
    """Success in the lowest and the highest third of the cells of each parameter."""
    rows = []
    for effect in found["marginal_effects"]:
        cells = [(cell["rate"]["successes"], cell["rate"]["n"]) for cell in effect["cells"]]
        third = max(1, len(cells) // 3)
        ends = [[sum(column) for column in zip(*part)] for part in (cells[:third], cells[-third:])]
        if all(n for _, n in ends):
            rows.append((effect["parameter"], *(f"{percent(s / n)} of {n}" for s, n in ends)))
    return rows


def main():
    robogate, out, tasks = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]
    done = [task for task in [*tasks, "fetch"] if (out / task / "summary.json").is_file()]
    found = {task: analysis(robogate, out / task) for task in done}
    print("# Meta-World and Fetch under the gate\n")
    print(f"Written by `scripts/environments.sh` on {datetime.date.today()}. Each run varies the physics of the task's objects and joints, the force of the")
    print("gripper and a delay of the actions, over the default space of the environment (`robogate env inspect NAME`). The policy is the")
    print("scripted expert that Meta-World ships, or our scripted policy for Fetch. The rates are of the uniform stage: they estimate that space.\n")
    print("| task | success in the varied space (exact 95 % interval) | failures by mode | conditions that the analysis advises |")
    print("|---|---|---|---|")
    for task in done:
        modes = ", ".join(f"{mode['mode']} {mode['failures']}" for mode in found[task]["failure_modes"]["modes"] if mode["failures"]) or "none"
        print(f"| {task} | {success(found[task])} | {modes} | {limits(found[task])} |")
    print("\n## Success at the ends of each parameter\n")
    print("The lowest and the highest third of each range, over all values of the other parameters.\n")
    print("| task | parameter | lowest third | highest third |")
    print("|---|---|---|---|")
    for task in done:
        for parameter, low, high in thirds(found[task]):
            print(f"| {task} | `{parameter}` | {low} | {high} |")
    print("\n## Replays\n")
    for task in tasks:
        replay = out / f"{task}-replay.txt"
        if replay.is_file():
            print(f"- {task}, episode 7: {replay.read_text(encoding='utf-8').strip().splitlines()[-1]}")


if __name__ == "__main__":
    main()
