"""Success and failure of an episode."""

from __future__ import annotations

from typing import Any

import numpy as np
from robogate_bridge import Problem

from .environment import Task, innermost
from .hints import example_file
from .trajectory import Trajectory


class Scoring:
    """Decides after each control period whether an episode has ended, and how."""

    def __init__(self, task: Task):
        self._task = task

    def is_known(self, trajectory: Trajectory) -> bool:
        """Whether it is known what success is: the task says it, or the environment has reported it in this trajectory."""
        return self._task.success is not None or _reported(trajectory) is not None

    def ending(self, trajectory: Trajectory, info: dict) -> dict | None:
        """The ending of the episode. None if it goes on."""
        if self._task.success is None:
            # Most environments report it in this way.
            reported = info.get("success", info)
            done = reported if type(reported) is bool else bool(reported) if type(reported) is float else self._succeeded(trajectory)
        else:
            done = self._task.success(trajectory)
        if done:
            return {"failure": None}
        failure = None if self._task.failure is None else self._task.failure(trajectory)
        if failure is None and trajectory.over:
            failure = "terminated" if trajectory.terminated else "timeout"
        return None if failure is None else {"failure": failure}

    def _succeeded(self, trajectory: Trajectory) -> bool:
        reported = _reported(trajectory)
        if reported is None and trajectory.over:
            example = example_file(trajectory.env, self._task.name, "success=lambda t: t.rewards[-1] > 0.9")
            has = ", ".join(map(str, trajectory.info)) or "nothing"
            raise Problem(
                "setup",
                "the environment reports no success: until the end of an episode, info had neither `success` nor `is_success` (it has "
                f"{has}), and there is no check_success(). Say in a file what success is, and name the file with --env. If it is a reward "
                f"above 0.9:\n{example}",
            )
        return bool(reported)


def _reported(trajectory: Trajectory) -> bool | None:
    """Success as most environments report it. None if this one has not reported anything yet."""
    for info in reversed(trajectory.infos):
        for key in ("success", "is_success"):
            if key in info:
                # Reported earlier and not now: this step is not a success.
                return info is trajectory.infos[-1] and _truth(info[key])
    env = innermost(trajectory.env)
    check = getattr(env, "check_success", None) or getattr(env, "_check_success", None)
    return None if check is None else _truth(check())


def _truth(value: Any) -> bool:
    if isinstance(value, str):
        raise Problem("setup", f"info reports success as the text {value!r:.40}. Expected True or False")
    # `np.all` of one number takes ten times as long.
    return bool(np.all(value)) if isinstance(value, (np.ndarray, list, tuple)) else bool(value)
