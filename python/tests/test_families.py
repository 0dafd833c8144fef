"""The families of environments are listed without their packages: `robogate env setup` starts from a bare Python."""

import json
import subprocess
import sys
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Isolated from installed packages.
LIST = "import sys; sys.path[:0] = [{!r}, {!r}]; sys.argv = ['environments', 'list']; import runpy; runpy.run_module('robogate_eval.environments', run_name='__main__')"


class Families(unittest.TestCase):
    def test_are_listed_by_a_bare_python(self):
        code = LIST.format(str(ROOT / "python/src"), str(ROOT / "bridges/common"))
        output = subprocess.run([sys.executable, "-I", "-S", "-c", code], check=True, capture_output=True, text=True).stdout
        families = {family["name"]: family for family in json.loads(output)}
        self.assertLessEqual({"metaworld", "fetch"}, families.keys())
        for family in families.values():
            self.assertTrue(family["summary"] and family["missing"], family)
            for requirement in family["requirements"]:
                self.assertIn("==", requirement)
        # `robogate env setup` cannot install LIBERO, and says how to get it before it installs anything.
        self.assertIn("PYTHONPATH", families["libero"]["yours"])
        self.assertEqual(families["libero"]["missing"], families["libero"]["package"])


if __name__ == "__main__":
    unittest.main()
