"""The control period and the time limit of an environment."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from numbers import Real
from typing import Any

from .environment import DeclarationError, Task, innermost
from .hints import unknown
from .layers import attribute, layers
from .model import Model
from .starting import first_reset

# What environments and wrappers call the number of control periods of an episode.
LIMITS = ("max_path_length", "max_episode_steps", "_max_episode_steps", "horizon")

# The example of a time limit in a Task.
TIME_LIMIT = "time_limit_s=10.0"


def control_period(env: Any, task: Task, model: Model | None, rest: Any, doing: Callable[[str], None]) -> float:
    """The time between two actions, in seconds: as declared, as MuJoCo simulates it, or as the environment states it."""
    if task.control_period_s is not None:
        return float(task.control_period_s)
    base = innermost(env)
    rate = (attribute(base, "metadata") or {}).get("render_fps")
    by_name = {name: one for name, one in _own_periods(base)} | ({'metadata["render_fps"]': 1.0 / float(rate)} if rate else {})
    stated = list(by_name.values())
    if model is not None and (simulated := _simulated_period(env, model, rest, doing)) > 0.0:
        return next((one for one in stated if math.isclose(one, simulated, rel_tol=0.01)), round(simulated, 9))
    if not stated:
        guess = next(_guesses(base), 0.05)
        # All that is missing is told at once.
        limit = "" if task.time_limit_s is not None or _own_limit(env) is not None else f", {TIME_LIMIT}"
        what = "control period and the time limit" if limit else "control period"
        raise DeclarationError(unknown(env, task.name, what, f"control_period_s={guess:g}{limit}"))
    if not all(math.isclose(stated[0], one, rel_tol=0.01) for one in stated):
        what = "control period (" + ", ".join(f"`{name}` says {one:g} s" for name, one in by_name.items()) + ")"
        raise DeclarationError(unknown(env, task.name, what, f"control_period_s={stated[0]:g}"))
    return stated[0]


def _numbers(owner: Any, *names: str) -> Iterator[float]:
    """The attributes of these names that are positive numbers."""
    values = (attribute(owner, name) for name in names)
    yield from (float(value) for value in values if isinstance(value, Real) and not isinstance(value, bool) and value > 0)


def _own_periods(base: Any) -> Iterator[tuple[str, float]]:
    """The control period under each name that means nothing else, such as those of MuJoCo's environments, ManiSkill and Isaac Lab."""
    for name in ("dt", "control_period", "control_dt", "control_timestep", "step_dt"):
        yield from ((name, period) for period in _numbers(base, name))
    for name in ("control_freq", "control_hz", "control_frequency"):
        yield from ((name, 1.0 / rate) for rate in _numbers(base, name))


def _guesses(base: Any) -> Iterator[float]:
    """What may be the control period, or the time steps in it: good enough to propose."""
    yield from (1.0 / rate for rate in _numbers(base, "fps"))
    # PyBullet's environments keep the time step beside the environment.
    owners = [base, *(attribute(base, name) for name in ("sim", "physics", "simulation"))]
    for step in (step for owner in owners for step in _numbers(owner, "timestep", "time_step", "sim_timestep", "sim_dt", "dt")):
        repeated = (count for owner in owners for count in _numbers(owner, "frame_skip", "n_substeps", "action_repeat", "decimation"))
        yield step * next(repeated, 1.0)


def _simulated_period(env: Any, model: Model, rest: Any, doing: Callable[[str], None]) -> float:
    """How far a step moves the time of the physics."""
    before = float(model.data.time)
    doing("step")
    env.step(rest)
    after = float(model.data.time)
    doing("reset")
    first_reset(env)
    model.bind(env)
    return after - before


def _own_limit(env: Any) -> int | None:
    """The number of control periods of an episode, if the environment or a wrapper states it."""
    stated = [attribute(attribute(env, "spec"), "max_episode_steps")]
    # A wrapper of the package's own may have it, as in ManiSkill.
    stated += [attribute(here, name) for here in layers(env) for name in LIMITS]
    return next((int(limit) for limit in stated if isinstance(limit, Real) and limit > 0), None)


def step_limit(env: Any, task: Task, period_s: float) -> int:
    """The largest number of control periods of an episode."""
    if task.time_limit_s is not None:
        return max(1, round(task.time_limit_s / period_s))
    if (limit := _own_limit(env)) is not None:
        return limit
    raise DeclarationError(unknown(env, task.name, "time limit", TIME_LIMIT))
