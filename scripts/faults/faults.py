#!/usr/bin/env python3
"""Injects faults into every writing verb, one call at a time, and checks what is left.

Usage: scripts/faults.sh [--per-cell N] [--seed S] [--verbs a,b] [--out FILE]

For each verb, call (open, read, write, fsync, rename, link, mkdir, unlink) and kind (EIO, ENOSPC, EACCES, a short write, a power
failure that loses unsynced bytes), up to N of the calls fail, one in each process, chosen by the seed. After each fault:

- the exit code is a documented one, and the command did not panic;
- a short write changes nothing: the result is that of the command without a fault;
- the same verb (a campaign is resumed if its folder has a plan) then ends as if nothing had happened, with the same bytes; or, where
  a file exists that must not be replaced, it says so and the file is complete.
"""

from __future__ import annotations

import argparse
import collections
import datetime
import hashlib
import os
import random
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CALLS = ["open", "read", "write", "fsync", "rename", "link", "mkdir", "unlink"]
KINDS = {
    "open": ["eio", "enospc", "eacces", "power"], "read": ["eio", "short"], "write": ["eio", "enospc", "short", "power"],
    "fsync": ["eio", "enospc", "power"], "rename": ["eio", "enospc", "eacces", "power"], "link": ["eio", "enospc", "eacces", "power"],
    "mkdir": ["eio", "enospc", "eacces", "power"], "unlink": ["eio", "eacces", "power"],
}
DOCUMENTED = {0, 1, 2, 3, 4, 5, 130}
KILLED = -9
# Longest time of a command, in seconds. Reaching it is a fault of its own.
LIMIT = 300


@dataclass
class Verb:
    """A command that writes. `{w}` is its folder; `before` prepares it without faults."""

    name: str
    arguments: str
    before: list[str] = field(default_factory=list)
    # A second call continues the folder.
    resumed: bool = False


RUN = "run --task pendulum -n 24 --seed 3 --design uniform --threads 1 --out r"
VERBS = [
    Verb("run", RUN, resumed=True),
    Verb("run, two stages", "run --task pendulum -n 40 --seed 3 --design two-stage --threads 1 --out r", resumed=True),
    Verb("gate", "gate --task pendulum --rounds 1 --threads 1 --out r", resumed=True),
    Verb("report", "report r --out page.html", [RUN]),
    Verb("export", "export r rows.csv", [RUN]),
    Verb("import", "import rows.csv rows.parquet", [RUN, "export r rows.csv"]),
    Verb("figure", "figure r {figure} --svg a.svg --csv a.csv", [RUN]),
    Verb("keys", "keys new key"),
    Verb("evidence", "evidence r e --requirements default", [RUN]),
    Verb("compare", "compare r r --out c.html", [RUN]),
    Verb("plan and merge", "merge r", [RUN + " --divide 2", "run --shard 0 --out r", "run --shard 1 --out r"]),
    Verb("monitor reference", "monitor reference r --out m.json", [RUN]),
    Verb("tasks", "tasks init cell"),
    Verb("completions", "completions bash --out c"),
    Verb("trial plan", "trial plan study --policy a --policy b --blocks 4 --setups parts.csv", ["parts"]),
]


