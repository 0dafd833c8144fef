"""LeRobot's environments and policies: the same episodes as in LeRobot's own evaluation.

Needs a Python with lerobot, gym-pusht, pyzmq and msgpack. A small ACT is trained here in seconds.
"""

import csv
import importlib.util
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

MISSING = [name for name in ("lerobot", "gym_pusht", "zmq", "msgpack") if importlib.util.find_spec(name) is None]

if not MISSING:
    import numpy as np
    import torch
    from robogate_bridge import Action, Problem, Scenario, declaration
    from robogate_eval import judging, policies
    from robogate_eval.environments import UnknownEnvironment, find, with_policy
    from robogate_eval.lerobot.policy import load, version
    from robogate_eval.serving.adapter import Adapter, _seed

ENVIRONMENT = "lerobot:pusht?obs_type=environment_state_agent_pos&episode_length=40"
PIXELS = "lerobot:pusht?episode_length=6"
EPISODES = 4


def features(environment):
    """Input and output features of a policy for an environment, as LeRobot derives them."""
    from lerobot.configs.types import FeatureType
    from lerobot.envs.utils import env_to_policy_features

    found = env_to_policy_features(environment.make().lerobot_config)
    outputs = {name: feature for name, feature in found.items() if feature.type is FeatureType.ACTION}
    return {name: feature for name, feature in found.items() if name not in outputs}, outputs


def train(environment, folder, kind="act", **options):
    """Train a small policy to push towards the block for a few steps, and save it with its normalisation."""
    from lerobot.policies.factory import get_policy_class, make_policy_config, make_pre_post_processors

    torch.manual_seed(1)
    inputs, outputs = features(environment)
    config = make_policy_config(kind, input_features=inputs, output_features=outputs, device="cpu", **options)
    policy = get_policy_class(config.type)(config)
    stats = {name: {"mean": torch.full((feature.shape[0], *[1] * (len(feature.shape) - 1)), 0.5 if len(feature.shape) == 3 else 250.0),
                    "std": torch.full((feature.shape[0], *[1] * (len(feature.shape) - 1)), 0.3 if len(feature.shape) == 3 else 120.0)}
             for name, feature in {**inputs, **outputs}.items()}  # fmt: skip
    for of in stats.values():
        of |= {"min": of["mean"] - of["std"], "max": of["mean"] + of["std"]}
    before, after = make_pre_post_processors(config, dataset_stats=stats)
    if kind == "act":
        optimizer = torch.optim.Adam(policy.parameters(), lr=3e-3)
        policy.train()
        for _ in range(60):
            state = 500.0 * torch.rand(16, 2)
            block = 500.0 * torch.rand(16, 16)
            chunk = torch.stack([state + (block[:, :2] - state) * (step + 1) / 8 for step in range(8)], dim=1)
            batch = before({"observation.state": state, "observation.environment_state": block, "action": chunk})
            batch["action_is_pad"] = torch.zeros(16, 8, dtype=torch.bool)
            loss, _ = policy.forward(batch)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    policy.save_pretrained(folder)
    before.save_pretrained(folder)
    after.save_pretrained(folder)


SMALL = {"dim_model": 32, "n_heads": 2, "dim_feedforward": 64, "n_encoder_layers": 1, "n_decoder_layers": 1, "use_vae": False,
         "chunk_size": 8, "n_action_steps": 3}  # fmt: skip


def of_robogate(adapter, index):
    """The actions of an episode of the policy `own`, its success and its number of steps."""
    step, actions = adapter.reset(Scenario(index, 1, {}, policy="own")), []
    while step.get("ending") is None:
        actions.append(step["proposed"]["action"])
        step = adapter.step(Action("vector", actions[-1]))
    return np.array(actions), step["ending"]["failure"] is None


def of_lerobot(config, folder, index):
    """The same by LeRobot's own evaluation loop."""
    from lerobot.envs.factory import make_env, make_env_pre_post_processors
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.scripts.lerobot_eval import rollout

    policy = load(folder)
    before, after = make_pre_post_processors(policy.config, pretrained_path=str(folder))
    env = next(iter(make_env(config, n_envs=1).values()))[0]
    seed = _seed(Scenario(index, 1, {}))
    torch.manual_seed(seed)
    found = rollout(env, policy, *make_env_pre_post_processors(config, policy.config), before, after, seeds=[seed])
    env.close()
    done = found["done"][0].tolist()
    steps = done.index(True) + 1 if True in done else len(done)
    return found["action"][0, :steps].numpy(), bool(found["success"][0, :steps].any())


