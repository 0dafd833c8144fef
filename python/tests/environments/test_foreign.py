"""Environments that were not written for RoboGate. They need gymnasium, mujoco, pyzmq and msgpack."""

import collections
import contextlib
import os
import random
import select
import subprocess
import sys
import tempfile
import types
import unittest
from pathlib import Path
from unittest import mock

import gymnasium
import mujoco
import numpy as np
from robogate_bridge import Action, Problem, Scenario, declaration
from robogate_eval.environments import UnknownEnvironment, find
from robogate_eval.serving import Knob, Policy, Task, rendering
from robogate_eval.serving.adapter import Adapter
from robogate_eval.serving.environment import DeclarationError, Environment
from robogate_eval.serving.foreign import _space
from robogate_eval.serving.knobs import parameter_name
from robogate_eval.serving.scoring import truth
from robogate_eval.serving.spaces import Observations, actions_of
from sliding_box import XML, SlidingBox


def adapter(make, **options):
    return Adapter(Environment(make=make, task=options.pop("task", Task(name="foreign")), **options))


def model_of(xml):
    """A class of environments with this model."""

    class Made(SlidingBox):
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,))

        def _build(self):
            self.model = mujoco.MjModel.from_xml_string(f"<mujoco>{xml}</mujoco>")
            self.data = mujoco.MjData(self.model)

        def _get_obs(self):
            return self.data.qpos[:1].copy()

    return Made


def body(name, place, joint="<freejoint/>"):
    return f'<body {name} pos="{place} 0 0.1">{joint}<geom size="0.05"/></body>'


def sampled(found):
    """The default space: the low and high value of each parameter."""
    return {entry["name"]: (entry["low"], entry["high"]) for entry in declaration.hello(found.hello())["space"]["parameter"]}


ARM = '<body name="arm" pos="0 1 0.1"><joint name="slide" type="slide" axis="1 0 0" damping="1"/><geom size="0.05"/></body>'
MOTOR = '<actuator><motor joint="slide" ctrlrange="-0.2 0.4"/></actuator>'
FLOOR = '<geom type="plane" size="2 2 0.1"/>'


class DefaultSpace(unittest.TestCase):
    def test_things_that_the_robot_handles_are_sampled(self):
        found = sampled(adapter(SlidingBox))
        self.assertEqual(set(found), {"action_delay", "gain", "mass_box", "friction_box"})
        # Moderate ranges, not the limits of the knobs.
        self.assertEqual((found["mass_box"], found["action_delay"]), ((0.25, 1.0), (0, 2)))

    def test_passive_joints_belong_to_what_is_handled(self):
        door = '<body name="door" pos="1 0 0.1"><joint name="hinge" damping="0.4"/><geom size="0.05"/></body>'
        found = sampled(adapter(model_of(f"<worldbody>{FLOOR}{ARM}{door}</worldbody>{MOTOR}")))
        self.assertEqual(set(found), {"action_delay", "gain", "mass_door", "friction_door", "damping_hinge"})

    def test_an_arm_that_a_mocap_body_moves_is_not_handled(self):
        weld = '<equality><weld body1="hand" body2="moved"/></equality>'
        bodies = '<body name="moved" mocap="true"/>' + body('name="hand"', 0) + body('name="box"', 1)
        found = sampled(adapter(model_of(f"<worldbody>{FLOOR}{ARM}{bodies}</worldbody>{weld}{MOTOR}")))
        self.assertEqual(set(found), {"action_delay", "gain", "mass_box", "friction_box"})

    def test_own_knobs_are_sampled_over_their_ranges(self):
        drag = Knob("drag", lambda env, value: None, lambda env: 0.0, 0.0, 4.0)
        surface = Knob("surface", lambda env, value: None, lambda env: "wet", choices=("wet", "dry"))
        space = adapter(SlidingBox, knobs=[drag, surface, "gravity"]).hello()["space"]["parameter"]
        self.assertEqual([entry["name"] for entry in space], ["drag", "surface", "gravity"])
        self.assertEqual((space[0]["high"], space[1]["choices"]), (4.0, ["wet", "dry"]))
        self.assertAlmostEqual(space[2]["low"], 0.9 * 9.81)


class Friction(unittest.TestCase):
    def test_declared_pairs_have_the_requested_friction(self):
        pair = '<contact><pair geom1="floor" geom2="ball" friction="1.3 1.3"/></contact>'
        ball = '<body name="ball" pos="0 0 0.04"><freejoint/><geom name="ball" size="0.05" contype="0" conaffinity="0"/><geom size="0.01"/></body>'
        floor = '<geom name="floor" type="plane" size="2 2 0.1"/>'
        found = adapter(model_of(f"<worldbody>{floor}{ARM}{ball}</worldbody>{pair}{MOTOR}"))
        for wanted in (0.2, 2.5):
            self.assertEqual(found.reset(Scenario(0, 1, {"friction_ball": wanted}))["applied"], {"friction_ball": wanted})
            found.step(Action("vector", [0.0]))
        found.reset(Scenario(0, 1, {}))
        np.testing.assert_allclose(found._model.model.pair_friction[0, :2], 1.3)


