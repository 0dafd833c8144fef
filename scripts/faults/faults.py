"""Injects faults into every verb that writes, one call at a time, and checks what is left.

Usage: scripts/faults.sh [--per-cell N] [--seed S] [--commands "a;b"] [--jobs N] [--minutes M] [--out FILE]

For each command (`commands.py`), call (open, create, read, write, truncate, fsync, rename, link, mkdir, unlink) and kind (EIO, ENOSPC,
EACCES, a short read or write, a disk that stays full), up to N of the calls fail, one in each process, chosen by the seed. Power
failures (`disk.py`) come behind 4 N calls that change the folder, and at the end: everything that was not synced is lost, or half of it,
in any order. After each fault:

- the exit code is a documented one, the command did not panic, and an error names the file;
- a short read or write changes nothing: the result is that of the command without a fault;
- no file under its final name is half-written, unless it is a journal, which says where it ends;
- the same command (a campaign is resumed if its folder has a plan) then ends as if nothing had happened, with the same bytes; or, where
  a file exists that must not be replaced, it says so and the file is complete.
"""

from __future__ import annotations

import argparse
import collections
import concurrent.futures
import datetime
import hashlib
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from commands import COMMANDS, EXAMPLES, FILES, OTHERS, Command
from disk import CHANGES, after_power_failure, operations

ROOT = Path(__file__).resolve().parents[2]
KINDS = {
    "open": ["eio", "eacces"],
    "create": ["eio", "enospc", "eacces"],
    "read": ["eio", "short"],
    "write": ["eio", "short", "full"],
    "truncate": ["eio", "enospc"],
    "fsync": ["eio", "enospc"],
    "rename": ["eio", "enospc", "eacces"],
    "link": ["eio", "enospc", "eacces"],
    "mkdir": ["eio", "enospc", "eacces"],
    "unlink": ["eio", "eacces"],
}
DOCUMENTED = {0, 1, 2, 3, 4, 5, 130}
DONE = (0, 1, 3)
# Longest time of a command, in seconds. Reaching it is a fault of its own.
LIMIT = 120
# The state of the user.
IGNORED = ("state/",)
# Files that grow while a command runs. Each line or record says whether it is complete.
JOURNALS = (".rgj", "journal.jsonl", "lost.jsonl", ".registrations", ".rgs", ".db", "journal.head")
OUTCOMES = ["no effect", "repeated", "resumed", "complete", "removed by the user", "noted", "records lost", "PROBLEM"]


class Problem(Exception):
    """What a fault left is wrong."""


def digests(folder: Path) -> dict[str, str]:
    """The files of a folder with the hashes of their bytes, without those that a killed process left under temporary names."""
    files = (file for file in sorted(folder.rglob("*")) if file.is_file())
    names = ((str(file.relative_to(folder)), file) for file in files)
    kept = ((name, file) for name, file in names if not name.startswith(IGNORED) and not is_temporary(name))
    return {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in kept}


def is_temporary(name: str) -> bool:
    # SQLite's own journals: the next process that opens the store reads and removes them.
    return name.endswith(("-wal", "-shm", "-journal")) or any(part.startswith(".") and part.endswith((".part", ".partial", ".tmp")) for part in name.split("/"))


