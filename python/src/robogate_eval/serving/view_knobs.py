"""Knobs that change what a camera sees: the light, and the poses of cameras. They are read from the scene that MuJoCo renders."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from .knobs import Knob
from .model import Model

# The colours of a light that have a brightness.
COLOURS = ("ambient", "diffuse", "specular")
# `mjCAMLIGHT_FIXED`: the camera moves with its body. Any other mode computes the pose in another way.
FIXED = 0


def catalogue(model: Model, moves: bool) -> list[Knob]:
    """The knobs of the light and of each fixed camera that has a name. `moves`: the observation contains images."""
    knobs = [_light(model, moves)]
    for camera, name in enumerate(model.names("camera")):
        if name and int(model.model.cam_mode[camera]) == FIXED:
            knobs += _camera(model, camera, name, moves)
    return knobs


def _light(model: Model, moves: bool) -> Knob:
    def fields() -> list[np.ndarray]:
        m = model.model
        return [getattr(m, f"light_{colour}") for colour in COLOURS] + [getattr(m.vis.headlight, colour) for colour in COLOURS]

    bases = [field.copy() for field in fields()]
    nominal = _rendered_light(model)

    def write(env: Any, value: float) -> None:
        for field, base in zip(fields(), bases):
            model.edit(field, slice(None), base * value)

    def read(env: Any) -> float | None:
        seen = _rendered_light(model)
        lit = nominal > 0.0
        if seen.shape != nominal.shape or not lit.any():
            return None
        # The mean over all lights, so that a light which does not follow is noticed. The scene has single precision.
        return float(np.mean(seen[lit] / nominal[lit]))

    return Knob(
        "light", write, read, 0.1, 3.0, nominal=1.0, moves=moves, family="light", meaning="Factor of the brightness of all lights.",
        read_from="lights of the scene that is rendered",
    )  # fmt: skip


def _rendered_light(model: Model) -> np.ndarray:
    """The colours of all lights of the rendered scene. No image is made, so this needs no graphics library."""
    import mujoco

    scene = mujoco.MjvScene(model.model, maxgeom=1)
    mujoco.mjv_updateScene(model.model, model.data, mujoco.MjvOption(), None, mujoco.MjvCamera(), 0, scene)
    return np.array([[getattr(light, colour) for colour in COLOURS] for light in scene.lights[: scene.nlight]], dtype=float)


def _camera(model: Model, camera: int, name: str, moves: bool) -> list[Knob]:
    base_position, base_orientation = model.model.cam_pos[camera].copy(), model.model.cam_quat[camera].copy()
    body = int(model.model.cam_bodyid[camera])

    def shift(axis: int) -> tuple[Callable, Callable]:
        def write(env: Any, value: float) -> None:
            model.edit(model.model.cam_pos, (camera, axis), base_position[axis] + value)

        def read(env: Any) -> float:
            d = model.data
            # From the world to the frame of the body.
            place = d.xmat[body].reshape(3, 3).T @ (d.cam_xpos[camera] - d.xpos[body])
            return float(place[axis] - base_position[axis])

        return write, read

    def turn(env: Any, value: float) -> None:
        c, s = math.cos(value / 2.0), math.sin(value / 2.0)
        w, x, y, z = base_orientation
        model.edit(model.model.cam_quat, camera, (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w))

    def turned(env: Any) -> float:
        d = model.data
        now = d.xmat[body].reshape(3, 3).T @ d.cam_xmat[camera].reshape(3, 3)
        spin = now @ _matrix(base_orientation).T
        return math.atan2(spin[1, 0] - spin[0, 1], spin[0, 0] + spin[1, 1])

    where = "cam_xpos and cam_xmat of the state"
    frame = "" if body == 0 else f" in the frame of the body {model.names('body')[body] or body}"
    knobs = [
        Knob(f"camera_{axis}:{name}", *shift(i), -0.5, 0.5, nominal=0.0, unit="m", moves=moves, read_from=where,
             family="camera", meaning=f"Translation of the camera {name} along {axis}{frame}.")
        for i, axis in enumerate("xyz")
    ]  # fmt: skip
    knobs.append(
        Knob(f"camera_turn:{name}", turn, turned, -0.6, 0.6, nominal=0.0, unit="rad", moves=moves, read_from=where,
             family="camera", meaning=f"Rotation of the camera {name} about z{frame}.")
    )  # fmt: skip
    return knobs


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    import mujoco

    out = np.empty(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)
