"""What this package expects of LeRobot and Stable-Baselines3, with small stand-ins for their modules.

The tests in python/tests/learned use the real packages, which CI does not install.
"""

import contextlib
import json
import os
import pickle
import sys
import tempfile
import types
import unittest
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import gymnasium
import numpy as np
from robogate_bridge import Action, Scenario
from robogate_eval import policies, stable_baselines
from robogate_eval.environments import UnknownEnvironment, find, with_policy
from robogate_eval.serving.adapter import Adapter

NEW_EPISODE = "lerobot_new_rollout"


class Tensor(np.ndarray):
    """The methods of a tensor that are used."""

    unsqueeze = lambda self, axis: np.expand_dims(self, axis)
    squeeze = lambda self, axis: np.asarray(self)[0].view(Tensor)
    to = cpu = lambda self, *_: self
    float = lambda self: self.astype(np.float32)
    numpy = lambda self: np.asarray(self)


def tensor(value, dtype=None):
    return np.asarray(value).view(Tensor)


class Toy(gymnasium.Env):
    """Ends after three steps. The success is an action of 1 in the last one."""

    observation_space = gymnasium.spaces.Dict({"agent_pos": gymnasium.spaces.Box(-1.0, 1.0, (2,))})
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    metadata = {"render_modes": [], "render_fps": 10}
    _max_episode_steps = 3
    executed = []
    task_description = "move"

    def observation(self):
        return {"agent_pos": np.array([self.start, 0.1 * self.steps], np.float32)}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.start, self.steps = self.np_random.uniform(-1.0, 1.0), 0
        return self.observation(), {}

    def step(self, action):
        self.steps += 1
        Toy.executed.append(float(action[0]))
        success = self.steps == 3 and bool(action[0] == 1.0)
        return self.observation(), 0.0, success, self.steps == 3, {"is_success": success}


class Frozen(gymnasium.Wrapper):
    """After an episode, a reset without the option of a new episode repeats the last observation: LeRobot's FreezeAfterEpisodeEnd."""

    frozen = None

    def reset(self, *, seed=None, options=None):
        if self.frozen is not None and not (options or {}).get(NEW_EPISODE):
            return self.frozen[0], {}
        self.frozen = None
        return self.env.reset(seed=seed)

    def step(self, action):
        if self.frozen is None:
            result = self.env.step(action)
            self.frozen = result if result[2] or result[3] else None
            return result
        return self.frozen


@dataclass
class ToyConfig:
    task: str = "toy"
    fps: int = 10
    features_map: dict = field(default_factory=dict)
    type = "toy"


class Rename:
    def __init__(self, rename_map):
        self.rename_map = rename_map


class Pipeline:
    def __init__(self, *steps):
        self.steps = steps

    def __call__(self, batch):
        for step in self.steps:
            batch = {step.rename_map.get(name, name): value for name, value in batch.items()}
        return batch


class Policy:
    """Acts with the last number of its input."""

    def __init__(self, config):
        self.config, self.seen = config, []

    def parameters(self):
        return iter([types.SimpleNamespace(device=types.SimpleNamespace(type="cpu"))])

    def eval(self):
        pass

    def reset(self):
        self.seen.clear()

    def select_action(self, batch):
        self.seen.append(batch)
        return batch["observation.state"][:, :1]


