"""Parts of scripts/environments_libero.sh.

environments_libero.py suite FILE STATES                      prints a suite with the first initial states of each task only
environments_libero.py page ROBOGATE OUT "SUITE..." "NAME..."  prints docs/results/environments-libero.md from finished runs
"""

import datetime
import json
import re
import sys
import tomllib
from pathlib import Path

from environments import analysis, limits, percent, success, thirds


def suite(file, states):
    """The suite with the scenarios of the first initial states."""
    for line in Path(file).read_text(encoding="utf-8").splitlines():
        state = re.search(r"initial_state = (\d+) }", line)
        if state is None or int(state[1]) < int(states):
            print(line)


def tasks(out, name):
    """The rows of a suite: task, instruction, success with its interval, and how the other episodes ended."""
    evaluation = json.loads((out / name / "gate.json").read_text(encoding="utf-8"))
    described = {group["name"]: group["description"] for group in tomllib.loads((out / f"{name}.toml").read_text(encoding="utf-8"))["group"]}
    for group in evaluation["groups"]:
        low, high = (f"{100 * end:.0f}" for end in group["interval_95"])
        endings = ", ".join(f"{ending['ending']} {ending['episodes']}" for ending in group["endings"]) or "none"
        yield described[group["group"]], f"{group['successes']} of {group['valid']} ({low} to {high} %)", endings, group


def page(robogate, out, suites, maps):
    """Prints the page."""
    out, suites, maps = Path(out), suites.split(), maps.split()
    suites = [name for name in suites if (out / name / "gate.json").is_file()]
    folders = {name: out / name.replace(":", "-").replace("/", "-") for name in maps}
    maps = [name for name in maps if (folders[name] / "summary.json").is_file()]
    print("# LIBERO and robosuite under the gate\n")
    print(f"Written by `scripts/environments_libero.sh` on {datetime.date.today()}. The policy is our scripted controller, which reads the state of the scene: its")
    print("success shows that the environment and its scoring work, and says nothing about a policy that sees. Published results of learned policies")
    print("are not comparable with it.\n")
    print("The protocol is the benchmark's: fixed initial states, ten actions that do nothing, and its time limits. Intervals are exact 95 % intervals.\n")
    for name in suites:
        rows = list(tasks(out, name))
        groups = [group for *_, group in rows]
        total, valid = sum(g["successes"] for g in groups), sum(g["valid"] for g in groups)
        solved = sum(2 * g["successes"] > g["valid"] for g in groups)
        print(f"## libero-{name}: {total} of {valid} episodes, {solved} of {len(groups)} tasks above one half\n")
        print(f"The first {max(g['valid'] for g in groups)} of the benchmark's 50 initial states of each task.\n")
        print("| instruction in the task file | success | other endings |")
        print("|---|---|---|")
        for instruction, rate, endings, _ in rows:
            print(f"| {instruction} | {rate} | {endings} |")
        verdict = json.loads((out / name / "gate.json").read_text(encoding="utf-8"))
        print(f"\nVerdict of `robogate gate`, with one requirement (success of at least 80 % at 95 % confidence): {verdict['verdict']}. Published results on this suite:\n")
        print("| policy | published success | |")
        print("|---|---|---|")
        for published in tomllib.loads((out / f"{name}.toml").read_text(encoding="utf-8"))["published"]:
            print(f"| {published['policy']} | {percent(published['success'])} | not comparable: another policy; {published['source']} |")
        print()
    if maps:
        print("## How far from nominal the controller works\n")
        print("Each run samples the environment's default space (`robogate env inspect NAME`): all parameters vary at once.\n")
        print("| environment | success in the varied space | failure regions (limit with 95 % interval, and the rates on both sides), advice |")
        print("|---|---|---|")
        found = {name: analysis(robogate, folders[name]) for name in maps}
        for name in maps:
            print(f"| `{name}` | {success(found[name])} | {limits(found[name])} |")
        print("\nSuccess in the lowest and the highest third of the range of each parameter:\n")
        print("| environment | parameter | lowest third | highest third |")
        print("|---|---|---|---|")
        for name in maps:
            for parameter, low, high in thirds(found[name]):
                print(f"| `{name}` | `{parameter}` | {low} | {high} |")
    print("\n## Replays\n")
    for name in [*suites, *maps]:
        replay = out / f"{name.replace(':', '-').replace('/', '-')}-replay.txt"
        if replay.is_file():
            print(f"- {name}, episode 7: {replay.read_text(encoding='utf-8').strip().splitlines()[-1]}")


if __name__ == "__main__":
    {"suite": suite, "page": page}[sys.argv[1]](*sys.argv[2:])