class Bench:
    """One command in a folder of its own."""

    def __init__(self, robogate: Path, shim: Path, work: Path, command: Command):
        self.robogate, self.shim, self.work, self.command = robogate, shim, work, command
        self.folder, self.template = work / "folder", work / "template"
        self.side = work / "side"
        self.side.mkdir(parents=True)
        self.environment = {name: value for name, value in os.environ.items() if not name.startswith(("FAULT_", "ROBOGATE_"))}
        self.environment |= {"NO_COLOR": "1", "ROBOGATE_STATE_DIR": str(self.folder / "state")}
        self.line = command.line
        self._prepare()

    def run(self, line: str, **faults: object) -> tuple[int, str]:
        environment = dict(self.environment)
        if faults:
            environment |= {"LD_PRELOAD": str(self.shim), "FAULT_DIR": str(self.folder)}
            environment |= {f"FAULT_{name.upper()}": str(value) for name, value in faults.items()}
        done = subprocess.run(
            [self.robogate, *line.split()], cwd=self.folder, env=environment, capture_output=True, text=True, timeout=LIMIT, errors="replace"
        )
        return done.returncode, done.stdout + done.stderr

    def _prepare(self) -> None:
        """Makes the template: a folder that is ready for the command. It has the same path, which files may contain."""
        self.folder.mkdir()
        for name, text in FILES.items():
            (self.folder / name).write_text(text)
        for name, example in EXAMPLES.items():
            shutil.copy(ROOT / "docs/examples" / example, self.folder / name)
        for name, (source, changes) in OTHERS.items():
            text = (self.folder / source).read_text()
            for old, new in changes:
                text = text.replace(old, new)
            (self.folder / name).write_text(text)
        for line in self.command.before:
            if line.startswith("full:"):
                _, at, line = line.split(":", 2)
                self.run(line, call="write", kind="full", at=at)
                continue
            code, text = self.run(self._filled(line))
            if code not in DONE:
                raise Problem(f"{line} ends with {code}\n{text}")
        self.line = self._filled(self.line)
        shutil.copytree(self.folder, self.template)

    def _filled(self, line: str) -> str:
        """The command with the code of the trial that comes next."""
        if "{code}" in line:
            line = line.replace("{code}", self.run("trial next study")[1].split()[1])
        return line

    def fresh(self) -> None:
        shutil.rmtree(self.folder)
        shutil.copytree(self.template, self.folder)

    def measure(self) -> None:
        """Runs the command without a fault: what it writes, and how many calls it makes."""
        self.fresh()
        self.code, text = self.run(self.line, count=self.side / "count", log=self.side / "log")
        if self.code not in DONE:
            raise Problem(f"ends with {self.code} without a fault\n{text}")
        self.expected = digests(self.folder)
        self.before = digests(self.template)
        self.shown = self.show()
        self.calls = {name: int(number) for name, number in map(str.split, (self.side / "count").read_text().splitlines())}
        self.log = operations(self.side / "log")
        # The same command twice gives the same bytes: otherwise no comparison means anything.
        self.fresh()
        if self.run(self.line)[0] != self.code or not self.as_expected():
            raise Problem(f"differs without a fault: {self.differing()}")

    def show(self) -> tuple[int, str]:
        code, text = self.run(self.command.shown_by) if self.command.shown_by else (0, "")
        return code, "" if self.command.random else text

    def as_expected(self) -> bool:
        """Whether the folder has what the command writes without a fault."""
        left = digests(self.folder)
        if self.command.shown_by:
            return set(left) == set(self.expected) and self.show() == self.shown
        return left == self.expected

    def differing(self) -> str:
        left = digests(self.folder)
        names = sorted(name for name in set(self.expected) | set(left) if self.expected.get(name) != left.get(name))
        return "files that differ: " + ", ".join(names[:6])

    def half_written(self) -> list[str]:
        """Files under their final names that are neither as before nor complete. Random bytes are never the same: see `shown_by`."""
        if self.command.shown_by:
            return []
        left = digests(self.folder)
        return [
            name for name, digest in left.items()
            if digest not in (self.expected.get(name), self.before.get(name)) and not name.endswith(JOURNALS)
        ]

    def inject(self, call: str, kind: str, at: int) -> str:
        """Lets one call fail. Gives how it ended, or raises `Problem`."""
        self.fresh()
        hit = self.side / "hit"
        hit.unlink(missing_ok=True)
        code, text = self.run(self.line, call=call, kind=kind, at=at, hit=hit)
        if "panicked" in text or "internal error" in text:
            raise Problem(f"panic: {text[-600:]}")
        if code not in DOCUMENTED:
            raise Problem(f"exit code {code}: {text[-400:]}")
        if kind == "short":
            if code != self.code or not self.as_expected():
                raise Problem(f"a short {call} changes the result: {code}, {self.differing()}: {text[-300:]}")
            return "no effect"
        if code == self.code and self.as_expected():
            return "no effect"
        where = self.named(hit, text)
        if where is not None:
            raise Problem(f"exit code {code}, and {where} is not named: {text[-300:]}")
        if half := self.half_written():
            if code != self.code:
                raise Problem(f"half-written: {', '.join(half[:4])}: {text[-300:]}")
        return self.again(noted=code == self.code)

    def named(self, hit: Path, text: str) -> str | None:
        """The file whose call failed, if the message does not name it."""
        if not hit.exists():
            return None
        path = Path(hit.read_text()).relative_to(self.folder)
        plain = re.sub(r"-(wal|shm|journal)$", "", path.name)
        plain = re.sub(r"(\.\d+-\d+)?\.part$", "", plain.removeprefix("."))
        names = {path.name, plain, *(part.removeprefix(".").removesuffix(".part") for part in path.parent.parts if part != "r")}
        if (self.folder / path).is_dir():
            # The entries of a folder are those of its files.
            names |= {name.split("/")[-1] for name in self.expected} | {name.split("/")[0] for name in self.expected}
        return None if any(name in text for name in names if name) else str(path)

    def lose_power(self, calls: int, draw: random.Random | None) -> str:
        """Power failure behind a number of calls of the undisturbed command. Gives how it ended, or raises `Problem`."""
        disk = after_power_failure(self.log, calls, self.folder, self.template, draw)
        shutil.rmtree(self.folder)
        disk.store(self.folder)
        at_end = calls == len(self.log)
        if at_end and self.as_expected():
            return "no effect"
        if at_end and self.command.durable:
            raise Problem(f"what the command wrote is not safe at its end: {self.differing()}")
        if half := self.half_written():
            raise Problem(f"half-written: {', '.join(half[:4])}")
        return self.again()

    def again(self, noted: bool = False) -> str:
        """Repeats the command, or resumes its campaign."""
        plan = self.folder / "r/plan.json"
        line = self.command.resume if self.command.resume and plan.exists() and plan.stat().st_size else self.line
        code, text = self.run(line)
        if code == self.code and self.as_expected():
            return "noted" if noted else "repeated" if line == self.line else "resumed"
        if code == self.code and noted and self.only_pages_differ():
            return "noted"
        left = digests(self.folder)
        if code == self.code and self.command.beside and {**left, self.command.beside: ""} == {**self.expected, self.command.beside: ""}:
            return "records lost"
        # A finished file is not replaced without being asked.
        if code == 2 and all(left.get(name) == digest for name, digest in self.expected.items()):
            return "complete"
        if code == 2 and self.command.shown_by and set(left) >= set(self.expected) and self.show() == self.shown:
            return "complete"
        if code == 2 and any(word in text for word in ("exist", "not empty", "already", "remove", "Hint:")):
            self.remove_results()
            code, text = self.run(self.line)
            if code == self.code and self.as_expected():
                return "removed by the user"
        raise Problem(f"{line}: exit code {code}, {self.differing()}: {text[-400:]}")

    def only_pages_differ(self) -> bool:
        """Whether only pages differ. They lack what could not be read, and the command has said so."""
        left = digests(self.folder)
        pages = [name for name in set(left) | set(self.expected) if left.get(name) != self.expected.get(name)]
        return all(name in left and name.endswith((".html", ".md")) for name in pages)

    def remove_results(self) -> None:
        """Removes what the command wrote, as the user is told."""
        for path in sorted(self.folder.rglob("*"), reverse=True):
            name = path.relative_to(self.folder)
            if not (self.template / name).exists() and not str(name).startswith(IGNORED):
                path.rmdir() if path.is_dir() else path.unlink()


