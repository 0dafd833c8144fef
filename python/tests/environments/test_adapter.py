"""The adapter, on environments that have no package of their own. They need gymnasium, mujoco, pyzmq and msgpack."""

import dataclasses
import tempfile
import unittest
from pathlib import Path

import gymnasium
import numpy as np
from robogate_bridge import Action, Problem, Scenario, Server, codec, declaration
from robogate_eval.environments import UnknownEnvironment, find
from robogate_eval.serving import Camera, FailureMode, Knob, Measure, Policy, Task
from robogate_eval.serving import friction as friction_of
from robogate_eval.serving.adapter import Adapter
from robogate_eval.serving.environment import DeclarationError, Environment, as_environment
from sliding_box import SlidingBox

PUSH = Policy(lambda env: lambda observation: np.array([0.4]), "Pushes as far as it can.")


def sliding_box(make=SlidingBox, **options):
    task = Task(
        name="sliding_box",
        failure_modes=[FailureMode("not_moved")],
        failure=lambda trajectory: "not_moved" if trajectory.over and trajectory.observation["box"][0] < 0.03 else None,
        measures=[Measure("way_m", "m", better="higher")],
        measure=lambda trajectory: {"way_m": trajectory.observation["box"][0] - trajectory.observations[0]["box"][0]},
    )
    return Adapter(Environment(make=make, task=task, policies={"push": PUSH}, **options))


def run(adapter, index=0, policy="push", **parameters):
    """Run an episode of a policy. Returns the last step, and all state hashes."""
    step = adapter.reset(Scenario(index, 1, parameters, policy=policy))
    states = [adapter.state_hash()]
    while step.get("ending") is None:
        step = adapter.step(Action("vector", step["proposed"]["action"]))
        states.append(adapter.state_hash())
    return step, states


