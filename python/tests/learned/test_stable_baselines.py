"""Models of Stable-Baselines3 and sb3_contrib: the same actions as in a plain loop around the environment of the training.

Needs a Python with stable-baselines3, sb3-contrib and pyyaml.
"""

import importlib.util
import shutil
import tempfile
import unittest
from pathlib import Path

MISSING = [name for name in ("stable_baselines3", "sb3_contrib", "yaml") if importlib.util.find_spec(name) is None]

if not MISSING:
    import gymnasium
    import numpy as np
    import sb3_contrib
    import stable_baselines3
    from robogate_eval import policies, stable_baselines
    from sb3_contrib.common.wrappers import TimeFeatureWrapper
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    class Reach(gymnasium.Env):
        """A point that a policy moves to a goal, observed as hindsight replay needs it."""

        action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
        observation_space = gymnasium.spaces.Dict(observation=action_space, achieved_goal=action_space, desired_goal=action_space)

        def _seen(self):
            return {"observation": self.point.copy(), "achieved_goal": self.point.copy(), "desired_goal": self.goal}

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.steps = 0
            self.point, self.goal = self.np_random.uniform(-1.0, 1.0, (2, 2)).astype(np.float32)
            return self._seen(), {}

        def step(self, action):
            self.steps += 1
            self.point = np.clip(self.point + 0.1 * action, -1.0, 1.0).astype(np.float32)
            reward = float(self.compute_reward(self.point, self.goal, {}))
            return self._seen(), reward, False, self.steps == 40, {"is_success": reward == 0.0}

        def compute_reward(self, achieved, desired, _):
            return -(np.linalg.norm(achieved - desired, axis=-1) > 0.1).astype(np.float32)

    class Picture(gymnasium.ObservationWrapper):
        """CartPole as a small image, with the channels last."""

        def __init__(self):
            super().__init__(gymnasium.make("CartPole-v1"))
            self.observation_space = gymnasium.spaces.Box(0, 255, (36, 40, 3), np.uint8)

        def observation(self, observation):
            return np.tile((40.0 * (observation[:3] + 3.0)).clip(0, 255).astype(np.uint8), (36, 40, 1))

    class Masked(gymnasium.Wrapper):
        """CartPole where each second action must be 0."""

        steps = 0

        def reset(self, **options):
            self.steps = 0
            return self.env.reset(**options)

        def step(self, action):
            self.steps += 1
            return self.env.step(action)

        def action_masks(self):
            return np.array([True, self.steps % 2 == 0])

TASK = "Pendulum-v1"
STEPS = 30


def plain_loop(model, env, statistics=None, recurrent=False):
    """Actions of a model in its own environment, as in the documentation of Stable-Baselines3."""
    vec = DummyVecEnv([lambda: env])
    if statistics:
        vec = VecNormalize.load(statistics, vec)
        vec.training, vec.norm_reward = False, False
    vec.seed(3)
    observation, actions, state, first = vec.reset(), [], None, np.ones(1, dtype=bool)
    for _ in range(STEPS):
        action, state = model.predict(observation, state=state, episode_start=first, deterministic=True)
        actions.append(action[0])
        observation, _, first, _ = vec.step(action)
    return np.array(actions)


def of_robogate(policy, env):
    """Actions of a loaded policy in the environment without wrappers."""
    observation, _ = env.reset(seed=3)
    act, actions = policies.as_function(policy, env), []
    for _ in range(STEPS):
        actions.append(act(observation))
        observation = env.step(actions[-1])[0]
    return np.array(actions)