def stand_ins(stored=None):
    """The modules of torch and LeRobot that are used. `stored` is the map of names in the checkpoint."""
    choices = {"toy": ToyConfig}
    feature = types.SimpleNamespace(shape=(2,), type=types.SimpleNamespace(name="STATE"))
    amp = []

    def processors(config, pretrained_path, preprocessor_overrides):
        renames = preprocessor_overrides.get("rename_observations_processor", {"rename_map": stored or {}})["rename_map"]
        return Pipeline(Rename(renames)), lambda action: action

    class Config(types.SimpleNamespace):
        @staticmethod
        def from_pretrained(folder):
            settings = json.loads((folder / "config.json").read_text())
            return Config(input_features={"observation.state": feature}, type=settings["type"], use_amp=settings.get("use_amp", False))

    class Loaded(Policy):
        @classmethod
        def from_pretrained(cls, folder, config):
            return cls(config)

    @contextlib.contextmanager
    def autocast(device):
        amp.append(device)
        yield

    modules = {
        "torch": {"Tensor": Tensor, "as_tensor": tensor, "float32": np.float32, "cat": lambda parts: tensor(np.concatenate(parts)), "inference_mode": contextlib.nullcontext, "autocast": autocast, "manual_seed": lambda _: None},
        "lerobot": {},
        "lerobot.configs": {},
        "lerobot.configs.policies": {"PreTrainedConfig": Config},
        "lerobot.policies": {},
        "lerobot.policies.factory": {"get_policy_class": lambda _: Loaded, "make_pre_post_processors": processors},
        "lerobot.envs": {},
        "lerobot.envs.configs": {"EnvConfig": types.SimpleNamespace(get_known_choices=lambda: choices)},
        "lerobot.envs.factory": {
            "make_env_config": lambda kind, **fields: choices[kind](**fields),
            "make_env": lambda config, n_envs: {"toy": {0: types.SimpleNamespace(envs=[Frozen(Toy())])}},
            "make_env_pre_post_processors": lambda env_cfg, policy_cfg: (lambda batch: batch, lambda action: action),
        },
        "lerobot.envs.utils": {
            "NEW_ROLLOUT_OPTION": NEW_EPISODE,
            "preprocess_observation": lambda seen: {"observation.state": tensor(seen["agent_pos"])},
        },
        "lerobot.utils": {},
        # A plug-in of the user adds an environment.
        "lerobot.utils.import_utils": {"register_third_party_plugins": lambda: choices.setdefault("so101", ToyConfig)},
    }
    made = {}
    for name, content in modules.items():
        made[name] = types.ModuleType(name)
        vars(made[name]).update(content, __path__=[])
        parent, _, own = name.rpartition(".")
        if parent:
            setattr(made[parent], own, made[name])
    return made, amp


