"""Trains a small ACT with LeRobot, judges it in all ways that RoboGate has, and compares each episode with LeRobot's own evaluation.

    ROBOGATE=target/release/robogate PYTHONPATH=python/src PYTHON scripts/learned/lerobot/agreement.py OUT [EPISODES]

PYTHON has lerobot, grpcio, protobuf, pyzmq and msgpack. Writes OUT/agreement.md, the table of docs/results/learned-policy.md.
Exit code 1: an episode differs.
"""

import csv
import datetime
import importlib.metadata
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
# LeRobot finds plug-ins by their metadata.
METADATA = "Metadata-Version: 2.1\nName: lerobot_env_reach\nVersion: 0.1\n"
ENVIRONMENT, SEED, CHUNK, EXECUTED, TRAINING_STEPS = "lerobot:reach", 5, 8, 4, 22
# Nothing varies but the start, which follows from the seed.
SPACE = 'name = "nominal"\n[[parameter]]\nname = "action_delay"\nkind = "integer"\nlow = 0\nhigh = 0\n'
PROFILE = """name = "act-reach"
model = "A small ACT"
[dialect]
name = "lerobot"
policy_type = "act"
checkpoint = "{checkpoint}"
device = "cpu"
[[camera]]
from = "pixels.front"
key = "front"
width = 32
height = 32
[[state]]
key = "state"
vectors = ["agent_pos"]
[action]
size = 2
arm = "vector"
[chunk]
length = {length}
execute = {executed}
"""