class Names(unittest.TestCase):
    def test_names_in_any_script_stay_different(self):
        names = [parameter_name(f"mass:{name}") for name in ("größe", "机器人", "物体", "été", "x" * 200 + "a", "x" * 200 + "b")]
        self.assertEqual(len(set(names)), len(names))
        self.assertEqual((names[0], names[3]), ("mass_gro_udf_e", "mass_ete"))
        self.assertTrue(all(name.isascii() and len(name) <= 120 for name in names))

    def test_bodies_with_one_parameter_are_reported(self):
        both = body('name="a/box"', 0) + body('name="a_box"', 1)
        found = adapter(model_of(f"<worldbody>{FLOOR}{ARM}{both}</worldbody>{MOTOR}"))
        self.assertIn(("mass:a_box", "its parameter mass_a_box is that of mass:a/box"), found.dropped)

    def test_bodies_without_a_name_have_a_number(self):
        two = body("", 0) + body("", 1)
        xml = f"<worldbody>{FLOOR}{ARM}{two}</worldbody>{MOTOR}"
        found = adapter(model_of(xml))
        self.assertEqual(found.dropped[0][0], "2 bodies")
        self.assertIn('(numbers 2, 3). To vary one, name it in the model, or use its number: knobs=["*", "mass:2"]', found.dropped[0][1])
        named = adapter(model_of(xml), knobs=["*", "mass:3"])
        self.assertEqual(named.reset(Scenario(0, 1, {"mass_3": 0.2}))["applied"], {"mass_3": 0.2})


class Observing(unittest.TestCase):
    def test_get_obs_must_return_the_observation_of_the_reset(self):
        class Needs(SlidingBox):
            def _get_obs(self, point=None):
                if point is None:
                    raise TypeError("_get_obs() missing 1 required positional argument: 'point'")
                return super()._get_obs()

            def reset(self, seed=None, options=None):
                super(SlidingBox, self).reset(seed=seed)
                mujoco.mj_resetData(self.model, self.data)
                mujoco.mj_forward(self.model, self.data)
                self.start = float(self.data.qpos[1])
                return self._get_obs(1), {}

            def step(self, action):
                mujoco.mj_step(self.model, self.data)
                return self._get_obs(1), 0.0, False, False, {"success": False}

        def wrapped():
            return gymnasium.wrappers.FlattenObservation(SlidingBox())

        task = Task(name="foreign", time_limit_s=1.0)
        for make in (Needs, wrapped):
            found = adapter(make, task=task)
            names = {knob.name for knob in found.knobs}
            self.assertFalse({"shift_x:box", "turn:box"} & names)
            self.assertIn("mass:box", names)
            self.assertIn("Declare `observe`", dict(found.dropped)["shift_x, shift_y and turn of the free bodies"])


class Success(unittest.TestCase):
    def test_report_at_the_end_of_an_episode_is_enough(self):
        class Late(SlidingBox):
            """The slider moves the box far enough in more than one step, and the report is an array."""

            count = 0

            def reset(self, seed=None, options=None):
                self.count = 0
                return super().reset(seed)

            def step(self, action):
                *others, info = super().step(action)
                self.count += 1
                return *others, {"is_success": np.array([info["success"]])} if self.count == self.max_path_length else {}

        found = adapter(Late)
        found.reset(Scenario(0, 1, {}))
        endings = [found.step(Action("vector", [0.4]))["ending"] for _ in range(Late.max_path_length)]
        self.assertEqual(endings, [None] * (Late.max_path_length - 1) + [{"failure": None}])

    def test_without_any_report_a_file_is_shown(self):
        with self.assertRaisesRegex(DeclarationError, r'gymnasium.make\("CartPole-v1".*\n?.*success=lambda'):
            adapter(lambda: _Continuous(gymnasium.make("CartPole-v1")))


    def test_text_is_no_report(self):
        class Text(SlidingBox):
            def step(self, action):
                return (*super().step(action)[:4], {"success": "false"})

        with self.assertRaisesRegex(DeclarationError, "is 'false' \\(str\\). Expected True"):
            adapter(Text)


