"""Trains a Stable-Baselines3 policy for Fetch's reach task and judges it before and after more training: environments_sb3.py OUT [FEW] [MORE].

SAC with hindsight replay on the CPU: FEW steps (default 1,500), then MORE in all (default 6,000). Both policies run the same 200 episodes, over the action
delay and the noise of the observation, and are compared pair by pair. Writes OUT/sb3.md, a section of docs/results/environments.md. Needs the
packages of scripts/environments/sb3-requirements.txt, `robogate_eval` on PYTHONPATH, and the command (ROBOGATE_COMMAND, or on PATH).
"""

import datetime
import importlib.metadata
import json
import subprocess
import sys
import time
from pathlib import Path

import gymnasium
import gymnasium_robotics
import torch
from stable_baselines3 import SAC, HerReplayBuffer

import robogate_eval
from robogate_eval._command import command as robogate

ENVIRONMENT = "fetch:FetchReach-v4"
EPISODES = 200
GATE_SEED = 7


def judged(model, folder):
    """The run of a model, with a plan without a boundary stage, so that both runs have the same scenarios."""
    plan = folder.parent / "plan.toml"
    plan.write_text(f"seed = {GATE_SEED}\n[uniform]\nepisodes = {EPISODES}\n[boundary]\nepisodes = 0\n", encoding="utf-8")
    return robogate_eval.run(ENVIRONMENT, model, out=folder, plan=plan)


def section(out, trained):
    """The section of the page: `trained` has name, steps and CPU time in s of each policy."""
    pair = json.loads((out / "compare.json").read_text(encoding="utf-8"))["paired"][0]
    low, high = (100 * end for end in pair["difference_95"])
    lines = [
        "## A policy of Stable-Baselines3, before and after more training\n",
        f"Written by `scripts/environments_sb3.py` on {datetime.date.today()}: SAC with hindsight replay for `{ENVIRONMENT}`, Stable-Baselines3",
        f"{importlib.metadata.version('stable-baselines3')}, on one thread of the CPU. Both policies run the same {EPISODES} episodes, over the action delay and the noise of the",
        "observation.\n",
        "| policy | training steps | CPU time of the training | success over the space (95 % interval) |",
        "|---|---|---|---|",
    ]
    for name, steps, seconds in trained:
        run = robogate_eval.load(out / name)
        ends = [100 * end for end in run.interval_95]
        lines.append(f"| {name} | {steps:,} | {seconds:.0f} s | {100 * run.success_rate:.1f} % ({ends[0]:.1f} to {ends[1]:.1f} %) |")
    lines += [
        f"\nPair by pair (`robogate compare --paired`): {pair['both']} episodes succeeded with both, {pair['first_only']} only before, {pair['second_only']} only after, {pair['neither']} with neither.",
        f"The difference, before minus after, is {100 * pair['difference']:.1f} % ({low:.1f} to {high:.1f} %), p = {pair['adjusted_p']:.1g}.",
    ]
    return "\n".join(lines) + "\n"


def main():
    out = Path(sys.argv[1])
    few, more = (int(sys.argv[i]) if len(sys.argv) > i else default for i, default in ((2, 1500), (3, 6000)))
    out.mkdir(parents=True, exist_ok=True)
    gymnasium.register_envs(gymnasium_robotics)
    torch.set_num_threads(1)
    model = SAC(
        "MultiInputPolicy", gymnasium.make("FetchReach-v4"), replay_buffer_class=HerReplayBuffer, learning_starts=500, batch_size=256,
        gamma=0.95, learning_rate=1e-3, policy_kwargs={"net_arch": [64, 64]}, seed=1,
    )  # fmt: skip
    trained, seconds = [], 0.0
    for name, steps in (("before", few), ("after", more)):
        began = time.process_time()
        model.learn(steps - model.num_timesteps, reset_num_timesteps=False)
        seconds += time.process_time() - began
        model.save(out / f"{name}.zip")
        trained.append((name, steps, seconds))
        judged(model, out / name)
    command = [str(robogate()), "compare", str(out / "before"), str(out / "after"), "--paired", "--json", "--names", "before,after", "--no-replay"]
    compared = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    (out / "compare.json").write_text(compared, encoding="utf-8")
    (out / "sb3.md").write_text(section(out, trained), encoding="utf-8")


if __name__ == "__main__":
    main()
