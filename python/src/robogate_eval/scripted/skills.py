"""Skills of a scripted controller: pick, place, slide a drawer, turn a knob. Each is a generator of actions."""

from __future__ import annotations

import numpy as np

from .grasp import grasps
from .motion import CLOSE, OPEN, action, axes_of, closing_angle, downwards, go, hold, rotation

# Spacing of the map of heights, and how far it extends beyond the object (m).
SPACING = 0.004
MARGIN = 0.15
# Distance above surfaces on the way (m).
CLEAR = 0.03


def highest_between(scene, start, end, ignore, width=0.06):
    """The height of the highest surface under a straight path of the hand."""
    along = end[:2] - start[:2]
    length = np.linalg.norm(along)
    side = np.array([-along[1], along[0]]) / length * width if length > 1e-6 else np.array([width, 0.0])
    count = max(2, int(length / 0.025))
    ceiling = max(start[2], end[2]) + 0.5
    points = [start[:2] + along * t + side * s for t in np.linspace(0, 1, count) for s in (-1, 0, 1)]
    return max(scene.height(x, y, ceiling, ignore) for x, y in points)


def travel(scene, target, axes, grip, *, below=0.011, ignore=(), tolerance=0.01):
    """Moves over everything on the way to a point. `below` is how far the hand, or what it holds, extends below the hand."""
    top = max(highest_between(scene, scene.hand, target, ignore) + below + CLEAR, target[2])
    if np.linalg.norm(scene.hand[:2] - target[:2]) > 0.02 and scene.hand[2] < top - 0.01:
        yield from go(scene, np.array([*scene.hand[:2], top]), scene.hand_axes, grip, tolerance=0.03)
    height = max(top, min(scene.hand[2], top + 0.1))
    yield from go(scene, np.array([*target[:2], height]), axes, grip, tolerance=tolerance)
    yield from go(scene, target, axes, grip, tolerance=tolerance, steps=60)


def find_grasps(scene, body):
    """Grasps of a body from above, best first."""
    low, high = scene.bounds(body)
    x = np.arange(low[0] - MARGIN, high[0] + MARGIN, SPACING)
    y = np.arange(low[1] - MARGIN, high[1] + MARGIN, SPACING)
    heights = scene.heights(x, y, high[2] + 0.3, mine=scene.subtree(body))
    return grasps(heights, current=scene.hand_axes[:2, 0], centre=(low[:2] + high[:2]) / 2, floor=low[2] + 0.002)


def pointing_down(closing):
    """The orientation of a hand that points down and closes along this unit vector."""
    return axes_of(closing, np.array([0.0, 0.0, -1.0]))


