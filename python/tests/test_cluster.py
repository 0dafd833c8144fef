"""Campaigns in shards: the leash of processes, the progress line, the calls of the command."""

import io
import os
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path
from unittest import mock

from robogate_eval.cluster import leash, shards
from robogate_eval.cluster.progress import Progress, duration


def alive(process: int) -> bool:
    """Whether a process runs. A zombie has ended."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def wait_for(condition: "object", seconds: float = 90.0) -> bool:
    """Wait until `condition()` holds."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():  # type: ignore[operator]
            return True
        time.sleep(0.05)
    return False


@unittest.skipUnless(sys.platform == "linux", "the leash needs Linux")
class Leash(unittest.TestCase):
    def setUp(self) -> None:
        work = tempfile.TemporaryDirectory()
        self.addCleanup(work.cleanup)
        self.work = Path(work.name)

    # Writes the ids of a shell, of its child, and of a grandchild in another session, and sleeps.
    FAMILY = "echo $$ > shell; sleep 300 & echo $! > child; setsid sh -c 'echo $$ > other; exec sleep 300' & wait"

    def family(self) -> "list[int]":
        names = ("shell", "child", "other")
        files = [self.work / name for name in names]
        self.assertTrue(wait_for(lambda: all(file.exists() and file.read_text().strip() for file in files)))
        return [int(file.read_text()) for file in files]

    def start(self) -> "subprocess.Popen[bytes]":
        """A process that holds a family on a leash."""
        program = f"import os; os.chdir({str(self.work)!r})\nfrom robogate_eval.cluster import leash\n"
        program += f"leash.start(['sh', '-c', {self.FAMILY!r}], None, None).wait()"
        holder = subprocess.Popen([sys.executable, "-c", program])
        self.addCleanup(holder.wait)
        self.addCleanup(holder.kill)
        return holder

    def test_exit_codes_and_output_pass_through(self) -> None:
        process = leash.start(["sh", "-c", "echo out; echo err >&2; exit 7"], subprocess.PIPE, subprocess.PIPE)
        self.assertEqual(process.communicate(), (b"out\n", b"err\n"))
        self.assertEqual(process.returncode, 7)
        process = leash.start(["sh", "-c", "kill -KILL $$"], None, None)
        self.assertEqual(process.wait(), 128 + signal.SIGKILL)
        process = leash.start(["/nowhere/robogate"], None, subprocess.PIPE)
        self.assertIn(b"cannot start /nowhere/robogate", process.communicate()[1])
        self.assertEqual(process.returncode, 127)

    def test_killed_parent_leaves_no_process(self) -> None:
        holder = self.start()
        family = self.family()
        holder.kill()
        self.assertTrue(wait_for(lambda: not any(map(alive, family))), "processes are left")

    def test_terminated_leash_leaves_no_process(self) -> None:
        os.chdir(self.work)
        self.addCleanup(os.chdir, "/")
        process = leash.start(["sh", "-c", self.FAMILY], None, None)
        family = self.family()
        process.terminate()
        self.assertEqual(process.wait(90), 128 + signal.SIGTERM)
        self.assertFalse(any(map(alive, family)))

    def test_killed_leash_kills_its_command(self) -> None:
        os.chdir(self.work)
        self.addCleanup(os.chdir, "/")
        process = leash.start(["sh", "-c", "echo $$ > shell; exec sleep 300"], None, None)
        shell = self.work / "shell"
        self.assertTrue(wait_for(lambda: shell.exists() and shell.read_text().strip()))
        process.kill()
        process.wait()
        self.assertTrue(wait_for(lambda: not alive(int(shell.read_text()))))


class ProgressLine(unittest.TestCase):
    STATUS = {"round": "uniform", "episodes": 100, "done": 20, "committed": 1, "missing": [1, 2, 3, 4], "outcomes": {"success": 20}}

    def test_counts_shards_and_outcomes(self) -> None:
        stream = io.StringIO()
        progress = Progress(self.STATUS, stream)
        progress.add({"outcomes": {"success": 10, "timeout": 8, "invalid": 2}})
        line = stream.getvalue().splitlines()[0]
        self.assertTrue(line.startswith("uniform   2 of 5 shards, 40 of 100 episodes, success 78.9 %, 2 invalid, "), line)
        self.assertIn(" left", line)

    def test_logs_a_line_for_each_tenth(self) -> None:
        stream = io.StringIO()
        progress = Progress({**self.STATUS, "episodes": 1000, "done": 0, "outcomes": {}}, stream)
        for _ in range(1000):
            progress.add({"outcomes": {"success": 1}})
        self.assertEqual(len(stream.getvalue().splitlines()), 10)

    def test_durations_have_units(self) -> None:
        self.assertEqual([duration(40), duration(720), duration(9000)], ["40 s", "12 min", "2.5 h"])


class Command(unittest.TestCase):
    def setUp(self) -> None:
        work = tempfile.TemporaryDirectory()
        self.addCleanup(work.cleanup)
        self.script = Path(work.name) / "robogate"
        environment = mock.patch.dict(os.environ, {"ROBOGATE_COMMAND": str(self.script)})
        environment.start()
        self.addCleanup(environment.stop)

    def answer(self, text: str) -> None:
        """Make the command run this script."""
        self.script.write_text(f"#!/bin/sh\n{text}\n")
        self.script.chmod(0o755)

    def test_next_shards_are_items(self) -> None:
        item = '{"shard": "1/2", "round": "uniform", "dir": "d", "episodes": 5, "command": ["robogate", "run", "--shard", "1/2"]}'
        self.answer(f"""echo '{{"version": 1, "round": "uniform", "shards": 2, "items": [{item}]}}'""")
        found = shards.next_round("d")
        self.assertEqual((found.name, found.shards), ("uniform", 2))
        self.assertEqual(found.items, [shards.Item("1/2", "uniform", "d", 5, ("run", "--shard", "1/2"))])

    def test_status_of_a_sweep_is_a_sum(self) -> None:
        entry = '{"round": "uniform", "state": "open", "episodes": 5, "done": 2, "committed": 1, "missing": [1], "outcomes": {"success": 2}}'
        done = entry.replace("open", "complete")
        run = f'{{"run": "a", "status": {{"rounds": [{done}, {entry}]}}}}'
        self.answer(f"""echo '{{"runs": [{run}, {run}]}}'""")
        total = shards.open_status("d")
        self.assertEqual((total["episodes"], total["done"], total["committed"], len(total["missing"])), (10, 4, 2, 2))
        self.assertEqual((total["round"], total["outcomes"]), ("sweep", {"success": 4}))

    def test_errors_have_code_and_message(self) -> None:
        self.answer("echo 'RoboGate 0.2' >&2; echo 'error: no campaign' >&2; echo 'hint: check' >&2; exit 2")
        with self.assertRaises(shards.CommandError) as raised:
            shards.next_round("d")
        self.assertEqual((raised.exception.code, str(raised.exception)), (2, "no campaign\nhint: check"))


if __name__ == "__main__":
    unittest.main()
