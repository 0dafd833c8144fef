"""Scripts of the repository that have tests of their own."""

import subprocess
import sys
import unittest
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


class RunUnittests(unittest.TestCase):
    def test_no_tests_are_an_error(self) -> None:
        command = [sys.executable, SCRIPTS / "run_unittests.py", Path(__file__).parent, "--pattern", "absent.py"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 1)
        self.assertIn("no tests were found", done.stderr)


if __name__ == "__main__":
    unittest.main()
