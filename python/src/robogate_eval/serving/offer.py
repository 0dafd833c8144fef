"""What can be varied in an environment: its own knobs, those of its MuJoCo model, delay and noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import mujoco_knobs
from .disturbances import Disturbances
from .environment import DeclarationError, Environment
from .knobs import Knob
from .model import Model
from .spaces import Observations

# The protocol allows 256 parameters.
MAX_KNOBS = 250


def offered(
    environment: Environment,
    env: Any,
    model: Model | None,
    observations: Observations,
    disturbances: Disturbances,
    observe: Callable[[Any], Any] | None,
    period_s: float,
) -> tuple[list[Knob], list[tuple[str, str]]]:
    """The knobs of an environment, and those that do not act, with the reason."""
    dropped: list[tuple[str, str]] = []
    wanted = environment.knobs
    own = [knob for knob in wanted if isinstance(knob, Knob)]
    names = {knob for knob in wanted if isinstance(knob, str)}
    others = disturbances.knobs(period_s)
    if model is not None:
        found = mujoco_knobs.catalogue(model, observe is not None, names | set(environment.space), bool(observations.images))
        if "*" not in names:
            found = [knob for knob in found if knob.name in names]
        kept, dropped = mujoco_knobs.self_test(model, found, env)
        others += kept
        if "*" in names:
            dropped += mujoco_knobs.unnamed(model, names)
            if observe is None and mujoco_knobs.has_free_body(model):
                why = "`_get_obs()` does not return the observation of the reset. Declare `observe` in the Environment"
                dropped.append(("shift_x, shift_y and turn of the free bodies", why))
    known = {knob.name for knob in others} | dict(dropped).keys()
    unknown = sorted(names - known - {"*"})
    if unknown:
        raise DeclarationError(f"{environment.task.name}: no knob is named {', '.join(unknown)}")
    taken: dict[str, str] = {}
    unique = []
    # Knobs that are sampled by default come first, so that they are within the limit.
    order = [*own, *sorted(others, key=lambda knob: knob.name not in environment.space and knob.name not in names)]
    for knob in order:
        first = taken.get(knob.parameter)
        if first is None:
            taken[knob.parameter] = knob.name
            unique.append(knob)
        elif first != knob.name:
            dropped.append((knob.name, f"its parameter {knob.parameter} is that of {first}"))
    dropped += [(knob.name, f"the task has more than {MAX_KNOBS} parameters") for knob in unique[MAX_KNOBS:]]
    return unique[:MAX_KNOBS], dropped


def is_bound(knob: Knob, environment: Environment) -> bool:
    """Whether a knob changes a body, joint or camera by its number in the first model."""
    own = any(knob is one for one in environment.knobs)
    return not own and ":" in knob.name and not knob.name.startswith(("gain:", "noise:"))
