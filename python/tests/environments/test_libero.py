"""LIBERO itself: seeds. Needs the packages of `robogate_eval.environments requirements libero`, and LIBERO on PYTHONPATH."""

import importlib.util
import unittest

from starts import assert_seeds_fix_starts


@unittest.skipUnless(importlib.util.find_spec("libero"), "LIBERO is not installed")
class Libero(unittest.TestCase):
    def test_seed_fixes_the_start(self):
        assert_seeds_fix_starts(self, ["libero:spatial", "libero:object/3", "libero:goal/8"])


if __name__ == "__main__":
    unittest.main()