class Spaces(unittest.TestCase):
    def test_tuples_and_numbers_are_vectors(self):
        class Mixed(SlidingBox):
            observation_space = gymnasium.spaces.Tuple([SlidingBox.observation_space, gymnasium.spaces.MultiDiscrete([3, 3])])

            def _get_obs(self):
                return super()._get_obs(), np.array([1, 2])

        found = adapter(Mixed)
        vectors = found.reset(Scenario(0, 1, {"noise_0_box": 0.1, "shift_x_box": 0.1}))["observation"]["vectors"]
        self.assertEqual({name: len(numbers) for name, numbers in vectors.items()}, {"0.box": 3, "0.pusher.x": 1, "1": 2})
        self.assertEqual(vectors["1"], [1.0, 2.0])

    def test_newest_of_stacked_frames_is_a_camera(self):
        frames = np.arange(4 * 5 * 6 * 3, dtype=np.uint8).reshape(4, 5, 6, 3)
        space = gymnasium.spaces.Dict({
            "front": gymnasium.spaces.Box(0, 255, (4, 5, 6, 3), np.uint8),
            "depth": gymnasium.spaces.Box(0.0, 10.0, (120, 160, 1), np.float32),
            "state": gymnasium.spaces.Box(-1.0, 1.0, (2,)),
        })  # fmt: skip
        seen = Observations(space)
        observation = {"front": frames, "depth": np.zeros((120, 160, 1), np.float32), "state": np.zeros(2)}
        seen.check(observation)
        np.testing.assert_array_equal(seen.image(observation, "front"), frames[-1])
        self.assertEqual(seen.images["front"][1:], (5, 6))
        self.assertEqual(list(seen.vectors), ["state"])
        why = dict(seen.skipped)
        self.assertIn("only the newest of 4 frames", why["front"])
        self.assertIn("an image of numbers, such as depth (shape (120, 160, 1))", why["depth"])

    def test_parts_with_one_name_are_refused(self):
        class Twice(SlidingBox):
            observation_space = gymnasium.spaces.Dict({"a b": gymnasium.spaces.Discrete(2), "a-b": gymnasium.spaces.Discrete(2)})

        with self.assertRaisesRegex(DeclarationError, "two parts of the observation have the name a-b"):
            adapter(Twice)

    def test_images_alone_identify_a_state(self):
        found = adapter(_Pictures, task=Task(name="pictures", time_limit_s=1.0, control_period_s=0.1))
        self.assertTrue(found.deterministic)
        declared = declaration.hello(found.hello())["task"]["observation"]
        self.assertEqual((declared["vectors"], [camera["name"] for camera in declared["cameras"]]), ([], ["observation"]))
        states = set()
        for seed in range(3):
            found.reset(Scenario(seed, 1, {}))
            states.add(found.state_hash())
        self.assertEqual(len(states), 3, "another image is another state")

    def test_observations_of_another_size_are_refused(self):
        class Grows(SlidingBox):
            def step(self, action):
                observation, *others = super().step(action)
                return {**observation, "box": np.zeros(4)}, *others

        with self.assertRaisesRegex(DeclarationError, "returned box with 4 numbers, and its observation_space declares 3"):
            adapter(Grows)

    def test_an_object_with_the_methods_is_enough(self):
        class Bare:
            """It is no gymnasium.Env, so it has no `unwrapped`."""

            observation_space, action_space = _Pictures.observation_space, _Pictures.action_space
            dt, max_path_length = 0.1, 5

            def __init__(self):
                inner = _Pictures()
                self.reset, self.step = inner.reset, inner.step

        self.assertEqual(adapter(Bare).hello()["task"]["time_limit_s"], 0.5)

    def test_many_worlds_at_once_are_refused(self):
        for count in (3, 1):
            with self.assertRaisesRegex(DeclarationError, f"is a vector of {count} worlds"):
                adapter(lambda count=count: gymnasium.make_vec("Pendulum-v1", num_envs=count, vectorization_mode="sync"))

    def test_pictures_that_show_nothing_are_noted(self):
        class Blind(_Pictures):
            dt, max_path_length = 0.1, 40
            observation_space = gymnasium.spaces.Dict({"eye": _Pictures.observation_space, "hand": _Pictures.observation_space})

            def seen(self):
                return {"eye": np.full((8, 8, 3), 90, np.uint8), "hand": self.first}

            def reset(self, seed=None, options=None):
                self.first, info = super().reset(seed=seed)
                return self.seen(), info

            def step(self, action):
                return self.seen(), float(np.sum(action)), *super().step(action)[2:]

        notes = adapter(Blind).notes
        self.assertEqual([note.partition(":")[0] for note in notes], [
            "the picture eye of the observation shows one colour everywhere",
            "the picture hand of the observation stays the same although the state changes",
        ])

        class Seeing(_Pictures):
            dt, max_path_length = 0.1, 40

        self.assertEqual(adapter(Seeing).notes, [])

    def test_ends_that_are_no_truth_values_are_refused(self):
        class Text(SlidingBox):
            def step(self, action):
                observation, reward, _, *others = super().step(action)
                return observation, reward, "False", *others

        with self.assertRaisesRegex(DeclarationError, r"terminated is 'False' \(str\). Expected True, False, 1 or 0$"):
            adapter(Text)

    def test_missing_rewards_are_refused(self):
        class NoReward(SlidingBox):
            def step(self, action):
                observation, _, *others = super().step(action)
                return observation, None, *others

        with self.assertRaisesRegex(DeclarationError, "step returned the reward None. Expected a number"):
            adapter(NoReward)


class DiscreteActions(unittest.TestCase):
    def bounds(self, space):
        actions = actions_of(space, ())
        return actions, actions.low.tolist(), actions.high.tolist()

    def test_levels_are_as_wide_as_each_other(self):
        spaces = gymnasium.spaces
        for space, low, high in [
            (spaces.Discrete(3), [-0.5], [2.5]),
            (spaces.Discrete(2, start=-1), [-1.5], [0.5]),
            (spaces.MultiDiscrete([3, 1]), [-0.5, -0.5], [2.5, 0.5]),
            (spaces.MultiBinary(2), [-0.5, -0.5], [1.5, 1.5]),
            (spaces.Box(0, 255, (1,), np.uint8), [-0.5], [255.5]),
        ]:
            actions, *bounds = self.bounds(space)
            self.assertEqual(bounds, [low, high], space)
            random = np.random.default_rng(0)
            for _ in range(50):
                self.assertIn(actions.decode(random.uniform(low, high).tolist()), space)
            for end in (low, high):
                self.assertIn(actions.decode(end), space)

    def test_actions_of_a_policy_are_unchanged(self):
        for space in (gymnasium.spaces.Discrete(4), gymnasium.spaces.MultiDiscrete([[2, 3], [4, 5]]), gymnasium.spaces.MultiBinary(3)):
            actions = actions_of(space, ())
            space.seed(1)
            for _ in range(20):
                action = space.sample()
                np.testing.assert_array_equal(actions.decode(actions.encode(action)), action)

    def test_other_numbers_of_a_policy_are_refused(self):
        actions = actions_of(gymnasium.spaces.Discrete(2), ())
        for wrong in (2, -1, 0.5):
            with self.assertRaisesRegex(Problem, "Expected integers: 0 to 1"):
                actions.encode(wrong)
        self.assertTrue(np.isnan(actions.encode(np.nan)[0]))

    def test_cart_pole_runs_with_its_own_actions(self):
        def make():
            return gymnasium.make("CartPole-v1")

        def lean(env):
            return lambda observation: int(observation[2] + observation[3] > 0.0)

        task = Task(name="balance", success=lambda t: t.steps >= 100)
        found = adapter(make, task=task, policies={"lean": Policy(lean)})
        self.assertTrue(found.deterministic)
        reply = found.reset(Scenario(0, 1, {"action_delay": 1}, policy="lean"))
        ending, actions = None, []
        while ending is None:
            actions.append(reply["proposed"]["action"])
            reply = found.step(Action("vector", actions[-1]))
            ending = reply["ending"]
        executed = [int(action) for action in found._trajectory.actions]
        # There is no rest among discrete actions: the first one runs until a delayed one takes effect.
        self.assertEqual(executed, [int(action[0]) for action in [actions[0], *actions[:-1]]])
        self.assertEqual({action[0] for action in actions}, {0.0, 1.0})


