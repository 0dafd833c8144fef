#!/usr/bin/env python3
"""Checks every arm of MuJoCo Menagerie with `robogate robots check menagerie:NAME`, and writes docs/results/menagerie.md.

    python scripts/menagerie.py target/debug/robogate [--note "Where the files are from."]

Runs in a Python with the package mujoco-menagerie. Its files must be on this machine: `python -m mujoco_menagerie prefetch`, or a
checkout in MENAGERIE_ROOT. The check drafts robot.toml from the model alone; nothing is corrected by hand.
"""

import json
import os
import pathlib
import subprocess
import sys

import mujoco_menagerie as menagerie

ROOT = pathlib.Path(__file__).resolve().parent.parent
CATEGORIES = ("arm", "dual_arm", "mobile_manipulator")

HEAD = """# Arms of MuJoCo Menagerie

`--robot menagerie:NAME` uses a robot of the Menagerie ([Robots](../guides/robots.md)). This page is the output of `scripts/menagerie.py`, which runs
`robogate robots check menagerie:NAME` for each robot of the categories arm, dual arm and mobile manipulator in version {version} of the package.
The check drafts `robot.toml` from the model alone, grasps parts of different size and weight, and ends with one episode of pick and place.

**{works} of {checked} robots work** on this machine ({robogate}).{checkout}

| robot | joints | gripper | workspace | result |
|---|---:|---|---:|---|
"""


def check(robogate, name):
    """The result of one robot: joints, gripper, share of the workspace, and the verdict in words."""
    command = [robogate, "robots", "check", f"menagerie:{name}", "--python", sys.executable, "--json"]
    run = subprocess.run(command, capture_output=True, text=True)
    if not run.stdout.strip():
        # The last cause says most.
        causes = [line.strip() for line in run.stderr.splitlines() if line.strip().startswith(("error:", "because:"))]
        why = causes[-1].split(": ", 1)[-1] if causes else run.stderr.strip()[:200]
        return None, "", None, False, why
    report = json.loads(run.stdout)
    robot, measured = report["robot"], report["measured"] or {}
    if robot is None:
        return None, "", None, False, report["problems"][0]["what"]
    grip = robot["gripper"]
    if grip["kind"] == "suction":
        gripper = f"cup, {1e3 * grip['cup_diameter_m']:.0f} mm (drafted)"
    else:
        gripper = f"{'one moving jaw' if 'fixed_jaw_m' in grip else 'two fingers'}, {1e3 * grip['opening_m']:.0f} mm"
    share = measured.get("workspace_share")
    episode = measured.get("episode")
    works = not report["problems"] and episode is not None and episode["failure"] is None
    if works:
        verdict = f"works: pick and place in {episode['time_s']:.1f} s with a cube of {1e3 * episode['part_m']:.0f} mm"
    elif report["problems"]:
        verdict = report["problems"][0]["what"]
    elif not measured.get("reaches_target"):
        verdict = "the target is out of reach"
    else:
        verdict = "the grasp was not tested"
    return robot["joints"], gripper, share, works, verdict


def main():
    robogate = sys.argv[1]
    note = " " + sys.argv[sys.argv.index("--note") + 1] if "--note" in sys.argv else ""
    rows, works, checked, missing = [], 0, 0, []
    for name in menagerie.names():
        robot = menagerie.get(name)
        if robot.category not in CATEGORIES:
            continue
        root = os.environ.get("MENAGERIE_ROOT")
        there = (pathlib.Path(root) / name).is_dir() if root else menagerie.Cache().is_cached(robot)
        if not there:
            missing.append(f"`{name}`")
            continue
        joints, gripper, share, good, verdict = check(robogate, name)
        print(f"{name:28} {'works' if good else 'FAILS':6} {verdict}", flush=True)
        checked += 1
        works += good
        share = "" if share is None else f"{100 * share:.0f} %"
        rows.append(f"| `{name}` | {joints or ''} | {gripper} | {share} | {verdict.replace('|', '/')} |")
    version = subprocess.run([robogate, "--version"], capture_output=True, text=True).stdout.strip()
    checkout = " The files were those of a checkout (`MENAGERIE_ROOT`)." if os.environ.get("MENAGERIE_ROOT") else ""
    text = HEAD.format(version=menagerie.__version__, works=works, checked=checked, robogate=version, checkout=checkout + note)
    text += "\n".join(rows) + "\n"
    if missing:
        text += f"\nNot checked, because their files were not on this machine: {', '.join(missing)}.\n"
    (ROOT / "docs/results/menagerie.md").write_text(text)


if __name__ == "__main__":
    main()
