"""Success and failure of an episode."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from robogate_bridge import Problem

from .environment import Task, innermost
from .foreign import plain
from .hints import example_file
from .trajectory import Trajectory


# Words in the keys of `info` that name success.
SUCCESS_WORDS = ("succe", "solved", "completed", "goal_reached", "goal_achieved", "task_done")


class Scoring:
    """Decides after each control period whether an episode has ended, and how."""

    def __init__(self, task: Task):
        self._task = task

    def is_known(self, trajectory: Trajectory) -> bool:
        """Whether it is known what success is: the task says it, or the environment has reported it in this trajectory."""
        return self._task.success is not None or _reported(trajectory) is not None

    def holds_at_start(self, trajectory: Trajectory, info: Any) -> bool:
        """Whether the criterion holds before the first action, as far as the environment can say: by `info` of the reset, by
        `check_success()`, or by the task's function if it accepts a trajectory without actions."""
        if self._task.success is not None:
            try:
                return self._task.success(trajectory) is True
            except Exception:  # most functions look at the last action or reward
                return False
        for key in ("success", "is_success"):
            if isinstance(info, Mapping) and key in info:
                return truth(info[key], f"info[{key!r}] of the reset")
        return bool(_reported(trajectory))

    def ending(self, trajectory: Trajectory, info: dict) -> dict | None:
        """The ending of the episode. None if it goes on."""
        if self._task.success is None:
            # Most environments report it in this way.
            reported = info.get("success")
            done = reported if type(reported) is bool and "is_success" not in info else self._succeeded(trajectory)
        else:
            done = truth(self._task.success(trajectory), "the result of the task's success function")
        if done:
            return {"failure": None}
        failure = None if self._task.failure is None else self._task.failure(trajectory)
        if failure is None and trajectory.over:
            failure = "terminated" if trajectory.terminated else "timeout"
        return None if failure is None else {"failure": failure}

    def _succeeded(self, trajectory: Trajectory) -> bool:
        reported = _reported(trajectory)
        if reported is None and trajectory.over:
            known = next(_named(trajectory.info), None)
            rule, what = "t.rewards[-1] > 0.9", "a reward above 0.9"
            if known is None and min(trajectory.rewards) > 0.9:
                # A reward for each step rewards going on.
                rule, what = "t.over and not t.terminated", "to reach the time limit"
            if known is not None:
                inner = "".join(f".get({key!r}, {{}})" for key in known[:-1])
                rule, what = f"bool(t.info{inner}.get({known[-1]!r}, False))", f"what {'.'.join(map(str, known))!r} says"
            example = example_file(trajectory.env, self._task.name, f"success=lambda t: {rule}")
            has = ", ".join(map(str, trajectory.info)) or "nothing"
            raise Problem(
                "setup",
                "the environment reports no success: until the end of an episode, info had neither `success` nor `is_success` (it has "
                f"{has}), and there is no check_success(). Say in a file what success is, and name the file with --env. If it is "
                f"{what}:\n{example}",
            )
        return bool(reported)


def _reported(trajectory: Trajectory) -> bool | None:
    """Success as most environments report it. None if this one has not reported anything yet."""
    for info in reversed(trajectory.infos):
        values = {key: truth(info[key], f"info[{key!r}]") for key in ("success", "is_success") if key in info}
        if len(set(values.values())) > 1:
            raise Problem(
                "setup",
                f"info['success'] is {info['success']!r:.60} and info['is_success'] is {info['is_success']!r:.60} in the same step. Say in "
                "a file which one counts: Task(..., success=lambda t: bool(t.info['is_success']))",
            )
        if values:
            # Reported earlier and not now: this step is not a success.
            return info is trajectory.infos[-1] and True in values.values()
    env = innermost(trajectory.env)
    check = getattr(env, "check_success", None) or getattr(env, "_check_success", None)
    return None if check is None else truth(check(), f"{check.__name__}()")


def _named(info: Mapping, path: tuple = ()) -> Iterator[tuple]:
    """The paths of the keys that name success, those of nested dicts last."""
    yield from ((*path, key) for key, value in info.items() if not isinstance(value, Mapping) and _names_success(key))
    for key, value in info.items():
        if isinstance(value, Mapping):
            yield from _named(value, (*path, key))


def _names_success(key: Any) -> bool:
    return any(word in str(key).lower() for word in SUCCESS_WORDS)


# What to do if a success is neither true nor false.
SHARE = '. If a share counts as success, say from which value on: Task(..., success=lambda t: t.info["success"] >= 0.9)'


def truth(value: Any, name: str, hint: str = SHARE) -> bool:
    """Success, or the end of an episode, as a truth value: True, False, 1 or 0, as a number of Python or NumPy, or as an array or tensor with one of these. Of
    robomimic's dict of conditions, the one with the name `task`.

    Anything else (a share, NaN, a dict) does not say whether the episode succeeded.

    Raises:
        Problem: The value is something else. Names what reported it, its value and its type.
    """
    one = plain(value)
    if isinstance(one, dict) and "task" in one:
        one = one["task"]
    if isinstance(one, (np.ndarray, list, tuple)) and np.size(one) == 1:
        one = np.asarray(one).reshape(())[()]
    # Comparing a number of another kind with 0 and 1 also excludes NaN.
    if isinstance(one, (bool, np.bool_, int, float, np.number)) and (one == 0 or one == 1):
        return bool(one)
    raise Problem("setup", f"{name} is {value!r:.60} ({type(value).__name__}). Expected True, False, 1 or 0{hint}")
