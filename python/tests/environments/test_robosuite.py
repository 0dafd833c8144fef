"""robosuite 1.5. Needs the packages of `robogate_eval.environments requirements robosuite`."""

import importlib.util
import unittest

from robogate_eval.environments import families

from starts import assert_seeds_fix_starts


@unittest.skipUnless(importlib.util.find_spec("robosuite"), "robosuite is not installed")
class Robosuite(unittest.TestCase):
    def test_seed_fixes_the_start(self):
        assert_seeds_fix_starts(self, [f"robosuite:{name}" for name in families()["robosuite"].names()])


if __name__ == "__main__":
    unittest.main()
