"""Campaigns in shards: the leash of processes, the progress line, the calls of the command."""

import io
import os
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from collections import deque
from pathlib import Path
from unittest import mock

from robogate_eval.cluster import batches, leash, shards
from robogate_eval.cluster.progress import Progress, duration


def alive(process: int) -> bool:
    """Whether a process runs. A zombie has ended."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def parent(process: int) -> int:
    """The parent of a process."""
    return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])


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

    def test_killed_leash_leaves_no_process(self) -> None:
        """Each of the two processes of a leash kills the family after the death of the other one."""
        os.chdir(self.work)
        self.addCleanup(os.chdir, "/")
        for inner in (False, True):
            for file in self.work.iterdir():
                file.unlink()
            process = leash.start(["sh", "-c", self.FAMILY], None, None)
            family = self.family()
            os.kill(parent(family[0]) if inner else process.pid, signal.SIGKILL)
            process.wait(90)
            self.assertTrue(wait_for(lambda: not any(map(alive, family))), "processes are left")

    def test_ignored_signals_of_children_are_no_problem(self) -> None:
        program = [sys.executable, "-I", "-S", leash._PROGRAM, str(os.getpid()), "sh", "-c", "exit 7"]
        done = subprocess.run(["sh", "-c", "trap '' CHLD; exec \"$@\"", "sh", *program], timeout=90, check=False)
        self.assertEqual(done.returncode, 7)


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


def item(index: int, of: int, episodes: int = 10, folder: str = "d") -> shards.Item:
    name = f"{index}/{of}"
    return shards.Item(name, "uniform", folder, episodes, ("run", "--shard", name, "--out", folder))


class Batches(unittest.TestCase):
    def taken(self, items: "list[shards.Item]", slots: int, alone: "tuple[shards.Item, ...]" = ()) -> "list[int]":
        """The sizes of the batches until nothing is left."""
        waiting, sizes, order = deque(items), [], []
        while waiting:
            batch = batches.take(waiting, slots, alone)
            sizes.append(len(batch.items))
            order += batch.items
        self.assertEqual(order, items)
        return sizes

    def test_batches_become_smaller(self) -> None:
        self.assertEqual(self.taken([item(k, 32, 1) for k in range(32)], 2), [8, 6, 5, 4, 3, 2, 1, 1, 1, 1])
        self.assertEqual(self.taken([item(k, 4) for k in range(4)], 8), [1, 1, 1, 1])

    def test_batches_have_few_episodes(self) -> None:
        self.assertEqual(self.taken([item(k, 20, 40) for k in range(20)], 1)[:3], [2, 2, 2])
        self.assertEqual(self.taken([item(k, 3, 5000) for k in range(3)], 1), [1, 1, 1])

    def test_failed_shards_run_alone(self) -> None:
        items = [item(k, 16, 1) for k in range(16)]
        self.assertEqual(self.taken(items, 1, (items[2],)), [2, 1, 7, 3, 2, 1])

    def test_a_batch_has_one_folder(self) -> None:
        self.assertEqual(self.taken([item(k, 4, 1, folder) for folder in "ab" for k in range(4)], 1), [4, 2, 1, 1])

    def test_arguments_name_all_shards(self) -> None:
        batch = batches.Batch(tuple(item(k, 16) for k in (0, 1, 2, 7)))
        self.assertEqual(batch.arguments, ["run", "--shard", "0-2,7/16", "--out", "d"])
        self.assertEqual(batch.name, "shards 0-2,7/16 of round uniform in d")
        one = batches.Batch((item(3, 16),))
        self.assertEqual((one.arguments, one.name), (["run", "--shard", "3/16", "--out", "d"], "shard 3/16 of round uniform in d"))


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

    def test_documents_are_lines(self) -> None:
        self.answer("""echo '{"shard": "0/2"}'; echo 'a note'; echo '{"shard": "1/2"}'; exit 5""")
        result = shards.call([])
        self.assertEqual((result.code, result.documents), (5, [{"shard": "0/2"}, {"shard": "1/2"}]))
        self.answer("""printf '{\\n  "rounds": []\\n}\\n'""")
        self.assertEqual(shards.call([]).documents, [{"rounds": []}])

    def test_a_command_without_a_document_is_an_error(self) -> None:
        self.answer("echo nothing")
        with self.assertRaises(shards.CommandError) as raised:
            shards.next_round("d")
        self.assertEqual(raised.exception.code, shards.INFRASTRUCTURE)

    def test_status_of_a_sweep_is_a_sum(self) -> None:
        entry = '{"round": "uniform", "state": "open", "episodes": 5, "done": 2, "committed": 1, "missing": [1], "outcomes": {"success": 2}}'
        done = entry.replace("open", "complete")
        run = f'{{"run": "a", "status": {{"rounds": [{done}, {entry}]}}}}'
        self.answer(f"""echo '{{"runs": [{run}, {run}]}}'""")
        total = shards.open_status("d")
        self.assertEqual((total["episodes"], total["done"], total["committed"], len(total["missing"])), (10, 4, 2, 2))
        self.assertEqual((total["round"], total["outcomes"]), ("sweep", {"success": 4}))

    def test_errors_have_code_and_message(self) -> None:
        self.answer("echo 'RoboGate 0.2' >&2; echo 'error: no campaign' >&2; echo 'Hint: check' >&2; exit 2")
        with self.assertRaises(shards.CommandError) as raised:
            shards.next_round("d")
        self.assertEqual((raised.exception.code, str(raised.exception)), (2, "no campaign\nHint: check"))


if __name__ == "__main__":
    unittest.main()
