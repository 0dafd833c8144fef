"""Writes docs/results/requalify.md from the answers of scripts/requalify.sh: python3 scripts/requalify/page.py FOLDER DATE MARGIN."""

import json
import re
import sys
from pathlib import Path

WORDS = {
    "meaning_changed": "meaning changed",
    "starts_changed": "starts changed",
    "success_changed": "success changed",
    "cannot_run": "cannot run",
    "not_paired": "not paired",
    "solver_worse": "solver does worse",
    "no_relevant_change": "no relevant change",
    "inconclusive": "inconclusive",
}


def order(version):
    return [int(part) for part in re.findall(r"\d+", version.split("==")[1])]


def cell(text):
    return text.replace("|", "\\|").replace("\n", " ")


def row(found):
    success = found["success"]
    rates = f"{success['successes'][0]} / {success['successes'][1]} of {success['pairs']}" if success["pairs"] else "-"
    visible = sorted(of["visible"] for of in found["explanation"]["divergence"] if of["visible"] is not None)
    first = str(visible[len(visible) // 2]) if visible else "-"
    details = "; ".join(detail.strip().splitlines()[-1] for change in found["changes"][:2] for detail in change["details"][:2]) or found["headline"]
    return f"| {found['upgrade']} | {WORDS[found['answer']]} | {found['pairs'][0]} | {rates} | {first} | {cell(details)[:260]} |"


def main(folder, date, margin):
    found = {}
    for path in sorted(folder.glob("*.json")):
        run, _, upgrade = path.name.removesuffix(".json").partition(".")
        if "==" in upgrade:
            found.setdefault(run, []).append(json.loads(path.read_text()))
    counts = {}
    for answers in found.values():
        for one in answers:
            counts[WORDS[one["answer"]]] = counts.get(WORDS[one["answer"]], 0) + 1
    repeated = [sum(one["repeats_run"][at] for answers in found.values() for one in answers) for at in (0, 1)]
    print(f"# What versions of MuJoCo change\n\n{date}. `scripts/requalify.sh` writes this page with [`robogate requalify`](../guides/requalify.md).")
    print("Success is given before / after the upgrade. \"Motion\" is the control period in which a body is more than 1 mm away from where it was, at the median.")
    print(f"A requalification stops when its answer is certain, so the numbers of pairs differ. The margin of success is {100.0 * margin:g} points.\n")
    print("Answers: " + ", ".join(f"{n} {word}" for word, n in sorted(counts.items(), key=lambda of: -of[1])) + ".")
    print(f"Before each upgrade, {repeated[0]:,} of {repeated[1]:,} episodes repeated those of their run bit for bit, with the physics recorded.")
    default = [one for answers in found.values() for one in answers if one["answer"] == "no_relevant_change" and max(map(abs, one["success"]["interval_95"])) > 0.1]
    if default:
        print(f"\nThe margin is wider than the default of 10 points, with which {len(default)} of the answers \"no relevant change\" are inconclusive.")
    print(f"\nThis page covers {', '.join(sorted(found))}. The script's defaults are eight Meta-World tasks, nominal and varied, with 60 episodes each.")
    for run, answers in sorted(found.items()):
        first = answers[0]["engines"][0]
        print(f"\n## {run}\n\nBefore: {first}.\n\n| upgrade | answer | pairs | success | motion | first details |\n|---|---|---:|---|---:|---|")
        for one in sorted(answers, key=lambda one: order(one["upgrade"])):
            print(row(one))
    hands = [json.loads(line) for line in (folder / "own_hand.jsonl").read_text().splitlines() if line.startswith("{")]
    if hands:
        print("\n## RoboGate's own hand\n")
        print("A model with a weld to a mocap body, contacts, a tendon and a servo is varied in each knob. `mj_setConst` rewrites fields that an author set,")
        print("and other fields depend on the version. After each knob is undone, all fields of the model must have the bytes of before, and an episode must be the same.\n")
        print("| MuJoCo | knobs | fields of the author that `mj_setConst` rewrites | fields left changed | episodes that differ |\n|---|---:|---|---:|---:|")
        for one in sorted(hands, key=lambda one: order("x==" + one["mujoco"])):
            rewritten = ", ".join(f"`{name}`" for name in one["rewritten"]) or "none"
            print(f"| {one['mujoco']} | {one['knobs']} | {rewritten} | {len(one['left'])} | {len(one['differ']) + len(one['nominal'])} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], float(sys.argv[3]))
