"""The control period and the time limit of an environment."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from .environment import DeclarationError, Task, innermost
from .hints import unknown
from .model import Model


def control_period(env: Any, task: Task, model: Model | None, rest: Any, doing: Callable[[str], None]) -> float:
    """The time between two actions, in seconds: as declared, as MuJoCo simulates it, or as the environment states it."""
    if task.control_period_s is not None:
        return float(task.control_period_s)
    base = innermost(env)
    period, rate = getattr(base, "dt", None), (getattr(base, "metadata", None) or {}).get("render_fps")
    stated = [float(period)] if isinstance(period, (int, float)) and period > 0 else []
    if rate:
        stated.append(1.0 / float(rate))
    if model is not None and (simulated := _simulated_period(env, model, rest, doing)) > 0.0:
        return next((one for one in stated if math.isclose(one, simulated, rel_tol=0.01)), round(simulated, 9))
    if not stated:
        guess = next(_guesses(base), 0.05)
        raise DeclarationError(unknown(env, task.name, "control period", f"control_period_s={guess:g}"))
    if not math.isclose(stated[0], stated[-1], rel_tol=0.01):
        what = f'control period (`dt` says {stated[0]:g} s, and `metadata["render_fps"]` {stated[-1]:g} s)'
        raise DeclarationError(unknown(env, task.name, what, f"control_period_s={stated[0]:g}"))
    return stated[0]


def _guesses(base: Any) -> Iterator[float]:
    """What environments call their control period, or the time steps in it: good enough to propose."""

    def number(owner: Any, *names: str) -> float | None:
        values = (getattr(owner, name, None) for name in names)
        return next((float(value) for value in values if type(value) in (int, float) and value > 0), None)

    if period := number(base, "control_period", "control_dt", "control_timestep", "step_dt"):
        yield period
    if rate := number(base, "control_freq", "control_hz", "control_frequency", "fps"):
        yield 1.0 / rate
    # PyBullet's environments keep the time step beside the environment.
    owners = [base, *(getattr(base, name, None) for name in ("sim", "physics", "simulation"))]
    if step := next(filter(None, (number(owner, "timestep", "time_step", "sim_timestep", "sim_dt", "dt") for owner in owners)), None):
        repeated = next(filter(None, (number(owner, "frame_skip", "n_substeps", "action_repeat", "decimation") for owner in owners)), None)
        yield step * (repeated or 1.0)


def _simulated_period(env: Any, model: Model, rest: Any, doing: Callable[[str], None]) -> float:
    """How far a step moves the time of the physics."""
    before = float(model.data.time)
    doing("step")
    env.step(rest)
    after = float(model.data.time)
    doing("reset")
    env.reset(seed=0)
    model.bind(env)
    return after - before


def step_limit(env: Any, task: Task, period_s: float) -> int:
    """The largest number of control periods of an episode."""
    if task.time_limit_s is not None:
        return max(1, round(task.time_limit_s / period_s))
    specification = getattr(env, "spec", None)
    for limit in (getattr(specification, "max_episode_steps", None), getattr(innermost(env), "max_path_length", None)):
        if limit:
            return int(limit)
    raise DeclarationError(unknown(env, task.name, "time limit", "time_limit_s=10.0"))
