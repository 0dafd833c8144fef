"""The cameras of an environment: in its observation, declared, of its MuJoCo model, or its own picture."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from robogate_bridge import Image, Problem

from .environment import Camera, Task, task_name
from .model import Model
from .rendering import Pictures
from .spaces import Observations

# Width and height of the images of the model's own cameras, in pixels, and how many of them are offered.
PICTURE_PX = 256
MAX_CAMERAS = 16
# The protocol allows images of this width and height.
MAX_PIXELS = 4096


class Cameras:
    """The cameras of an environment, and their images."""

    def __init__(self, env: Any, model: Model | None, observations: Observations, task: Task):
        self._env = env
        self._model = model
        self._observations = observations
        self._pictures = Pictures()
        self._cameras = self._find(task)

    def declaration(self) -> list[dict]:
        """The cameras in the form of the bridge protocol."""
        return [{"name": camera.name, "width": camera.width, "height": camera.height} for camera in self._cameras]

    def _find(self, task: Task) -> list[Camera]:
        seen = [Camera(name, width, height) for name, (_, height, width) in self._observations.images.items()]
        declared = [*seen, *task.cameras]
        if declared:
            return declared
        if self._model is None:
            return self._own_picture()
        # Without a choice of the environment: the cameras of its model. Only those that a policy uses are rendered.
        names = {task_name(name): name for name in self._model.names("camera") if name}
        own = [Camera(shown, PICTURE_PX, PICTURE_PX, partial(self._pixels, name)) for shown, name in names.items()]
        # The same views in a quality that takes a fraction of the time without a GPU.
        plain = [Camera(f"{shown[:58]}.plain", PICTURE_PX, PICTURE_PX, partial(self._pixels, name, plain=True)) for shown, name in names.items()]
        return [*own, *plain][:MAX_CAMERAS]

    def _own_picture(self) -> list[Camera]:
        """What the environment itself renders, if it was made for images."""
        if getattr(self._env, "render_mode", None) != "rgb_array":
            return []
        try:
            pixels = _rgb(self._env)
        except Exception:  # a package for rendering is missing, or a display
            return []
        if pixels.ndim != 3 or pixels.shape[2] != 3 or not 1 <= min(pixels.shape) <= max(pixels.shape) <= MAX_PIXELS:
            return []
        height, width, _ = pixels.shape
        return [Camera("render", width, height, _rgb)]

    def render(self, names: list[str], seen: Any) -> list[Image]:
        """The images of these cameras. `seen` is the last observation."""
        by_name = {camera.name: camera for camera in self._cameras}
        return [self._image(by_name[name], seen) for name in names]

    def _image(self, camera: Camera, seen: Any) -> Image:
        if camera.name in self._observations.images:
            pixels = self._observations.image(seen, camera.name)
        elif camera.render is not None:
            pixels = np.ascontiguousarray(camera.render(self._env), dtype=np.uint8)
        else:
            pixels = self._rendered(camera)
        return Image(camera.name, camera.width, camera.height, pixels.tobytes())

    def _rendered(self, camera: Camera) -> np.ndarray:
        if self._model is None:
            raise Problem("unsupported", f"the camera {camera.name} has no render function, and there is no MuJoCo model")
        return self._pixels(camera.name, self._env, camera.width, camera.height)

    def _pixels(self, name: str, env: Any, width: int = PICTURE_PX, height: int = PICTURE_PX, plain: bool = False) -> np.ndarray:
        """The image of a camera of the model."""
        try:
            return self._pictures.picture(self._model.model, self._model.data, name, height, width, plain)
        except Exception as why:
            raise Problem("setup", f"MuJoCo cannot render the camera {name}: {why}. Set MUJOCO_GL to egl, osmesa or glfw") from why


def _rgb(env: Any) -> np.ndarray:
    """The image that an environment renders, without transparency."""
    return np.asarray(env.render(), dtype=np.uint8)[..., :3]