@unittest.skipIf(MISSING, f"missing: {', '.join(MISSING)}")
class StableBaselines(unittest.TestCase):
    def setUp(self):
        place = tempfile.TemporaryDirectory()
        self.addCleanup(place.cleanup)
        self.folder = Path(place.name)

    def assert_same(self, loaded, expected, make=lambda: gymnasium.make(TASK)):
        np.testing.assert_allclose(of_robogate(loaded, make()), expected, rtol=1e-5, atol=1e-6)

    def test_algorithms_are_recognised(self):
        for module, name, policy, options in [
            (stable_baselines3, "PPO", "MlpPolicy", {"n_steps": 64, "batch_size": 32}),
            (stable_baselines3, "A2C", "MlpPolicy", {}),
            (sb3_contrib, "TRPO", "MlpPolicy", {"n_steps": 64, "batch_size": 32}),
            (sb3_contrib, "TQC", "MlpPolicy", {"learning_starts": 10}),
            (sb3_contrib, "CrossQ", "MlpPolicy", {"learning_starts": 10}),
            (sb3_contrib, "ARS", "LinearPolicy", {"n_delta": 1}),
            (sb3_contrib, "RecurrentPPO", "MlpLstmPolicy", {"n_steps": 64, "batch_size": 32}),
        ]:
            kwargs = {} if name in ("ARS", "CrossQ") else {"policy_kwargs": {"net_arch": [8]}}
            model = getattr(module, name)(policy, TASK, seed=1, device="cpu", **options, **kwargs).learn(64)
            file = self.folder / f"{name}.zip"
            model.save(file)
            loaded = policies.load(file)
            self.assertEqual(type(loaded.model).__name__, name)
            self.assert_same(loaded, plain_loop(model, gymnasium.make(TASK)))

    def saved(self, model):
        model.save(self.folder / "model.zip")
        return policies.load(self.folder / "model.zip")

    def test_discrete_actions_are_those_of_a_plain_loop(self):
        for module, name in ((stable_baselines3, "DQN"), (sb3_contrib, "QRDQN")):
            model = getattr(module, name)("MlpPolicy", "CartPole-v1", learning_starts=10, seed=1, device="cpu", policy_kwargs={"net_arch": [8]}).learn(60)
            loaded = self.saved(model)
            self.assertEqual(type(loaded.model).__name__, name)
            self.assert_same(loaded, plain_loop(model, gymnasium.make("CartPole-v1")), lambda: gymnasium.make("CartPole-v1"))
        make = lambda: Masked(gymnasium.make("CartPole-v1"))
        model = sb3_contrib.MaskablePPO("MlpPolicy", make(), n_steps=32, batch_size=16, seed=1, device="cpu", policy_kwargs={"net_arch": [8]}).learn(32)
        env, expected = make(), []
        observation, _ = env.reset(seed=3)
        for _ in range(STEPS):
            expected.append(model.predict(observation, action_masks=env.action_masks(), deterministic=True)[0])
            observation = env.step(expected[-1])[0]
        self.assert_same(self.saved(model), np.array(expected), make)
        self.assertFalse(np.array(expected)[1::2].any())

    def test_hindsight_models_need_no_environment(self):
        options = {"replay_buffer_class": stable_baselines3.HerReplayBuffer, "replay_buffer_kwargs": {"n_sampled_goal": 2}, "learning_starts": 50}
        for module, name in ((stable_baselines3, "SAC"), (sb3_contrib, "TQC")):
            model = getattr(module, name)("MultiInputPolicy", Reach(), seed=1, device="cpu", policy_kwargs={"net_arch": [8]}, **options).learn(60)
            self.assert_same(self.saved(model), plain_loop(model, Reach()), Reach)

    def test_images_may_have_their_channels_last(self):
        model = stable_baselines3.PPO("CnnPolicy", Picture(), n_steps=8, batch_size=8, n_epochs=1, seed=1, device="cpu").learn(8)
        self.assert_same(self.saved(model), plain_loop(model, Picture()), Picture)

    def test_statistics_of_a_checkpoint_are_its_own(self):
        from stable_baselines3.common.callbacks import CheckpointCallback

        vec = VecNormalize(DummyVecEnv([lambda: gymnasium.make(TASK)]))
        model = stable_baselines3.PPO("MlpPolicy", vec, n_steps=64, batch_size=64, seed=1, device="cpu")
        model.learn(128, callback=CheckpointCallback(64, str(self.folder), save_vecnormalize=True))
        earlier = stable_baselines3.PPO.load(self.folder / "rl_model_64_steps.zip", device="cpu")
        expected = plain_loop(earlier, gymnasium.make(TASK), str(self.folder / "rl_model_vecnormalize_64_steps.pkl"))
        self.assert_same(policies.load(self.folder / "rl_model_64_steps.zip"), expected)

    def test_statistics_beside_a_model_are_used(self):
        vec = VecNormalize(DummyVecEnv([lambda: gymnasium.make(TASK)]))
        model = stable_baselines3.PPO("MlpPolicy", vec, n_steps=128, batch_size=64, seed=1, device="cpu").learn(512)
        model.save(self.folder / "model.zip")
        without = of_robogate(policies.load(self.folder / "model.zip"), gymnasium.make(TASK))
        vec.save(str(self.folder / "vecnormalize.pkl"))
        expected = plain_loop(model, gymnasium.make(TASK), str(self.folder / "vecnormalize.pkl"))
        self.assert_same(policies.load(self.folder / "model.zip"), expected)
        self.assertGreater(np.abs(without - expected).max(), 0.01)
        shutil.move(self.folder / "vecnormalize.pkl", self.folder / "other.pkl")
        self.assert_same(stable_baselines.load(self.folder / "model.zip", statistics=self.folder / "other.pkl"), expected)
        # The version of the policy names the statistics too.
        self.assertNotEqual(policies._version([self.folder / "model.zip"]), policies._version([self.folder / "model.zip", self.folder / "other.pkl"]))

    def zoo(self, config):
        """A folder as RL Baselines3 Zoo writes it, with a model of the time feature."""
        env = TimeFeatureWrapper(gymnasium.make(TASK))
        model = sb3_contrib.TQC("MlpPolicy", env, learning_starts=10, seed=1, device="cpu", policy_kwargs={"net_arch": [8]}).learn(40)
        model.save(self.folder / f"{TASK}.zip")
        model.save(self.folder / "rl_model_40_steps.zip")
        (self.folder / TASK).mkdir(exist_ok=True)
        head = "!!python/object/apply:collections.OrderedDict\n- - - n_timesteps\n    - 40\n"
        (self.folder / TASK / "config.yml").write_text(head + config, encoding="utf-8")
        return model

    def test_zoo_folder_has_its_time_feature(self):
        model = self.zoo("  - - env_wrapper\n    - sb3_contrib.common.wrappers.TimeFeatureWrapper\n")
        self.assert_same(policies.load(f"sb3:{self.folder}"), plain_loop(model, TimeFeatureWrapper(gymnasium.make(TASK))))

    def test_zoo_folder_has_its_arguments(self):
        self.zoo("  - - env_wrapper\n    - sb3_contrib.common.wrappers.TimeFeatureWrapper\n")
        head = "!!python/object/apply:collections.OrderedDict\n- - - algo\n    - tqc\n  - - conf\n    - !!python/name:builtins.print\n  - - env_kwargs\n"
        (self.folder / TASK / "args.yml").write_text(f"{head}    - g: 9.0\n", encoding="utf-8")
        loaded = policies.load(f"sb3:{self.folder}")
        self.assertIsNotNone(policies.as_function(loaded, gymnasium.make(TASK, g=9.0)))
        with self.assertRaisesRegex(ValueError, rf"with g = 9.0 .*gymnasium:{TASK}\?g=9.0"):
            policies.as_function(loaded, gymnasium.make(TASK))
        # A class of the user's own shows its arguments as attributes.
        own = gymnasium.make(TASK).unwrapped
        own.spec = None
        with self.assertRaisesRegex(ValueError, "does not show that it has them"):
            loaded.check(own)
        own.g = 9.0
        loaded.check(own)

    def test_what_is_not_known_is_refused(self):
        self.zoo("  - - normalize\n    - true\n")
        with self.assertRaisesRegex(ValueError, "trained with normalised observations, but there is no vecnormalize.pkl"):
            policies.load(f"sb3:{self.folder}")
        for config, reason in [
            ("  - - frame_stack\n    - 4\n", "stacked frames"),
            ("  - - env_wrapper\n    - gym.wrappers.Other\n", "trained with the wrapper gym.wrappers.Other"),
            ("  - - vec_env_wrapper\n    - a.VecFrameStack\n", "the wrapper a.VecFrameStack around several environments"),
            ("  - - x\n    - !!python/object/apply:os.system ['true']\n", "not the settings of RL Baselines3 Zoo"),
        ]:
            (self.folder / TASK / "config.yml").write_text(
                f"!!python/object/apply:collections.OrderedDict\n- - - n_timesteps\n    - 40\n{config}", encoding="utf-8"
            )
            with self.assertRaisesRegex(ValueError, reason):
                policies.load(f"sb3:{self.folder}")
        (self.folder / TASK / "config.yml").unlink()
        loaded, env = policies.load(f"sb3:{self.folder}"), gymnasium.make(TASK)
        with self.assertRaisesRegex(ValueError, r"shape \(4,\), but the environment observes \(3,\). If it was trained with the remaining time"):
            policies.as_function(loaded, env)(env.reset(seed=1)[0])
        # The same before the first episode.
        with self.assertRaisesRegex(ValueError, r"shape \(4,\), but the environment observes \(3,\)"):
            loaded.check(env)
        shutil.copy(self.folder / f"{TASK}.zip", self.folder / "second.zip")
        with self.assertRaisesRegex(ValueError, "expected one model"):
            policies.load(f"sb3:{self.folder}")


if __name__ == "__main__":
    unittest.main()