class _Pictures(gymnasium.Env):
    """An environment that shows a picture and nothing else."""

    observation_space = gymnasium.spaces.Box(0, 255, (8, 8, 3), np.uint8)
    action_space = gymnasium.spaces.MultiBinary(2)

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.picture = self.np_random.integers(0, 255, (8, 8, 3)).astype(np.uint8)
        return self.picture, {}

    def step(self, action):
        self.picture = np.roll(self.picture, 1 + int(action[0]), axis=0)
        return self.picture, 0.0, False, False, {"is_success": np.bool_(False)}


class Tensor:
    """A tensor of another library, of which NumPy takes nothing without `detach`."""

    def __init__(self, array, device="cpu"):
        self.array, self.device = np.asarray(array), device

    shape = property(lambda self: self.array.shape)

    def __array__(self, *_, **__):
        raise TypeError("can't convert a tensor on this device. Use Tensor.cpu()")

    def detach(self):
        return self

    cpu = detach

    def numpy(self):
        return self.array


class Counting(gymnasium.Env):
    """Succeeds when the sum of the actions is above a number that follows from the seed."""

    observation_space = gymnasium.spaces.Box(-100.0, 100.0, (2,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    dt, max_path_length = 0.1, 6

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.sum, self.goal = 0.0, self.np_random.uniform(1.0, 5.0)
        return self.seen(), {}

    def seen(self):
        return np.array([self.sum, self.goal])

    def step(self, action):
        self.sum += float(np.asarray(action).reshape(-1)[0])
        return self.seen(), self.sum, False, False, {"success": self.sum > self.goal}


def played(found, index=1):
    """The states of an episode whose actions are 1."""
    states = [found.reset(Scenario(index=index, seed=3, parameters={}))["observation"]["vectors"]]
    ending = None
    while ending is None:
        reply = found.step(Action("vector", [1.0] * len(found._actions.low)))
        states.append(reply["observation"]["vectors"])
        ending = reply["ending"]
    return [state["observation"] for state in states], ending["failure"]


class OtherInterfaces(unittest.TestCase):
    def setUp(self):
        self.plain = played(adapter(Counting))

    def test_tensors_are_numbers(self):
        class Tensors(Counting):
            def seen(self):
                return Tensor(super().seen())

            def step(self, action):
                *others, info = super().step(action)
                return *others, {"success": Tensor([info["success"]])}

        self.assertEqual(played(adapter(Tensors)), self.plain)

    def test_batch_of_one_world_is_one_world(self):
        class Batch(Counting):
            num_envs, single_action_space, single_observation_space = 1, Counting.action_space, Counting.observation_space
            action_space, observation_space = (gymnasium.vector.utils.batch_space(space, 1) for space in (Counting.action_space, Counting.observation_space))

            def reset(self, seed=None, options=None):
                first, _ = super().reset(seed=seed)
                return first[None], {"success": np.array([False])}

            def step(self, action):
                assert np.shape(action) == (1, 1)
                observation, reward, *_, info = super().step(action)
                return observation[None], np.array([reward]), np.array([False]), np.array([False]), {"success": np.array([info["success"]])}

        self.assertEqual(played(adapter(Batch)), self.plain)
        self.assertEqual(adapter(lambda: gymnasium.Wrapper(Batch()))._observations.vectors["observation"], ((), 2))
        self.assertEqual(played(adapter(lambda: gymnasium.Wrapper(Batch()))), self.plain)

        class Alone(gymnasium.Wrapper):
            """Takes the world out of the batch."""

            observation_space, action_space = Counting.observation_space, Counting.action_space

            def reset(self, seed=None, options=None):
                return self.env.reset(seed=seed)[0][0], {}

            def step(self, action):
                observation, reward, *_, info = self.env.step(action[None])
                return observation[0], reward[0], False, False, info

        self.assertEqual(played(adapter(lambda: Alone(Batch()))), self.plain)

        class Many(Counting):
            num_envs = 4

        with self.assertRaisesRegex(DeclarationError, "is a vector of 4 worlds"):
            adapter(lambda: gymnasium.Wrapper(Many()))

        class Resets(Batch):
            def _reset_idx(self, worlds):
                pass

        with self.assertRaisesRegex(DeclarationError, "is a vector of 1 worlds"):
            adapter(Resets)

    def test_older_gym_is_seeded_by_its_generators(self):
        class Old(Counting):
            def reset(self):
                first, _ = super().reset()
                return first

            def step(self, action):
                observation, reward, _, _, info = super().step(action)
                return observation, reward, False, info

        found = adapter(Old)
        self.assertTrue(found.deterministic)
        self.assertEqual(played(found), played(adapter(Old)))
        self.assertNotEqual(played(found), played(found, index=2))

        class Ends(Old):
            def step(self, action):
                observation, reward, _, info = super().step(action)
                return observation, reward, self.sum > 0.5, {**info, "TimeLimit.truncated": self.goal > 4.0}

        ends = adapter(Ends)
        failures = {(played(ends, index)[1], bool(ends._trajectory.info["TimeLimit.truncated"])) for index in range(8)}
        self.assertEqual(failures, {("terminated", False), ("timeout", True)})

    def test_spaces_follow_from_the_first_observation(self):
        class NoSpaces:
            dt, max_path_length, action_spec = 0.1, 6, (np.array([-1.0]), np.array([1.0]))

            def __init__(self):
                self.inner = Counting()

            def reset(self, seed=None, options=None):
                return {"state": self.inner.reset(seed=seed)[0], "name": "a text"}, {}

            def step(self, action):
                observation, *others = self.inner.step(action)
                return {"state": observation, "name": "a text"}, *others

        found = adapter(NoSpaces)
        self.assertEqual(list(found._observations.vectors), ["state"])
        self.assertEqual(found._actions.low.tolist(), [-1.0])

    def test_spaces_of_the_older_gym_are_translated(self):
        older = {
            "Box": {"low": np.array([-2.0, -1.0]), "high": np.array([2.0, 1.0]), "dtype": np.dtype("float32")},
            "Discrete": {"n": 3},
            "MultiBinary": {"n": 4},
        }
        made = {kind: _space(type(kind, (), fields)()) for kind, fields in older.items()}
        whole = _space(type("Dict", (), {"spaces": made})())
        self.assertEqual(whole, gymnasium.spaces.Dict({
            "Box": gymnasium.spaces.Box(np.array([-2.0, -1.0]), np.array([2.0, 1.0]), dtype=np.float32),
            "Discrete": gymnasium.spaces.Discrete(3),
            "MultiBinary": gymnasium.spaces.MultiBinary(4),
        }))
        with self.assertRaisesRegex(DeclarationError, "is not a space of Gymnasium"):
            _space(object())

    def test_time_steps_of_dm_env_are_understood(self):
        TimeStep = collections.namedtuple("TimeStep", "step_type reward discount observation")
        TimeStep.last = lambda self: self.step_type == 2

        class Control:
            dt, max_path_length = 0.1, 9

            def __init__(self):
                self.task = types.SimpleNamespace(random=np.random.RandomState())

            def action_spec(self):
                return types.SimpleNamespace(minimum=-1.0, maximum=1.0, shape=(2,))

            def reset(self):
                self.steps, self.goal = 0, self.task.random.uniform()
                return TimeStep(0, None, None, {"place": self.goal})

            def step(self, action):
                self.steps += 1
                return TimeStep(2 if self.steps == 4 else 1, self.steps / 4.0, 1.0, {"place": self.goal})

        found = adapter(Control, task=Task(name="control", success=lambda t: t.rewards[-1:] == [1.0]))
        self.assertEqual((found.deterministic, len(found._actions.low)), (True, 2))
        found.reset(Scenario(index=1, seed=3, parameters={}))
        endings = [found.step(Action("vector", [0.0, 0.0]))["ending"] for _ in range(4)]
        self.assertEqual(endings, [None, None, None, {"failure": None}])

    def test_pure_functions_are_an_environment(self):
        State = collections.namedtuple("State", "goal sum obs reward done info metrics")

        class Pure:
            """As in Brax and MuJoCo Playground."""

            observation_size, action_size, dt = 2, 1, 0.1
            _config = types.SimpleNamespace(episode_length=6)

            def reset(self, key):
                return self.state(np.random.default_rng(key).uniform(1.0, 5.0), 0.0)

            def step(self, state, action):
                return self.state(state.goal, state.sum + float(action[0]))

            def state(self, goal, total):
                return State(goal, total, Tensor([total, goal]), Tensor(total).array, Tensor(0.0).array, {}, {"success": Tensor(total > goal)})

        jax = types.SimpleNamespace(jit=lambda function: function, random=types.SimpleNamespace(PRNGKey=lambda seed: seed))
        with mock.patch.dict(sys.modules, jax=jax):
            found = adapter(Pure)
            states, failure = played(found)
        self.assertTrue(found.deterministic)
        self.assertEqual((failure, len(states)), (None, int(states[0][1]) + 2))


class Truth(unittest.TestCase):
    def test_one_number_of_any_library_counts(self):
        for value, expected in ((Tensor([True]), True), (Tensor(0), False), (np.array([[1.0]]), True), ({"task": np.bool_(True), "reach": False}, True)):
            self.assertIs(truth(value, "success"), expected)
        for value in (np.float32(0.4), "true", None, 2, Tensor([0.5]), np.array([True, False]), {"reach": True}):
            with self.assertRaisesRegex(Problem, "success is .* Expected True, False, 1 or 0"):
                truth(value, "success")


class Time(unittest.TestCase):
    def test_control_period_is_that_of_the_physics(self):
        class Wrong(SlidingBox):
            dt = 0.005

        class Silent(SlidingBox):
            dt = None

        # Ten steps of 5 ms.
        self.assertEqual([adapter(make).hello()["task"]["control_period_s"] for make in (SlidingBox, Wrong, Silent)], [0.05] * 3)

    def test_two_control_periods_without_physics_are_refused(self):
        with self.assertRaisesRegex(DeclarationError, "`dt` says 0.05 s, .*render_fps.* 0.0333333 s.*is unknown"):
            adapter(lambda: gymnasium.make("Pendulum-v1"))

    def test_names_that_mean_the_control_period_count(self):
        class Rate(_Pictures):
            dt, control_freq, max_path_length = None, 25, 5

        class Both(Rate):
            control_timestep = 0.02

        self.assertEqual(adapter(Rate).hello()["task"]["control_period_s"], 0.04)
        with self.assertRaisesRegex(DeclarationError, "`control_timestep` says 0.02 s, `control_freq` says 0.04 s"):
            adapter(Both)

    def test_all_that_is_missing_is_told_at_once(self):
        class Nothing(_Pictures):
            dt, max_path_length = None, None

        with self.assertRaisesRegex(DeclarationError, "period and the time limit of .* are unknown(.|\n)*period_s=0.05, time_limit_s=10.0"):
            adapter(Nothing)

    def test_hint_proposes_the_own_control_period(self):
        class Owner:
            time_step, frame_skip = 0.002, 5

        class Steps(_Pictures):
            dt, sim = None, Owner()

        with self.assertRaisesRegex(DeclarationError, r"control_period_s=0.01[,)]"):
            adapter(Steps)

    def test_wrappers_of_a_package_have_the_time_limit(self):
        class Limit(gymnasium.Wrapper):
            _max_episode_steps = 7

        class Endless(_Pictures):
            dt = 0.1

        self.assertAlmostEqual(adapter(lambda: Limit(Endless())).hello()["task"]["time_limit_s"], 0.7)


class History(unittest.TestCase):
    def test_resets_that_keep_the_memory_of_the_solver_repeat(self):
        class Keeps(SlidingBox):
            def reset(self, seed=None, options=None):
                super(SlidingBox, self).reset(seed=seed)
                self.data.qpos[:], self.data.qvel[:], self.data.time = self.model.qpos0, 0.0, 0.0
                self.data.qpos[1] = self.np_random.uniform(-0.02, 0.02)
                # The positions settle, from the forces of the last episode.
                mujoco.mj_step(self.model, self.data, 10)
                self.start = float(self.data.qpos[1])
                return self._get_obs(), {}

        self.assertTrue(adapter(Keeps).deterministic)

    def test_shared_generators_follow_from_the_seed(self):
        class Shared(SlidingBox):
            observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,))

            def reset(self, seed=None, options=None):
                super().reset(seed=seed)
                return self._get_obs(), {}

            def _get_obs(self):
                return np.array([np.random.uniform(), random.random()])

        def start(index, found):
            return found.reset(Scenario(index, 1, {}))["observation"]["vectors"]["observation"]

        first, other = adapter(Shared, knobs=()), adapter(Shared, knobs=())
        wanted = [start(index, first) for index in (1, 2)]
        self.assertEqual([start(index, other) for index in (2, 1)], wanted[::-1])
        self.assertNotEqual(*wanted)

    def test_counters_of_episodes_do_not_repeat(self):
        """A counter that the reset keeps: every second, or every third, episode is another one."""
        class Counts(SlidingBox):
            every = 2

            def reset(self, seed=None, options=None):
                self.number = getattr(self, "number", 0) + 1
                return super().reset(seed=seed)

            def step(self, action):
                *rest, info = super().step(action)
                return *rest, {"success": self.number % self.every == 0 and self.data.time > 0.2}

        class Third(Counts):
            every = 3

        self.assertEqual([adapter(make).deterministic for make in (SlidingBox, Counts, Third)], [True, False, False])

    def test_chance_of_its_own_does_not_repeat(self):
        class Chance(SlidingBox):
            def reset(self, seed=None, options=None):
                return super().reset(seed=None)

        self.assertFalse(adapter(Chance).deterministic)


