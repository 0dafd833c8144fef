"""Trains small models of Stable-Baselines3 and sb3_contrib, judges them by `--policy sb3:`, and compares each episode with a plain loop.

    ROBOGATE=target/release/robogate PYTHONPATH=python/src PYTHON scripts/learned/sb3_agreement.py OUT [EPISODES]

PYTHON has stable-baselines3, sb3-contrib, pyyaml, pyzmq and msgpack. Writes OUT/agreement.md, the table of docs/results/environments.md.
Exit code 1: an episode differs.
"""

import datetime
import importlib.metadata
import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE / "lerobot"), str(HERE / "plug_in")]
from agreement import SPACE, robogate, rows  # noqa: E402

ENVIRONMENT, SEED = "gymnasium:point_reach:PointReach-v0", 5


def plain_loop(model, episodes, wrap=lambda env: env, statistics=None):
    """Success and number of steps of each episode, up to its first success, as in the documentation of Stable-Baselines3."""
    import gymnasium
    from robogate_bridge import Scenario
    from robogate_eval.serving.adapter import _seed
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    vec = DummyVecEnv([lambda: wrap(gymnasium.make("PointReach-v0"))])
    if statistics is not None:
        vec = VecNormalize.load(str(statistics), vec)
        vec.training, vec.norm_reward = False, False
    found = []
    for index in range(episodes):
        vec.seed(_seed(Scenario(index, SEED, {})))
        observation, done, success, steps = vec.reset(), False, False, 0
        while not done and not success:
            observation, _, (done,), (info,) = vec.step(model.predict(observation, deterministic=True)[0])
            success, steps = bool(info["is_success"]), steps + 1
        found.append((success, steps))
    return found


def models(out):
    """Name, path, model, wrapper and statistics of each model, trained so that they succeed in some episodes and not in others."""
    import gymnasium
    import point_reach  # noqa: F401
    import sb3_contrib
    import stable_baselines3
    from sb3_contrib.common.wrappers import TimeFeatureWrapper
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    make = lambda: gymnasium.make("PointReach-v0")
    small = {"seed": 1, "device": "cpu", "policy_kwargs": {"net_arch": [32]}}
    vec = VecNormalize(DummyVecEnv([make]))
    ppo = stable_baselines3.PPO("MultiInputPolicy", vec, n_steps=512, batch_size=128, learning_rate=3e-3, **small).learn(6144)
    (out / "ppo").mkdir()
    ppo.save(out / "ppo" / "model.zip")
    vec.save(str(out / "ppo" / "vecnormalize.pkl"))
    yield "PPO with VecNormalize", out / "ppo" / "model.zip", ppo, lambda env: env, out / "ppo" / "vecnormalize.pkl"
    zoo = out / "PointReach-v0_1"
    (zoo / "PointReach-v0").mkdir(parents=True)
    tqc = sb3_contrib.TQC("MultiInputPolicy", TimeFeatureWrapper(make()), replay_buffer_class=stable_baselines3.HerReplayBuffer,
                          learning_starts=100, learning_rate=3e-3, gamma=0.9, **small).learn(600)  # fmt: skip
    tqc.save(zoo / "PointReach-v0.zip")
    (zoo / "PointReach-v0" / "config.yml").write_text(
        "!!python/object/apply:collections.OrderedDict\n- - - env_wrapper\n    - sb3_contrib.common.wrappers.TimeFeatureWrapper\n  - - n_timesteps\n    - 600.0\n"
    )
    yield "TQC with hindsight replay and time feature, a folder of RL Baselines3 Zoo", zoo, tqc, TimeFeatureWrapper, None


def main():
    out, episodes = Path(sys.argv[1]).resolve(), int(sys.argv[2]) if len(sys.argv) > 2 else 40
    out.mkdir(parents=True, exist_ok=True)
    os.environ |= {"PYTHONPATH": os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(HERE / "plug_in")]), "OMP_NUM_THREADS": "1"}
    import torch

    torch.set_num_threads(1)
    (out / "space.toml").write_text(SPACE)
    version = importlib.metadata.version
    lines = [
        f"Written by `scripts/learned/sb3_agreement.py` on {datetime.date.today()}: Stable-Baselines3 {version('stable-baselines3')}, sb3_contrib {version('sb3-contrib')}, {episodes} episodes on the same seeds.\n",
        "| model | successes in a plain loop | successes with `--policy sb3:` | episodes with another outcome or number of steps |",
        "|---|---|---|---|",
    ]
    different = 0
    for name, path, model, wrap, statistics in models(out):
        expected = plain_loop(model, episodes, wrap, statistics)
        folder = out / f"{path.parent.name}-{path.stem}-run"
        robogate("run", "--env", ENVIRONMENT, "--python", sys.executable, "--policy", f"sb3:{path}", "--space", out / "space.toml", "-n", episodes,
                 "--seed", SEED, "--threads", 1, "--out", folder)  # fmt: skip
        found = rows(folder, 10)
        wrong = sum(one != other for one, other in zip(found, expected, strict=True))
        different += wrong
        lines.append(f"| {name} | {sum(success for success, _ in expected)} | {sum(success for success, _ in found)} | {wrong} |")
    (out / "agreement.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
