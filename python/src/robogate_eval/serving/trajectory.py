"""The trajectory of an episode, for functions that score it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


# Deepest nesting of containers that are copied.
DEEPEST = 8


def owned(value: Any, depth: int = 0) -> Any:
    """A copy of the arrays in `value`, and of the dicts, lists and tuples around them. Many environments write each observation into the
    same array. Values of other kinds stay as they are."""
    # Environments are listed, and declared, without NumPy.
    numpy = sys.modules.get("numpy")
    if numpy is not None and isinstance(value, numpy.ndarray):
        return value.copy()
    if depth >= DEEPEST:
        return value
    try:
        if isinstance(value, Mapping):
            copied = {key: owned(item, depth + 1) for key, item in value.items()}
            return copied if type(value) is dict else type(value)(copied)
        if isinstance(value, (list, tuple)):
            items = [owned(item, depth + 1) for item in value]
            return type(value)(*items) if hasattr(value, "_fields") else type(value)(items)
        if type(value).__module__.partition(".")[0] == "torch" and hasattr(value, "clone"):
            return value.clone()
    except (TypeError, ValueError):
        # A container that is made in another way.
        return value
    return value


@dataclass
class Trajectory:
    """What happened in an episode so far."""

    # The environment, as `make` returned it.
    env: Any
    # Time between two actions, in seconds.
    control_period_s: float
    # The observations of the environment, without added noise: one more than actions.
    observations: list[Any] = field(default_factory=list)
    # The actions that the environment ran.
    actions: list[Any] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    infos: list[dict[str, Any]] = field(default_factory=list)
    # The environment ended the episode (`terminated`).
    terminated: bool = False
    # This was the last control period: the time limit, or the environment truncated or terminated the episode.
    over: bool = False

    @property
    def steps(self) -> int:
        """Number of actions that were run."""
        return len(self.actions)

    @property
    def time_s(self) -> float:
        """Simulated time, in seconds."""
        return self.steps * self.control_period_s

    @property
    def info(self) -> dict[str, Any]:
        """The `info` of the last step; empty before it."""
        return self.infos[-1] if self.infos else {}

    @property
    def observation(self) -> Any:
        """The last observation."""
        return self.observations[-1]
