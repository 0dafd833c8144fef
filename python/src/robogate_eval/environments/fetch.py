"""Fetch of gymnasium-robotics: reach, push, slide, and pick and place."""

from __future__ import annotations

import math
from typing import Any

from ..serving.environment import Environment, FailureMode, Measure, Policy, Task
from ..serving.trajectory import Trajectory
from .family import Family, installed, unknown

INSTRUCTIONS = {
    "FetchReach-v4": "move the gripper to the target",
    "FetchPush-v4": "push the block to the target",
    "FetchSlide-v4": "slide the puck to the target",
    "FetchPickAndPlace-v4": "move the block to the target",
}
# Time between two actions: 20 time steps of 2 ms.
PERIOD_S = 0.04


def names() -> list[str]:
    return list(INSTRUCTIONS)


def _measure(trajectory: Trajectory) -> dict[str, float | None]:
    distances = [math.dist(observation["achieved_goal"], observation["desired_goal"]) for observation in trajectory.observations]
    return {"final_distance_m": distances[-1], "smallest_distance_m": min(distances)}


def _failure(trajectory: Trajectory) -> str | None:
    if not trajectory.over:
        return None
    first, moved = trajectory.observations[0], trajectory.observations[-1]
    far = math.dist(moved["achieved_goal"], first["achieved_goal"]) > 0.01
    return "not_completed" if far else "not_moved"


def _scripted(env: Any):
    """Ours: move above the block, lower, close, and carry it to the target."""
    import numpy as np

    closed = [0]

    def act(observation: dict) -> Any:
        state, goal = observation["observation"], observation["desired_goal"]
        hand = state[:3]
        if len(state) < 25:  # FetchReach has no block
            return np.append(np.clip((goal - hand) * 10.0, -1.0, 1.0), 0.0)
        block = state[3:6]
        offset = block - hand
        if closed[0] == 0:
            above = np.linalg.norm(offset[:2]) > 0.01
            target = offset + np.array([0.0, 0.0, 0.06 if above else 0.0])
            closed[0] = int(not above and abs(offset[2]) < 0.008)
            return np.append(np.clip(target * 10.0, -1.0, 1.0), 1.0)
        closed[0] += 1
        if closed[0] < 6:
            return np.array([0.0, 0.0, 0.0, -1.0])
        return np.append(np.clip((goal - block) * 10.0, -1.0, 1.0), -1.0)

    return act


def environment(name: str) -> Environment:
    if name not in INSTRUCTIONS:
        raise unknown("task", name, INSTRUCTIONS, "fetch:")

    def make() -> Any:
        import gymnasium
        import gymnasium_robotics

        gymnasium.register_envs(gymnasium_robotics)
        return gymnasium.make(name)

    space: dict[str, tuple] = {"action_delay": (0, 5), "noise:observation": (0.0, 0.02)}
    if name != "FetchReach-v4":
        space |= {
            "mass:object0": (0.2, 10.0, "log"),
            "friction:object0": (0.05, 2.0, "log"),
            "shift_x:object0": (-0.03, 0.03),
            "shift_y:object0": (-0.03, 0.03),
        }
    # The arm follows a mocap body. The fingers are the only actuators, and only this task moves them.
    if name == "FetchPickAndPlace-v4":
        space["gain"] = (0.5, 1.5)
    scripted = Policy(_scripted, "Moves to the block, grasps it and carries it. Not for FetchPush and FetchSlide.")
    return Environment(
        make=make,
        task=Task(
            name=f"fetch.{name}",
            instruction=INSTRUCTIONS[name],
            control_period_s=PERIOD_S,
            failure_modes=[
                FailureMode("not_moved", "What is to move (the gripper or the block) moved less than 1 cm."),
                FailureMode("not_completed", "It moved, but not to the target in time."),
            ],
            failure=_failure,
            measures=[
                Measure("final_distance_m", "m", "Distance from the target at the end.", "lower"),
                Measure("smallest_distance_m", "m", "Smallest distance from the target.", "lower"),
            ],
            measure=_measure,
            # The authors draw targets around the gripper or the block, and count those that are reached at once.
            starts_may_succeed=True,
            action_names=["x", "y", "z", "gripper"],
        ),
        source=installed("gymnasium-robotics"),
        space=space,
        policies={"scripted": scripted} if name in ("FetchReach-v4", "FetchPickAndPlace-v4") else {},
    )


FAMILY = Family(
    name="fetch",
    summary="Fetch of gymnasium-robotics: reach, push, slide, pick and place",
    package="gymnasium_robotics",
    requirements=["gymnasium-robotics==1.4.2", "mujoco==3.3.7", "gymnasium==1.4.0", "numpy==2.4.6"],
    names=names,
    environment=environment,
)