class ChangingModels(unittest.TestCase):
    def test_knobs_of_bodies_are_not_offered(self):
        class Changes(SlidingBox):
            count = 0

            def _build(self):
                self.count += 1
                extra = f'<body name="more" pos="0 {self.count} 1"><freejoint/><geom size="0.05"/></body>' * (self.count % 2)
                self.model = mujoco.MjModel.from_xml_string(XML.replace("</worldbody>", f"{extra}</worldbody>"))
                self.data = mujoco.MjData(self.model)

        found = adapter(lambda: Changes(rebuild=True))
        self.assertEqual({knob.name for knob in found.knobs}, {"action_delay", "noise:box", "noise:pusher.x", "gravity", "gain", "light"})
        self.assertIn(("mass:box", "each reset builds a model with other bodies or joints"), found.dropped)
        self.assertEqual(set(sampled(found)), {"action_delay", "gain"})


class Delay(unittest.TestCase):
    def delayed(self, low):
        class Bounded(SlidingBox):
            action_space = gymnasium.spaces.Box(low, 0.4, (1,))

        found = adapter(Bounded)
        found.reset(Scenario(0, 1, {"action_delay": 2}))
        for action in (0.1, 0.2, 0.3, 0.4):
            found.step(Action("vector", [action]))
        return [round(float(action[0]), 3) for action in found._trajectory.actions]

    def test_first_action_is_held_where_zeros_are_no_rest(self):
        self.assertEqual(self.delayed(-0.2), [0.0, 0.0, 0.1, 0.2])
        self.assertEqual(self.delayed(0.0), [0.1, 0.1, 0.1, 0.2])


