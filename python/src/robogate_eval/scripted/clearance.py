"""How low the hand can be at a point without hitting anything, and how far the arm reaches."""

from __future__ import annotations

import numpy as np

from .grasp import PANDA, _template

# Distance between the points at which surfaces are sampled (m).
SPACING = 0.024
# From the point between the fingertips of a hand that points down to the centre of the Panda's wrist (axes 5 and 6): towards the
# base, and up.
WRIST_BACK_M, WRIST_UP_M = 0.088, 0.21
# The largest distance between shoulder and wrist. Beyond it the elbow is stretched to its limit, where the controller stalls.
REACH_M = 0.685


def lowest(scene, point, closing, below=None, ignore=(), gripper=PANDA):
    """The lowest height of the hand over a point (x, y) at which no part of it is inside of a surface.

    `closing` is the direction in which the fingers close. `below` is how far the fingers and what they hold extend below the hand;
    without it only the parts above the fingers count.
    """
    closing = np.asarray(closing[:2], dtype=float)
    closing = closing / (np.linalg.norm(closing) or 1.0)
    axes = np.array([closing, [closing[1], -closing[0]]])
    start = scene.hand[2] + 1.0
    parts = [(part.bottom, part.along, part.across) for part in gripper.parts]
    if below is not None:
        parts.append((-below, (-0.06, 0.06), (-0.06, 0.06)))
    height = -np.inf
    for bottom, along, across in parts:
        points = np.asarray(point[:2]) + _template(along, across, SPACING) @ axes
        height = max(height, scene.highest(points, start, ignore) - bottom)
    return height


def lowest_between(scene, start, end, closings, below, ignore):
    """The same on a straight path, for several directions of closing."""
    count = max(2, int(np.linalg.norm(end[:2] - start[:2]) / 0.04) + 1)
    points = [start[:2] + (end[:2] - start[:2]) * t for t in np.linspace(0, 1, count)]
    return max(lowest(scene, point, closing, below, ignore) for point in points for closing in closings)


def stretch(shoulder, position):
    """The distance between the shoulder and the wrist of a hand at a position, pointing down."""
    radius = np.hypot(position[0] - shoulder[0], position[1] - shoulder[1]) - WRIST_BACK_M
    return float(np.hypot(radius, position[2] + WRIST_UP_M - shoulder[2]))


def highest_reach(shoulder, point):
    """The largest height of the hand over a point (x, y) that the arm reaches; -inf if it reaches none."""
    radius = np.hypot(point[0] - shoulder[0], point[1] - shoulder[1]) - WRIST_BACK_M
    if radius >= REACH_M:
        return -np.inf
    return shoulder[2] - WRIST_UP_M + float(np.sqrt(REACH_M**2 - radius**2))