@unittest.skipIf(MISSING, f"missing: {', '.join(MISSING)}")
class LeRobot(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        # As in a process of the command: the last bits of a network depend on the number of threads.
        torch.set_num_threads(1)
        cls.place = tempfile.TemporaryDirectory()
        cls.folder = Path(cls.place.name) / "act"
        cls.environment = find(ENVIRONMENT)
        train(cls.environment, cls.folder, **SMALL)

    @classmethod
    def tearDownClass(cls):
        cls.place.cleanup()

    def assert_equal_episodes(self, name, folder):
        adapter = Adapter(with_policy(find(name), f"own=lerobot:{folder}"))
        declaration.hello(adapter.hello())
        config = find(name).make().lerobot_config
        low, high = adapter._actions.low, adapter._actions.high
        for index in range(EPISODES):
            actions, success = of_robogate(adapter, index)
            expected, expected_success = of_lerobot(config, folder, index)
            self.assertEqual((len(actions), success), (len(expected), expected_success), f"episode {index}")
            np.testing.assert_array_equal(actions, np.clip(expected.astype(float), low, high), err_msg=f"episode {index}")

    def test_episodes_are_those_of_lerobot(self):
        self.assert_equal_episodes(ENVIRONMENT, self.folder)

    def test_images_are_those_of_lerobot(self):
        folder = Path(self.place.name) / "pixels"
        train(find(PIXELS), folder, "diffusion", down_dims=(32, 64), horizon=8, n_action_steps=4, num_inference_steps=2, crop_shape=(84, 84),
              pretrained_backbone_weights=None, spatial_softmax_num_keypoints=4)  # fmt: skip
        # It samples its actions: the seed of the episode is that of the noise.
        self.assert_equal_episodes(PIXELS, folder)

    def test_policies_without_a_server_work(self):
        from lerobot.async_inference.constants import SUPPORTED_POLICIES

        self.assertNotIn("gaussian_actor", SUPPORTED_POLICIES)
        folder = Path(self.place.name) / "gaussian"
        train(self.environment, folder, "gaussian_actor", state_encoder_hidden_dim=16, latent_dim=16)
        self.assert_equal_episodes(ENVIRONMENT, folder)

    @unittest.skipUnless(os.environ.get("ROBOGATE_COMMAND"), "ROBOGATE_COMMAND names no command")
    def test_command_and_function_agree_with_lerobot(self):
        """The command loads the checkpoint itself; the function is given the policy."""

        def rows(name, *options):
            out = Path(self.place.name) / name
            command = [os.environ["ROBOGATE_COMMAND"], "run", "--out", str(out), "-n", str(2 * EPISODES), "--seed", "1", "--threads", "1", *options]
            subprocess.run(command, check=True, capture_output=True)
            table = out.with_suffix(".csv")
            subprocess.run([command[0], "export", str(out), str(table)], check=True, capture_output=True)
            with open(table, newline="", encoding="utf-8") as file:
                return {int(row["index"]): row for row in csv.DictReader(file)}

        loaded = rows("loaded", "--env", ENVIRONMENT, "--policy", f"lerobot:{self.folder}", "--python", sys.executable)
        policy = policies.load(f"lerobot:{self.folder}")
        with judging._served(ENVIRONMENT, policy) as (address, chosen):
            given = rows("given", "--simulator", address, "--policy", chosen)
        compared, config = 0, self.environment.make().lerobot_config
        for index, row in loaded.items():
            for column in ("outcome", "cycle_time_s", "trajectory_hash", "action_delay"):
                self.assertEqual(row[column], given[index][column], f"episode {index}, {column}")
            if float(row["action_delay"]) == 0.0:
                actions, success = of_lerobot(config, self.folder, index)
                self.assertEqual((round(float(row["cycle_time_s"]) * config.fps), row["outcome"] == "success"), (len(actions), success), f"episode {index}")
                compared += 1
        self.assertGreater(compared, 1)

    def test_version_follows_from_the_files(self):
        before = version(self.folder)
        (self.folder / "note.txt").write_text("changed", encoding="utf-8")
        self.assertNotEqual(version(self.folder), before)
        (self.folder / "note.txt").unlink()
        self.assertEqual(version(self.folder), before)

    def test_loaded_policy_is_a_function(self):
        world = self.environment.make()
        observation, _ = world.reset(seed=3)
        action = policies.as_function(policies.load(f"lerobot:{self.folder}"), world)(observation)
        self.assertEqual((action.shape, action.dtype), ((2,), np.float32))

    def test_errors_name_what_exists(self):
        with self.assertRaisesRegex(UnknownEnvironment, "Did you mean lerobot:pusht"):
            find("lerobot:pust")
        with self.assertRaisesRegex(UnknownEnvironment, "'size=3' is not an argument. Expected key=value with one of: .*obs_type"):
            find("lerobot:pusht?size=3")
        with self.assertRaisesRegex(UnknownEnvironment, "downloads its code"):
            find("lerobot:isaaclab_arena")
        with self.assertRaisesRegex(ValueError, "not a checkpoint of LeRobot"):
            policies.load(f"lerobot:{self.place.name}/none")
        pixels = Adapter(with_policy(find(PIXELS), f"own=lerobot:{self.folder}"))
        with self.assertRaisesRegex(Exception, "expects observation.environment_state"):
            pixels.reset(Scenario(0, 1, {}, policy="own"))
        self.assertTrue(issubclass(Problem, Exception))


if __name__ == "__main__":
    unittest.main()