def pick(scene, body, lift=0.08):
    """Grasps a body from above and lifts it. Tries other grasps if the body does not follow, and ends if there is none."""
    for attempt in range(3):
        found = find_grasps(scene, body)
        if not found:
            return
        # After a failure, a grasp that is different.
        grasp = found[min(attempt * len(found) // 10, len(found) - 1)]
        axes, before = pointing_down(grasp.closing), scene.body(body)
        above = grasp.position + [0, 0, max(0.06, scene.bounds(body)[1][2] - grasp.position[2] + 0.03)]
        yield from travel(scene, above, axes, OPEN)
        yield from go(scene, grasp.position, axes, OPEN, tolerance=0.004, steps=40, speed=0.7)
        yield from hold(scene, axes, CLOSE, 8, grasp.position)
        yield from go(scene, grasp.position + [0, 0, lift], axes, CLOSE, tolerance=0.015, steps=25)
        if scene.body(body)[2] - before[2] > 0.5 * lift:
            return
        yield from hold(scene, axes, OPEN, 5)


def holds(scene, body):
    """Whether the hand is closed around a body: it is within reach of the fingers, and they did not close completely."""
    low, high = scene.bounds(body)
    near = np.all(scene.hand > low - 0.03) and np.all(scene.hand < high + 0.03)
    return bool(near and scene.opening > 0.002)


def place(scene, body, target, *, surface, done=None, gap=0.004, drop=0.0):
    """Puts a held body down, with its origin over the point `target` (x, y) and its lowest point on the height `surface`."""
    ignore = scene.subtree(body)
    axes = downwards(closing_angle(scene.hand_axes), scene.hand_axes)
    below = scene.hand[2] - scene.bounds(body)[0][2]
    offset = scene.hand - scene.body(body)
    over = np.array([target[0] + offset[0], target[1] + offset[1], surface + below + 0.05 + drop])
    yield from travel(scene, over, axes, CLOSE, below=below, ignore=ignore)
    # The body may have turned or slipped between the fingers.
    for height in (0.03, gap):
        below = scene.hand[2] - scene.bounds(body)[0][2]
        offset = scene.hand - scene.body(body)
        at = np.array([target[0] + offset[0], target[1] + offset[1], surface + below + height + drop])
        yield from go(scene, at, axes, CLOSE, tolerance=0.005, steps=30, speed=0.6, until=done)
    yield from hold(scene, axes, OPEN, 6)
    yield from go(scene, scene.hand + [0, 0, 0.10], axes, OPEN, tolerance=0.02, steps=25)


def slide(scene, body, handle, distance, attempts=2):
    """Grips the handle of a drawer from the front and moves the drawer along its joint to the position `distance`.

    `handle` is a point of the handle in the frame of the body.
    """
    joint = scene.joint_of(body)
    for _ in range(attempts):
        outwards = scene.joint_axis(joint) * np.sign(distance)
        at = scene.body(body) + scene.body_axes(body) @ handle
        # The fingers close vertically, above and below the handle.
        closing = np.array([0.0, 0.0, 1.0])
        first = axes_of(closing, -outwards)
        second = axes_of(-closing, -outwards)
        axes = max((first, second), key=lambda candidate: np.trace(candidate @ scene.hand_axes.T))
        yield from go(scene, at + outwards * 0.14 + [0, 0, 0.10], scene.hand_axes, OPEN, tolerance=0.03, steps=60)
        yield from go(scene, at + outwards * 0.14, axes, OPEN, tolerance=0.02, steps=70)
        yield from go(scene, at + outwards * 0.004, axes, OPEN, tolerance=0.006, steps=50, speed=0.6)
        yield from hold(scene, axes, CLOSE, 10)
        goal = scene.hand + outwards * (abs(distance - scene.joint_position(joint)) + 0.03)
        yield from go(scene, goal, axes, CLOSE, tolerance=0.006, steps=70, speed=0.8,
                      until=lambda: abs(scene.joint_position(joint)) > abs(distance))  # fmt: skip
        yield from hold(scene, axes, OPEN, 6)
        yield from go(scene, scene.hand + outwards * 0.08, axes, OPEN, tolerance=0.02, steps=30)
        if abs(scene.joint_position(joint)) > abs(distance):
            break
    up = scene.hand + [0, 0, 0.15]
    yield from go(scene, up, downwards(closing_angle(scene.hand_axes) if abs(scene.hand_axes[2, 0]) < 0.7 else np.pi / 2,
                                       scene.hand_axes), OPEN, tolerance=0.03, steps=60)  # fmt: skip


def turn(scene, body, angle, attempts=2):
    """Grips a knob from above and turns it about its vertical joint to the position `angle`."""
    joint = scene.joint_of(body)
    for attempt in range(attempts):
        found = find_grasps(scene, body)
        if not found:
            return
        grasp = found[min(attempt * len(found) // 10, len(found) - 1)]
        axes = pointing_down(grasp.closing)
        yield from travel(scene, grasp.position + [0, 0, 0.06], axes, OPEN)
        yield from go(scene, grasp.position, axes, OPEN, tolerance=0.004, steps=40, speed=0.7)
        yield from hold(scene, axes, CLOSE, 8, grasp.position)
        axis, anchor, start = scene.joint_axis(joint), scene.joint_anchor(joint), scene.hand
        begin = scene.joint_position(joint)
        for step in np.linspace(0.1, 1.25, 24):
            matrix = rotation(axis, step * (angle - begin))
            yield action(scene, anchor + matrix @ (start - anchor), matrix @ axes, CLOSE)
            if (scene.joint_position(joint) - angle) * np.sign(angle - begin) > 0:
                break
        yield from hold(scene, scene.hand_axes, OPEN, 5)
        yield from go(scene, scene.hand + [0, 0, 0.08], scene.hand_axes, OPEN, tolerance=0.02, steps=20)
        if (scene.joint_position(joint) - angle) * np.sign(angle - begin) > 0:
            return


def push_shut(scene, body):
    """Pushes the front of a drawer until the drawer is shut."""
    joint = scene.joint_of(body)
    position = scene.joint_position(joint)
    outwards = scene.joint_axis(joint) * np.sign(position)
    points = scene.corners(scene.collision_geoms(scene.subtree(body)))
    front = points[(points @ outwards).argmax()] @ outwards
    low, high = scene.bounds(body)
    middle = (low + high) / 2
    # The fingers point down in front of the drawer, a little below its upper edge.
    start = middle + outwards * (front - middle @ outwards + 0.05)
    start[2] = high[2] - 0.005
    axes = downwards(closing_angle(axes_of(np.cross(outwards, [0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0]))), scene.hand_axes)
    yield from travel(scene, start, axes, CLOSE)
    goal = start - outwards * (abs(position) + 0.06)
    yield from go(scene, goal, axes, CLOSE, tolerance=0.004, steps=60, speed=0.7)
    yield from go(scene, scene.hand + outwards * 0.05 + [0, 0, 0.1], axes, CLOSE, tolerance=0.03, steps=25)


def push(scene, body, target, done):
    """Pushes a flat, round body over its support to the point `target` (x, y), with the open fingers behind it."""
    low, high = scene.bounds(body)
    middle = (low + high) / 2
    radius = 0.5 * (high - low)[:2].max()
    along = (target - middle[:2]) / np.linalg.norm(target - middle[:2])
    axes = pointing_down(np.array([-along[1], along[0], 0.0]))
    if axes[:, 0] @ scene.hand_axes[:, 0] < 0:
        axes = pointing_down(-axes[:, 0])
    height = low[2] + 0.013
    behind = middle[:2] - along * (radius + 0.03)
    yield from travel(scene, np.array([*behind, height + 0.08]), axes, OPEN)
    yield from go(scene, np.array([*behind, height]), axes, OPEN, tolerance=0.008, steps=40)
    for _ in range(90):
        low, high = scene.bounds(body)
        now = ((low + high) / 2)[:2]
        left = target - now
        if done() or np.linalg.norm(left) < 0.005:
            break
        # The hand stays behind the body on the line to the target, and leads by a part of the remaining distance.
        along = left / np.linalg.norm(left)
        at = now - along * (radius - 0.012) + along * min(0.03, np.linalg.norm(left))
        yield action(scene, np.array([*at, height]), axes, OPEN, speed=0.5)
    yield from go(scene, scene.hand + [0, 0, 0.1], axes, OPEN, tolerance=0.03, steps=25)
