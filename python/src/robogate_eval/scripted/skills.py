"""Skills of a scripted controller: pick, place, slide a drawer, turn a knob. Each is a generator of actions."""

from __future__ import annotations

import numpy as np

from .clearance import REACH_M, highest_reach, lowest, lowest_between, stretch
from .grasp import grasps
from .motion import CLOSE, OPEN, action, axes_of, closing_angle, downwards, go, hold, rotation

# Spacing of the map of heights, and how far it extends beyond the object (m).
SPACING = 0.004
MARGIN = 0.15
# Distance above surfaces on the way (m).
CLEAR = 0.02
# How far the closed fingers extend below the hand (m).
TIP = 0.009
# How far a body is lifted before it is carried (m).
LIFT = 0.06


def travel(scene, target, axes, grip, *, below=TIP, ignore=(), tolerance=0.01):
    """Moves over everything on the way to a point. `below` is how far the hand, or what it holds, extends below the hand."""
    closings = [axes[:, 0]] if abs(axes[:, 0] @ scene.hand_axes[:, 0]) > 0.9 else [axes[:, 0], scene.hand_axes[:, 0]]
    start = scene.hand
    top = max(lowest_between(scene, start, target, closings, below, ignore) + CLEAR, target[2])
    # High and far the arm is stretched, so it is better to pass closely.
    top = max(target[2], min(top, highest_reach(scene.shoulder, start), highest_reach(scene.shoulder, target)))
    if np.linalg.norm(start[:2] - target[:2]) > 0.02 and start[2] < top - 0.01:
        yield from go(scene, np.array([*start[:2], top]), scene.hand_axes, grip, tolerance=0.02, steps=40)
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


def choose(scene, body, found, target=None, surface=None):
    """The grasps that the arm reaches and with which the hand fits over the target where the body will be put; all, if there is
    none. The first 60 are examined."""
    step = 1 + len(found) // 60
    low, origin, ignore = scene.bounds(body)[0][2], scene.body(body), scene.subtree(body)
    fitting = []
    for grasp in found[::step]:
        if stretch(scene.shoulder, grasp.position + [0, 0, LIFT]) > REACH_M:
            continue
        if target is not None:
            at = target[:2] + (grasp.position - origin)[:2]
            height = surface + grasp.position[2] - low + 0.01
            if height < lowest(scene, at, grasp.closing, ignore=ignore) or height > highest_reach(scene.shoulder, at):
                continue
        fitting.append(grasp)
    return fitting or found


def pick(scene, body, target=None, surface=None, lift=LIFT):
    """Grasps a body from above and lifts it. Tries other grasps if the body does not follow, and ends if there is none.

    With `target` (x, y) and the height `surface` there, it prefers a grasp with which the hand fits over the target."""
    for attempt in range(3):
        found = choose(scene, body, find_grasps(scene, body), target, surface)
        if not found:
            return
        # After a failure, a grasp that is different.
        grasp = found[min(attempt * len(found) // 10, len(found) - 1)]
        axes, before = pointing_down(grasp.closing), scene.body(body)
        above = grasp.position + [0, 0, max(0.05, scene.bounds(body)[1][2] - grasp.position[2] + 0.02)]
        yield from travel(scene, above, axes, OPEN)
        yield from go(scene, grasp.position, axes, OPEN, tolerance=0.004, steps=40, speed=0.7)
        yield from close(scene, axes, grasp.position)
        yield from go(scene, grasp.position + [0, 0, lift], axes, CLOSE, tolerance=0.015, steps=25)
        if scene.body(body)[2] - before[2] > 0.5 * lift:
            return
        yield from hold(scene, axes, OPEN, 5)


def close(scene, axes, position, most=16):
    """Closes the fingers until they stop."""
    before = scene.opening
    for step in range(most):
        yield action(scene, position, axes, CLOSE)
        # The fingers start slowly.
        if step >= 5 and before - scene.opening < 0.0004:
            return
        before = scene.opening


def holds(scene, body):
    """Whether a body is at the hand: the point between the fingertips is within its bounds, or close to them."""
    low, high = scene.bounds(body)
    return bool(np.all(scene.hand > low - 0.02) and np.all(scene.hand < high + 0.02))


def place(scene, body, target, *, surface, done=None, gap=0.004):
    """Puts a held body down, with its origin over the point `target` (x, y) and its lowest point on the height `surface`. Ends
    early if the body is lost."""
    ignore = scene.subtree(body)
    axes = pointing_down(np.array([*scene.hand_axes[:2, 0], 0.0]) / np.linalg.norm(scene.hand_axes[:2, 0]))

    def over(height):
        # Where the hand has to be. The body may turn or slip between the fingers, so this is computed again.
        offset = scene.hand - scene.body(body)
        below = scene.hand[2] - scene.bounds(body)[0][2]
        return np.array([target[0] + offset[0], target[1] + offset[1], surface + below + height])

    def carry():
        below = scene.hand[2] - scene.bounds(body)[0][2]
        yield from travel(scene, over(0.05), axes, CLOSE, below=below, ignore=ignore)
        for height in (0.03, gap):
            yield from go(scene, over(height), axes, CLOSE, tolerance=0.005, steps=30, speed=0.6, until=done)

    for step in carry():
        if not holds(scene, body):
            return
        yield step
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
        yield from close(scene, axes, scene.hand)
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
        yield from close(scene, axes, grasp.position)
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
    """Pushes a flat, hollow body, such as a plate, over its support to the point `target` (x, y): the closed fingers press against
    the inside of its rim."""
    low, high = scene.bounds(body)
    middle, ignore = (low + high) / 2, scene.subtree(body)
    floor = scene.height(*middle[:2], high[2] + 0.1)
    # A little too low, so that the fingers press and friction helps.
    height = floor + TIP - 0.006
    quarter = np.array([-scene.hand_axes[1, 0], scene.hand_axes[0, 0], 0.0])
    closings = [scene.hand_axes[:, 0], quarter, -quarter]
    axes = pointing_down(min(closings, key=lambda closing: lowest_between(scene, middle, target, [closing], TIP, ignore)))
    yield from travel(scene, np.array([*middle[:2], height + 0.05]), axes, CLOSE)
    yield from go(scene, np.array([*middle[:2], height]), axes, CLOSE, tolerance=0.005, steps=40)
    for _ in range(100):
        low, high = scene.bounds(body)
        left = target - ((low + high) / 2)[:2]
        if done() or np.linalg.norm(left) < 0.003:
            break
        at = scene.hand[:2] + left / np.linalg.norm(left) * min(0.03, max(0.01, np.linalg.norm(left)))
        yield action(scene, np.array([*at, height]), axes, CLOSE)
    yield from go(scene, scene.hand + [0, 0, 0.1], axes, CLOSE, tolerance=0.03, steps=25)
