"""A family: the environments of one package."""

from __future__ import annotations

import difflib
import importlib.metadata
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from ..serving.environment import Environment


@dataclass(frozen=True)
class Family:
    """Environments of one package."""

    # The part of a name before the colon.
    name: str
    # One line for `robogate list environments`.
    summary: str
    # The package that must be importable.
    package: str
    # Pinned requirements of pip, without those of this package.
    requirements: list[str]
    # Lists what may follow the colon. May import the package.
    names: Callable[[], list[str]]
    # The environment of one of these names. Raises `UnknownEnvironment` for any other name.
    environment: Callable[[str], Environment]
    # How users get the package, if pip cannot install it: it must be importable before `robogate env setup`.
    yours: str | None = None


def installed(package: str) -> str:
    """Name and version of an installed package."""
    return f"{package} {importlib.metadata.version(package)}"


def arguments(query: str, known: "Iterable[str] | None" = None) -> dict[str, Any]:
    """The arguments after the `?` of a name, `key=value&...`. A value is read as JSON, otherwise it is a text; `true` is True.

    Raises:
        ValueError: A part is none of the `known` arguments, or stands twice.
    """
    found: dict[str, Any] = {}
    for pair in filter(None, query.split("&")):
        key, equals, text = pair.partition("=")
        if not equals or not key.isidentifier() or known is not None and key not in known:
            expected = ", as in ID?obs_type=state&max_steps=50" if known is None else f" with one of: {', '.join(sorted(known))}"
            raise ValueError(f"{pair!r} is not an argument. Expected key=value{expected}")
        if key in found:
            raise ValueError(f"the argument {key} is given twice")
        try:
            found[key] = json.loads(text)
        except ValueError:
            found[key] = text
    return found


# Bounds of the actions of environments whose action space is narrower than what their own policies use. The part of the identifier
# before the slash. ALOHA's joints go to pi, and its space to 1.
WIDER_ACTIONS = {"gym_aloha": math.pi}


def widened(env: Any) -> Any:
    """The environment, with the action space that its policies need."""
    bound = WIDER_ACTIONS.get((getattr(env.spec, "id", None) or "").partition("/")[0])
    if bound is not None:
        space = env.action_space
        env.action_space = type(space)(-bound, bound, space.shape, space.dtype)
    return env


class UnknownEnvironment(LookupError):
    """There is no environment of this name."""


def unknown(kind: str, name: str, known: Iterable[str], family: str = "") -> UnknownEnvironment:
    """The error for a name that is not one of these, with the nearest of them first."""
    known = list(known)
    nearest = difflib.get_close_matches(name, known, n=1)
    meant = f"Did you mean {family}{nearest[0]}? " if nearest else ""
    return UnknownEnvironment(f"{family}{name}: unknown {kind}. {meant}Expected one of: {', '.join(known)}")
