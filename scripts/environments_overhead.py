"""Compares Meta-World's experts through RoboGate with the plain Python loop: environments_overhead.py ROBOGATE PYTHON [TURNS] [TASK...].

Both run the same episodes, in turns, and the seeds agree, so that they take the same control steps. Prints wall time and CPU time for
each episode, their ratios, and how much faster two workers are than one. The start of the processes is not counted: the times of a
short run are subtracted from those of a long one. CPU time is that of all processes. PYTHON is an interpreter with Meta-World.
"""

import csv
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PLAIN = """
import sys
from types import SimpleNamespace
from metaworld.policies import ENV_POLICY_MAP
from robogate_eval.environments import find
from robogate_eval.serving.adapter import _seed
task, episodes = sys.argv[1], int(sys.argv[2])
env, steps = find("metaworld:" + task).make(), 0
for index in range(episodes):
    act, done = ENV_POLICY_MAP[task]().get_action, False
    observation, _ = env.reset(seed=_seed(SimpleNamespace(seed=7, index=index)))
    while not done:
        observation, _, _, truncated, info = env.step(act(observation).clip(-1.0, 1.0))
        steps += 1
        done = truncated or info["success"] > 0.0
print(steps)
"""
SHORT, LONG = 4, 64
TASKS = ["drawer-open-v3", "push-v3", "pick-place-v3", "door-open-v3"]


def timed(command):
    """Wall time and CPU time in s, and the output."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.monotonic() - began, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, output


def plain(python, task, episodes):
    wall, cpu, output = timed([python, "-W", "ignore", "-c", PLAIN, task, str(episodes)])
    return wall, cpu, int(output.split()[-1])


def gated(robogate, python, task, episodes, folder, threads=1):
    run = folder / f"run-{task}-{episodes}-{threads}"
    # The space has one parameter, which is nominal in all episodes.
    space = folder / "nominal.toml"
    space.write_text('name = "nominal"\n[[parameter]]\nname = "action_delay"\nkind = "integer"\nlow = 0\nhigh = 0\n', encoding="utf-8")
    plan = folder / "plan.toml"
    plan.write_text(f"[uniform]\nepisodes = {episodes}\n[boundary]\nepisodes = 0\n", encoding="utf-8")
    common = ["--env", f"metaworld:{task}", "--python", python, "--space", str(space), "--plan", str(plan), "--seed", "7"]
    wall, cpu, _ = timed([robogate, "run", *common, "--threads", str(threads), "--out", str(run)])
    rows = run.with_suffix(".csv")
    subprocess.run([robogate, "export", str(run), str(rows)], check=True, capture_output=True)
    with rows.open(encoding="utf-8") as file:
        return wall, cpu, sum(int(row["ticks"]) for row in csv.DictReader(file))


def per_episode(measure):
    """Wall time and CPU time of an episode in ms, without the start, and control steps of an episode."""
    short, long = measure(SHORT), measure(LONG)
    return [(1000.0 if i < 2 else 1.0) * (long[i] - short[i]) / (LONG - SHORT) for i in range(3)]


def main():
    robogate, python = sys.argv[1:3]
    turns = int(sys.argv[3]) if len(sys.argv) > 3 else 5
    root = Path(__file__).resolve().parents[1]
    os.environ["PYTHONPATH"] = f"{root / 'python/src'}:{root / 'bridges/common'}"
    print(f"Medians of {turns} turns. Load of the machine at the start: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores.")
    for task in sys.argv[4:] or TASKS:
        found = []
        for _ in range(turns):
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                through = per_episode(lambda n: gated(robogate, python, task, n, folder))
                loop = per_episode(lambda n: plain(python, task, n))
                two = per_episode(lambda n: gated(robogate, python, task, n, folder, threads=2))
            assert through[2] == loop[2] == two[2], f"{task}: the episodes differ"
            found.append((through, loop, two))
        wall, cpu = ([f[0][i] / f[1][i] for f in found] for i in (0, 1))
        faster = statistics.median(f[0][0] / f[2][0] for f in found)
        middle = [statistics.median(f[j][i] for f in found) for j in (0, 1) for i in (0, 1)]
        print(
            f"{task}: {found[0][1][2]:.0f} steps; through RoboGate {middle[0]:.1f} ms wall, {middle[1]:.1f} ms CPU; plain {middle[2]:.1f} ms, {middle[3]:.1f} ms; "
            f"ratio of wall time {statistics.median(wall):.2f}x ({min(wall):.2f} to {max(wall):.2f}), of CPU time {statistics.median(cpu):.2f}x "
            f"({min(cpu):.2f} to {max(cpu):.2f}); two workers {faster:.2f}x as fast as one",
            flush=True,
        )


if __name__ == "__main__":
    main()
