"""Turns the goal of a LIBERO task file into skills of the scripted controller.

A plan follows from the predicates of the goal and from the state of the scene. It does not know the name of a task.
"""

from __future__ import annotations

import numpy as np

from ..scripted import skills
from ..scripted.scene import Scene

# A drawer counts as open for the controller at this position (m).
OPEN_M = 0.10
# How far a drawer is pulled, and a knob turned.
PULL_M = 0.15
TURN_RAD = 1.2
# A body that is this flat and wide cannot be gripped from above (m).
FLAT_M, WIDE_M = 0.025, 0.078
# How often the goal is tried. The time limit of an episode usually allows two.
ATTEMPTS = 3
# Predicates are achieved in this order: a drawer is opened before something is put into it and closed afterwards.
ORDER = {"open": 0, "turnon": 1, "turnoff": 1, "in": 2, "on": 2, "close": 3}


def ordered(goal):
    """The predicates of a goal in the order in which a controller achieves them."""
    return sorted(goal, key=lambda predicate: ORDER.get(predicate[0], 2))


class Planner:
    """Plans of one episode."""

    def __init__(self, scene: Scene, task, holds):
        """`holds` tells whether a predicate of the goal holds now."""
        self._scene, self._task, self._holds = scene, task, holds
        self._bodies = {name for kinds in (task.objects, task.fixtures) for names in kinds.values() for name in names}

    def plan(self):
        """The actions of the whole task. Ends when the plan is done, whether it succeeded or not."""
        for _ in range(ATTEMPTS):
            for predicate in ordered(self._task.goal):
                if not self._holds(predicate):
                    yield from self._achieve(predicate)

    def _achieve(self, predicate):
        verb, name, *rest = predicate
        if verb in ("in", "on"):
            yield from self._put(name, rest[0], lambda: self._holds(predicate))
        elif verb == "open":
            yield from self._slide(name, PULL_M)
        elif verb == "turnon":
            yield from skills.turn(self._scene, self._moving_part(f"{name}_main"), TURN_RAD)
        elif verb == "close":
            yield from self._push_shut(name)

    def _put(self, name, target, done):
        scene, body = self._scene, f"{name}_main"
        if target not in self._bodies:
            part = scene.site_body(target)
            joint = scene.joint_of(part)
            if joint is not None and self._is_drawer(joint) and abs(scene.joint_position(joint)) < OPEN_M:
                yield from self._slide(target, PULL_M)
        low, high = scene.bounds(body)
        if high[2] - low[2] < FLAT_M and (high - low)[:2].min() > WIDE_M and target not in self._bodies and scene.joint_of(scene.site_body(target)) is None:
            # The hand cannot grip a plate from above.
            yield from skills.push(scene, body, scene.site(target)[:2], done)
            return
        # The highest surface under the body where it will stand.
        radius, ignore = 0.3 * (high - low)[:2].min(), scene.subtree(body)
        spots = [(0, 0), (radius, 0), (-radius, 0), (0, radius), (0, -radius)]

        def place_at():
            at = scene.body(f"{target}_main") if target in self._bodies else scene.site(target)
            return at, scene.highest(at[:2] + spots, at[2] + 0.4, ignore)

        yield from skills.pick(scene, body, *place_at())
        if skills.holds(scene, body):
            at, surface = place_at()
            yield from skills.place(scene, body, at[:2], surface=surface, done=done)

    def _is_drawer(self, joint):
        return self._scene.model.jnt_type[joint] == 2  # mjJNT_SLIDE

    def _moving_part(self, body):
        """The first body below `body` that a joint moves."""
        scene = self._scene
        for index in scene.subtree(body):
            name = scene.model.body(index).name
            if scene.joint_of(name) is not None:
                return name
        raise ValueError(f"{body} has no joint")

    def _slide(self, region, distance):
        scene = self._scene
        part = scene.site_body(region)
        joint = scene.joint_of(part)
        low, high = scene.model.jnt_range[joint]
        sign = -1.0 if abs(low) > abs(high) else 1.0
        outwards = scene.joint_axis(joint) * sign
        geoms = scene.collision_geoms([scene.model.body(part).id])
        bar = max(geoms, key=lambda g: scene.data.geom_xpos[g] @ outwards)
        handle = scene.body_axes(part).T @ (scene.data.geom_xpos[bar] - scene.body(part))
        yield from skills.slide(scene, part, handle, sign * distance)

    def _push_shut(self, region):
        part = self._scene.site_body(region) if region not in self._bodies else self._moving_part(f"{region}_main")
        yield from skills.push_shut(self._scene, part)