def train(folder):
    """Train an ACT for a few seconds, so that it reaches some goals and not others, and save it with its processors."""
    import numpy as np
    import torch
    from lerobot.configs.types import FeatureType
    from lerobot.envs.utils import env_to_policy_features
    from lerobot.policies.factory import get_policy_class, make_policy_config, make_pre_post_processors
    from lerobot_env_reach import ReachConfig, demonstrations

    torch.manual_seed(1)
    features = env_to_policy_features(ReachConfig())
    outputs = {name: feature for name, feature in features.items() if feature.type is FeatureType.ACTION}
    config = make_policy_config(
        "act", input_features={name: feature for name, feature in features.items() if name not in outputs}, output_features=outputs, device="cpu",
        dim_model=32, n_heads=2, dim_feedforward=64, n_encoder_layers=1, n_decoder_layers=1, use_vae=False, chunk_size=CHUNK,
        n_action_steps=EXECUTED, pretrained_backbone_weights=None)  # fmt: skip
    policy = get_policy_class("act")(config)
    channels = {"mean": torch.full((3, 1, 1), 0.3), "std": torch.full((3, 1, 1), 0.3)}
    stats = {
        "observation.images.front": channels,
        "observation.state": {"mean": torch.zeros(4), "std": torch.full((4,), 0.6)},
        "action": {"mean": torch.zeros(2), "std": torch.full((2,), 0.8)},
    }
    before, after = make_pre_post_processors(config, dataset_stats=stats)
    optimizer, generator = torch.optim.Adam(policy.parameters(), lr=2e-3), np.random.default_rng(1)
    policy.train()
    for _ in range(TRAINING_STEPS):
        states, images, chunks = map(torch.as_tensor, demonstrations(32, CHUNK, generator))
        batch = before({
            "observation.state": states, "observation.images.front": images.permute(0, 3, 1, 2).float() / 255.0, "action": chunks,
            "action_is_pad": torch.zeros(len(states), CHUNK, dtype=torch.bool),
        })  # fmt: skip
        loss, _ = policy.forward(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    for part in (policy, before, after):
        part.save_pretrained(folder)


def of_lerobot(folder, episodes):
    """Success and number of steps of each episode in LeRobot's own loop."""
    import torch
    from lerobot.envs.factory import make_env, make_env_pre_post_processors
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.scripts.lerobot_eval import rollout
    from lerobot_env_reach import ReachConfig
    from robogate_bridge import Scenario
    from robogate_eval import policies
    from robogate_eval.serving.adapter import _seed

    config, policy, found = ReachConfig(), policies.load(f"lerobot:{folder}"), []
    policy.eval()
    around = (*make_env_pre_post_processors(config, policy.config), *make_pre_post_processors(policy.config, pretrained_path=str(folder)))
    env = next(iter(make_env(config, n_envs=1).values()))[0]
    for index in range(episodes):
        seed = _seed(Scenario(index, SEED, {}))
        torch.manual_seed(seed)
        result = rollout(env, policy, *around, seeds=[seed])
        done = result["done"][0].tolist()
        steps = done.index(True) + 1 if True in done else len(done)
        found.append((bool(result["success"][0, :steps].any()), steps))
    return found


def robogate(*arguments):
    done = subprocess.run([os.environ["ROBOGATE"], *map(str, arguments)], capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        sys.exit(f"robogate {arguments[0]} ended with {done.returncode}: {done.stderr[-2000:]}")


def rows(folder, fps):
    """Success and number of steps of each episode of a run."""
    table = folder.with_suffix(".csv")
    robogate("export", folder, table)
    with open(table, newline="", encoding="utf-8") as file:
        found = {int(row["index"]): (row["outcome"] == "success", round(float(row["cycle_time_s"]) * fps)) for row in csv.DictReader(file)}
    return [found[index] for index in sorted(found)]


class Server:
    """LeRobot's policy server."""

    def __init__(self, out):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        command = [sys.executable, "-m", "lerobot.async_inference.policy_server", "--host=127.0.0.1", f"--port={self.port}", "--fps=10", "--inference_latency=0"]
        self.process = subprocess.Popen(command, cwd=out, stdout=open(out / "server.log", "w"), stderr=subprocess.STDOUT)

    def __enter__(self):
        return f"grpc://127.0.0.1:{self.port}"

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait()


def main():
    out, episodes = Path(sys.argv[1]).resolve(), int(sys.argv[2]) if len(sys.argv) > 2 else 40
    plug_in = out / "plug_in"
    (plug_in / "lerobot_env_reach-0.1.dist-info").mkdir(parents=True)
    (plug_in / "lerobot_env_reach-0.1.dist-info" / "METADATA").write_text(METADATA)
    (plug_in / "lerobot_env_reach.py").write_text((HERE / "plug_in" / "lerobot_env_reach.py").read_text())
    sys.path.append(str(plug_in))
    os.environ |= {"PYTHONPATH": os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(plug_in)]), "OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"}
    import robogate_eval
    import torch
    from lerobot_env_reach import FPS
    from robogate_eval import policies

    torch.set_num_threads(1)
    os.environ["ROBOGATE_COMMAND"] = os.environ["ROBOGATE"]
    checkpoint = out / "act"
    began = time.process_time()
    train(checkpoint)
    trained_s = time.process_time() - began
    expected = of_lerobot(checkpoint, episodes)
    (out / "space.toml").write_text(SPACE)
    common = ("--env", ENVIRONMENT, "--python", sys.executable, "--space", out / "space.toml", "-n", episodes, "--seed", SEED, "--threads", 1)
    (out / "profile.toml").write_text(PROFILE.format(checkpoint=checkpoint, length=CHUNK, executed=EXECUTED))
    robogate("run", *common, "--policy", f"lerobot:{checkpoint}", "--out", out / "loaded")
    with Server(out) as address:
        robogate("run", *common, "--policy", address, "--profile", out / "profile.toml", "--wait", "5m", "--out", out / "served")
    robogate_eval.run(ENVIRONMENT, policies.load(f"lerobot:{checkpoint}"), episodes=episodes, out=out / "given", seed=SEED, space=out / "space.toml")
    ways = {"loaded": "`--policy lerobot:FOLDER`", "served": "LeRobot's `policy_server`, `--policy grpc://...`", "given": "`robogate_eval.run(env, policy)`"}
    version, succeeded = importlib.metadata.version, sum(success for success, _ in expected)
    lines = [
        f"Written by `scripts/learned/lerobot/agreement.py` on {datetime.date.today()}: LeRobot {version('lerobot')}, PyTorch {version('torch')} on one thread of the CPU. An ACT was trained",
        f"for {TRAINING_STEPS} steps ({trained_s:.0f} s) to move a point to a goal, in an environment that a plug-in adds to LeRobot. LeRobot's own `rollout`: {succeeded} of {episodes} succeeded.\n",
        "| way | episodes | successes | episodes with another outcome or number of steps |",
        "|---|---|---|---|",
    ]
    different = 0
    for name, way in ways.items():
        found = rows(out / name, FPS)
        wrong = sum(one != other for one, other in zip(found, expected, strict=True))
        different += wrong
        lines.append(f"| {way} | {len(found)} | {sum(success for success, _ in found)} | {wrong} |")
    (out / "agreement.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
