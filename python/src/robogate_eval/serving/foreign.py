"""Environments whose interface differs from Gymnasium's: tensors, a batch of one world, gym before 0.26, dm_env, and pure functions."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from .environment import DeclarationError, innermost
from .layers import attribute, layers

VECTOR = (
    "the environment is a vector of {worlds} worlds (num_envs), which reset themselves. Expected one world without a vector around it: "
    "RoboGate starts a process for each"
)


def translated(env: Any) -> Any:
    """The environment with Gymnasium's interface. One that has this interface is returned as it is.

    Raises:
        DeclarationError: It is a vector of worlds, which reset themselves.
    """
    # Gymnasium's wrappers do not pass it on.
    worlds = attribute(env, "num_envs") or attribute(innermost(env), "num_envs")
    # Gymnasium's and Stable-Baselines3's vectors, and those of Isaac Lab and legged_gym.
    resets_itself = any(hasattr(here, name) for here in (env, innermost(env)) for name in ("step_async", "_reset_idx", "reset_idx"))
    if worlds is not None and (worlds != 1 or resets_itself or "autoreset_mode" in (attribute(env, "metadata") or {})):
        raise DeclarationError(VECTOR.format(worlds=worlds))
    action_space, observation_space = attribute(env, "action_space"), attribute(env, "observation_space")
    if observation_space is None and hasattr(env, "observation_size") and hasattr(env, "action_size"):
        return Functional(env)
    native = isinstance(action_space, spaces.Space) and isinstance(observation_space, spaces.Space) and _takes_seed(env)
    return env if native and not _is_batch(env) else Translated(env)


def plain(value: Any, batch: bool = False) -> Any:
    """A value with NumPy arrays in place of the tensors of PyTorch and the arrays of JAX, on any device. Of a `batch` of one world, the
    values of this world."""
    if isinstance(value, Mapping):
        return {key: plain(inner, batch) for key, inner in value.items()}
    if isinstance(value, (tuple, list)) and any(holds_tensors(one) or isinstance(one, np.ndarray) for one in value):
        parts = [plain(one, batch) for one in value]
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    if _is_tensor(value):
        value = value.detach().cpu().numpy() if hasattr(value, "detach") else np.asarray(value)
    if batch and isinstance(value, np.ndarray) and value.ndim > 0 and value.shape[0] == 1:
        return value[0]
    return value


def holds_tensors(value: Any) -> bool:
    """Whether there are tensors of PyTorch or arrays of JAX in a value."""
    if isinstance(value, Mapping):
        return any(map(holds_tensors, value.values()))
    return any(map(holds_tensors, value)) if isinstance(value, (tuple, list)) else _is_tensor(value)


def _is_tensor(value: Any) -> bool:
    return hasattr(value, "__array__") and hasattr(value, "shape") and not isinstance(value, (np.ndarray, np.generic))


def _is_batch(env: Any) -> bool:
    """Whether an environment observes a batch of one world. A wrapper that takes the world out of the batch has another space."""
    base = innermost(env)
    if attribute(base, "num_envs") != 1 or attribute(base, "single_action_space") is None:
        return False
    return env is base or attribute(env, "observation_space") == attribute(base, "observation_space")


def _takes_seed(env: Any) -> bool:
    try:
        parameters = inspect.signature(env.reset).parameters
    except (TypeError, ValueError):
        return True
    return "seed" in parameters or any(one.kind is one.VAR_KEYWORD for one in parameters.values())


class _Around:
    """An environment inside another interface. What it has beside `reset` and `step` is reached through this one."""

    def __init__(self, env: Any):
        self.env = env
        self.metadata = attribute(env, "metadata") or {}
        self.render_mode, self.spec = attribute(env, "render_mode"), attribute(env, "spec")

    @property
    def unwrapped(self) -> Any:
        return innermost(self.env)

    def __getattr__(self, name: str) -> Any:
        if name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)


class Translated(_Around):
    """An environment with tensors, a batch of one world, the interface of gym before 0.26 or of dm_env, or without spaces."""

    def __init__(self, env: Any):
        super().__init__(env)
        self._batch, self._takes_seed = _is_batch(env), _takes_seed(env)
        # The device of the tensors of a batch; None for arrays.
        self._device: Any = None
        owner, single = (innermost(env), "single_") if self._batch else (env, "")
        observed, acted = attribute(owner, f"{single}observation_space"), attribute(owner, f"{single}action_space")
        self.action_space = _action_space(env) if acted is None else _space(acted)
        self._acts_in_batch = self._batch and attribute(env, "action_space").shape != self.action_space.shape
        self.observation_space = _space_of(self.reset(seed=0)[0]) if observed is None or callable(observed) else _space(observed)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict]:
        if self._takes_seed:
            result = self.env.reset(seed=seed, options=options)
        else:
            if seed is not None:
                _seed_own(self.env, seed)
            result = self.env.reset()
        if hasattr(result, "step_type"):
            return result.observation, {}
        observation, info = result if isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], Mapping) else (result, {})
        if self._batch:
            self._device = next((one.device for one in _leaves(observation) if hasattr(one, "detach")), None)
        return plain(observation, self._batch), plain(info, self._batch)

    def step(self, action: Any) -> tuple:
        result = self.env.step(self._in_batch(action) if self._acts_in_batch else action)
        if hasattr(result, "step_type"):
            over = bool(result.last())
            ended = over and result.discount == 0.0
            return result.observation, result.reward or 0.0, ended, over and not ended, {}
        if not isinstance(result, tuple) or len(result) not in (4, 5):
            return result
        observation, reward, *ends, info = plain(result, self._batch)
        if len(ends) == 1:
            # The older gym: one `done` for both.
            truncated = bool(isinstance(info, Mapping) and info.get("TimeLimit.truncated", False))
            ends = [bool(ends[0]) and not truncated, truncated]
        return observation, reward, *ends, info

    def _in_batch(self, action: Any) -> Any:
        if isinstance(action, dict):
            return {key: self._in_batch(one) for key, one in action.items()}
        if isinstance(action, tuple):
            return tuple(map(self._in_batch, action))
        array = np.asarray(action)[None]
        if self._device is None:
            return array
        import torch

        return torch.as_tensor(array, device=self._device)

    def render(self) -> Any:
        return plain(self.env.render(), self._batch)


class Functional(_Around):
    """An environment of pure functions, as those of Brax and MuJoCo Playground: `reset(key)` and `step(state, action)` return a state
    with `obs`, `reward`, `done`, `info` and `metrics`. The dict `info` has what the last two contain."""

    def __init__(self, env: Any):
        super().__init__(env)
        import jax

        self._key, self._reset, self._step = jax.random.PRNGKey, jax.jit(env.reset), jax.jit(env.step)
        self.max_path_length = attribute(attribute(env, "_config"), "episode_length")
        # The convention of both.
        self.action_space = spaces.Box(-1.0, 1.0, (int(env.action_size),), np.float32)
        self.observation_space = _space_of(self.reset(seed=0)[0])
        # Compiled here, which takes longer than a step may: for the state of a reset, and for that of a step, whose types may differ.
        for _ in range(2):
            self.step(np.zeros(self.action_space.shape, np.float32))

    @property
    def unwrapped(self) -> Any:
        return self

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict]:
        self._state = self._reset(self._key(seed or 0))
        return plain(self._state.obs), self._info()

    def step(self, action: Any) -> tuple:
        self._state = state = self._step(self._state, action)
        return plain(state.obs), float(state.reward), bool(state.done), False, self._info()

    def _info(self) -> dict:
        return {**plain(self._state.info), **plain(self._state.metrics)}


def _leaves(value: Any) -> list:
    if isinstance(value, Mapping):
        return [leaf for inner in value.values() for leaf in _leaves(inner)]
    return [leaf for inner in value for leaf in _leaves(inner)] if isinstance(value, (tuple, list)) else [value]


def _seed_own(env: Any, seed: int) -> None:
    """Seed an environment whose `reset` takes no seed: with `seed()`, and the generators of NumPy that it keeps."""
    for here in layers(env):
        if callable(seeding := attribute(here, "seed")):
            seeding(seed)
        for owner in filter(None, (here, attribute(here, "task"), attribute(here, "_task"))):
            # Gymnasium makes its generator when it is asked for.
            for value in (attribute(owner, "np_random"), *getattr(owner, "__dict__", {}).values()):
                if isinstance(value, np.random.Generator):
                    value.bit_generator.state = type(value.bit_generator)(seed).state
                elif isinstance(value, np.random.RandomState):
                    value.seed(seed)


def _space(space: Any) -> spaces.Space:
    """A space of the older gym as one of Gymnasium."""
    if isinstance(space, spaces.Space):
        return space
    kind = type(space).__name__
    if kind == "Box":
        return spaces.Box(space.low, space.high, dtype=space.dtype.type)
    if kind == "Dict":
        return spaces.Dict({key: _space(inner) for key, inner in space.spaces.items()})
    if kind == "Tuple":
        return spaces.Tuple([_space(inner) for inner in space.spaces])
    if kind == "Discrete":
        return spaces.Discrete(int(space.n), start=int(getattr(space, "start", 0)))
    if kind in ("MultiDiscrete", "MultiBinary"):
        return getattr(spaces, kind)(space.nvec if kind == "MultiDiscrete" else space.n)
    raise DeclarationError(f"{space!r:.80} is not a space of Gymnasium. Expected a Box, Discrete, MultiDiscrete, MultiBinary, Dict or Tuple")


def _space_of(value: Any) -> spaces.Space:
    """The space of observations like this one, for an environment that declares none."""
    if isinstance(value, Mapping):
        return spaces.Dict({str(key): _space_of(inner) for key, inner in value.items()})
    if isinstance(value, tuple):
        return spaces.Tuple([_space_of(inner) for inner in value])
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        return spaces.Text(4096)
    if array.dtype == np.uint8 and array.ndim == 3:
        return spaces.Box(0, 255, array.shape, np.uint8)
    return spaces.Box(-np.inf, np.inf, array.shape, np.float64)


def _action_space(env: Any) -> spaces.Space:
    """The action space of an environment that declares none: its `action_spec`, or numbers from -1 to 1."""
    found = attribute(env, "action_spec")
    found = found() if callable(found) else found
    low, high = found if isinstance(found, tuple) and len(found) == 2 else (attribute(found, "minimum"), attribute(found, "maximum"))
    if low is not None and high is not None:
        shape = np.broadcast_shapes(np.shape(low), np.shape(high), getattr(found, "shape", ()))
        return spaces.Box(np.broadcast_to(low, shape).astype(float), np.broadcast_to(high, shape).astype(float), dtype=np.float64)
    for name in ("action_dimension", "action_size", "action_dim"):
        if isinstance(size := attribute(env, name), (int, np.integer)):
            return spaces.Box(-1.0, 1.0, (int(size),))
    raise DeclarationError(
        f"{type(innermost(env)).__name__} has no action_space. Expected Gymnasium's interface: action_space, observation_space, reset(seed=...) and step(action)"
    )
