"""Compares Meta-World's experts through RoboGate with the plain Python loop: environments_overhead.py ROBOGATE PYTHON [PAIRS] [TASK...].

One process of each side runs the same episodes, with the same seeds and control steps, in short blocks: a block through RoboGate, the
same block in the plain loop, and so on, the one or the other first. So a change of the load or of the clock rate of the machine meets
both. Prints the median of the ratios of the pairs of blocks with its 95 % confidence interval (from order statistics, which make no
assumption about the distribution), of wall time and of CPU time. The CPU time through RoboGate is that of the command and of its server.
A block ends when the next reset arrives, so that everything between two episodes counts. The start of the processes does not.
With `--workers` as the last argument: also how much faster two workers are than one.

PYTHON is an interpreter with Meta-World.
"""

import csv
import math
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TURNS = ROOT / "scripts/environments/taking_turns.py"
# Both sides score an episode in the same way.
PLAIN = """
import os, sys
sys.path.insert(0, os.path.dirname(sys.argv[1]))
import taking_turns
from metaworld.policies import ENV_POLICY_MAP
env, steps = taking_turns.make("plain"), 0
for index in range(int(sys.argv[2])):
    act, done = ENV_POLICY_MAP[taking_turns.TASK]().get_action, False
    observation, _ = env.reset(seed=taking_turns.seed_of(index))
    while not done:
        observation, _, _, truncated, info = env.step(act(observation).clip(-1.0, 1.0))
        steps += 1
        done = truncated or info["success"] > 0.0
print(steps)
"""
TASKS = ["drawer-open-v3", "push-v3", "pick-place-v3", "door-open-v3"]
# Episodes of a block: about 0.2 s.
BLOCK = 4
# Pairs at the start that do not count: caches are cold.
WARM_UP = 2


class Side:
    """One of the two processes that take turns."""

    def __init__(self, connection, processes):
        self._connection = connection
        self._processes = processes

    def block(self):
        """Runs a block. Returns its wall time and its CPU time in s."""
        cpu, began = self._cpu_s(), time.perf_counter()
        self._connection.sendall(b".")
        if self._connection.recv(1) != b".":
            raise SystemExit("error: a side ended early")
        return time.perf_counter() - began, self._cpu_s() - cpu

    def end(self):
        """Lets the process run to its end."""
        self._connection.sendall(b"e")

    def _cpu_s(self):
        """The time that its processes have run."""
        # The number that clock_getcpuclockid(3) returns on Linux. /proc has the time of a running process with a delay.
        return sum(time.clock_gettime((~process << 3) | 2) for process in self._processes)


def arguments_of(folder, episodes):
    """The space and the plan of a run with nominal parameters."""
    space, plan = folder / "nominal.toml", folder / f"plan-{episodes}.toml"
    space.write_text('name = "nominal"\n[[parameter]]\nname = "action_delay"\nkind = "integer"\nlow = 0\nhigh = 0\n', encoding="utf-8")
    plan.write_text(f"[uniform]\nepisodes = {episodes}\n[boundary]\nepisodes = 0\n", encoding="utf-8")
    return ["--space", str(space), "--plan", str(plan), "--seed", "7"]


def steps_of(robogate, run):
    """The number of control steps of a run."""
    rows = run.with_suffix(".csv")
    subprocess.run([robogate, "export", str(run), str(rows)], check=True, capture_output=True)
    with rows.open(encoding="utf-8") as file:
        return sum(int(row["ticks"]) for row in csv.DictReader(file))


