"""Fetch: the scripted policy and the knobs. Needs the packages of `robogate_eval.environments requirements fetch`."""

import unittest

from robogate_bridge import Action, Scenario, declaration
from robogate_eval.environments import families, find
from robogate_eval.serving.adapter import Adapter

from starts import assert_seeds_fix_starts


def run(adapter, index, **parameters):
    """Run an episode of the scripted policy. Returns the last step."""
    step = adapter.reset(Scenario(index, 1, parameters, policy="scripted"))
    while step.get("ending") is None:
        step = adapter.step(Action("vector", step["proposed"]["action"]))
    return step


class Fetch(unittest.TestCase):
    def test_declarations_are_valid(self):
        for name in families()["fetch"].names():
            hello = declaration.hello(Adapter(find(f"fetch:{name}")).hello())
            self.assertEqual([v["name"] for v in hello["task"]["observation"]["vectors"]], ["achieved_goal", "desired_goal", "observation"])

    def test_seed_fixes_the_start(self):
        assert_seeds_fix_starts(self, [f"fetch:{name}" for name in families()["fetch"].names()])

    def test_scripted_policy_succeeds(self):
        for name in ("FetchReach-v4", "FetchPickAndPlace-v4"):
            adapter = Adapter(find(f"fetch:{name}"))
            endings = [run(adapter, index)["ending"]["failure"] for index in range(5)]
            self.assertEqual(endings, [None] * 5, name)

    def test_all_knobs_read_back(self):
        adapter = Adapter(find("fetch:FetchPickAndPlace-v4"))
        wanted = {"mass_object0": 3.0, "friction_object0": 0.4, "shift_x_object0": 0.02, "gain": 0.8, "action_delay": 2, "gravity": 5.0}
        applied = adapter.reset(Scenario(0, 1, wanted))["applied"]
        for name, value in wanted.items():
            self.assertAlmostEqual(applied[name], value, msg=name)


if __name__ == "__main__":
    unittest.main()