class Plain(SlidingBox):
    """The observation is one array."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (4,))

    def _get_obs(self):
        return np.concatenate([self.data.body("box").xpos, self.data.qpos[:1]])


class Reused(Plain):
    """All observations are the same array."""

    seen = np.zeros(4)

    def _get_obs(self):
        self.seen[:] = super()._get_obs()
        return self.seen


def unpacked(reply, frames, tick, dt=0.05):
    """The steps of a reply, with those in frames as entries like the others."""
    packed = reply.get("packed")
    if packed is None:
        return reply.get("steps", [])
    shape = (packed["periods"], -1)
    rows, actions, hashes = (np.frombuffer(frame, kind) for frame, kind in zip(frames, ("<f8", "<f8", "<u8")))
    entries = zip(rows.reshape(shape).tolist(), actions.reshape(shape).tolist(), hashes.tolist())
    before = tick + len(reply["steps"])
    middle = [
        {"observation": {"time_s": (before + i) * dt, "vectors": {packed["vector"]: row}}, "measures": {}, "ending": None, "events": [],
         "state_hash": digest, "proposed": {"action_space": "vector", "action": action}}
        for i, (row, action, digest) in enumerate(entries, 1)
    ]  # fmt: skip
    return [*reply["steps"], *middle, *reply["later"]]


class RunningAhead(unittest.TestCase):
    def episode(self, make, ahead, packed=False, **parameters):
        """All control periods of an episode over the protocol, with so many ahead."""
        task = Task(name="sliding_box", measures=[Measure("way_m", "m")], measure=lambda t: {"way_m": float(t.env.data.qpos[1])})
        server = Server(Adapter(Environment(make=make, task=task, policies={"push": PUSH})))

        def ask(**fields):
            header, *frames = server.answer([codec.encode({"v": codec.VERSION, "episode": 1, **fields})])
            return codec.decode(bytes(header)), frames

        reply, _ = ask(op="reset", index=0, seed=1, parameters=parameters, policy="push")
        steps, self.packed = [], 0
        while reply["ok"] and (not steps or steps[-1].get("ending") is None):
            action = (steps[-1] if steps else reply)["proposed"]["action"]
            more = {"packed": True} if packed else {}
            reply, frames = ask(op="step", tick=len(steps), action_space="vector", actions=[action], ahead=ahead, **more)
            self.packed += len(frames)
            steps += unpacked(reply, frames, len(steps))
        return steps, reply

    def test_steps_do_not_depend_on_the_distance(self):
        for make in (Plain, Reused, SlidingBox):
            for parameters in ({}, {"noise_box" if make is SlidingBox else "noise_observation": 0.1, "action_delay": 2}):
                one, _ = self.episode(make, 0, **parameters)
                many, _ = self.episode(make, 64, **parameters)
                self.assertEqual(one, many, make.__name__)
                arrays, _ = self.episode(make, 64, packed=True, **parameters)
                self.assertEqual(one, arrays, make.__name__)
                # A Dict of observations is not packed.
                self.assertEqual(self.packed > 0, make is not SlidingBox)
                self.assertGreater(len(one), 3)
                self.assertIsNone(one[-1]["ending"]["failure"])

    def test_numbers_that_are_not_finite_are_reported_in_their_step(self):
        class Broken(Plain):
            def _get_obs(self):
                found = super()._get_obs()
                return found * np.nan if self.data.time > 0.12 else found

        for ahead, packed in ((0, False), (64, False), (64, True)):
            steps, reply = self.episode(Broken, ahead, packed)
            self.assertEqual((len(steps), reply["error"]["kind"]), (2, "diverged"), ahead)


class Finding(unittest.TestCase):
    def test_only_class_of_a_file_is_found(self):
        text = "import gymnasium\nfrom sliding_box import SlidingBox\nclass {}(SlidingBox):\n    pass\n"
        with tempfile.TemporaryDirectory() as folder:
            one, two = Path(folder) / "only_one.py", Path(folder) / "two_of_them.py"
            one.write_text(text.format("Mine"))
            two.write_text(text.format("First") + text.format("Second"))
            self.assertEqual(find(str(one)).task.name, "only_one.Mine")
            with self.assertRaisesRegex(UnknownEnvironment, "It has the environments First, Second: name one after a colon"):
                find(str(two))
            self.assertEqual(find(f"{two}:Second").task.name, "two_of_them.Second")

    def test_nearest_family_is_named(self):
        with self.assertRaisesRegex(UnknownEnvironment, "Did you mean metaworld:push-v3"):
            find("metawrld:push-v3")


class Declaring(unittest.TestCase):
    def test_declaration_is_valid(self):
        hello = declaration.hello(sliding_box(space={"friction:box": (0.1, 1.0)}).hello())
        self.assertEqual([(v["name"], v["length"]) for v in hello["task"]["observation"]["vectors"]], [("box", 3), ("pusher.x", 1)])
        self.assertEqual(hello["space"]["parameter"][0]["name"], "friction_box")
        self.assertTrue(hello["deterministic"])
        self.assertEqual(hello["policies"][0]["name"], "push")

    def test_catalogue_of_the_model(self):
        names = {knob.name for knob in sliding_box().knobs}
        self.assertLessEqual(
            {"mass:box", "inertia:box", "friction:box", "size:box", "shift_x:box", "turn:box", "damping:slide", "friction_loss:slide",
             "gain", "gravity", "action_delay", "noise:box"},
            names,
        )  # fmt: skip
        # The table does not move, so its mass does not act.
        self.assertNotIn("mass:world", names)

    def test_cameras_of_the_model_are_offered(self):
        adapter = sliding_box()
        cameras = declaration.hello(adapter.hello())["task"]["observation"]["cameras"]
        self.assertEqual([(c["name"], c["width"]) for c in cameras], [(name, 256) for name in ("front", "on_pusher", "front.plain", "on_pusher.plain")])
        adapter.reset(Scenario(0, 1, {}))
        (image,) = adapter.render(["front"])
        self.assertEqual((image.camera, len(image.rgb)), ("front", 3 * 256 * 256))
        self.assertGreater(len(set(image.rgb)), 10)

    def test_declared_cameras_are_the_only_ones(self):
        task = Task(name="sliding_box", cameras=[Camera("front", 64, 32)])
        adapter = Adapter(Environment(make=SlidingBox, task=task))
        adapter.reset(Scenario(0, 1, {}))
        self.assertEqual([len(image.rgb) for image in adapter.render(["front"])], [3 * 64 * 32])
        self.assertEqual([c["name"] for c in adapter.hello()["task"]["observation"]["cameras"]], ["front"])

    def test_unknown_knob_is_refused(self):
        with self.assertRaisesRegex(DeclarationError, "mass:ball"):
            sliding_box(knobs=["mass:ball"])

    def test_unbounded_action_is_refused(self):
        class Unbounded(SlidingBox):
            action_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,))

        with self.assertRaisesRegex(DeclarationError, "bounds"):
            sliding_box(Unbounded)

    def test_differences_from_the_declared_spaces_are_refused(self):
        class Other(SlidingBox):
            def _get_obs(self):
                return {"box": np.zeros(2), "pusher": {"x": np.zeros(1)}}

        class Missing(SlidingBox):
            def _get_obs(self):
                return {"box": np.zeros(3)}

        class Text(SlidingBox):
            observation_space = gymnasium.spaces.Text(10)

        class Spoken(SlidingBox):
            action_space = gymnasium.spaces.Dict({"arm": SlidingBox.action_space, "words": gymnasium.spaces.Text(9)})

        class Old(SlidingBox):
            def step(self, action):
                observation, reward, terminated, _, info = super().step(action)
                return observation, reward, terminated, info

        class OldReset(SlidingBox):
            def reset(self, seed=None):
                return super().reset(seed)[0]

        class Endless(SlidingBox):
            max_path_length = None

        class NoInfo(SlidingBox):
            def step(self, action):
                return (*super().step(action)[:4], None)

        class Large(SlidingBox):
            observation_space = gymnasium.spaces.Box(-1.0, 1.0, (100, 100))

        for make, part in (
            (Other, "declares box with 3 numbers, but reset returned 2 numbers"),
            (Missing, "declares pusher.x with 1 numbers, but reset returned a dict with the keys box"),
            (Text, "the observation is a Text"),
            (Spoken, "the action space is a Text.*ActionWrapper"),
            (Old, "step returned 4 values.*shimmy translates"),
            (NoInfo, "step returned the info None. Expected a dict"),
            (Large, r"the observation has 10000 numbers \(shape \(100, 100\)\)"),
            (OldReset, "reset returned a dict"),
            (Endless, "Task\\(name=.*time_limit_s=10.0"),
        ):
            with self.assertRaisesRegex(DeclarationError, part):
                sliding_box(make)

    def test_names_are_failure_modes_and_other_values_are_refused(self):
        self.assertEqual(Task("a", failure_modes=["far", FailureMode("near")]).failure_modes, (FailureMode("far"), FailureMode("near")))
        with self.assertRaisesRegex(DeclarationError, "failure_modes has 3. Expected FailureMode"):
            Task("a", failure_modes=[3])
        with self.assertRaisesRegex(DeclarationError, "measures has 'd'. Expected Measure"):
            Task("a", measures=["d"])

    def test_what_needs_arguments_names_them(self):
        class Needs(Plain):
            def __init__(self, radius, *, noise=0.0):
                super().__init__()

        with self.assertRaisesRegex(DeclarationError, "mine.Needs needs the arguments radius. Hint: .*return Needs\\(radius=...\\)"):
            as_environment(Needs, "mine.Needs")

    def test_class_is_an_environment(self):
        environment = as_environment(SlidingBox, "mine.SlidingBox")
        self.assertEqual(environment.task.name, "mine.SlidingBox")
        self.assertTrue(Adapter(environment).knobs)

    def test_chance_is_not_deterministic(self):
        class Chance(SlidingBox):
            def reset(self, seed=None, options=None):
                return super().reset(seed=None)

        self.assertFalse(sliding_box(Chance).deterministic)


class Running(unittest.TestCase):
    def test_clipped_actions_are_counted(self):
        def measured(policy):
            task = Task(name="sliding_box", time_limit_s=0.5)
            adapter = Adapter(Environment(make=SlidingBox, task=task, policies={"own": Policy(lambda env: policy)}))
            self.assertIn("clipped_actions", [measure["name"] for measure in adapter.hello()["task"]["measures"]])
            return run(adapter, policy="own")[0]["measures"]["clipped_actions"]

        numbers = iter([99.0, 0.4, 0.4 + 1e-7, -99.0] * 100)
        self.assertEqual(measured(lambda observation: np.array([0.0])), 0.0)
        self.assertAlmostEqual(measured(lambda observation: np.array([next(numbers)])), 0.5, delta=0.05)

    def test_success_and_measures(self):
        step, _ = run(sliding_box())
        self.assertEqual(step["ending"], {"failure": None})
        self.assertGreater(step["measures"]["way_m"], 0.1)

    def test_one_array_for_all_observations_keeps_their_history(self):
        def way(make):
            task = Task(
                name="sliding_box",
                time_limit_s=1.0,
                measures=[Measure("way_m", "m", better="higher")],
                measure=lambda trajectory: {"way_m": float(trajectory.observations[-1][0] - trajectory.observations[0][0])},
            )
            return run(Adapter(Environment(make=make, task=task, policies={"push": PUSH})))[0]["measures"]["way_m"]

        self.assertEqual(way(Reused), way(Plain))
        self.assertGreater(way(Reused), 0.01)

    def test_failure_mode_at_the_limit(self):
        step, states = run(sliding_box(), friction_box=2.0, mass_box=5.0)
        self.assertEqual(step["ending"], {"failure": "not_moved"})
        self.assertEqual(len(states), SlidingBox.max_path_length + 1)

    def test_episodes_repeat_bit_for_bit(self):
        adapter = sliding_box()
        _, first = run(adapter, 3, friction_box=0.3, size_box=1.2, shift_x_box=0.02)
        run(adapter, 4, mass_box=1.0, gain=2.0)
        self.assertEqual(run(adapter, 3, friction_box=0.3, size_box=1.2, shift_x_box=0.02)[1], first)
        self.assertEqual(run(sliding_box(), 3, friction_box=0.3, size_box=1.2, shift_x_box=0.02)[1], first)

    def test_knobs_do_not_outlast_an_episode(self):
        adapter = sliding_box()
        _, plain = run(adapter, 5)
        for knob in adapter.knobs:
            adapter.reset(Scenario(6, 1, {knob.parameter: knob.low if knob.low != knob.nominal else knob.high}))
        self.assertEqual(run(adapter, 5)[1], plain)

    def test_knobs_act_on_a_rebuilt_model(self):
        rebuilt = sliding_box(lambda: SlidingBox(rebuild=True))
        for parameters in ({"mass_box": 2.0}, {"friction_box": 0.1}, {"gravity": 5.0}):
            self.assertEqual(run(rebuilt, 2, **parameters)[1], run(sliding_box(), 2, **parameters)[1])

    def test_delay_and_noise(self):
        adapter = sliding_box()
        first = adapter.reset(Scenario(1, 1, {"noise_box": 0.1}))["observation"]["vectors"]
        exact = adapter.reset(Scenario(1, 1, {}))["observation"]["vectors"]
        self.assertNotEqual(first["box"], exact["box"])
        self.assertEqual(first["pusher.x"], exact["pusher.x"])
        adapter.reset(Scenario(1, 1, {"action_delay": 3}))
        for _ in range(3):
            adapter.step(Action("vector", [0.4]))
            self.assertEqual(float(adapter._trajectory.actions[-1][0]), 0.0)
        adapter.step(Action("vector", [0.4]))
        self.assertAlmostEqual(float(adapter._trajectory.actions[-1][0]), 0.4, places=6)

    def test_own_knob(self):
        def stiffen(env, value):
            env.model.actuator_gainprm[0, 0] = value
            env.model.actuator_biasprm[0, 1] = -value

        stiffness = Knob("stiffness", stiffen, lambda env: env.model.actuator_gainprm[0, 0], 50.0, 500.0, nominal=200.0, unit="N/m")
        adapter = sliding_box(knobs=[stiffness])
        self.assertEqual(adapter.reset(Scenario(0, 1, {"stiffness": 70.0}))["applied"], {"stiffness": 70.0})


class Views(unittest.TestCase):
    def test_light_and_cameras_are_read_from_the_scene(self):
        adapter = sliding_box()
        wanted = {"light": 0.3, "camera_x_front": 0.2, "camera_z_front": -0.1, "camera_turn_front": 0.4, "camera_y_on_pusher": 0.05}
        applied = adapter.reset(Scenario(0, 1, wanted))["applied"]
        for name, value in wanted.items():
            self.assertAlmostEqual(applied[name], value, msg=name)
        camera = adapter._model.data.camera("front")
        np.testing.assert_allclose(camera.xpos, [1.2, 0.0, 0.4])

    def test_light_that_does_not_follow_is_read_back(self):
        adapter = sliding_box()
        knob = adapter._by_parameter["light"]

        def dim_the_lamp_only(env, value):
            adapter._model.edit(adapter._model.model.light_diffuse, slice(None), adapter._model.model.light_diffuse * value)

        adapter._by_parameter["light"] = dataclasses.replace(knob, set=dim_the_lamp_only)
        adapter.knobs[adapter.knobs.index(knob)] = adapter._by_parameter["light"]
        self.assertNotAlmostEqual(adapter.reset(Scenario(0, 1, {"light": 0.5}))["applied"]["light"], 0.5)

    def test_views_do_not_change_the_physics(self):
        self.assertEqual(run(sliding_box(), 3, light=0.5, camera_x_front=0.3)[1], run(sliding_box(), 3)[1])


class Friction(unittest.TestCase):
    """MuJoCo takes the larger friction of two geoms. The table has 1.5 and the plate 0.2."""

    def test_contacts_have_the_requested_friction(self):
        for wanted in (0.05, 0.4, 3.0):
            adapter = sliding_box()
            reply = adapter.reset(Scenario(0, 1, {"friction_box": wanted}))
            self.assertAlmostEqual(reply["applied"]["friction_box"], wanted)
            self.assertEqual(set(friction_of.live(adapter._model, [2])), {wanted})

    def test_unchanged_priority_is_read_back(self):
        adapter = sliding_box()
        knob = adapter._by_parameter["friction_box"]
        adapter._by_parameter["friction_box"] = _without_priority(adapter, knob)
        adapter.knobs[adapter.knobs.index(knob)] = adapter._by_parameter["friction_box"]
        reply = adapter.reset(Scenario(0, 1, {"friction_box": 0.05}))
        # The model's field has 0.05. The contacts have the friction of the table, so the client rejects the episode.
        self.assertAlmostEqual(float(adapter._model.model.geom("block").friction[0]), 0.05)
        self.assertAlmostEqual(reply["applied"]["friction_box"], 1.5)

    def test_friction_that_changes_later_is_not_applied(self):
        adapter = sliding_box()
        adapter.reset(Scenario(0, 1, {"friction_box": 0.05}))
        adapter._model.model.geom_priority[:] = 0
        with self.assertRaisesRegex(Problem, "not_applied.*1.5 acted"):
            adapter.step(Action("vector", [0.0]))

    def test_larger_friction_counts_between_two_varied_bodies(self):
        for box, pusher in ((0.3, 0.9), (0.9, 0.3)):
            adapter = sliding_box()
            step = adapter.reset(Scenario(0, 1, {"friction_box": box, "friction_pusher": pusher}, policy="push"))
            self.assertEqual(step["applied"], {"friction_box": box, "friction_pusher": pusher})
            seen = set()
            while step.get("ending") is None:
                step = adapter.step(Action("vector", step["proposed"]["action"]))
                seen |= set(friction_of.live(adapter._model, [1]))
            # The pusher touches the box only.
            self.assertEqual(seen, {0.9})

    def test_body_without_contact_is_probed(self):
        # The pusher touches nothing after a reset.
        reply = sliding_box().reset(Scenario(0, 1, {"friction_pusher": 0.9}))
        self.assertAlmostEqual(reply["applied"]["friction_pusher"], 0.9)


def _without_priority(adapter, knob):
    return dataclasses.replace(knob, set=lambda env, value: friction_of.write(adapter._model, [2], value, raise_priority=False))


class Faults(unittest.TestCase):
    def test_diverged_physics(self):
        adapter = sliding_box()
        adapter.reset(Scenario(0, 1, {}))
        adapter._model.data.qvel[:] = np.nan
        with self.assertRaisesRegex(Problem, "diverged"):
            adapter.step(Action("vector", [0.0]))

    def test_stepping_another_model(self):
        class Other(SlidingBox):
            def step(self, action):
                return self._get_obs(), 0.0, False, False, {"success": False}

        environment = Environment(make=lambda: Other(), task=Task(name="other"))
        with self.assertRaisesRegex(DeclarationError, "does not step the model"):
            Adapter(environment)

    def test_error_of_one_start_makes_one_episode_invalid(self):
        for make in (SlidingBox, Plain):
            tries = []

            def policy(env):
                count = [0]

                def act(observation):
                    count[0] += 1
                    if count[0] == 3 and len(tries) < fails:
                        tries.append(count[0])
                        raise ValueError("no solution")
                    return np.array([0.4])

                return act

            # The task of the sliding box reads a Dict.
            adapter = Adapter(Environment(make=make, task=Task(name="box", success=lambda t: False), policies={"push": Policy(policy)}))
            fails = 2
            with self.assertRaisesRegex(Problem, "setup: raised in two tries at this start: ValueError: no solution"):
                run(adapter)
            self.assertEqual(len(tries), 2)
            fails = 3
            with self.assertRaisesRegex(ValueError, "no solution"):
                run(adapter)
            fails = 0
            self.assertIsNotNone(run(adapter)[0]["ending"])

    def test_registered_environment_takes_arguments(self):
        from robogate_eval.environments.family import arguments

        self.assertEqual(arguments("mode=state&steps=50&dense=true"), {"mode": "state", "steps": 50, "dense": True})
        for query in ("mode", "1x=2", "a=1&a=2"):
            with self.assertRaises(ValueError):
                arguments(query)
            with self.assertRaises(UnknownEnvironment):
                find(f"gymnasium:Pendulum-v1?{query}")
        environment = find("gymnasium:Pendulum-v1?g=1.5")
        self.assertEqual(environment.make().unwrapped.g, 1.5)

    def test_graphics_library_is_chosen_without_a_display(self):
        import os
        from unittest import mock

        from robogate_eval.serving import rendering

        for found, expected in [({"EGL", "OSMesa"}, "egl"), ({"OSMesa"}, "osmesa"), (set(), None)]:
            with mock.patch.dict(os.environ, clear=True), mock.patch.object(rendering, "find_library", lambda name: name if name in found else None):
                rendering.choose_library()
                self.assertEqual(os.environ.get("MUJOCO_GL"), expected)
        with mock.patch.dict(os.environ, {"DISPLAY": ":0"}, clear=True):
            rendering.choose_library()
            self.assertNotIn("MUJOCO_GL", os.environ)

    def test_parts_that_are_no_numbers_are_skipped(self):
        from gymnasium import spaces
        from robogate_eval.serving.spaces import Observations

        grey, first, alpha = spaces.Box(0, 255, (4, 6, 1), np.uint8), spaces.Box(0, 255, (3, 8, 6), np.uint8), spaces.Box(0, 255, (4, 6, 4), np.uint8)
        parts = {"state": spaces.Box(-1, 1, (3,)), "text": spaces.Text(20), "depth": spaces.Box(0, 9, (120, 160, 1)), "grey": grey, "first": first, "alpha": alpha}
        space = spaces.Dict(parts)
        observations = Observations(space)
        self.assertEqual(list(observations.vectors), ["state"])
        self.assertEqual({name for name, _ in observations.skipped}, {"text", "depth"})
        self.assertEqual({name: size for name, (_, *size) in observations.images.items()}, {"grey": [4, 6], "first": [8, 6], "alpha": [4, 6]})
        seen = space.sample()
        observations.check(seen)
        np.testing.assert_array_equal(observations.image(seen, "first")[5, 2], seen["first"][:, 5, 2])
        np.testing.assert_array_equal(observations.image(seen, "alpha"), seen["alpha"][:, :, :3])
        self.assertEqual(observations.image(seen, "grey").shape, (4, 6, 3))
        with self.assertRaisesRegex(DeclarationError, "is a Text"):
            Observations(spaces.Dict({"text": spaces.Text(20)}))

    def test_actions_of_two_arms_are_joined(self):
        from gymnasium import spaces
        from robogate_eval.serving.spaces import actions_of

        arms = spaces.Dict({"right": spaces.Box(-1, 1, (2,), np.float32), "left": spaces.Box(-2, 2, (1, 2), np.float32), "grip": spaces.Discrete(2)})
        actions = actions_of(arms, ())
        self.assertEqual(sorted(actions.names), ["grip", "left_0", "left_1", "right_0", "right_1"])
        for _ in range(5):
            action = arms.sample()
            again = actions.decode(actions.encode(action))
            self.assertTrue(arms.contains(again), again)
            for key in action:
                np.testing.assert_array_equal(again[key], action[key])
        with self.assertRaisesRegex(ValueError, "with the parts left. Expected"):
            actions.encode({"left": np.zeros((1, 2))})
        pair = actions_of(spaces.Tuple([spaces.Box(-1, 1, (1,)), spaces.Box(-1, 1, (2,))]), ("a", "b", "c"))
        self.assertEqual((pair.names, len(pair.decode([0.1, 0.2, 0.3]))), (["a", "b", "c"], 2))

    def test_success_is_a_truth_value(self):
        from robogate_eval.serving.scoring import truth

        for value, expected in [(True, True), (np.bool_(False), False), (1, True), (0.0, False), (np.array([1]), True), (np.array(False), False), (np.float32(1), True)]:
            self.assertIs(truth(value, "x"), expected)
        for value in (0.4, float("nan"), -1, 100, {"a": 1}, "yes", None, np.array([True, True]), [], np.float32(0.4)):
            with self.assertRaisesRegex(Problem, rf"info\['success'\] is .*\({type(value).__name__}\). Expected True"):
                truth(value, "info['success']")

    def test_share_of_success_is_refused(self):
        class Share(SlidingBox):
            def step(self, action):
                *rest, info = super().step(action)
                return *rest, {"success": 0.4}

        with self.assertRaisesRegex(DeclarationError, r"info\['success'\] is 0.4 \(float\)"):
            sliding_box(Share)

    def test_success_at_the_start_is_invalid(self):
        class Solved(SlidingBox):
            def reset(self, **options):
                observation, info = super().reset(**options)
                return observation, {**info, "is_success": True}

        with self.assertRaisesRegex(DeclarationError, "already successful at the start"):
            sliding_box(Solved)
        task = Task(name="solved", starts_may_succeed=True)
        adapter = Adapter(Environment(make=Solved, task=task, policies={"push": PUSH}))
        self.assertEqual(run(adapter)[0]["measures"]["success_at_start"], 1.0)
        self.assertIn("success_at_start", [measure["name"] for measure in adapter.hello()["task"]["measures"]])

    def test_success_that_no_action_changes_is_no_success(self):
        """A criterion that only `info` of a step reports, and that holds whatever the policy does."""
        class Lifted(SlidingBox):
            def step(self, action):
                *rest, info = super().step(action)
                return *rest, {**info, "success": True}

        with self.assertRaisesRegex(DeclarationError, "already successful at the start"):
            sliding_box(Lifted)

        class Quick(SlidingBox):
            def step(self, action):
                *rest, info = super().step(action)
                return *rest, {**info, "success": bool(np.asarray(action).ravel()[0] > 0.0)}

        ending = run(sliding_box(Quick))[0]["ending"]
        self.assertEqual(ending, {"failure": None})

    def test_success_of_an_earlier_episode_does_not_count(self):
        """A flag that the reset forgets."""
        class Sticky(SlidingBox):
            done = False

            def step(self, action):
                *rest, info = super().step(action)
                self.done = self.done or self.data.time > 0.4
                return *rest, {"success": self.done}

        adapter = sliding_box(Sticky)
        with self.assertRaisesRegex(Problem, "earlier episode has an effect"):
            [run(adapter, index=index) for index in (5, 6, 7)]

    def test_two_reports_of_success_must_agree(self):
        class Two(SlidingBox):
            def step(self, action):
                *rest, info = super().step(action)
                return *rest, {"success": False, "is_success": self.data.time > 0.4}

        with self.assertRaisesRegex(DeclarationError, "is_success.* in the same step. Say in a file which one counts"):
            sliding_box(Two)

    def test_hint_names_the_key_that_it_found(self):
        class Nested(SlidingBox):
            def step(self, action):
                return *super().step(action)[:4], {"step": 1, "metrics": {"task": {"Success_rate": 1.0}}}

        with self.assertRaisesRegex(DeclarationError, r"t.info.get\('metrics', {}\).get\('task', {}\).get\('Success_rate', False\)"):
            sliding_box(Nested)

    def test_derived_constants_leave_the_rest_alone(self):
        """From MuJoCo 3.17 on, mj_setConst rewrites the poses of welds that an author set."""
        import mujoco
        from robogate_eval.serving import model as module

        xml = """<mujoco><worldbody><body name="mocap" mocap="true" pos="0 0 .5"/><body name="hand" pos="0 0 .55"><freejoint/>
        <geom type="box" size=".03 .03 .03" mass="1"/></body></worldbody><equality><weld body1="mocap" body2="hand"/></equality></mujoco>"""

        class Env:
            model = mujoco.MjModel.from_xml_string(xml)
            data = mujoco.MjData(model)

        Env.model.eq_data[0, 3:6] = (0, 0, 0.1)
        original = mujoco.mj_setConst

        def rewrites(model, data):
            original(model, data)
            model.eq_data[0, 3:6] = (0, 0, 0.05)
            # A field that follows from the mass in some version only, such as dof_length from sizes since MuJoCo 3.9.
            model.dof_armature[0] = 0.1 * (model.body_mass[2] - 1.0)

        before = {name: array.copy() for name, array in module._numbers(Env.model).items()}
        edited = module.Model(Env())
        mujoco.mj_setConst = rewrites
        try:
            # Without an effect on derived fields.
            edited.edit(Env.model.geom_friction, (0, 0), 0.5)
            edited.finish()
            edited.restore()
            edited.edit(Env.model.body_mass, 2, 2.0)
            edited.finish()
            np.testing.assert_array_equal(Env.model.eq_data, before["eq_data"])
            self.assertAlmostEqual(Env.model.body_subtreemass[2], 2.0)
            edited.restore()
        finally:
            mujoco.mj_setConst = original
        for name, array in module._numbers(Env.model).items():
            np.testing.assert_array_equal(array, before[name], err_msg=name)

    def test_no_report_of_success(self):
        class Silent(SlidingBox):
            def step(self, action):
                return (*super().step(action)[:4], {})

        with self.assertRaisesRegex(DeclarationError, "reports no success"):
            sliding_box(Silent)

class Worn(SlidingBox):
    """The reset leaves the wear as it is, and the start depends on it."""

    wear = 1.0
    resets = 0

    def reset(self, seed=None, options=None):
        if seed == -1:
            raise RuntimeError("no start")
        observation, info = super().reset(seed=seed, options=options)
        self.resets += 1
        self.model.opt.viscosity = 0.01 * self.wear
        return observation, info


def wear(env, value):
    env.unwrapped.wear = value


class KnobsAreUndone(unittest.TestCase):
    def test_an_episode_does_not_see_the_knobs_of_others(self):
        for nominal in (None, 1.0):
            knob = Knob("wear", wear, lambda env: env.unwrapped.wear, 0.0, 4.0, nominal=nominal)
            adapter = sliding_box(Worn, knobs=[knob])
            env = adapter._env.unwrapped
            _, first = run(adapter)
            _, other = run(adapter, wear=3.5)
            self.assertEqual(env.wear, 3.5)
            _, again = run(adapter)
            self.assertEqual((env.wear, env.model.opt.viscosity), (1.0, 0.01))
            self.assertEqual(first, again)
            # From now on the value is set before each reset, which runs once.
            run(adapter, wear=2.0)
            before = env.resets
            _, varied = run(adapter, wear=3.5)
            self.assertEqual(env.resets, before + 1)
            self.assertEqual(other, varied)
            _, last = run(adapter)
            self.assertEqual(first, last)

    def test_a_knob_that_the_reset_uses_is_set_before_it(self):
        knob = Knob("wear", wear, lambda env: env.unwrapped.wear, 0.0, 4.0, nominal=1.0, before_reset=True)
        adapter = sliding_box(Worn, knobs=[knob])
        env = adapter._env.unwrapped
        viscosities = []
        for parameters in ({}, {"wear": 3.0}, {"wear": 2.0}, {}, {}):
            run(adapter, **parameters)
            viscosities.append(round(100 * env.model.opt.viscosity, 6))
        self.assertEqual(viscosities, [1.0, 3.0, 2.0, 1.0, 1.0])

    def test_an_environment_may_raise_in_some_starts(self):
        class Raises(SlidingBox):
            def reset(self, seed=None, options=None):
                observation, info = super().reset(seed=seed, options=options)
                if self.np_random.uniform() < 0.6:
                    raise RuntimeError("cannot place the part")
                return observation, info

        adapter = sliding_box(Raises)
        self.assertTrue(adapter.deterministic)

        class Never(SlidingBox):
            def reset(self, seed=None, options=None):
                raise RuntimeError("no licence")

        with self.assertRaisesRegex(RuntimeError, "no licence"):
            sliding_box(Never)

if __name__ == "__main__":
    unittest.main()