class LeRobot(unittest.TestCase):
    def setUp(self):
        place = tempfile.TemporaryDirectory()
        self.addCleanup(place.cleanup)
        self.folder = Path(place.name)
        (self.folder / "config.json").write_text(json.dumps({"type": "toy"}))
        self.use(stand_ins())

    def use(self, found):
        modules, self.amp = found
        patches = [mock.patch.dict(sys.modules, modules), mock.patch("robogate_eval.lerobot.world.installed", lambda name: f"{name} 0")]
        for patch in patches:
            patch.start()
            self.addCleanup(patch.stop)

    def test_each_episode_starts_anew(self):
        world = find("lerobot:toy").make()
        first, _ = world.reset(seed=1)
        for _ in range(3):
            world.step(np.zeros(1, np.float32))
        second, _ = world.reset(seed=2)
        self.assertNotEqual(first["agent_pos"][0], second["agent_pos"][0])
        self.assertEqual(second["agent_pos"][1], 0.0)

    def test_plug_ins_add_environments(self):
        self.assertEqual(find("lerobot:so101").task.control_period_s, 0.1)
        with self.assertRaisesRegex(UnknownEnvironment, "Did you mean lerobot:so101"):
            find("lerobot:so100")

    def test_checkpoint_acts_in_the_environment(self):
        environment = with_policy(find("lerobot:toy"), f"own=lerobot:{self.folder}")
        adapter = Adapter(environment)
        for index in range(2):
            step, actions = adapter.reset(Scenario(index, 1, {}, policy="own")), []
            start = step["observation"]["vectors"]["agent_pos"][0]
            while step.get("ending") is None:
                actions += step["proposed"]["action"]
                step = adapter.step(Action("vector", step["proposed"]["action"]))
            np.testing.assert_allclose(actions, [start] * 3)
            self.assertEqual(step["ending"], {"failure": "timeout"})
        # Its version is that of its files.
        (self.folder / "model.safetensors").write_bytes(b"0")
        self.assertNotEqual(with_policy(find("lerobot:toy"), f"own=lerobot:{self.folder}").policies["own"].version, environment.policies["own"].version)

    def test_actions_of_a_checkpoint_are_not_clipped(self):
        adapter = Adapter(with_policy(find("lerobot:toy"), f"own=lerobot:{self.folder}"))
        with mock.patch.object(Toy, "observation", lambda env: {"agent_pos": np.array([1.7, 0.0], np.float32)}):
            step = adapter.reset(Scenario(0, 1, {}, policy="own"))
            # The command sees numbers of the action space.
            self.assertEqual(step["proposed"]["action"], [1.0])
            adapter.step(Action("vector", [1.0]))
            self.assertAlmostEqual(Toy.executed[-1], 1.7, places=6)
            # Another action than the policy's is one of the command.
            adapter.step(Action("vector", [0.5]))
            self.assertEqual(Toy.executed[-1], 0.5)

    def test_inputs_keep_their_stored_names(self):
        env = types.SimpleNamespace(instruction="move")
        self.use(stand_ins(stored={"observation.joints": "observation.state"}))
        seen = {"joints": np.array([0.5, 0.0], np.float32)}
        act = policies.as_function(policies.load(f"lerobot:{self.folder}"), env)
        np.testing.assert_allclose(act(seen), [0.5])
        np.testing.assert_allclose(act({"state": seen["joints"]}), [0.5])
        # The map of the command line replaces the stored one.
        renamed = policies.load(f'lerobot:{self.folder}?rename_map={{"observation.q":"observation.state"}}')
        np.testing.assert_allclose(policies.as_function(renamed, env)({"q": seen["joints"]}), [0.5])
        with self.assertRaisesRegex(KeyError, "expects observation.q"):
            policies.as_function(renamed, env)(seen)
        for wrong, why in (("rename_map=a", "Expected a map"), ("rename=1", "is not an argument. Expected key=value with one of: rename_map")):
            with self.assertRaisesRegex(ValueError, why):
                policies.load(f"lerobot:{self.folder}?{wrong}")

    def test_several_episodes_share_a_batch(self):
        policy, env = policies.load(f"lerobot:{self.folder}"), types.SimpleNamespace(instruction="move")
        self.assertIsNone(policies.batched(policy))

        def chunk(policy, batch):
            self.assertEqual((batch["task"], len(batch["observation.state"])), (["move"] * 2, 2))
            return np.stack([batch["observation.state"][:, :1]] * 3, axis=1).view(Tensor)

        with mock.patch.object(Policy, "predict_action_chunk", chunk, create=True):
            policy.config.n_action_steps = 2
            answer, asked = policies.batched(policy), []

            def ask(prepared):
                asked.append(prepared)
                return answer([prepared, prepared])[1]

            act = policies.as_function(policy, env, ask)
            actions = [act({"agent_pos": np.array([0.1 * at, 0.0], np.float32)}) for at in range(4)]
            # Two actions of each chunk are executed, as with `select_action`.
            np.testing.assert_allclose(np.concatenate(actions), [0.0, 0.0, 0.2, 0.2], atol=1e-7)
            self.assertEqual(len(asked), 2)
            for setting in ({"n_obs_steps": 2}, {"temporal_ensemble_coeff": 0.01}):
                with mock.patch.multiple(policy.config, create=True, **setting):
                    self.assertIsNone(policies.batched(policy))

    def test_half_precision_is_that_of_the_checkpoint(self):
        observation = {"agent_pos": np.zeros(2, np.float32)}
        for use_amp, expected in ((False, []), (True, ["cpu"])):
            (self.folder / "config.json").write_text(json.dumps({"type": "toy", "use_amp": use_amp}))
            policies.as_function(policies.load(f"lerobot:{self.folder}"), None)(observation)
            self.assertEqual(self.amp, expected)


