"""Compares Meta-World's expert through RoboGate with the plain Python loop: environments_overhead.py ROBOGATE PYTHON [TASK] [EPISODES].

Prints wall time and CPU time for each control step of both, in turns, and their ratios. The start of the process is not counted: the
times of a short run are subtracted from those of a long one. PYTHON is an interpreter with Meta-World.
"""

import csv
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PLAIN = """
import sys
from metaworld.policies import ENV_POLICY_MAP
from robogate_eval.environments import find
task, episodes = sys.argv[1], int(sys.argv[2])
environment = find("metaworld:" + task)
env, steps = environment.make(), 0
for episode in range(episodes):
    act, done = ENV_POLICY_MAP[task]().get_action, False
    observation, _ = env.reset(seed=episode)
    while not done:
        observation, _, _, truncated, info = env.step(act(observation).clip(-1.0, 1.0))
        steps += 1
        done = truncated or info["success"] > 0.0
print(steps)
"""
SHORT = 4


def timed(command):
    """Wall time and CPU time in s, and the output."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.monotonic() - began, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, output


def plain(python, task, episodes):
    wall, cpu, output = timed([python, "-W", "ignore", "-c", PLAIN, task, str(episodes)])
    return wall, cpu, int(output.split()[-1])


def gated(robogate, python, task, episodes, folder):
    run = folder / f"run-{episodes}"
    # The space has one parameter, which is nominal in all episodes.
    space = folder / "nominal.toml"
    space.write_text('name = "nominal"\n[[parameter]]\nname = "action_delay"\nkind = "integer"\nlow = 0\nhigh = 0\n', encoding="utf-8")
    plan = folder / "plan.toml"
    plan.write_text(f"[uniform]\nepisodes = {episodes}\n[boundary]\nepisodes = 0\n", encoding="utf-8")
    common = ["--env", f"metaworld:{task}", "--python", python, "--space", str(space), "--plan", str(plan), "--threads", "1"]
    wall, cpu, _ = timed([robogate, "run", *common, "--out", str(run)])
    rows = folder / f"rows-{episodes}.csv"
    subprocess.run([robogate, "export", str(run), str(rows)], check=True, capture_output=True)
    with rows.open(encoding="utf-8") as file:
        return wall, cpu, sum(int(row["ticks"]) for row in csv.DictReader(file))


def per_step(measure):
    """Wall and CPU time for each step, in ms, without the start."""
    short, long = measure(SHORT), measure(SHORT + EPISODES)
    steps = long[2] - short[2]
    return [1000.0 * (long[i] - short[i]) / steps for i in (0, 1)]


robogate, python = sys.argv[1:3]
TASK = sys.argv[3] if len(sys.argv) > 3 else "drawer-open-v3"
EPISODES = int(sys.argv[4]) if len(sys.argv) > 4 else 40
root = Path(__file__).resolve().parents[1]
os.environ["PYTHONPATH"] = f"{root / 'python/src'}:{root / 'bridges/common'}"
for turn in range(3):
    with tempfile.TemporaryDirectory() as folder:
        through = per_step(lambda n: gated(robogate, python, TASK, n, Path(folder)))
        loop = per_step(lambda n: plain(python, TASK, n))
    print(
        f"turn {turn + 1}: wall {through[0]:.2f} ms through RoboGate, {loop[0]:.2f} ms plain, {through[0] / loop[0]:.2f}x; "
        f"CPU {through[1]:.2f} ms, {loop[1]:.2f} ms, {through[1] / loop[1]:.2f}x"
    )
