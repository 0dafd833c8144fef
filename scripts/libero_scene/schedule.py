"""The motions of the comparison: one after the other, each from rest."""

from __future__ import annotations

import numpy as np

# Name, element of the action, value. Each motion is followed by its reverse.
MOTIONS = [("+z", 2, 1.0), ("-z", 2, -1.0), ("+y", 1, 1.0), ("-y", 1, -1.0), ("+x", 0, 0.5), ("-x", 0, -0.5), ("+yaw", 5, 1.0), ("-yaw", 5, -1.0)]
STEPS, REST = 10, 14
LENGTH = STEPS + REST


def action(step: int) -> np.ndarray:
    """The action number `step` of an episode, as LIBERO numbers it: the gripper stays open (-1)."""
    numbers = np.zeros(7)
    numbers[6] = -1.0
    motion, within = divmod(step, LENGTH)
    if motion < len(MOTIONS) and within < STEPS:
        _, element, value = MOTIONS[motion]
        numbers[element] = value
    return numbers


def rotation(vector) -> np.ndarray:
    """The rotation matrix of a rotation vector (formula of Rodrigues)."""
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def turned(first, now) -> np.ndarray:
    """The rotation vector from one orientation to another, both as rotation vectors, in the world frame."""
    matrix = rotation(now) @ rotation(first).T
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    length = np.linalg.norm(axis)
    return np.zeros(3) if length < 1e-12 else axis / length * np.arctan2(length, np.trace(matrix) - 1.0)


def displacements(positions, orientations) -> dict:
    """How far each motion moved the hand: after its last action, and after the last but one, along or about its own axis."""
    found = {}
    for number, (name, element, _) in enumerate(MOTIONS):
        start = number * LENGTH
        if start + STEPS >= len(positions):
            break

        def moved(step):
            if element < 3:
                return float(positions[start + step][element] - positions[start][element])
            return float(turned(orientations[start], orientations[start + step])[element - 3])

        found[name] = (moved(STEPS), moved(STEPS) - moved(STEPS - 1))
    return found
