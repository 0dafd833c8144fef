"""The four suites and the protocol of the benchmark."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

# Actions that do nothing, at the start of each episode: objects of the initial states fall onto their supports.
REST_STEPS = 10
# Seed of the benchmark. It places fixtures, which the initial states do not contain.
SEED = 7


@dataclass(frozen=True)
class Suite:
    """A suite of ten tasks."""

    # The part of an environment's name, for example `spatial` in `libero:spatial/3`.
    name: str
    # The folder of its task files.
    folder: str
    # The largest number of actions of an episode, after the ones that do nothing.
    steps: int
    meaning: str
    # Of a variant: the folder of the suite that it varies.
    original: str | None = None


SUITES = {
    suite.name: suite
    for suite in (
        Suite("spatial", "libero_spatial", 220, "the same bowl in ten places"),
        Suite("object", "libero_object", 280, "ten objects into a basket"),
        Suite("goal", "libero_goal", 300, "ten goals in the same scene"),
        Suite("10", "libero_10", 520, "ten long tasks"),
    )
}


def suite(name: str, folders: Iterable[str]) -> Suite | None:
    """The suite of this name, also a variant of one that the installation has a folder for, such as `spatial_swap` of LIBERO-PRO. A variant
    has the time limit of its original. None if there is none."""
    if name in SUITES:
        return SUITES[name]
    original = SUITES.get(name.partition("_")[0])
    folder = f"libero_{name}"
    return None if original is None or folder not in folders else dataclasses.replace(original, name=name, folder=folder, original=original.folder)


def wording(task_name: str) -> str:
    """The instruction that LIBERO's benchmark class derives from the name of a task file (`task.language`).

    openpi, OpenVLA-OFT, LeRobot and vla-eval send it. The text in the task file differs from it in most tasks.
    """
    if task_name[:1].isupper():
        # SCENE10 has one more digit than the others.
        start = task_name.find("SCENE") + (8 if "SCENE10" in task_name else 7)
        task_name = task_name[start:]
    return " ".join(task_name.split("_"))