class Divergence(unittest.TestCase):
    def test_physics_error_is_no_fault_of_the_server(self):
        class PhysicsError(RuntimeError):
            pass

        class Explodes(SlidingBox):
            def step(self, action):
                if action[0] > 0.399:
                    raise PhysicsError("Physics state is invalid.")
                return super().step(action)

        found = adapter(Explodes)
        found.reset(Scenario(0, 1, {}))
        with self.assertRaisesRegex(Problem, "diverged: Physics state is invalid"):
            found.step(Action("vector", [0.4]))


class Processes(unittest.TestCase):
    def test_processes_of_an_environment_end_with_its_server(self):
        forking = "import os, time\nfrom sliding_box import SlidingBox\nclass Forks(SlidingBox):\n    def __init__(self):\n        super().__init__()\n"
        forking += "        if os.fork() == 0:\n            time.sleep(3600)\n"
        ours, theirs = os.pipe()
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "forks.py"
            file.write_text(forking)
            paths = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
            server = subprocess.Popen(
                [sys.executable, "-m", "robogate_eval.environments", "serve", "--child", f"{file}:Forks"], stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, pass_fds=[theirs], env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            )  # fmt: skip
            os.close(theirs)
            with server:
                while b"listening" not in (line := server.stdout.readline()):
                    self.assertTrue(line, "the server ended")
                # Both processes hold the other end of the pipe.
                server.stdin.close()
                self.assertTrue(select.select([ours], [], [], 60)[0], "a process is left")
                self.assertEqual(os.read(ours, 1), b"")
        os.close(ours)


