"""How many episodes a served policy answers together, and what limits the speed: ratios within one run, without a GPU.

A stub behind `robogate_eval.serve` takes the same time for any number of requests, as a large model does on a GPU. It judges the random
motion of a Meta-World task at each number of episodes in flight. `batch of N` is the mean batch over the episodes in flight; `server` is
the share of the time in which the stub computes.

Usage: scripts/throughput.py ROBOGATE --python PYTHON [--episodes N] [--compute-ms MS] [--in-flight 1,8,32]

PYTHON has Meta-World (`robogate env setup metaworld`); the stub runs in this interpreter, which needs numpy, msgpack and websockets.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PROFILE = """name = "stub"
model = "stub"

[dialect]
name = "openpi"

[[state]]
key = "observation/state"
vectors = ["observation"]

[action]
size = 4
arm = "vector"

[chunk]
execute = 5
"""

STUB = """
import sys, time
import numpy as np
import robogate_eval

class Stub:
    def predict_batch(self, observations):
        time.sleep(float(sys.argv[1]) / 1000.0)
        return [np.full((5, 4), np.sin(observation["observation/state"][0])) for observation in observations]

robogate_eval.serve(Stub(), bind="ws://127.0.0.1:*", batch=256)
"""


def measure(arguments: argparse.Namespace, folder: Path, in_flight: int) -> dict[str, float]:
    """One campaign. Returns its time, the requests, the mean batch and the share of the time in which the stub computes."""
    package = Path(__file__).resolve().parent.parent / "python" / "src"
    environment = {**os.environ, "PYTHONPATH": str(package)}
    stub = [sys.executable, "-c", STUB, str(arguments.compute_ms)]
    with subprocess.Popen(stub, stdout=subprocess.PIPE, text=True, env=environment) as server:
        assert server.stdout is not None
        address = json.loads(server.stdout.readline())["address"]
        command = [
            arguments.robogate, "run", "--env", arguments.env, "--python", arguments.python, "--policy", address, "--profile",
            str(folder / "stub.toml"), "--in-flight", str(in_flight), "-n", str(arguments.episodes), "--design", "uniform",
            "--nominal-episodes", "0", "--continue", "--out", str(folder / f"run-{in_flight}"),
        ]
        began = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        took_s = time.monotonic() - began
        server.send_signal(2)
        lines = [json.loads(line) for line in server.stdout.read().splitlines()]
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    said = [line for line in done.stderr.splitlines() if line.startswith("policy servers:")]
    print("\n".join(said), file=sys.stderr)
    return {"time_s": took_s, **lines[-1]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robogate")
    parser.add_argument("--python", required=True)
    parser.add_argument("--env", default="metaworld:reach-v3")
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--compute-ms", type=float, default=60.0)
    parser.add_argument("--in-flight", default="1,8,32")
    arguments = parser.parse_args()
    print(f"{arguments.env}, {arguments.episodes} episodes, {arguments.compute_ms:g} ms for a batch, {os.cpu_count()} cores\n")
    print("| in flight | time | ratio | requests | batch | of N | server |")
    print("|---:|---:|---:|---:|---:|---:|---:|")
    first = None
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "stub.toml").write_text(PROFILE, encoding="utf-8")
        for text in arguments.in_flight.split(","):
            in_flight = int(text)
            found = measure(arguments, Path(folder), in_flight)
            first = first or found["time_s"]
            batch = found["mean_batch"]
            print(
                f"| {in_flight} | {found['time_s']:.0f} s | {first / found['time_s']:.1f} | {found['requests']:.0f} | {batch:.1f} | "
                f"{batch / in_flight:.2f} | {100 * found['busy']:.0f} % |",
                flush=True,
            )


if __name__ == "__main__":
    main()