def faults(bench: Bench, per_cell: int, draw: random.Random) -> list[tuple]:
    """The faults of a command."""
    chosen: list[tuple] = []
    for call, kinds in KINDS.items():
        calls = bench.calls[call]
        for kind in kinds:
            chosen.extend((call, kind, at) for at in sorted(draw.sample(range(1, calls + 1), min(per_cell, calls))))
    if bench.command.starts_others:
        return chosen
    changes = [i for i, one in enumerate(bench.log) if one[0] in CHANGES]
    for kind in ("lost", "reordered"):
        cuts = sorted(draw.sample(changes, min(4 * per_cell, len(changes))))
        chosen.extend(("power", kind, cut) for cut in (*cuts, len(bench.log)))
    return chosen


def examine(robogate: Path, shim: Path, command: Command, per_cell: int, seed: int) -> tuple[collections.Counter, collections.Counter, list[str]]:
    """All faults of one command: outcomes, faults by call, and problems."""
    draw = random.Random(f"{seed} {command.name}")
    outcomes, injected, problems = collections.Counter(), collections.Counter(), []
    with tempfile.TemporaryDirectory() as work:
        try:
            bench = Bench(robogate, shim, Path(work).resolve(), command)
            bench.measure()
        except Problem as problem:
            # The table is wrong, or a clock or a random number is in the result.
            print(f"UNUSABLE {command.name}: {problem}", flush=True)
            return outcomes, injected, [f"{command.name}: {problem}"]
        for call, kind, at in faults(bench, per_cell, draw):
            injected[call] += 1
            try:
                if call == "power":
                    outcome = bench.lose_power(at, random.Random(draw.random()) if kind == "reordered" else None)
                else:
                    outcome = bench.inject(call, kind, at)
                outcomes[outcome] += 1
            except (Problem, subprocess.TimeoutExpired) as problem:
                outcomes["PROBLEM"] += 1
                problems.append(f"{command.name}: {call} number {at}, {kind}: {problem}".replace(str(bench.folder), "FOLDER"))
                print(problems[-1], file=sys.stderr, flush=True)
    print(command.name, sum(injected.values()), dict(outcomes), flush=True)
    return outcomes, injected, problems