class _Continuous(gymnasium.ActionWrapper):
    action_space = gymnasium.spaces.Box(0.0, 1.0, (1,))

    def action(self, action):
        return int(action[0] > 0.5)


class Plane(gymnasium.Env):
    """A point on a plane, which it draws if it was made for images."""

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)
    action_space = gymnasium.spaces.Box(-0.1, 0.1, (2,), np.float64)
    max_path_length = 20

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.at = np.zeros(2)
        return self.at.copy(), {}

    def step(self, action):
        self.at = np.clip(self.at + action, -1.0, 1.0)
        return self.at.copy(), 0.0, False, False, {"success": bool(self.at[0] > 0.9)}

    def render(self):
        pixels = np.zeros((30, 40, 4), dtype=np.uint8)
        pixels[:, : int(20 * (1.0 + self.at[0]))] = 200
        return pixels


class SeenPictures(unittest.TestCase):
    """What a policy of the environment sees, by the layout of the image in the observation."""

    LAYOUTS = {
        "last": ((32, 24, 3), lambda image: image),
        "first": ((3, 32, 24), lambda image: np.moveaxis(image, 2, 0)),
        "grey": ((32, 24, 1), lambda image: image[..., :1]),
        "alpha": ((32, 24, 4), lambda image: np.concatenate([image, np.full((32, 24, 1), 9, np.uint8)], axis=2)),
        "stack": ((2, 32, 24, 3), lambda image: np.stack([image, image])),
    }

    def seen(self, layout="last", steps=6, **parameters):
        shape, laid = self.LAYOUTS[layout]
        seen = []

        class Seen(gymnasium.Env):
            observation_space = gymnasium.spaces.Dict({"eye": gymnasium.spaces.Box(0, 255, shape, np.uint8), "steps": gymnasium.spaces.Box(0, 99, (1,))})
            action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
            dt, max_path_length = 0.1, 20

            def reset(self, seed=None, options=None):
                super().reset(seed=seed)
                self.steps = 0
                return self.observed(), {}

            def observed(self):
                image = np.full((32, 24, 3), 100, np.uint8)
                image[:16, :, 1] = 150
                image[0, 0, 2] = self.steps
                return {"eye": laid(image), "steps": np.array([self.steps], dtype=float)}

            def step(self, action):
                self.steps += 1
                return self.observed(), 0.0, False, False, {"success": self.steps > 15}

        policy = Policy(lambda env: lambda observation: (seen.append(observation["eye"]), np.zeros(1))[1])
        found = adapter(Seen, policies={"look": policy})
        seen.clear()
        found.reset(Scenario(index=1, seed=3, parameters=parameters, policy="look"))
        for _ in range(steps - 1):
            found.step(Action("vector", [0.0]))
        return np.stack(seen)

    def test_nominal_values_change_nothing(self):
        for layout in self.LAYOUTS:
            plain, nominal = self.seen(layout), self.seen(layout, image_noise=0.0, image_contrast=1.0, image_delay=0)
            np.testing.assert_array_equal(plain, nominal)

    def test_every_layout_is_changed(self):
        for layout, (shape, _) in self.LAYOUTS.items():
            plain, bright = self.seen(layout), self.seen(layout, image_brightness=50.0)
            self.assertEqual((bright.shape[1:], bright.dtype), (shape, np.uint8))
            difference = bright.astype(int) - plain
            colours = difference[..., :3] if layout == "alpha" else difference
            self.assertEqual(set(np.unique(colours)), {50}, layout)
            if layout == "alpha":
                self.assertFalse(difference[..., 3].any())

    def test_changes_are_as_declared(self):
        plain = self.seen().astype(int)
        noisy = self.seen(image_noise=10.0) - plain
        self.assertAlmostEqual(noisy[:, 2:].std(), 10.0, delta=0.5)
        np.testing.assert_array_equal(noisy, self.seen(image_noise=10.0) - plain)
        self.assertNotEqual(noisy[0].tolist(), noisy[1].tolist())
        warm = self.seen(image_warmth=20.0) - plain
        self.assertEqual([warm[0, 5, 5, channel] for channel in range(3)], [20, 0, -20])
        self.assertAlmostEqual((self.seen(image_occlusion=0.25)[0] == 128).mean(), 0.25, delta=0.02)
        self.assertEqual(self.seen(image_contrast=0.5)[0, 5, 5].tolist(), [114, 139, 114])
        half = self.seen(image_rotation_deg=180.0 / 6)[0, :, :, 1]
        self.assertGreater(np.abs(half.astype(int) - plain[0, :, :, 1]).max(), 20)
        edge = self.seen(image_blur_px=2.0)[0, :, 12, 1].astype(int)
        self.assertTrue(100 < edge[16] < edge[15] < 150 and edge[0] == 150 and edge[31] == 100)
        # The corner, which shows the number of the step, is cut off.
        self.assertEqual([self.seen(image_crop=crop)[3, 0, 0, 2] for crop in (0.0, 0.25)], [3, 100])

    def test_frames_are_late_or_lost(self):
        number = lambda images: images[:, 0, 0, 2].tolist()
        self.assertEqual(number(self.seen()), [0, 1, 2, 3, 4, 5])
        self.assertEqual(number(self.seen(image_delay=2)), [0, 0, 0, 1, 2, 3])
        lost = number(self.seen(image_dropped_frames=0.5))
        self.assertTrue(lost != [0, 1, 2, 3, 4, 5] and lost == sorted(lost) and lost[0] == 0, lost)


