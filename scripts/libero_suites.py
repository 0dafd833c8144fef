#!/usr/bin/env python3
"""Writes the suites of LIBERO into assets/suites, from an installation of LIBERO: scripts/libero_suites.py

Needs LIBERO on PYTHONPATH. Each task is a group of 50 scenarios, one for each of the benchmark's initial states.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "python" / "src"))

from robogate_eval.libero import bddl, installation  # noqa: E402
from robogate_eval.libero.suites import REST_STEPS, SUITES  # noqa: E402

INITIAL_STATES = 50
OFT = "OpenVLA-OFT paper, arXiv 2502.19645, 500 episodes"
OPENVLA = "OpenVLA paper, arXiv 2406.09246, 500 episodes and three seeds"
# Success of each policy on the suites spatial, object, goal and 10.
PUBLISHED = [
    ("OpenVLA", OPENVLA, (0.847, 0.884, 0.792, 0.537)),
    ("OpenVLA-OFT", OFT, (0.976, 0.984, 0.979, 0.945)),
    ("pi0", "table of the OpenVLA-OFT paper, arXiv 2502.19645", (0.968, 0.988, 0.958, 0.852)),
]


def text(suite, position):
    """The TOML text of a suite."""
    folder = installation.folder() / "bddl_files" / suite.folder
    lines = [
        f"# LIBERO-{suite.name}: {suite.meaning}. Written by scripts/libero_suites.py; do not edit.",
        "schema = 1",
        f'name = "libero-{suite.name}"',
        'version = "1.0.0"',
        f'description = "LIBERO-{suite.name}: 10 tasks, each from the {INITIAL_STATES} initial states of the benchmark; {REST_STEPS} actions that do nothing, '
        f'then at most {suite.steps}."',
        f'environment = "libero:{suite.name}"',
    ]
    for policy, source, success in PUBLISHED:
        lines += ["", "[[published]]", f'policy = "{policy}"', f"success = {success[position]}", f'source = "{source}"']
    for number, task in enumerate(installation.task_order()[suite.folder]):
        instruction = bddl.read(folder / f"{task}.bddl").instruction
        states = "\n".join(f'    {{ id = "task{number}-{state}", initial_state = {state} }},' for state in range(INITIAL_STATES))
        lines += ["", "[[group]]", f'name = "task{number}"', 'category = "task"', f'description = "{instruction}"',
                  f'defaults = {{ task = "{task}" }}', f"scenarios = [\n{states}\n]"]  # fmt: skip
    return "\n".join(lines) + "\n"


def main():
    """Writes the files."""
    for position, suite in enumerate(SUITES.values()):
        file = ROOT / "assets" / "suites" / f"libero-{suite.name}.toml"
        file.write_text(text(suite, position))
        print(file.relative_to(ROOT))


if __name__ == "__main__":
    main()
