"""Policies in Python: functions, models of Stable-Baselines3, and policies of LeRobot."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from . import stable_baselines
from .environments.family import arguments
from .serving.environment import DeclarationError, Policy

# What stands before the path of a policy that the process of the environment loads.
LEROBOT, STABLE_BASELINES = "lerobot:", "sb3:"


def is_model_file(policy: Any) -> bool:
    """Whether this names a model that this process loads: a zip file or folder of Stable-Baselines3, or a checkpoint of LeRobot."""
    if not isinstance(policy, (str, os.PathLike)):
        return False
    text = os.fspath(policy)
    return _parts(text)[0].endswith(".zip") or text.startswith((LEROBOT, STABLE_BASELINES))


def load(path: "str | os.PathLike[str]") -> Any:
    """Load a model that `is_model_file` accepts, with `?key=value&...` after it for the arguments of `load` of its kind. It may contain
    programs: load only files that you trust.

    Raises:
        ValueError: There is no such model.
    """
    path, query = _parts(os.fspath(path))
    if path.startswith(LEROBOT):
        from .lerobot import policy

        return policy.load(path.removeprefix(LEROBOT), **arguments(query, {"rename_map"}))
    return stable_baselines.load(path.removeprefix(STABLE_BASELINES), **arguments(query, {"statistics"}))


def _parts(text: str) -> tuple[str, str]:
    """The path of a model and its arguments."""
    path, _, query = text.partition("?")
    return path, query


def declared(path: str) -> Policy:
    """The policy at this path for the declaration of an environment. Each process loads it once."""
    try:
        model = load(path)
    except ValueError as why:
        raise DeclarationError(f"--policy {path}: {why}") from None
    if path.startswith(LEROBOT):
        from .lerobot import policy

        version, kind = policy.version(Path(_parts(path)[0].removeprefix(LEROBOT))), "LeRobot"
    else:
        version, kind = _version(model.files), "Stable-Baselines3"
    check = model.check if isinstance(model, stable_baselines.Model) else None
    return Policy(lambda env: as_function(model, env), f"A policy of {kind}.", version, check)


def _version(files: list[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return f"sha256:{digest.hexdigest()}"


def as_function(policy: Any, env: Any = None, ask: "Callable[[Any], Any] | None" = None) -> Callable[[Any], Any]:
    """A policy as a function from an observation of `env` to an action. Called at the start of each episode. With `ask`, another process
    computes the answers: `batched` of the same policy."""
    if isinstance(policy, stable_baselines.Model):
        return policy.function(env, ask)
    if ask is not None and not hasattr(policy, "select_action"):
        from .in_flight import rows

        return rows(ask)
    if hasattr(policy, "predict"):
        return lambda observation: policy.predict(observation, deterministic=True)[0]
    if hasattr(policy, "select_action"):
        from .lerobot.policy import as_function as of_lerobot

        _reset(policy, ask)
        return of_lerobot(policy, env, ask)
    _reset(policy, ask)
    if callable(policy):
        return policy
    raise TypeError(
        f"{type(policy).__name__}: not a policy. Expected a function, a model with `predict` (Stable-Baselines3) or `select_action` "
        "(LeRobot), or a name"
    )


def _reset(policy: Any, ask: Any) -> None:
    """Start an episode of a policy that keeps something between its actions."""
    if ask is None and callable(reset := getattr(policy, "reset", None)):
        reset()


def batched(policy: Any) -> "Callable[[list[Any]], list[Any]] | None":
    """The policy as a function from what several episodes ask (`as_function`) to a list of their answers: arrays (actions, numbers). None
    if it answers one request at a time."""
    if callable(batch := getattr(policy, "predict_batch", None)):
        return batch
    if isinstance(policy, stable_baselines.Model) or hasattr(policy, "predict"):
        return stable_baselines.batched(getattr(policy, "model", policy) if isinstance(policy, stable_baselines.Model) else policy)
    if hasattr(policy, "select_action"):
        from .lerobot.policy import batched as of_lerobot

        return of_lerobot(policy)
    return None
