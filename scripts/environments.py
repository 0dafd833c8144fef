"""Writes docs/results/environments.md from the runs of scripts/environments.sh: environments.py ROBOGATE OUT TASK..."""

import datetime
import json
import math
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
    """The failure regions along one parameter, and the advice of the analysis: conditions that keep the success rate up."""
    out = []
    for region in found["claims"]["failure_regions"]:
        shape = region["shape"]
        if shape["kind"] in ("falling", "rising"):
            side = "above" if shape["kind"] == "falling" else "below"
            step = shape["steps"][0]
            low, high = step["interval_95"]
            rates = f"{percent(shape['low']['rate'])} instead of {percent(shape['high']['rate'])}"
            out.append(f"`{region['parameter']}` {side} {step['at']:.3g} ({low:.3g} to {high:.3g}): {rates}")
        else:
            out.append(f"`{region['parameter']}`")
    for advice in found["claims"]["advice"]:
        if advice["kind"] == "keep":
            out.append(f"advice: `{advice['parameter']}` {'above' if advice['above'] else 'below'} {advice['threshold']:.3g}")
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


def effects(found):
    """Correlations of success with a parameter: task, parameter, estimate and natural logarithm of p."""
    for task, analysed in found.items():
        for effect in analysed["marginal_effects"]:
            estimated = effect["correlation"].get("estimated")
            if estimated and estimated.get("point_biserial") is not None:
                yield task, effect["parameter"], estimated


def findings(found, out):
    """What the nominal rate of a task hides: the significant failure regions of the analysis, those with the lowest rates first."""
    rows = []
    for task, analysed in found.items():
        nominal = out / f"{task}-nominal" / "summary.json"
        if not nominal.is_file():
            continue
        plain = json.loads(nominal.read_text(encoding="utf-8"))["estimate"]["success_rate"]
        for region in analysed["claims"]["failure_regions"]:
            shape = region["shape"]
            if shape["kind"] in ("falling", "rising"):
                side = "above" if shape["kind"] == "falling" else "below"
                where = f"`{region['parameter']}` {side} {shape['steps'][0]['at']:.3g}"
                rows.append((shape["low"]["rate"], task, plain, where, shape["low"], shape["high"], region["adjusted_p"]))
    print("\n## What the nominal figure hides\n")
    print("Failure regions of Meta-World's experts (permutation tests, p after correction for all parameters of a task). A delay of one control period is 12.5 ms.\n")
    print("| task | nominal | region | success there | success elsewhere | p |")
    print("|---|---|---|---|---|---|")
    for _, task, plain, where, low, high, p in sorted(rows):
        there, elsewhere = (f"{rate['successes']} of {rate['n']}: {percent(rate['rate'])}" for rate in (low, high))
        print(f"| {task} | {percent(plain)} | {where} | {there} | {elsewhere} | {p:.1g} |")


def main():
    robogate, out, tasks = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]
    done = [task for task in [*tasks, "fetch"] if (out / task / "summary.json").is_file()]
    found = {task: analysis(robogate, out / task) for task in done}
    print("# Meta-World and Fetch under the gate\n")
    print(f"Measured with the commands of `scripts/environments.sh`, {datetime.date.today()}. Each run varies the physics of the task's objects and joints, the force of the")
    print("gripper and a delay of the actions, over the default space of the environment (`robogate env inspect NAME`). The policy is the")
    print("scripted expert that Meta-World ships, or our scripted policy for Fetch. The rates are of the uniform stage: they estimate that space.\n")
    print("Nominal: 50 episodes with Meta-World's own random goals and object positions, and nothing else varied. For comparison: Meta-World publishes no success rate of each")
    print("expert; its own test suite requires at least 80 % of 50 nominal episodes of each (`tests/metaworld/test_evaluation.py`).\n")
    print("| task | nominal | success in the varied space (exact 95 % interval) | failures by mode | failure regions (limit with 95 % interval, and the rates on both sides), advice |")
    print("|---|---|---|---|---|")
    for task in done:
        modes = ", ".join(f"{mode['mode']} {mode['failures']}" for mode in found[task]["failure_modes"]["modes"] if mode["failures"]) or "none"
        nominal = out / f"{task}-nominal"
        plain = success(analysis(robogate, nominal)) if (nominal / "summary.json").is_file() else "-"
        print(f"| {task} | {plain} | {success(found[task])} | {modes} | {limits(found[task])} |")
    tested = list(effects(found))
    limit = math.log(0.05 / max(1, len(tested)))
    print("\n## Parameters that change the success rate\n")
    print(f"Point-biserial correlation of success with each parameter: those of {len(tested)} tests with p < 0.05 after Bonferroni's correction.\n")
    print("| task | parameter | correlation (95 % interval) | p before correction |")
    print("|---|---|---|---|")
    for task, parameter, estimated in tested:
        if estimated["ln_p"] < limit:
            low, high = estimated["interval_95"]
            r, p = estimated["point_biserial"], math.exp(estimated["ln_p"])
            print(f"| {task} | `{parameter}` | {r:+.2f} ({low:+.2f} to {high:+.2f}) | {p:.1g} |")
    print("\n## Success at the ends of each parameter\n")
    print("The lowest and the highest third of each range, over all values of the other parameters.\n")
    print("| task | parameter | lowest third | highest third |")
    print("|---|---|---|---|")
    for task in done:
        for parameter, low, high in thirds(found[task]):
            print(f"| {task} | `{parameter}` | {low} | {high} |")
    overhead = out / "overhead.txt"
    if overhead.is_file():
        print("\n## Overhead\n")
        print("Time of an episode through RoboGate and in the plain Python loop (`scripts/environments_overhead.py`). Both run the same episodes, in short blocks in turns. A ratio is the median of those")
        print("of the pairs of blocks, with its 95 % confidence interval:\n")
        print(f"```\n{overhead.read_text(encoding='utf-8').strip()}\n```")
        note = out / "overhead-note.txt"
        if note.is_file():
            print(f"\n{note.read_text(encoding='utf-8').strip()}")
    sb3 = out / "sb3.md"
    if sb3.is_file():
        print(f"\n{sb3.read_text(encoding='utf-8').strip()}")
    faults = out / "faults.md"
    if faults.is_file():
        print("\n## When something breaks\n")
        print("What the user reads (`scripts/environments_faults.sh`), without the progress and the table of failures. Episodes that an infrastructure fault lost run again; those that are lost")
        print("once more are invalid, and are counted as such.")
        print(f"\n{faults.read_text(encoding='utf-8').strip()}")
    absent = [task for task in tasks if task not in done]
    if absent:
        print(f"\nNot run yet: {', '.join(absent)}.")
    findings(found, out)
    print("\n## Replays\n")
    for task in tasks:
        replay = out / f"{task}-replay.txt"
        if replay.is_file():
            print(f"- {task}, episode 7: {replay.read_text(encoding='utf-8').strip().splitlines()[-1]}")


if __name__ == "__main__":
    main()
