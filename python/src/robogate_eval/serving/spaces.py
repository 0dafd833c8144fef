"""Observations as named vectors and cameras, actions as bounded vectors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces
from robogate_bridge import Problem

from .environment import DeclarationError, task_name


# Numbers of channels of an image: grey, colours, colours with transparency.
CHANNELS = (3, 1, 4)


class Observations:
    """The observation space of an environment.

    A Box of numbers becomes a vector: `observation`, the key of a Dict, or the position in a Tuple (those of nested spaces are joined
    by `.`). A Box of bytes of the shape height x width x channels or channels x height x width becomes a camera: with three channels,
    one (grey) or four (the last is not used), and stacked frames, of which the newest counts. Discrete, MultiDiscrete and MultiBinary become vectors too. Other parts of a Dict or a
    Tuple are skipped: the policy of a server does not receive them.
    """

    def __init__(self, space: spaces.Space):
        # name -> (path in the observation, length)
        self.vectors: dict[str, tuple[tuple[str | int, ...], int]] = {}
        # name -> (path, height, width)
        self.images: dict[str, tuple[tuple[str | int, ...], int, int]] = {}
        # Images with the channels first.
        self._channels_first: set[str] = set()
        # Parts that are neither numbers nor images, with the reason.
        self.skipped: list[tuple[str, str]] = []
        self._add(space, ())
        if not self.vectors and not self.images:
            raise DeclarationError(self.skipped[0][1] if self.skipped else "the observation has no parts. Expected numbers or images")
        # The whole observation is one vector.
        self.single = list(self.vectors.values()) == [((), self.vectors["observation"][1])] if "observation" in self.vectors else False
        self._plain = (self.vectors["observation"][1],) if self.single else None

    @staticmethod
    def _is_image(shape: tuple[int, ...]) -> bool:
        return shape[2] in CHANNELS or shape[0] in CHANNELS

    def _add(self, space: spaces.Space, path: tuple[str | int, ...], newest: bool = False) -> None:
        name = task_name(".".join(map(str, path))) if path else "observation"
        which = f"observation {name}" if path else "observation"
        if name in self.vectors or name in self.images:
            raise DeclarationError(f"two parts of the observation have the name {name}. Rename a key, for example with a gymnasium.ObservationWrapper")
        if isinstance(space, spaces.Dict):
            for key, inner in space.spaces.items():
                self._add(inner, (*path, key))
        elif isinstance(space, spaces.Tuple):
            for position, inner in enumerate(space.spaces):
                self._add(inner, (*path, position))
        elif isinstance(space, spaces.Box) and space.dtype == np.uint8 and len(space.shape) == 3 and space.shape[2] in CHANNELS:
            self.images[name] = ((*path, -1) if newest else path, space.shape[0], space.shape[1])
        elif isinstance(space, spaces.Box) and space.dtype == np.uint8 and len(space.shape) == 3 and space.shape[0] in CHANNELS:
            self.images[name] = ((*path, -1) if newest else path, space.shape[1], space.shape[2])
            self._channels_first.add(name)
        elif isinstance(space, spaces.Box) and space.dtype == np.uint8 and len(space.shape) == 4 and self._is_image(space.shape[1:]):
            # Frames of several moments, the newest last.
            self._add(spaces.Box(0, 255, space.shape[1:], np.uint8), path, newest=True)
            self.skipped.append((name, f"only the newest of {space.shape[0]} frames is a camera. `history` in a profile asks for earlier ones"))
        elif isinstance(space, (spaces.Box, spaces.MultiBinary, spaces.MultiDiscrete, spaces.Discrete)):
            length = int(np.prod(space.shape)) if space.shape else 1
            if length > 4096:
                why = (
                    f"the {which} is an image of numbers, such as depth (shape {space.shape}). Only policies in the process of the environment see it"
                    if path and space.dtype.kind == "f" and len(space.shape) in (2, 3) and min(space.shape[:2]) > 8
                    else f"the {which} has {length} numbers (shape {space.shape}). Expected at most 4096, or an image: bytes of the shape height x "
                    "width x 3. Hint: a gymnasium.ObservationWrapper can change it"
                )
                self.skipped.append((name, why))
                return
            self.vectors[name] = (path, length)
        else:
            why = f"the {which} is a {type(space).__name__}. Expected a Box, Discrete, MultiDiscrete or MultiBinary, or a Dict or Tuple of these"
            self.skipped.append((name, why))

    def declaration(self) -> list[dict]:
        """The vectors in the form of the bridge protocol."""
        return [{"name": name, "length": length} for name, (_, length) in self.vectors.items()]

    def check(self, observation: Any) -> None:
        """Raise if an observation differs from the declared space."""
        sizes = {name: (path, length) for name, (path, length) in self.vectors.items()}
        pixels = {name: (path, height * width) for name, (path, height, width) in self.images.items()}
        for name, (path, length) in (sizes | pixels).items():
            try:
                found = np.size(_at(observation, path))
                if name in pixels and found in [length * channels for channels in CHANNELS]:
                    continue
            except (KeyError, IndexError, TypeError):
                keys = f" with the keys {', '.join(map(str, observation))}" if isinstance(observation, dict) else ""
                found = f"a {type(observation).__name__}{keys}"
            if found != length:
                found = f"{found} numbers" if isinstance(found, int) else found
                raise DeclarationError(f"observation_space declares {name} with {length} numbers, but reset returned {found}")

    def encode(self, observation: Any) -> dict[str, list[float]]:
        """The vectors of an observation."""
        if self.is_plain(observation):
            return {"observation": observation.tolist()}
        return {name: self._numbers(observation, name) for name in self.vectors}

    def _numbers(self, observation: Any, name: str) -> list[float]:
        path, length = self.vectors[name]
        numbers = np.asarray(_at(observation, path), dtype=float).ravel().tolist()
        if len(numbers) != length:
            raise Problem("setup", f"the environment returned {name} with {len(numbers)} numbers, and its observation_space declares {length}")
        return numbers

    def is_plain(self, observation: Any) -> bool:
        """Whether an observation is one array of double precision, as most are."""
        return type(observation) is np.ndarray and observation.shape == self._plain and observation.dtype == np.float64

    def image(self, observation: Any, name: str) -> np.ndarray:
        """The image of a camera in an observation."""
        image = np.asarray(_at(observation, self.images[name][0]))
        if name in self._channels_first:
            image = np.moveaxis(image, 0, 2)
        image = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image[:, :, :3]
        return np.ascontiguousarray(image)

    def with_noise(self, observation: Any, noise: dict[str, np.ndarray]) -> Any:
        """An observation with these numbers added to vectors. The original stays as it is."""
        for name, numbers in noise.items():
            observation = _replaced(observation, self.vectors[name][0], partial(_sum, numbers))
        return observation

    def with_images(self, observation: Any, change: Callable[[str, np.ndarray], np.ndarray]) -> Any:
        """An observation whose images are changed: `change` maps the name of a camera and an image of height x width x channels to another
        one. Of stacked frames each changes. The original stays as it is."""
        for name, (path, _, _) in self.images.items():
            stacked = path[-1:] == (-1,)

            def changed(image: Any, name: str = name, stacked: bool = stacked) -> np.ndarray:
                frames = np.asarray(image) if stacked else np.asarray(image)[None]
                if name in self._channels_first:
                    frames = np.moveaxis(frames, 1, 3)
                # Each frame of a stack has a history of its own.
                made = np.stack([change(f"{name}.{i}" if stacked else name, frame) for i, frame in enumerate(frames)])
                made = np.moveaxis(made, 3, 1) if name in self._channels_first else made
                return made if stacked else made[0]

            observation = _replaced(observation, path[:-1] if stacked else path, changed)
        return observation


def same(one: Any, other: Any) -> bool:
    """Whether two observations have the same structure and, up to single precision, the same numbers."""
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict) or isinstance(other, dict):
        both = isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys()
        return both and all(same(one[key], other[key]) for key in one)
    one, other = np.asarray(one), np.asarray(other)
    return one.shape == other.shape and np.allclose(one, other, rtol=1e-5, atol=1e-6, equal_nan=True)


def _at(observation: Any, path: Sequence[str | int]) -> Any:
    for key in path:
        observation = observation[key]
    return observation


def _sum(numbers: np.ndarray, values: Any) -> np.ndarray:
    values = np.asarray(values, dtype=float)
    return values + numbers.reshape(values.shape)


def _replaced(observation: Any, path: Sequence[str | int], change: Callable[[Any], Any]) -> Any:
    """The observation with another part at this path."""
    if not path:
        return change(observation)
    inner = _replaced(observation[path[0]], path[1:], change)
    if isinstance(observation, tuple):
        return (*observation[: path[0]], inner, *observation[path[0] + 1 :])
    return {**observation, path[0]: inner}


def actions_of(space: spaces.Space, names: Sequence[str]) -> Actions:
    """The actions of an environment."""
    if isinstance(space, spaces.Discrete):
        return Levels([space.start], [space.n], (), np.int64, names)
    if isinstance(space, spaces.MultiDiscrete):
        return Levels(np.broadcast_to(getattr(space, "start", 0), space.nvec.shape), space.nvec, space.shape, space.dtype, names)
    if isinstance(space, (spaces.Dict, spaces.Tuple)):
        return Joined(space, names)
    if isinstance(space, spaces.MultiBinary):
        return Levels(np.zeros(space.shape), np.full(space.shape, 2), space.shape, space.dtype, names)
    if not isinstance(space, spaces.Box):
        raise DeclarationError(
            f"the action space is a {type(space).__name__}. Expected a Box with finite bounds, Discrete, MultiDiscrete or MultiBinary, or a Dict or Tuple of these. Hint: "
            "a gymnasium.ActionWrapper can translate the numbers of one Box"
        )
    if not (np.isfinite(space.low).all() and np.isfinite(space.high).all()):
        raise DeclarationError(
            "the action space has no finite bounds. Choose bounds that the policy needs, for example with gymnasium.wrappers."
            f"TransformAction(env, lambda action: action, gymnasium.spaces.Box(-1.0, 1.0, {space.shape}))"
        )
    if np.issubdtype(space.dtype, np.integer):
        low, high = (np.asarray(bound, dtype=float) for bound in (space.low, space.high))
        return Levels(low, high - low + 1.0, space.shape, space.dtype, names)
    return Actions(space.low, space.high, space.shape, space.dtype, names)


class Actions:
    """The action space of an environment: numbers with finite bounds."""

    # Whether zeros are a rest position, if they lie inside the bounds.
    zeros_rest = True

    def __init__(self, low: Any, high: Any, shape: tuple[int, ...], dtype: Any, names: Sequence[str]):
        low, high = (np.asarray(bound, dtype=float).ravel() for bound in (low, high))
        self.low, self.high, self.shape, self.dtype = low, high, shape, dtype
        self.names = list(names) or [f"action_{i}" for i in range(len(low))]
        if len(self.names) != len(low):
            raise DeclarationError(f"the task names {len(self.names)} numbers of an action, but the environment has {len(low)}")
        # The last action that was encoded, as numbers and as an array: most often it is the next that is decoded.
        self._last: tuple[list[float], np.ndarray] = ([], np.empty(0))
        self._ones = np.ones(len(low))
        self._is_flat = len(shape) == 1
        # A number outside of its bounds by less is rounding.
        self._rounding = 1e-5 * (high - low)
        self._asked = self._outside = 0
        # Whether the environment executes what its policy returned, also outside of the bounds.
        self.unclipped = False

    def begin(self) -> None:
        """Begin an episode."""
        self._asked = self._outside = 0

    def clipped_share(self) -> float | None:
        """The share of the actions of the policy in this episode that were outside of the bounds. None without any."""
        return self._outside / self._asked if self._asked else None

    def declaration(self) -> dict:
        """The action space in the form of the bridge protocol."""
        return {"kind": "vector", "names": self.names, "low": self.low.tolist(), "high": self.high.tolist()}

    def decode(self, numbers: "Sequence[float] | np.ndarray") -> np.ndarray:
        """The action that the environment takes. An array is one of `bounded`."""
        if type(numbers) is np.ndarray:
            action = numbers.astype(self.dtype)
            return action if self._is_flat else action.reshape(self.shape)
        last, array = self._last
        if numbers is last or self.unclipped and list(numbers) == last:
            return array.astype(self.dtype).reshape(self.shape)
        return self._clipped(np.asarray(numbers, dtype=float)).astype(self.dtype).reshape(self.shape)

    def encode(self, action: Any) -> list[float]:
        """The numbers of an action of a policy, clipped to the bounds. A NaN stays one, so it is reported."""
        array = self.bounded(action)
        executed = np.asarray(action, dtype=float).ravel() if self.unclipped else array
        self._last = (array.tolist(), executed)
        return self._last[0]

    def bounded(self, action: Any) -> np.ndarray:
        """The same as `encode`, as an array."""
        numbers = np.asarray(action, dtype=float).ravel()
        if len(numbers) != len(self.low):
            raise ValueError(f"the policy returned {len(numbers)} numbers. Expected {len(self.low)}")
        clipped = self._clipped(numbers)
        self._asked += 1
        self._outside += bool((np.abs(numbers - clipped) > self._rounding).any())
        return clipped

    def are_finite(self, numbers: np.ndarray) -> bool:
        """Whether all numbers of an action are finite. They are bounded, so their sum is finite too."""
        # A tenth of the time of `np.isfinite(numbers).all()`.
        return math.isfinite(numbers.dot(self._ones))

    def _clipped(self, numbers: np.ndarray) -> np.ndarray:
        # The same as `np.clip`, three times as fast for a few numbers.
        return np.minimum(np.maximum(numbers, self.low), self.high)


class Levels(Actions):
    """Actions that are integers: Discrete, MultiDiscrete, MultiBinary, or a Box of integers.

    The numbers of an action are rounded to the next level. Their bounds lie half a level below the first level and above the last,
    so that random numbers between the bounds choose each level equally often.
    """

    # The level 0 is an action like any other.
    zeros_rest = False

    def __init__(self, first: Any, counts: Any, shape: tuple[int, ...], dtype: Any, names: Sequence[str]):
        first, counts = (np.asarray(numbers, dtype=float).ravel() for numbers in (first, counts))
        self.first, self.last = first, first + counts - 1.0
        super().__init__(self.first - 0.5, self.last + 0.5, shape, dtype, names)

    def decode(self, numbers: "Sequence[float] | np.ndarray") -> Any:
        """The levels that the environment takes; for Discrete one NumPy integer."""
        levels = np.clip(np.floor(np.asarray(numbers, dtype=float) + 0.5), self.first, self.last).astype(self.dtype)
        return levels.reshape(self.shape) if self.shape else levels[0]

    def bounded(self, action: Any) -> np.ndarray:
        """The numbers of an action of a policy, which must be levels. A NaN stays one, so it is reported."""
        numbers = np.asarray(action, dtype=float).ravel()
        if len(numbers) == len(self.low) and ((numbers < self.first) | (numbers > self.last) | (numbers != np.floor(numbers))).any():
            if np.isfinite(numbers).all():
                levels = ", ".join(f"{first:.0f} to {last:.0f}" for first, last in zip(self.first, self.last))
                raise Problem("bad_action", f"the policy returned the action {action!r:.80}. Expected integers: {levels}")
        return super().bounded(numbers)


class Joined(Actions):
    """Actions that are a Dict or a Tuple, such as one for each arm: their numbers stand one after the other, in the order of the space.

    The default names have the key in front: `left_0`, `left_1`, `right_0`. A key whose part is one number is its name.
    """

    def __init__(self, space: spaces.Space, names: Sequence[str]):
        self._keys = list(space.spaces) if isinstance(space, spaces.Dict) else None
        inner = space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces)
        self._parts = {key: actions_of(part, ()) for key, part in inner}
        if not self._parts:
            raise DeclarationError("the action space has no parts. Expected at least one number")
        own = []
        for key, part in self._parts.items():
            prefix = task_name(str(key))
            own += [prefix] if len(part.names) == 1 else [f"{prefix}_{name.removeprefix('action_')}" for name in part.names]
        low, high = (np.concatenate([getattr(part, bound) for part in self._parts.values()]) for bound in ("low", "high"))
        super().__init__(low, high, (len(low),), float, names or own)
        self.zeros_rest = all(part.zeros_rest for part in self._parts.values())

    def decode(self, numbers: "Sequence[float] | np.ndarray") -> Any:
        """The Dict or Tuple that the environment takes."""
        numbers, start, values = np.asarray(numbers, dtype=float), 0, []
        for part in self._parts.values():
            values.append(part.decode(numbers[start : start + len(part.low)].tolist()))
            start += len(part.low)
        return tuple(values) if self._keys is None else dict(zip(self._keys, values))

    def bounded(self, action: Any) -> np.ndarray:
        """The numbers of an action of a policy: a Dict or Tuple like the space, or all numbers in a row."""
        if not isinstance(action, (dict, tuple)):
            return super().bounded(action)
        keys = set(action) if isinstance(action, dict) else set(range(len(action)))
        if keys != set(self._parts):
            expected, found = (", ".join(map(str, which)) for which in (self._parts, sorted(keys, key=str)))
            raise ValueError(f"the policy returned an action with the parts {found}. Expected {expected}")
        before = self._outside_of_parts()
        numbers = np.concatenate([part.bounded(action[key]) for key, part in self._parts.items()])
        self._asked += 1
        self._outside += self._outside_of_parts() > before
        return numbers

    def _outside_of_parts(self) -> int:
        return sum(part._outside for part in self._parts.values())