class Aloha(unittest.TestCase):
    def test_joints_of_aloha_pass_one_radian(self):
        gymnasium.register("gym_aloha/Toy-v0", entry_point=Toy)
        self.addCleanup(gymnasium.registry.pop, "gym_aloha/Toy-v0")
        env = find("gymnasium:gym_aloha/Toy-v0").make()
        self.assertAlmostEqual(float(env.action_space.high[0]), np.pi, places=6)
        self.assertEqual(float(Toy.action_space.high[0]), 1.0)


class VecNormalize:
    """What a pickle of Stable-Baselines3 holds, under its module."""

    def __init__(self, **attributes):
        vars(self).update(attributes)


class RunningMeanStd(VecNormalize):
    pass


class Starts:
    """A pickle that creates a file where it is run."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


class StableBaselines(unittest.TestCase):
    def setUp(self):
        place = tempfile.TemporaryDirectory()
        self.addCleanup(place.cleanup)
        self.folder = Path(place.name)
        self.asked = {}

        class SAC:
            observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
            action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))

            @classmethod
            def load(cls, file, device, custom_objects):
                self.asked.update(custom_objects)
                return cls()

            def predict(self, observation, deterministic):
                return observation, None

        patch = mock.patch.dict(sys.modules, {"stable_baselines3": types.SimpleNamespace(SAC=SAC)})
        patch.start()
        self.addCleanup(patch.stop)
        self.model = self.save("model.zip")

    def save(self, name):
        with zipfile.ZipFile(self.folder / name, "w") as archive:
            archive.writestr("data", json.dumps({"policy_class": {"__module__": "stable_baselines3.sac.policies"}}))
        return self.folder / name

    def statistics(self, name, mean, protocol=pickle.DEFAULT_PROTOCOL, **more):
        """Write statistics, with objects of every kind that stand in them."""
        rms = RunningMeanStd(mean=np.array(mean), var=np.array([4.0, 1.0]), count=np.float64(3.0))
        space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
        space.seed(1)
        state = {"norm_obs": True, "clip_obs": 2.0, "epsilon": 0.0, "obs_rms": rms, "observation_space": space, "keys": gymnasium.spaces.Dict(a=space)}
        (self.folder / name).write_bytes(pickle.dumps(VecNormalize(**{**state, **more}), protocol))

    def seen(self, name="model.zip", query=""):
        """What the model is given for the observation (1, 9)."""
        return policies.as_function(policies.load(f"sb3:{self.folder / name}{query}"))(np.array([1.0, 9.0], np.float32)).tolist()

    def test_actions_are_those_of_the_training(self):
        model = stable_baselines.load(self.model)
        spaces = gymnasium.spaces
        for same in (spaces.Box(-1.0, 1.0, (2,)), spaces.Box(-1.0, 1.0, (2,), np.float64), None):
            self.assertTrue(callable(model.function(types.SimpleNamespace(action_space=same))))
        for other in (spaces.Box(-2.0, 2.0, (2,)), spaces.Box(-1.0, 1.0, (3,)), spaces.Discrete(2), spaces.MultiBinary(2)):
            with self.assertRaisesRegex(ValueError, "was trained with the actions"):
                model.function(types.SimpleNamespace(action_space=other))
        model.model.action_space = spaces.Discrete(3)
        with self.assertRaisesRegex(ValueError, "was trained with the actions"):
            model.function(types.SimpleNamespace(action_space=spaces.Discrete(2)))

    def test_what_training_needs_is_replaced(self):
        self.assertEqual(self.seen(), [1.0, 9.0])
        self.assertEqual((self.asked["replay_buffer_class"], self.asked["buffer_size"]), (None, 1))

    def test_statistics_are_found_by_name(self):
        for protocol in (3, 4, 5):
            self.statistics("vecnormalize.pkl", [3.0, 0.0], protocol)
            self.assertEqual(self.seen(), [-1.0, 2.0])
        self.statistics("model_vecnormalize.pkl", [5.0, 0.0])
        self.assertEqual(self.seen(), [-2.0, 2.0])
        self.save("rl_model_500_steps.zip")
        self.statistics("rl_model_vecnormalize_500_steps.pkl", [1.0, 0.0])
        self.assertEqual(self.seen("rl_model_500_steps.zip"), [0.0, 2.0])
        self.statistics("elsewhere", [-1.0, 0.0])
        self.assertEqual(self.seen(query=f"?statistics={self.folder / 'elsewhere'}"), [1.0, 2.0])

    def test_only_named_keys_are_normalised(self):
        rms = {name: RunningMeanStd(mean=np.array(2.0), var=np.array(1.0)) for name in ("a", "b")}
        state = {"norm_obs": True, "clip_obs": 9.0, "epsilon": 0.0, "obs_rms": rms, "norm_obs_keys": ["a"]}
        (self.folder / "dict.pkl").write_bytes(pickle.dumps(VecNormalize(**state)))
        observation = {"a": np.array([3.0]), "b": np.array([3.0])}
        found = stable_baselines.Statistics(self.folder / "dict.pkl").normalized(observation)
        self.assertEqual((found["a"][0], found["b"][0]), (1.0, 3.0))

    def test_statistics_start_no_code(self):
        marker = self.folder / "started"
        self.statistics("vecnormalize.pkl", [3.0, 0.0], more=Starts(marker))
        self.assertEqual(self.seen(), [-1.0, 2.0])
        self.assertFalse(marker.exists())
        pickle.loads((self.folder / "vecnormalize.pkl").read_bytes())
        self.assertTrue(marker.exists())

    def test_other_pickles_are_refused(self):
        for content in (b"", b"\x80\x04.", pickle.dumps({"mean": 1.0}), pickle.dumps(VecNormalize(norm_obs=True)),
                        pickle.dumps(VecNormalize(norm_obs=True, clip_obs=1.0, epsilon=0.0, obs_rms=3))):  # fmt: skip
            (self.folder / "vecnormalize.pkl").write_bytes(content)
            with self.assertRaisesRegex(ValueError, "not the statistics of VecNormalize"):
                policies.load(f"sb3:{self.model}")

    def test_other_arguments_of_the_environment_are_refused(self):
        loaded = stable_baselines.load(self.model)
        loaded.model.action_space = gymnasium.make("Pendulum-v1").action_space
        trained = stable_baselines.Model(loaded.model, None, None, [], {"g": 1.5})
        self.assertIsNotNone(trained.function(gymnasium.make("Pendulum-v1", g=1.5, render_mode="rgb_array")))
        for env in (gymnasium.make("Pendulum-v1"), gymnasium.make("Pendulum-v1", g=2.0)):
            with self.assertRaisesRegex(ValueError, r"with g = 1.5 .*gymnasium:Pendulum-v1\?g=1.5"):
                trained.function(env)
        # An environment of a file shows its arguments as attributes.
        own = gymnasium.make("Pendulum-v1").unwrapped.__class__()
        with self.assertRaisesRegex(ValueError, "with g = 1.5 .* does not show that it has them"):
            trained.function(own)
        own.g = 1.5
        self.assertIsNotNone(trained.function(own))

    def test_channels_of_images_may_be_last(self):
        loaded = policies.load(f"sb3:{self.model}")
        loaded.model.observation_space = gymnasium.spaces.Box(0, 255, (3, 8, 6), np.uint8)
        for shape in ((3, 8, 6), (8, 6, 3)):
            self.assertEqual(policies.as_function(loaded)(np.zeros(shape, np.uint8)).shape, shape)
        with self.assertRaisesRegex(ValueError, r"\(3, 8, 6\), but the environment observes \(6, 8, 3\)"):
            policies.as_function(loaded)(np.zeros((6, 8, 3), np.uint8))


if __name__ == "__main__":
    unittest.main()
