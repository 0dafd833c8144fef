"""Motions of a robot hand under OSC_POSE of robosuite, as generators of actions.

An action has seven numbers: a translation (1.0 is 0.05 m), a rotation vector in the world frame (1.0 is 0.5 rad) and the gripper
(-1 opens, +1 closes). Each generator reads the scene before it yields the next action, so it reacts to what happened.
"""

from __future__ import annotations

import numpy as np

TRANSLATION = 0.05
ROTATION = 0.5
OPEN, CLOSE = -1.0, 1.0


def rotation_vector(matrix):
    """The rotation vector of a rotation matrix (rad)."""
    cos = np.clip((np.trace(matrix) - 1) / 2, -1.0, 1.0)
    angle = np.arccos(cos)
    skew = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    if angle > np.pi - 1e-3:
        # Half a turn: the skew part vanishes, and the axis is the largest column of M + I.
        column = (matrix + np.eye(3))[:, np.argmax(np.diag(matrix))]
        return column / np.linalg.norm(column) * angle
    norm = np.linalg.norm(skew)
    return np.zeros(3) if norm < 1e-12 else skew / norm * angle


def rotation(axis, angle):
    """The matrix of a rotation about a unit vector (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def axes_of(closing, approach):
    """The orientation of a hand that closes along one unit vector and points along another."""
    return np.stack([closing, np.cross(approach, closing), approach], axis=1)


def downwards(angle, current=None):
    """The orientation of a hand that points down and closes at this angle to the world's x axis. The fingers are alike, so of the
    two such orientations it is the one that is nearer to `current`."""
    closing = np.array([np.cos(angle), np.sin(angle), 0.0])
    if current is not None and closing @ current[:, 0] < 0:
        closing = -closing
    return axes_of(closing, np.array([0.0, 0.0, -1.0]))


def closing_angle(axes):
    """The angle between the world's x axis and the direction of closing, from 0 to pi."""
    return float(np.arctan2(axes[1, 0], axes[0, 0]) % np.pi)


def action(scene, position, axes, grip, speed=1.0):
    """The action towards a pose. `speed` bounds the translation, as a fraction of the largest."""
    away = (position - scene.hand) / TRANSLATION
    norm = np.abs(away).max()
    if norm > speed:
        away *= speed / norm
    turn = rotation_vector(axes @ scene.hand_axes.T) / ROTATION
    return np.concatenate([away, np.clip(turn, -1, 1), [grip]])


def go(scene, position, axes, grip, *, tolerance=0.008, turn_tolerance=0.06, steps=80, speed=1.0, until=None):
    """Moves to a pose. Ends there, after `steps`, when the hand makes no more progress, or when `until()` holds."""
    best, stalled = np.inf, 0
    for _ in range(steps):
        away = np.linalg.norm(position - scene.hand)
        turn = np.linalg.norm(rotation_vector(axes @ scene.hand_axes.T))
        if (away < tolerance and turn < turn_tolerance) or (until is not None and until()):
            return
        total = away + 0.1 * turn
        stalled = 0 if total < best - 0.0005 else stalled + 1
        best = min(best, total)
        if stalled > 12:
            return
        yield action(scene, position, axes, grip, speed)


def hold(scene, axes, grip, steps, position=None):
    """Stays where the hand is, for example to move the fingers."""
    position = scene.hand if position is None else position
    for _ in range(steps):
        yield action(scene, position, axes, grip)
