"""The wrappers of an environment."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any


def layers(env: Any) -> Iterator[Any]:
    """An environment, and those that it wraps."""
    waiting, seen = [env], []
    while waiting:
        here = waiting.pop(0)
        if here is not None and not any(here is other for other in seen):
            seen.append(here)
            yield here
            waiting += [attribute(here, "env"), attribute(here, "unwrapped"), attribute(here, "_env")]


def attribute(value: Any, name: str) -> Any:
    """An attribute, or None."""
    if value is None:
        return None
    try:
        return getattr(value, name, None)
    except Exception:  # a property of an environment that is not ready yet
        return None


def action_masks(env: Any) -> Callable[[], Any] | None:
    """What returns which actions are possible now. None for an environment that does not say."""
    return next((masks for layer in layers(env) if callable(masks := attribute(layer, "action_masks"))), None)