def pairs_of(robogate, python, task, pairs, folder):
    """For each pair of blocks: wall time and CPU time through RoboGate and in the plain loop; and the steps of an episode."""
    # The last episode only ends the last block.
    episodes = (WARM_UP + pairs) * BLOCK + 1
    address = str(folder / "turns")
    environment = os.environ | {
        "TURNS_TASK": task, "TURNS_BLOCK": str(BLOCK), "TURNS_ADDRESS": address, "PYTHONPATH": f"{ROOT / 'python/src'}:{ROOT / 'bridges/common'}",
    }  # fmt: skip
    run = folder / f"run-{task}"
    common = ["--threads", "1", "--simulator-timeout", "600", *arguments_of(folder, episodes), "--out", str(run)]
    commands = {
        "gated": [robogate, "run", "--env", str(TURNS), "--python", python, *common],
        "plain": [python, "-W", "ignore", "-c", PLAIN, str(TURNS), str(episodes)],
    }
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(address)
        listener.listen()
        started = {
            name: subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            for name, command in commands.items()
        }
        sides = {}
        listener.settimeout(5.0)
        while len(sides) < 2:
            try:
                connection, _ = listener.accept()
            except TimeoutError:
                for name, process in started.items():
                    if process.poll() is not None:
                        raise SystemExit(f"error: {task}, {name}: {process.communicate()[1]}") from None
                continue
            connection.settimeout(600.0)
            # Byte by byte: what follows the line says that the side waits for its first block.
            greeting = b""
            while not greeting.endswith(b"\n."):
                greeting += connection.recv(1) or exit(f"error: {task}: a side ended early")
            name, *processes = greeting[:-2].decode("utf-8").split()
            sides[name] = Side(connection, [int(process) for process in processes])
        found = []
        for number in range(WARM_UP + pairs):
            order = ("gated", "plain") if number % 2 else ("plain", "gated")
            times = {name: sides[name].block() for name in order}
            found.append((times["gated"], times["plain"]))
        for side in sides.values():
            side.end()
        output = {name: process.communicate()[0] for name, process in started.items()}
    steps, gated = int(output["plain"].split()[-1]), steps_of(robogate, run)
    assert gated == steps, f"{task}: the episodes differ: {gated} and {steps} steps"
    return found[WARM_UP:], steps / episodes


def interval(values):
    """The 95 % confidence interval of the median: the narrowest pair of order statistics, counted from both ends, that covers it."""
    ordered, n = sorted(values), len(values)
    below, position = 0.5**n, 0
    while below + math.comb(n, position + 1) * 0.5**n <= 0.025:
        position += 1
        below += math.comb(n, position) * 0.5**n
    return ordered[position], ordered[n - 1 - position]


def workers(robogate, python, task, folder):
    """How much faster two workers are than one, without the start of the processes."""
    os.environ["PYTHONPATH"] = f"{ROOT / 'python/src'}:{ROOT / 'bridges/common'}"

    def seconds(episodes, threads):
        run = folder / f"workers-{task}-{episodes}-{threads}"
        began = time.perf_counter()
        common = ["--env", f"metaworld:{task}", "--python", python, "--threads", str(threads), *arguments_of(folder, episodes), "--out", str(run)]
        subprocess.run([robogate, "run", *common], check=True, capture_output=True)
        return time.perf_counter() - began

    one, two = (seconds(64, threads) - seconds(4, threads) for threads in (1, 2))
    return one / two


def main():
    arguments = [argument for argument in sys.argv[1:] if argument != "--workers"]
    robogate, python = arguments[:2]
    pairs = int(arguments[2]) if len(arguments) > 2 else 60
    if pairs < 6:
        raise SystemExit("error: PAIRS must be at least 6: fewer pairs have no 95 % confidence interval")
    print(
        f"{pairs} pairs of blocks of {BLOCK} episodes for each task. Load of the machine at the start: {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores.",
        flush=True,
    )
    for task in arguments[3:] or TASKS:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            found, steps = pairs_of(str(Path(robogate).resolve()), python, task, pairs, folder)
            faster = f"; two workers {workers(robogate, python, task, folder):.2f}x as fast as one" if "--workers" in sys.argv else ""
        text = []
        for kind, what in enumerate(("wall time", "CPU time")):
            ratios = [gated[kind] / plain[kind] for gated, plain in found]
            middle = [1000.0 * statistics.median(pair[side][kind] for pair in found) / BLOCK for side in (0, 1)]
            low, high = interval(ratios)
            text.append(f"{what} {middle[0]:.1f} ms and {middle[1]:.1f} ms, ratio {statistics.median(ratios):.3f}x ({low:.3f} to {high:.3f})")
        print(f"{task}: {steps:.0f} steps; an episode through RoboGate and in the plain loop: {'; '.join(text)}{faster}", flush=True)


if __name__ == "__main__":
    main()
