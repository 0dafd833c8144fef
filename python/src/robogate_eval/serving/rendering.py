"""MuJoCo's renderer, also on a machine without a display."""

from __future__ import annotations

import os
import sys
from ctypes.util import find_library
from typing import Any


def choose_library() -> None:
    """Choose MuJoCo's graphics library for this process before an environment imports MuJoCo, which fixes the choice.

    Without a display and without a choice in `MUJOCO_GL` that is EGL, or OSMesa where EGL is missing. Without both nothing is
    chosen, because MuJoCo cannot be imported with a library that is missing.
    """
    shown = any(os.environ.get(name) for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"))
    if sys.platform != "linux" or shown:
        return
    found = next((name for name, library in (("egl", "EGL"), ("osmesa", "OSMesa")) if find_library(library)), None)
    if found is not None:
        os.environ["MUJOCO_GL"] = found


def renderer(model: Any, height: int, width: int) -> Any:
    """A renderer of this model.

    Without a display and without a choice in `MUJOCO_GL`, MuJoCo would use a library that needs a display. EGL needs none. The
    choice is made here and not before MuJoCo is imported: with `MUJOCO_GL=egl` it cannot be imported on a machine without EGL, and
    most runs render nothing.
    """
    import mujoco

    shown = any(os.environ.get(name) for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"))
    if sys.platform == "linux" and not shown:
        from mujoco.egl import GLContext

        # The module from which the renderer takes it has another place in MuJoCo 4.
        sys.modules[mujoco.Renderer.__module__].gl_context.GLContext = GLContext
    # A picture that is larger than the buffer of the model would be refused, or grey where there is no buffer.
    buffer = model.vis.global_
    buffer.offwidth, buffer.offheight = max(buffer.offwidth, width), max(buffer.offheight, height)
    return mujoco.Renderer(model, height, width)


def _plain_renderer(model: Any, height: int, width: int) -> Any:
    """A renderer without shadows, reflections and smoothed edges."""
    import mujoco

    quality = model.vis.quality
    samples, quality.offsamples = quality.offsamples, 0
    try:
        made = renderer(model, height, width)
    finally:
        quality.offsamples = samples
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        made.scene.flags[flag] = 0
    return made


class Pictures:
    """Pictures of the cameras of a model. One renderer is kept for each size and quality, until the model is another one."""

    def __init__(self, hidden_groups: tuple[int, ...] = ()):
        """Geoms of `hidden_groups` are not drawn."""
        self._hidden = hidden_groups
        self._held: dict[tuple[int, int, bool], tuple[Any, Any]] = {}

    def picture(self, model: Any, data: Any, camera: str, height: int, width: int, plain: bool = False) -> Any:
        """The picture of a camera in the present state: an array of height x width x 3 bytes, upright. A `plain` one has no
        shadows, reflections and smoothed edges, which take most of the time without a GPU."""
        import mujoco

        held = self._held.get((height, width, plain))
        if held is None or held[0] is not model:
            held = (model, (_plain_renderer if plain else renderer)(model, height, width))
            self._held[height, width, plain] = held
        option = mujoco.MjvOption()
        for group in self._hidden:
            option.geomgroup[group] = 0
        held[1].update_scene(data, camera, option)
        return held[1].render()