class Pictures(unittest.TestCase):
    def test_buffer_grows_to_the_picture(self):
        model = mujoco.MjModel.from_xml_string(XML)
        model.vis.global_.offwidth, model.vis.global_.offheight = 64, 480
        with mock.patch.object(mujoco, "Renderer") as made, mock.patch.dict(os.environ, {"MUJOCO_GL": "disabled"}):
            rendering.renderer(model, 240, 320)
        made.assert_called_once_with(model, 240, 320)
        self.assertEqual((model.vis.global_.offwidth, model.vis.global_.offheight), (320, 480))

    def test_an_environment_made_for_images_has_a_camera(self):
        task = Task(name="plane", control_period_s=0.1)
        found = adapter(lambda: Plane("rgb_array"), task=task)
        self.assertEqual(found.hello()["task"]["observation"]["cameras"], [{"name": "render", "width": 40, "height": 30}])
        found.reset(Scenario(0, 1, {}))
        before = np.frombuffer(found.render(["render"])[0].rgb, np.uint8).reshape(30, 40, 3)
        found.step(Action("vector", [0.1, 0.0]))
        after = np.frombuffer(found.render(["render"])[0].rgb, np.uint8).reshape(30, 40, 3)
        self.assertEqual([int((pixels[0, :, 0] > 0).sum()) for pixels in (before, after)], [20, 22])
        # Without a mode, and if a package for rendering is missing, there is none.
        self.assertEqual(adapter(Plane, task=task).hello()["task"]["observation"]["cameras"], [])

        class Broken(Plane):
            def render(self):
                raise ImportError("no such package")

        self.assertEqual(adapter(lambda: Broken("rgb_array"), task=task).hello()["task"]["observation"]["cameras"], [])

    def test_registered_environments_are_made_for_images(self):
        gymnasium.register("Plane-v0", entry_point=Plane, max_episode_steps=20)
        try:
            self.assertEqual(find("gymnasium:Plane-v0").make().render_mode, "rgb_array")
        finally:
            del gymnasium.registry["Plane-v0"]


class Registered(unittest.TestCase):
    @contextlib.contextmanager
    def module(self):
        """A module whose import registers an environment."""
        module = types.ModuleType("foreign_package")
        module.__spec__ = None
        sys.modules["foreign_package"] = module
        gymnasium.register("Foreign-v0", entry_point=SlidingBox, max_episode_steps=40)
        try:
            yield
        finally:
            del sys.modules["foreign_package"], gymnasium.registry["Foreign-v0"]

    def test_module_is_imported(self):
        with self.module():
            self.assertEqual(find("gymnasium:foreign_package:Foreign-v0").task.name, "Foreign-v0")
        with self.assertRaises(ModuleNotFoundError):
            find("gymnasium:no_such_package:Foreign-v0")

    def test_package_is_recorded(self):
        self.assertEqual(find("gymnasium:CartPole-v1").source, f"gymnasium {gymnasium.__version__}")

    def test_unknown_name_has_a_hint(self):
        with self.assertRaisesRegex(UnknownEnvironment, "Hint: if another package registers it, gymnasium:MODULE:ID"):
            find("gymnasium:Foreign-v0")


if __name__ == "__main__":
    unittest.main()
