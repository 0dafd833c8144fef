"""MuJoCo's renderer, also on a machine without a display."""

from __future__ import annotations

import os
import sys
from typing import Any


def renderer(model: Any, height: int, width: int) -> Any:
    """A renderer of this model.

    Without a display and without a choice in `MUJOCO_GL`, MuJoCo would use a library that needs a display. EGL needs none. The
    choice is made here and not before MuJoCo is imported: with `MUJOCO_GL=egl` it cannot be imported on a machine without EGL, and
    most runs render nothing.
    """
    import mujoco

    shown = any(os.environ.get(name) for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"))
    if sys.platform == "linux" and not shown:
        from mujoco import gl_context
        from mujoco.egl import GLContext

        gl_context.GLContext = GLContext
    return mujoco.Renderer(model, height, width)
