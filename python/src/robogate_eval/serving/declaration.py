"""What an environment declares to the command, in the form of the bridge protocol."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from .cameras import Cameras
from .default_space import default_space
from .environment import DeclarationError, Environment, Measure, Task
from .knobs import Knob, parameter_name
from .model import Model
from .spaces import Actions, Observations


# The measure of a task whose episodes may start in success.
SUCCESS_AT_START = Measure("success_at_start", meaning="1 if the criterion held before the first action, otherwise 0.")

# The measure of an environment with policies of its own.
CLIPPED = Measure("clipped_actions", meaning="Share of the control periods in which the policy's action was outside of its range.")


def measures_of(environment: Environment) -> list[Measure]:
    """The measures of the task, and those that this package adds."""
    task = environment.task
    added = [SUCCESS_AT_START] * task.starts_may_succeed + [CLIPPED] * bool(environment.policies)
    return [*task.measures, *added]


def task_declaration(
    environment: Environment, period_s: float, steps: int, knobs: Sequence[Knob], observations: Observations, cameras: Cameras, actions: Actions
) -> dict:
    """The task in the form of the bridge protocol. `steps`: the largest number of control periods of an episode."""
    task = environment.task
    modes = [{"name": mode.name, "meaning": mode.meaning, "severity": mode.severity} for mode in task.failure_modes]
    if all(mode.name != "terminated" for mode in task.failure_modes):
        modes.append({"name": "terminated", "meaning": "The environment ended the episode without success."})
    return {
        "name": task.name,
        "version": task.version,
        "instruction": task.instruction or task.name,
        "control_period_s": period_s,
        "time_limit_s": steps * period_s,
        "failure_modes": modes,
        "measures": [
            {"name": measure.name, "unit": measure.unit, "meaning": measure.meaning, "better": measure.better}
            for measure in measures_of(environment)
        ],
        "parameters": [knob.declaration() for knob in knobs],
        "observation": {"vectors": observations.declaration(), "cameras": cameras.declaration()},
        "action": {"spaces": [actions.declaration()]},
    }


def space_declaration(
    environment: Environment, knobs: Sequence[Knob], dropped: Sequence[tuple[str, str]], model: Model | None, period_s: float
) -> dict | None:
    """The space that is sampled by default, in the form of the bridge protocol."""
    by_parameter = {knob.parameter: knob for knob in knobs}
    own = {knob.name for knob in environment.knobs if isinstance(knob, Knob)}
    named = {knob for knob in environment.knobs if isinstance(knob, str)}
    parameters = []
    for name, domain in (environment.space or default_space(knobs, own, named, model, period_s)).items():
        knob = by_parameter.get(parameter_name(name))
        if knob is None:
            reason = dict(dropped).get(name, "the environment has no such knob")
            raise DeclarationError(f"the space of {environment.task.name} contains {name}: {reason}")
        if knob.choices:
            parameters.append({"name": knob.parameter, "kind": "categorical", "choices": list(domain)})
            continue
        low, high, *scale = domain
        parameter = {"name": knob.parameter, "kind": "integer" if knob.integer else "continuous", "low": low, "high": high}
        if scale:
            parameter["scale"] = scale[0]
        parameters.append(parameter)
    return {"name": environment.task.name, "parameter": parameters} if parameters else None


def engine_of(environment: Environment, model: Model | None) -> tuple[str, str]:
    """Name and version of the physics."""
    if environment.engine is not None:
        return environment.engine
    if model is not None:
        import mujoco

        return "mujoco", mujoco.__version__
    import gymnasium

    return "gymnasium", gymnasium.__version__


def mujoco_sha256() -> str | None:
    """The hash of MuJoCo's library, or None if the package contains none."""
    import mujoco

    libraries = sorted(Path(mujoco.__file__).parent.glob("libmujoco*"))
    return hashlib.sha256(libraries[0].read_bytes()).hexdigest() if libraries else None
