"""dm_control: declarations, knobs and the scripted policy. Needs the packages of `robogate_eval.environments requirements dm_control`."""

import os
import unittest

# No images are made here.
os.environ.setdefault("MUJOCO_GL", "disabled")

import numpy as np
from robogate_bridge import Action, Scenario, declaration
from robogate_eval.environments import find
from robogate_eval.environments.dm_control import World
from robogate_eval.serving.adapter import Adapter

from starts import assert_seeds_fix_starts


class DmControl(unittest.TestCase):
    def test_declarations_are_valid(self):
        for name in ("reach_site", "lift_brick", "stack_2_bricks"):
            adapter = Adapter(find(f"dm_control:{name}"))
            hello = declaration.hello(adapter.hello())
            self.assertTrue(hello["deterministic"], name)
            self.assertEqual(hello["task"]["action"]["spaces"][0]["names"][0], "joint_1")

    def test_seed_fixes_the_start(self):
        # The last one shuffles the bricks of the last episode.
        assert_seeds_fix_starts(self, [f"dm_control:{name}" for name in ("reach_site", "place_brick", "reassemble_5_bricks_random_order")])

    def test_scripted_policy_succeeds(self):
        for name in ("reach_site", "reach_duplo"):
            adapter = Adapter(find(f"dm_control:{name}"))
            for index in range(3):
                step = adapter.reset(Scenario(index, 1, {}, policy="scripted"))
                while step.get("ending") is None:
                    step = adapter.step(Action("vector", step["proposed"]["action"]))
                self.assertIsNone(step["ending"]["failure"], name)

    def test_all_knobs_read_back(self):
        adapter = Adapter(find("dm_control:lift_brick"))
        wanted = {"mass_duplo2x4": 0.02, "friction_duplo2x4": 0.4, "shift_x_duplo2x4": 0.02, "gain": 0.8, "camera_z_front_close": 0.1, "light": 0.5}
        applied = adapter.reset(Scenario(0, 1, wanted))["applied"]
        for name, value in wanted.items():
            self.assertAlmostEqual(applied[name], value, places=6, msg=name)

    def test_observation_is_taken_again(self):
        world = World("lift_brick")
        observation, _ = world.reset(3)
        again = world._get_obs()
        self.assertEqual(observation.keys(), again.keys())
        for name, value in observation.items():
            np.testing.assert_array_equal(again[name], value, err_msg=name)


if __name__ == "__main__":
    unittest.main()
