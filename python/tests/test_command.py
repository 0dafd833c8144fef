"""The Python package finds and runs the command."""

import os
import subprocess
import sys
import sysconfig
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import robogate_eval


def script(folder: Path, text: str = "exit 0") -> Path:
    """Create an executable `robogate` in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "robogate"
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)
    return file


class Command(unittest.TestCase):
    def setUp(self) -> None:
        work = tempfile.TemporaryDirectory()
        self.addCleanup(work.cleanup)
        self.work = Path(work.name)
        # No command of this machine is found.
        environment = mock.patch.dict(os.environ, {"PATH": str(self.work / "path")})
        environment.start()
        self.addCleanup(environment.stop)
        os.environ.pop("ROBOGATE_COMMAND", None)
        paths = mock.patch.object(sysconfig, "get_path", lambda _, scheme="main": str(self.work / scheme))
        paths.start()
        self.addCleanup(paths.stop)

    def test_scripts_folder_precedes_path(self) -> None:
        in_path = script(self.work / "path")
        self.assertEqual(robogate_eval.command(), in_path)
        user = script(self.work / f"{os.name}_user")
        self.assertEqual(robogate_eval.command(), user)
        main = script(self.work / "main")
        self.assertEqual(robogate_eval.command(), main)

    def test_command_beside_the_package_precedes(self) -> None:
        script(self.work / "main")
        packages = self.work / "prefix/lib/python3.9/site-packages"
        beside = script(self.work / "prefix/bin")
        with mock.patch("robogate_eval._command.__file__", str(packages / "robogate_eval/_command.py")):
            self.assertEqual(robogate_eval.command(), beside)

    def test_variable_overrides(self) -> None:
        script(self.work / "main")
        mine = script(self.work / "mine")
        os.environ["ROBOGATE_COMMAND"] = str(mine)
        self.assertEqual(robogate_eval.command(), mine)
        os.environ["ROBOGATE_COMMAND"] = str(self.work / "absent")
        with self.assertRaisesRegex(robogate_eval.CommandNotFoundError, "ROBOGATE_COMMAND=.*absent"):
            robogate_eval.command()

    def test_missing_command_names_the_remedy(self) -> None:
        with self.assertRaisesRegex(robogate_eval.CommandNotFoundError, "pip install"):
            robogate_eval.command()

    def test_exit_code_is_returned(self) -> None:
        script(self.work / "main", 'echo "$@"; exit 3')
        done = robogate_eval.run_command("run", Path("a b"), capture_output=True, text=True)
        self.assertEqual((done.returncode, done.stdout), (3, "run a b\n"))

    def test_module_is_the_command(self) -> None:
        mine = script(self.work / "mine", 'echo "$@"; exit 3')
        environment = {"ROBOGATE_COMMAND": str(mine), "PYTHONPATH": str(Path(robogate_eval.__file__).parents[1])}
        run = [sys.executable, "-m", "robogate_eval", "list", "tasks"]
        done = subprocess.run(run, env=environment, capture_output=True, text=True)
        self.assertEqual((done.returncode, done.stdout), (3, "list tasks\n"))
        environment["ROBOGATE_COMMAND"] = "absent"
        done = subprocess.run(run, env=environment, capture_output=True, text=True)
        self.assertEqual(done.returncode, 1)
        self.assertRegex(done.stderr, "^error: ROBOGATE_COMMAND=absent")


if __name__ == "__main__":
    unittest.main()
