"""Finds a grasp from above in a map of heights, for a gripper with two parallel fingers.

The map holds only surfaces that are seen from above, so a grasp is found without knowledge of the object: the rim of a bowl, the
narrow side of a box and the ridge of a knob are all material between two free places for the fingers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .scene import Heights


@dataclass(frozen=True)
class Gripper:
    """Dimensions of a gripper (m). Heights are relative to the point between the fingertips, upwards."""

    # Half the distance between the open fingers.
    reach: float = 0.039
    # Thickness of a finger in the direction of closing, and half its width across it.
    finger: float = 0.026
    half_width: float = 0.011
    # Half the width of the pads that hold the object.
    half_pad: float = 0.008
    # The lowest point of the fingers and the highest point of their pads.
    tip: float = -0.011
    pad_top: float = 0.012
    # The palm: its lowest point, and half its size along and across the direction of closing.
    palm: float = 0.031
    half_palm: tuple[float, float] = (0.10, 0.032)


PANDA = Gripper()


@dataclass(frozen=True)
class Grasp:
    """A grasp from above: the position of the point between the fingertips, the angle about the vertical axis between the world's
    x axis and the direction of closing (0 to pi), and the height of material between the pads."""

    position: np.ndarray
    angle: float
    depth: float
    score: float


def _template(along, across, spacing):
    """Points of a rectangle, n x 2: along and across the direction of closing. `along` and `across` are (low, high)."""
    u = np.arange(along[0], along[1] + 1e-9, spacing)
    v = np.arange(across[0], across[1] + 1e-9, spacing)
    return np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)


def grasps(heights: Heights, *, prefer_angle, centre, gripper=PANDA, angles=12, clearance=0.004, floor=None):
    """Grasps of the object, best first.

    `prefer_angle` is the current angle of the gripper, `centre` the (x, y) of the object. `floor` is the lowest height that the
    fingertips may reach.
    """
    spacing = heights.x[1] - heights.x[0]
    g = gripper
    between = _template((-g.reach, g.reach), (-g.half_pad, g.half_pad), spacing)
    left = _template((-g.reach - g.finger, -g.reach), (-g.half_width, g.half_width), spacing)
    fingers = np.concatenate([left, left * [-1, 1]])
    palm = _template((-g.half_palm[0], g.half_palm[0]), (-g.half_palm[1], g.half_palm[1]), 3 * spacing)

    mine = np.argwhere(heights.mine)
    if len(mine) == 0:
        return []
    # A grasp may be centred beside the material, because the rim of a bowl is thinner than the opening.
    centres = np.stack([heights.x[mine[:, 0]], heights.y[mine[:, 1]]], axis=-1)[:: max(1, len(mine) // 500)]
    found = []
    for angle in np.arange(angles) * np.pi / angles:
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        seen, mine_seen = _look(heights, centres, between @ axes)
        finger_top = _look(heights, centres, fingers @ axes)[0].max(axis=1)
        palm_top = _look(heights, centres, palm @ axes)[0].max(axis=1)
        material = np.where(mine_seen, seen, -np.inf)
        top = material.max(axis=1)
        z = np.maximum(finger_top + clearance - g.tip, palm_top + clearance - g.palm)
        z = np.maximum(z, top - 0.030)
        if floor is not None:
            z = np.maximum(z, floor - g.tip)
        depth = top - z
        # Material that the pads will touch, and where it lies along the direction of closing.
        held = material > (z + 0.002)[:, None]
        other = (~mine_seen) & (seen > (z + g.tip)[:, None])
        u = between[:, 0]
        low = np.where(held, u, np.inf).min(axis=1)
        high = np.where(held, u, -np.inf).max(axis=1)
        with np.errstate(invalid="ignore"):
            width, offset = high - low, (high + low) / 2
        inside = (depth > 0.006) & (width < 2 * g.reach - 0.004) & ~other.any(axis=1)
        turn = abs((angle - prefer_angle + np.pi / 2) % np.pi - np.pi / 2)
        for i in np.flatnonzero(inside):
            away = np.linalg.norm(centres[i] - centre)
            score = min(depth[i], 0.02) * 100 - abs(offset[i]) * 60 - away * 6 - turn * 0.5
            # How full the pads are: a sharp corner between the pads slips.
            score += held[i].any() * np.mean(_columns(held[i], between)) * 1.0
            position = np.array([*centres[i], z[i]])
            found.append(Grasp(position, float(angle), float(depth[i]), float(score)))
    return sorted(found, key=lambda grasp: -grasp.score)


def _look(heights, centres, offsets):
    """The heights at centres + offsets (m x n), and whether the object is there. Outside of the map there is nothing."""
    points = centres[:, None, :] + offsets[None, :, :]
    spacing = heights.x[1] - heights.x[0]
    i = np.rint((points[..., 0] - heights.x[0]) / spacing).astype(int)
    j = np.rint((points[..., 1] - heights.y[0]) / spacing).astype(int)
    ok = (i >= 0) & (i < len(heights.x)) & (j >= 0) & (j < len(heights.y))
    i, j = np.clip(i, 0, len(heights.x) - 1), np.clip(j, 0, len(heights.y) - 1)
    return np.where(ok, heights.top[i, j], -np.inf), heights.mine[i, j] & ok


def _columns(held, between):
    """For each position across the direction of closing, whether there is material between the pads."""
    across = np.unique(between[:, 1])
    return [held[between[:, 1] == v].any() for v in across]