def page(chosen: argparse.Namespace, rows: list[tuple], left_out: list[str], seconds: float) -> str:
    """The page of results."""
    calls = [*KINDS, "power"]
    total = sum(sum(injected.values()) for _, (_, injected, _) in rows)
    problems = [problem for _, (_, _, found) in rows for problem in found]
    out = [
        "# Faults of the disk: measurements\n",
        f"{datetime.datetime.now(datetime.timezone.utc):%d %B %Y}, `scripts/faults.sh --per-cell {chosen.per_cell} --seed {chosen.seed}`: "
        f"{total:,} faults in {len(rows)} commands, {seconds / 60:.0f} minutes.",
        f"{len(problems) or 'No'} fault{'' if len(problems) == 1 else 's'} left something wrong.\n",
        "In each process one call of the C library fails, or the power fails behind one call. [How RoboGate is tested](../concepts/testing.md#faults-of-the-disk) says what is checked.\n",
        "| command | faults | " + " | ".join(kind if kind != "PROBLEM" else "problems" for kind in OUTCOMES) + " |",
        "|---|---:|" + "---:|" * len(OUTCOMES),
    ]
    for command, (outcomes, injected, _) in rows:
        out.append(f"| {command.name} | {sum(injected.values())} | " + " | ".join(str(outcomes[kind] or "") for kind in OUTCOMES) + " |")
    if left_out:
        out.append(f"\nNot tried in this run, which had {chosen.minutes:.0f} minutes: {', '.join(left_out)}.")
    out += [
        "",
        "- *no effect*: the result and the exit code of the command without a fault, for example because a call is tried again",
        "- *repeated*, *resumed*: an error that names the file, or a power failure; then the same bytes as without a fault",
        "- *complete*: the second call refuses to replace files, and they are complete",
        "- *removed by the user*: the second call refuses what is left, and says so; after its removal it gives the same bytes",
        "- *noted*: the command did its work and named a file that it could not read or write beside it; the second call wrote it, or keeps a page without it",
        "- *records lost*: the result has the same bytes, and the file of signals beside it lacks episodes; `robogate warn` says how many\n",
        "| call | faults | kinds |\n|---|---:|---|",
    ]
    for call in calls:
        number = sum(injected[call] for _, (_, injected, _) in rows)
        out.append(f"| {call} | {number:,} | {', '.join(KINDS.get(call, ['everything unsynced lost', 'half of it lost, in any order']))} |")
    if problems:
        out += ["\n## Problems\n", *(f"- {' '.join(problem.split())[:500]}" for problem in problems)]
    return "\n".join(out) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robogate", type=Path)
    parser.add_argument("shim", type=Path)
    parser.add_argument("--per-cell", type=int, default=3, help="faults for each command, call and kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--commands", default="", help="names of commands, separated by semicolons; default: all")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="commands that are tried at a time")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no command after this time; the page names those that are left out")
    parser.add_argument("--out", type=Path, help="write the table to this page")
    chosen = parser.parse_args()
    wanted = [name.strip() for name in chosen.commands.split(";") if name]
    commands = [command for command in COMMANDS if not wanted or command.name in wanted]
    began = time.monotonic()
    with concurrent.futures.ThreadPoolExecutor(chosen.jobs) as pool:
        def within(command: Command) -> tuple | None:
            if time.monotonic() - began > 60 * chosen.minutes:
                return None
            return examine(chosen.robogate.resolve(), chosen.shim.resolve(), command, chosen.per_cell, chosen.seed)

        results = list(pool.map(within, commands))
    rows = [(command, result) for command, result in zip(commands, results, strict=True) if result]
    left_out = [command.name for command, result in zip(commands, results, strict=True) if not result]
    if chosen.out:
        chosen.out.write_text(page(chosen, rows, left_out, time.monotonic() - began), encoding="utf-8")
    sys.exit(any(found for _, (_, _, found) in rows))


if __name__ == "__main__":
    main()
