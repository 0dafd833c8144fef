"""The scripted controller as a policy of the environment."""

from __future__ import annotations

import numpy as np

from ..scripted.scene import Scene
from .plans import Planner
from ..environments.robosuite_world import REST_ACTION

ROBOT = ("robot0_", "gripper0_", "mount0_")


def scene_of(world) -> Scene:
    """A view of the scene of a LIBERO environment."""
    fingers = ("gripper0_finger_joint1", "gripper0_finger_joint2")
    return Scene(world.model, world.data, ROBOT, "gripper0_grip_site", fingers, "robot0_link2")


def scripted(env):
    """A policy that reads the state of the scene. When its plan ends, it stays where it is."""
    plan = Planner(scene_of(env), env.task, env.holds).plan()

    def act(observation):
        return np.asarray(next(plan, np.array(REST_ACTION)), dtype=float)

    return act
