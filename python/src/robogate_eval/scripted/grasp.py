"""Finds a grasp from above in a map of heights, for a gripper with two parallel fingers.

The map holds only surfaces that are seen from above, so a grasp is found without knowledge of the object: the rim of a bowl, the
narrow side of a box and the ridge of a knob are all material between two free places for the fingers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .scene import Heights


@dataclass(frozen=True)
class Part:
    """A part of the hand that must not hit anything, as a box: its lowest point above the point between the fingertips, and its
    extent along the direction of closing and across it (m)."""

    bottom: float
    along: tuple[float, float]
    across: tuple[float, float]


@dataclass(frozen=True)
class Gripper:
    """Dimensions of a gripper (m). Heights are relative to the point between the fingertips, upwards."""

    # Half the distance between the open fingers.
    reach: float
    # Thickness of a finger in the direction of closing, and half its width across it.
    finger: float
    half_width: float
    # Half the width of the pads that hold the object.
    half_pad: float
    # The lowest point of the fingers.
    tip: float
    # The parts above the fingers.
    parts: tuple[Part, ...]


# Bounding boxes of the collision geometry of robosuite's Panda and its gripper: fingers, hand, link 7 and link 6.
PANDA = Gripper(
    reach=0.038,
    finger=0.027,
    half_width=0.011,
    half_pad=0.008,
    tip=-0.009,
    parts=(
        Part(0.031, (-0.104, 0.104), (-0.033, 0.033)),
        Part(0.097, (-0.088, 0.088), (-0.045, 0.045)),
        Part(0.152, (-0.054, 0.054), (-0.137, 0.045)),
    ),
)
# A surface that is more oblique over the width of the pads cannot be held (m).
OBLIQUE_M = 0.010
# The least fraction of the width of the pads that must touch the object.
FULL = 0.7
# Grasps deeper than this are not better.
DEEP = 0.027


@dataclass(frozen=True)
class Grasp:
    """A grasp from above: the position of the point between the fingertips, the unit vector in which the fingers close, and how
    far the object extends above that point."""

    position: np.ndarray
    closing: np.ndarray
    depth: float
    score: float


def _template(along, across, spacing):
    """Points of a rectangle, n x 2: along and across the direction of closing."""
    u = np.arange(along[0], along[1] + 1e-9, spacing)
    v = np.arange(across[0], across[1] + 1e-9, spacing)
    return np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)


def grasps(heights: Heights, *, current, centre, floor, gripper=PANDA, angles=12, clearance=0.002):
    """Grasps of the object, best first.

    `current` is the direction (x, y) in which the fingers close now: the gripper turns by at most a quarter. `centre` is the (x, y)
    of the object, `floor` the lowest height that the fingertips may reach.
    """
    spacing, g = heights.spacing, gripper
    between = _template((-g.reach, g.reach), (-g.half_pad, g.half_pad), spacing)
    left = _template((-g.reach - g.finger, -g.reach), (-g.half_width, g.half_width), spacing)
    fingers = np.concatenate([left, left * [-1, 1]])
    parts = [(part.bottom, _template(part.along, part.across, 3 * spacing)) for part in g.parts]

    mine = np.argwhere(heights.mine)
    if len(mine) == 0:
        return []
    # A bound on the number of candidates keeps large objects fast.
    centres = np.stack([heights.x[mine[:, 0]], heights.y[mine[:, 1]]], axis=-1)[:: 1 + len(mine) // 500]
    now = np.arctan2(current[1], current[0])
    found = []
    for turn in np.linspace(-0.5, 0.5, angles + 1) * np.pi:
        found += _at_angle(heights, centres, now, turn, between, fingers, parts, g, centre, floor, clearance)
    return sorted(found, key=lambda grasp: -grasp.score)


def _at_angle(heights, centres, now, turn, between, fingers, parts, g, centre, floor, clearance):
    """The grasps that turn the gripper by this angle from the direction `now`."""
    closing = np.array([np.cos(now + turn), np.sin(now + turn)])
    # Seen from above, the second axis of a hand that points down is clockwise of the first.
    axes = np.array([closing, [closing[1], -closing[0]]])
    seen, mine_seen = _look(heights, centres, between @ axes)
    material = np.where(mine_seen, seen, -np.inf)
    top = material.max(axis=1)
    z = _look(heights, centres, fingers @ axes)[0].max(axis=1) + clearance - g.tip
    for bottom, points in parts:
        z = np.maximum(z, _look(heights, centres, points @ axes)[0].max(axis=1) + clearance - bottom)
    z = np.maximum.reduce([z, top - DEEP, np.full(len(z), floor - g.tip)])
    depth = top - z
    held = material > z[:, None]
    other = ~mine_seen & (seen > (z + g.tip)[:, None])
    u = between[:, 0]
    low, high = np.where(held, u, np.inf).min(axis=1), np.where(held, u, -np.inf).max(axis=1)
    possible = (depth > 0.003) & (high - low < 2 * g.reach - 0.004) & ~other.any(axis=1)
    across = [between[:, 1] == v for v in np.unique(between[:, 1])]
    edges = [(np.where(held[:, row], u[row], np.inf).min(axis=1), np.where(held[:, row], u[row], -np.inf).max(axis=1)) for row in across]
    found = []
    for i in np.flatnonzero(possible):
        # A deep, centred grasp that fills the width of the pads, near the middle of the object, without a large turn.
        rows = [(first[i], last[i]) for first, last in edges if first[i] <= last[i]]
        full = len(rows) / len(across)
        # A surface that is oblique to the pads, such as a corner, slips.
        oblique = max(np.ptp([first for first, _ in rows]), np.ptp([last for _, last in rows]))
        if oblique > OBLIQUE_M or full < FULL:
            continue
        away = np.linalg.norm(centres[i] - centre)
        score = 100 * min(depth[i], 0.02) - 30 * abs(low[i] + high[i]) - 6 * away - 0.5 * abs(turn) + full - 60 * oblique
        found.append(Grasp(np.array([*centres[i], z[i]]), np.array([*closing, 0.0]), float(depth[i]), float(score)))
    return found


def _look(heights, centres, offsets):
    """The heights at centres + offsets (m x n), and whether the object is there. Outside of the map there is nothing."""
    points = centres[:, None, :] + offsets[None, :, :]
    i = np.rint((points[..., 0] - heights.x[0]) / heights.spacing).astype(int)
    j = np.rint((points[..., 1] - heights.y[0]) / heights.spacing).astype(int)
    inside = (i >= 0) & (i < len(heights.x)) & (j >= 0) & (j < len(heights.y))
    i, j = np.clip(i, 0, len(heights.x) - 1), np.clip(j, 0, len(heights.y) - 1)
    return np.where(inside, heights.top[i, j], -np.inf), heights.mine[i, j] & inside
