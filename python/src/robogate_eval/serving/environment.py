"""The declaration of an environment: how it is made, its task, its knobs, its policies."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .knobs import DeclarationError, Knob
from .trajectory import Trajectory


@dataclass(frozen=True)
class FailureMode:
    """A way in which an episode can fail."""

    # Letters, digits, '_', '-' and '.'.
    name: str
    meaning: str = ""
    # minor, major or critical
    severity: str = "major"


@dataclass(frozen=True)
class Measure:
    """A number that describes an episode."""

    name: str
    unit: str = ""
    meaning: str = ""
    # Which values are better: lower, higher or neither.
    better: str = "neither"


@dataclass(frozen=True)
class Camera:
    """A camera that a policy observes."""

    name: str
    width: int
    height: int
    # (env) -> array of height x width x 3, uint8, upright. Default: MuJoCo renders its camera of this name.
    render: Callable[[Any], Any] | None = None


@dataclass(frozen=True)
class Policy:
    """A policy that runs in the process of the environment.

    `make(env)` is called after each reset and returns a function from an observation of the environment to an action. So a policy
    keeps no state from one episode to the next.
    """

    make: Callable[[Any], Callable[[Any], Any]]
    meaning: str = ""
    # Version of the policy, or the hash of its files. A run records it.
    version: str = ""
    # Raises ValueError if the policy does not fit an environment. Called once, before the first episode.
    check: Callable[[Any], None] | None = None


@dataclass(frozen=True)
class Task:
    """What an episode is about, and how it is scored."""

    # Letters, digits, '_', '-' and '.'.
    name: str
    instruction: str = ""
    # Increase it when a failure mode, a measure or the rule for success changes its meaning.
    version: int = 1
    # Default: the environment's own (`max_episode_steps` or `max_path_length`).
    time_limit_s: float | None = None
    # Default: the time that a step takes in MuJoCo; otherwise the environment's own (`dt`, `metadata["render_fps"]`).
    control_period_s: float | None = None
    # Called after each step. Default: `info["success"]`, `info["is_success"]` or `env.check_success()`.
    success: Callable[[Trajectory], bool] | None = None
    # Whether an episode may start in success: the measure `success_at_start` then counts these. Otherwise such an episode is invalid.
    starts_may_succeed: bool = False
    failure_modes: Sequence[FailureMode] = ()
    # Called after each step that was no success. Returns the name of a failure mode to end the episode, or None. If
    # `trajectory.over`, the episode ends in any case: None is then a `timeout`, or `terminated` if the environment ended it.
    failure: Callable[[Trajectory], str | None] | None = None
    measures: Sequence[Measure] = ()
    # Called once, at the end of an episode: the values of the measures by name. None is a measure without a value.
    measure: Callable[[Trajectory], Mapping[str, float | None]] | None = None
    # Called after reset and knobs, with the environment and the first observation. Returns the observation to start from. For
    # example, LIBERO runs ten actions that do nothing.
    prepare: Callable[[Any, Any], Any] | None = None
    # (env) -> the instruction of this episode, if episodes differ.
    episode_instruction: Callable[[Any], str] | None = None
    cameras: Sequence[Camera] = ()
    # Names of the numbers of an action. Default: action_0, action_1, ...
    action_names: Sequence[str] = ()
    # What the environment runs until the first delayed action takes effect. Default: zeros, or the first action if a bound excludes
    # them. State it if the numbers are absolute positions.
    rest_action: Sequence[float] | None = None


@dataclass(frozen=True)
class Environment:
    """An environment that can be served.

    `make()` returns an object with Gymnasium's interface: `observation_space` (Box or Dict of Boxes), `action_space` (Box),
    `reset(seed=...)` and `step(action)` with five results. All randomness of an episode must depend on the seed.
    """

    make: Callable[[], Any]
    task: Task
    # What can be varied: `Knob` objects, and names of MuJoCo knobs such as "mass:obj" (see `robogate_eval.serving.mujoco`).
    # "*" stands for all that the model offers.
    knobs: Sequence[str | Knob] = ("*",)
    # The space that is sampled by default: (low, high) or (low, high, "log") for the name of a knob, or its choices. Without any:
    # `Knob` objects over their ranges, and moderate ranges of knobs that are named or are usual (`default_space.py`).
    space: Mapping[str, tuple] = field(default_factory=dict)
    # By name.
    policies: Mapping[str, Policy] = field(default_factory=dict)
    # Whether an action of one of these policies outside of the action space is executed as it is, as the environment's own evaluation
    # does it. Otherwise it is clipped to the space, as those of all other policies are.
    unclipped_actions: bool = False
    # (env) -> observation, in the present state. Default: `env.unwrapped._get_obs()`. Knobs that move something need it.
    observe: Callable[[Any], Any] | None = None
    # Name and version of the physics. Default: MuJoCo, otherwise Gymnasium.
    engine: tuple[str, str] | None = None
    # Name and version of the package that the environment comes from, or the hash of its file. A run records it, and is resumed
    # only with the same.
    source: str = ""


def as_environment(value: Any, name: str) -> Environment:
    """The environment that this value declares: an `Environment`, or a function that returns one or a `gymnasium.Env`."""
    if isinstance(value, Environment):
        return value
    if not callable(value):
        hint = ". Hint: `lambda: ...` around what makes it" if hasattr(value, "reset") else ""
        raise DeclarationError(f"{name}: expected an Environment or a function that makes one, not {type(value).__name__}{hint}")
    # A class, or a function that is annotated with something else, makes a Gymnasium environment.
    if not isinstance(value, type):
        made = value()
        if isinstance(made, Environment):
            return made
        first = [made]
        return Environment(make=lambda: first.pop() if first else value(), task=Task(name=task_name(name)))
    return Environment(make=value, task=Task(name=task_name(name)))


def innermost(env: Any) -> Any:
    """The environment without its wrappers. An object that only has Gymnasium's methods is its own."""
    return getattr(env, "unwrapped", env)


def task_name(text: str) -> str:
    """This text as the name of a task."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", text).strip("-")[:64] or "environment"