def digests(folder: Path) -> dict[str, str]:
    """The files of a folder with the hashes of their bytes. Files of a process that was killed have other names."""
    files = (file for file in sorted(folder.rglob("*")) if file.is_file())
    return {str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


class Bench:
    def __init__(self, robogate: Path, shim: Path, work: Path):
        self.robogate, self.shim, self.work = robogate, shim, work
        self.environment = {
            **os.environ, "ROBOGATE_STATE_DIR": str(work / "state"), "NO_COLOR": "1",
        }
        for name in list(self.environment):
            if name.startswith("FAULT_"):
                del self.environment[name]

    def run(self, arguments: str, folder: Path, **faults: str) -> tuple[int, str]:
        environment = dict(self.environment)
        if faults:
            environment |= {"LD_PRELOAD": str(self.shim), "FAULT_DIR": str(folder)} | {f"FAULT_{key.upper()}": value for key, value in faults.items()}
        done = subprocess.run(
            [self.robogate, *arguments.split()], cwd=folder, env=environment, capture_output=True, text=True, timeout=LIMIT, errors="replace"
        )
        return done.returncode, done.stdout + done.stderr

    def prepared(self, verb: Verb, template: Path, name: str) -> Path:
        """A folder that is ready for the verb."""
        folder = self.work / name
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(template, folder)
        return folder

    def template(self, verb: Verb) -> tuple[Path, str]:
        folder = self.work / "template"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        arguments = verb.arguments
        for line in verb.before:
            if line == "parts":
                (folder / "parts.csv").write_text("part,place\n" + "".join(f"p{i},{i % 3}\n" for i in range(12)))
                continue
            code, text = self.run(line, folder)
            if code not in (0, 1, 3):
                sys.exit(f"{verb.name}: {line} ends with {code}\n{text}")
        if "{figure}" in arguments:
            _, text = self.run("figure r", folder)
            arguments = arguments.replace("{figure}", text.split()[0])
        return folder, arguments


def check(bench: Bench, verb: Verb, arguments: str, template: Path, expected: dict[str, str], clean_code: int, call: str, kind: str, at: int) -> str:
    """Inject one fault. Gives how it ended, or raises `AssertionError` with the reason."""
    folder = bench.prepared(verb, template, "faulty")
    code, text = bench.run(arguments, folder, call=call, kind=kind, at=str(at))
    assert "panicked" not in text and "internal error" not in text, f"panic: {text[-600:]}"
    if kind == "power":
        assert code in (KILLED, clean_code), f"exit code {code}: {text[-400:]}"
    else:
        assert code in DOCUMENTED, f"exit code {code}: {text[-400:]}"
    if kind == "short":
        assert (code, digests(folder)) == (clean_code, expected), f"a short {call} changes the result: {code}, {differing(expected, digests(folder))}: {text[-300:]}"
        return "no effect"
    if code == clean_code and kind != "power":
        left = digests(folder)
        if left == expected:
            return "no effect"
    again = "resume r" if verb.resumed and (folder / "r/plan.json").exists() and (folder / "r/plan.json").stat().st_size else arguments
    code, text = bench.run(again, folder)
    left = digests(folder)
    if left == expected and code == clean_code:
        return "as without a fault" if again == arguments else "resumed"
    changed = [name for name in set(expected) | set(left) if expected.get(name) != left.get(name)]
    if code == clean_code and all(name.endswith(".html") and "is not shown: " in (folder / name).read_text() for name in changed if name in left):
        return "page without an episode"
    # A finished file is not replaced without being asked.
    if code == 2 and {name: left.get(name) for name in expected} == expected:
        return "complete"
    if code == 2 and any(word in text for word in ("exists", "not empty", "already", "remove", "Hint:")):
        # The user is told to remove what is there, and then all is well.
        for name in set(left) - set(digests(template)):
            (folder / name).unlink()
        for place in sorted((p for p in folder.rglob("*") if p.is_dir()), reverse=True):
            if not any(place.iterdir()) and not (template / place.relative_to(folder)).exists():
                place.rmdir()
        code, text = bench.run(arguments, folder)
        left = digests(folder)
        if left == expected and code == clean_code:
            return "removed by the user"
    raise AssertionError(f"{again}: exit code {code}, {differing(expected, left)}: {text[-400:]}")


def differing(expected: dict[str, str], left: dict[str, str]) -> str:
    names = sorted(set(expected) ^ set(left)) + sorted(name for name in expected if name in left and expected[name] != left[name])
    return "files that differ: " + ", ".join(names[:6])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robogate", type=Path)
    parser.add_argument("shim", type=Path)
    parser.add_argument("--per-cell", type=int, default=3, help="faults for each verb, call and kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--verbs", default="", help="names of verbs, separated by commas; default: all")
    parser.add_argument("--out", type=Path, help="write the table to this page")
    chosen = parser.parse_args()
    draw = random.Random(chosen.seed)
    rows, problems = [], []
    with tempfile.TemporaryDirectory() as temporary:
        bench = Bench(chosen.robogate.resolve(), chosen.shim.resolve(), Path(temporary).resolve())
        for verb in VERBS:
            if chosen.verbs and verb.name not in chosen.verbs.split(","):
                continue
            template, arguments = bench.template(verb)
            clean = bench.prepared(verb, template, "faulty")
            clean_code, text = bench.run(arguments, clean)
            if clean_code not in (0, 1, 3):
                sys.exit(f"{verb.name}: ends with {clean_code} without a fault\n{text}")
            expected = digests(clean)
            # A key is another one each time.
            random_files = verb.name in ("keys", "trial plan")
            outcomes: collections.Counter[str] = collections.Counter()
            injected = 0
            for call in CALLS:
                counted = bench.prepared(verb, template, "faulty")
                bench.run(arguments, counted, call=call, kind="eio", at="0", count=str(bench.work / "count"))
                calls = int((bench.work / "count").read_text() or 0)
                for kind in KINDS[call]:
                    for at in sorted(draw.sample(range(1, calls + 1), min(chosen.per_cell, calls))):
                        injected += 1
                        try:
                            if random_files:
                                outcomes[of_random(bench, verb, arguments, template, call, kind, at)] += 1
                            else:
                                outcomes[check(bench, verb, arguments, template, expected, clean_code, call, kind, at)] += 1
                        except (AssertionError, subprocess.TimeoutExpired) as error:
                            outcomes["PROBLEM"] += 1
                            problems.append(f"{verb.name}: {call} number {at} with {kind}: {error}")
                            print(problems[-1], file=sys.stderr, flush=True)
            rows.append((verb.name, injected, outcomes))
            print(verb.name, injected, dict(outcomes), flush=True)
    if chosen.out:
        write(chosen, rows, problems)
    sys.exit(1 if problems else 0)


def of_random(bench: Bench, verb: Verb, arguments: str, template: Path, call: str, kind: str, at: int) -> str:
    """A verb whose files are random: no panic, a documented exit code, and a second call works or says what to remove."""
    folder = bench.prepared(verb, template, "faulty")
    code, text = bench.run(arguments, folder, call=call, kind=kind, at=str(at))
    assert "panicked" not in text and (code in DOCUMENTED or (kind == "power" and code == KILLED)), f"exit code {code}: {text[-400:]}"
    if code == 0:
        return "no effect"
    code, text = bench.run(arguments, folder)
    if code == 0:
        return "as without a fault"
    assert code == 2 and "exist" in text, f"{code}: {text[-400:]}"
    for name in set(digests(folder)) - set(digests(template)):
        (folder / name).unlink()
    code, text = bench.run(arguments, folder)
    assert code in (0, 2), text[-400:]
    return "removed by the user"


def write(chosen: argparse.Namespace, rows: list, problems: list[str]) -> None:
    kinds = ["no effect", "as without a fault", "resumed", "complete", "page without an episode", "removed by the user", "PROBLEM"]
    out = [
        "# Faults of the disk\n",
        f"`scripts/faults.sh --per-cell {chosen.per_cell} --seed {chosen.seed}`, {datetime.date.today()}. Each row is a command; in each of its processes one call of the C library fails",
        "(open, read, write, fsync, rename, link, mkdir, unlink x EIO, ENOSPC, EACCES, short, power failure that loses unsynced bytes). Then the command runs",
        "again without a fault, or the campaign is resumed.\n",
        "| command | faults | " + " | ".join(kinds[:-1] + ["problems"]) + " |\n|---|---|" + "---|" * len(kinds),
    ]
    for name, injected, outcomes in rows:
        out.append(f"| {name} | {injected} | " + " | ".join(str(outcomes[kind] or "") for kind in kinds) + " |")
    out.append("\n- *no effect*: the same result and exit code, for example because a call is tried again\n- *as without a fault*, *resumed*: an error, and then the same bytes as without a fault")
    out.append("- *complete*: the second call refuses to replace files, and they are complete\n- *removed by the user*: it refuses what is left; after its removal all is well")
    out.append("- *page without an episode*: the recording of an episode could not read the rows, and the page says so")
    if problems:
        out.append("\n## Problems\n")
        out.extend(f"- {problem[:500]}" for problem in problems)
    chosen.out.write_text("\n".join(out) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
