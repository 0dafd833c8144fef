"""What robosuite's environments and LIBERO's have in common: a Panda arm that robosuite simulates, with Gymnasium's interface.

It imports without any packages, because the families are listed by any Python.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..serving.environment import Camera

# Time between two actions: 20 Hz.
PERIOD_S = 0.05
# The size of pictures that policies for LIBERO were trained with.
PIXELS = 256
CAMERAS = ("agentview", "robot0_eye_in_hand")
ACTION_NAMES = ("x", "y", "z", "roll", "pitch", "yaw", "gripper")
REST_ACTION = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0)


class RobosuiteWorld:
    """A base class. Its subclass sets `_env` to robosuite's environment, or to one that has its `sim`."""

    _env: Any
    _pictures: Any = None

    @property
    def unwrapped(self):
        return self

    @property
    def sim(self):
        return self._env.sim

    @property
    def model(self):
        """MuJoCo's model of the loaded task."""
        return self._env.sim.model._model

    @property
    def data(self):
        """MuJoCo's data of the loaded task."""
        return self._env.sim.data._data

    def begin(self) -> None:
        """Measures from here: heights and displacements are relative to the present state."""
        raise NotImplementedError

    def render(self, camera: str):
        """The picture of a camera, upright. Only what is meant to be seen is drawn, not the collision geometry of group 0."""
        from ..serving.rendering import Pictures

        if self._pictures is None:
            self._pictures = Pictures(hidden_groups=(0,))
        return self._pictures.picture(self.model, self.data, camera, PIXELS, PIXELS)


def cameras() -> list[Camera]:
    """The cameras that policies for robosuite's tasks observe."""
    return [Camera(camera, PIXELS, PIXELS, lambda env, camera=camera: env.render(camera)) for camera in CAMERAS]


def after_rest(steps: int) -> Callable[[RobosuiteWorld, Any], Any]:
    """A task's `prepare`: first so many actions that do nothing."""
    import numpy as np

    def prepare(env: RobosuiteWorld, observation: Any) -> Any:
        for _ in range(steps):
            observation, *_ = env.step(np.array(REST_ACTION))
        env.begin()
        return observation

    return prepare


def once(first: Any, make: Callable[[], Any]) -> Callable[[], Any]:
    """A function that returns `first`, and later what `make` makes. The declaration of an environment needs one of it."""
    made = [first]
    return lambda: made.pop() if made else make()
