"""Meta-World: its experts, knobs and seeds. Needs the packages of `robogate_eval.environments requirements metaworld`."""

import unittest

from robogate_bridge import Action, Scenario, declaration
from robogate_eval.environments import UnknownEnvironment, families, find
from robogate_eval.serving.adapter import Adapter

from starts import assert_seeds_fix_starts


def run(adapter, index, **parameters):
    """Run an episode of the expert. Returns the last step and the number of control periods."""
    step, periods = adapter.reset(Scenario(index, 1, parameters, policy="expert")), 0
    while step.get("ending") is None:
        step, periods = adapter.step(Action("vector", step["proposed"]["action"])), periods + 1
    return step, periods


class MetaWorld(unittest.TestCase):
    def test_all_tasks_are_known(self):
        family = families()["metaworld"]
        self.assertEqual(len(family.names()), 50)
        with self.assertRaisesRegex(UnknownEnvironment, "Did you mean metaworld:drawer-open-v3"):
            family.environment("drawr-open-v3")

    def test_expert_succeeds(self):
        for name in ("drawer-open-v3", "push-v3"):
            adapter = Adapter(find(f"metaworld:{name}"))
            declaration.hello(adapter.hello())
            self.assertTrue(adapter.deterministic)
            endings = [run(adapter, index)[0]["ending"]["failure"] for index in range(3)]
            self.assertEqual(endings, [None] * 3, name)

    def test_goal_is_observed(self):
        adapter = Adapter(find("metaworld:push-v3"))
        first = adapter.reset(Scenario(0, 1, {}))["observation"]["vectors"]["observation"][36:]
        then = adapter.step(Action("vector", [0.0] * 4))["observation"]["vectors"]["observation"][36:]
        self.assertNotEqual(first, [0.0] * 3)
        self.assertEqual(first, then)

    def test_goal_follows_from_the_index(self):
        adapter = Adapter(find("metaworld:push-v3"))

        def first(index):
            return adapter.reset(Scenario(index, 1, {}))["observation"]["vectors"]["observation"]

        self.assertEqual(first(1), first(1))
        self.assertNotEqual(first(1), first(2))

    def test_seed_fixes_the_start(self):
        # Every seventh task: all of them take minutes.
        assert_seeds_fix_starts(self, [f"metaworld:{name}" for name in families()["metaworld"].names()[::7]])

    def test_nominal_values_change_nothing(self):
        # The same bits as the environment alone, although the knobs evaluate its model once more after the reset.
        adapter = Adapter(find("metaworld:push-v3"))
        nominal = {knob["name"]: knob["nominal"] for knob in adapter.hello()["task"]["parameters"] if knob["name"] in ("mass_obj", "action_delay")}
        self.assertEqual(len(nominal), 2)

        def states(**parameters):
            step, states = adapter.reset(Scenario(2, 1, parameters, policy="expert")), []
            while step.get("ending") is None:
                step = adapter.step(Action("vector", step["proposed"]["action"]))
                states.append(step["state_hash"])
            return states

        self.assertEqual(states(**nominal), states())

    def test_low_friction_makes_the_expert_fail(self):
        # The coefficient in the contacts is the requested one, although the table has more friction.
        adapter = Adapter(find("metaworld:push-v3"))
        self.assertIsNone(run(adapter, 0)[0]["ending"]["failure"])
        step, periods = run(adapter, 0, friction_obj=0.02)
        self.assertEqual(periods, 500)
        self.assertIsNotNone(step["ending"]["failure"])


if __name__ == "__main__":
    unittest.main()
