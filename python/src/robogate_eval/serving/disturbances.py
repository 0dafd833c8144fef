"""Delay of actions, noise of observations and changes of observed images, for any environment."""

from __future__ import annotations

import hashlib
from collections import deque
from copy import deepcopy
from typing import Any

import numpy as np

from .image_changes import ImageChanges
from .knobs import Knob

# Largest delay, in control periods.
MAX_DELAY = 20


class Disturbances:
    """The action delay, the observation noise and the changes of images of an episode."""

    def __init__(self, vectors: dict[str, int], rest: np.ndarray | None, sees: bool = False):
        """`rest`: what the environment runs until the first action takes effect. Without it: the first action itself. `sees`: the
        observation has images."""
        self._vectors = vectors
        self._sees = sees
        self.images = ImageChanges()
        self._rest = rest
        self.begin(0, 0)

    def begin(self, seed: int, index: int) -> None:
        """Start an episode without delay and noise."""
        self._queue: deque = deque()
        self._scale = dict.fromkeys(self._vectors, 0.0)
        # Whether the episode has noise, and whether it has a delay.
        self.noisy = self.delays = False
        self._episode = f"{seed}/{index}"
        self.images.begin(self._episode)
        # Made with the first noise: most episodes have none.
        self._random: np.random.Generator | None = None

    def delayed(self, action: np.ndarray) -> np.ndarray:
        """The action that the environment runs when the policy returns this one."""
        if self._queue[0] is None:
            self._queue = deque(deepcopy(action) for _ in self._queue)
        self._queue.append(action)
        return self._queue.popleft()

    def noise(self) -> dict[str, np.ndarray]:
        """The noise of the next observation: Gaussian, independent for each number."""
        if self._random is None:
            digest = hashlib.blake2b(f"{self._episode}/noise".encode(), digest_size=8).digest()
            self._random = np.random.default_rng(int.from_bytes(digest, "little"))
        return {name: self._random.normal(0.0, scale, self._vectors[name]) for name, scale in self._scale.items() if scale > 0.0}

    def knobs(self, period_s: float) -> list[Knob]:
        """The knobs of delay, noise and images."""

        def delay(env: Any, value: int) -> None:
            self._queue = deque(None if self._rest is None else deepcopy(self._rest) for _ in range(int(value)))
            self.delays = bool(self._queue)

        knobs = [
            Knob("action_delay", delay, lambda env: len(self._queue), 0, MAX_DELAY, nominal=0, unit="steps", integer=True,
                 family="delay", meaning=f"Delay of each action, in control periods of {period_s:g} s.", read_from="length of the queue of actions")
        ]  # fmt: skip
        for name in self._vectors:

            def scale(env: Any, value: float, name: str = name) -> None:
                self._scale[name] = value
                self.noisy = True

            knobs.append(
                Knob(f"noise:{name}", scale, lambda env, name=name: self._scale[name], 0.0, 1.0, nominal=0.0, family="noise",
                     meaning=f"Standard deviation of the noise of each number of {name}.", read_from="the noise generator")
            )  # fmt: skip
        return knobs + (self.images.knobs() if self._sees else [])
