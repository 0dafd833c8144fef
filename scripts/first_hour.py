#!/usr/bin/env python3
"""Follows the tutorials as a new user does, and writes the commands with their times to docs/results/first-hour.md.

Usage: scripts/first_hour.py ROBOGATE [PYTHON]

ROBOGATE is the command of a release build, PYTHON an interpreter with gymnasium, pyzmq and msgpack (`python3` by default). Each page
starts in an empty folder with an empty cache, so the download of MuJoCo counts.
"""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# The pages, their users, and the command with the first verdict on the user's own thing.
PAGES = [
    ("policy.md", "robot-learning engineer: an environment of 40 lines and an ONNX network", "robogate gate"),
    ("robot.md", "system integrator: a URDF arm with a gripper and a payload", "robogate gate"),
    ("evidence.md", "safety engineer: evidence, its check, and the monitor", "robogate verify"),
]


def commands(page: str) -> list[str]:
    """The commands of the blocks `console`, as crates/robogate/tests/it/tutorials.rs reads them."""
    blocks = page.split("```console\n")[1:]
    lines = [line for block in blocks for line in block.split("```")[0].splitlines()]
    return [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]


def follow(page: str, robogate: Path, python: Path) -> list[tuple[str, float, int]]:
    """Run the commands of a page. Gives each with its seconds and its exit code."""
    done = []
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) / "work"
        work.mkdir()
        (Path(folder) / "robogate").symlink_to(ROOT)
        environment = {
            **os.environ,
            "PATH": os.pathsep.join([str(robogate.parent), str(python.parent), os.environ["PATH"]]),
            "ROBOGATE_CACHE_DIR": str(Path(folder) / "cache"),
            "ROBOGATE_STATE_DIR": str(Path(folder) / "state"),
        }
        for line in commands(page):
            command, _, comment = line.partition("  # ")
            expected = int(comment[len("exit code ") :][:1]) if comment.startswith("exit code ") else 0
            begun = time.monotonic()
            result = subprocess.run(["sh", "-c", command], cwd=work, env=environment, capture_output=True, text=True)
            if result.returncode != expected:
                sys.exit(f"{command}: exit code {result.returncode} in place of {expected}\n{result.stdout}{result.stderr}")
            done.append((command.strip(), time.monotonic() - begun, result.returncode))
    return done


def main() -> None:
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    robogate = Path(sys.argv[1]).resolve()
    python = Path(sys.argv[2] if len(sys.argv) > 2 else sys.executable).absolute()
    out = [
        "# The first hour\n",
        f"The commands of the [tutorials](../tutorials/policy.md), each page from an empty folder, run by `scripts/first_hour.py` on {datetime.date.today()}",
        f"({os.cpu_count()} processors, {platform.machine()}). Reading and typing are not counted. A verdict is the answer of the command in bold.\n",
    ]
    for name, user, first in PAGES:
        done = follow((ROOT / "docs/tutorials" / name).read_text(encoding="utf-8"), robogate, python)
        verdict = next(at for at, (command, *_) in enumerate(done) if command.startswith(first))
        until = sum(seconds for _, seconds, _ in done[: verdict + 1])
        own = sum(command.startswith("robogate") for command, *_ in done[: verdict + 1])
        out.append(f"## [{name.removesuffix('.md').capitalize()}](../tutorials/{name}): {user}\n")
        out.append(f"First verdict after {own} commands of RoboGate and {until:.0f} s.\n")
        out.append("| command | seconds | exit code |\n|---|---|---|")
        for at, (command, seconds, code) in enumerate(done):
            mark = "**" if at == verdict else ""
            out.append(f"| {mark}`{command}`{mark} | {seconds:.1f} | {code} |")
        out.append("")
    (ROOT / "docs/results/first-hour.md").write_text("\n".join(out), encoding="utf-8")


if __name__ == "__main__":
    main()
