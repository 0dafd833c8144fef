"""How an episode of LIBERO is described: failure modes and measures."""

from __future__ import annotations

from ..serving.environment import FailureMode, Measure

# A body that was lifted by this much was picked up, and a drawer or knob that moved by this much was gripped (m or rad).
LIFTED_M = 0.02
ACTUATED = 0.02

FAILURE_MODES = [
    FailureMode("not_grasped", "The object was never lifted by 2 cm."),
    FailureMode("dropped", "The object slipped out of the closed gripper and lies in the wrong place.", "critical"),
    FailureMode("wrong_place", "The gripper released the object in the wrong place."),
    FailureMode("not_placed", "The time ended while the gripper still held the object."),
    FailureMode("not_actuated", "The drawer, door or knob moved by less than 2 cm or 0.02 rad."),
    FailureMode("half_done", "A part of the goal was achieved, but not all of it."),
]

MEASURES = [
    Measure("goal_fraction", "", "Fraction of the goal's predicates that held at the end.", "higher"),
    Measure("goal_distance_m", "m", "Horizontal distance of the object from its goal at the end.", "lower"),
    Measure("object_displacement_m", "m", "Distance of the object from its start at the end.", "neither"),
    Measure("other_displacement_m", "m", "Largest displacement of an object that the goal does not name.", "lower"),
    Measure("lift_m", "m", "Largest height of the object above its start.", "neither"),
]


def failure(trajectory):
    """The failure mode of an episode whose time is over; None before."""
    if not trajectory.over:
        return None
    last, moves = trajectory.info, bool(trajectory.env.moved)
    if last["satisfied"] > 0.0:
        return "half_done"
    if not moves:
        return "not_actuated" if last["actuated"] < ACTUATED else None
    if last["lifted_m"] < LIFTED_M:
        return "not_grasped"
    if last["held"]:
        return "not_placed"
    return "dropped" if lost_while_closed(trajectory) else "wrong_place"


def lost_while_closed(trajectory):
    """Whether the gripper was commanded to close when it held the object for the last time."""
    held = [i for i, info in enumerate(trajectory.infos) if info["held"]]
    # The action after the last one in which the object was held.
    after = min(held[-1] + 1, trajectory.steps - 1) if held else trajectory.steps - 1
    return float(trajectory.actions[after][-1]) > 0.0


def measure(trajectory):
    """The measures at the end of an episode."""
    last = trajectory.info
    return {
        "goal_fraction": last["satisfied"],
        "goal_distance_m": last["distance_m"],
        "object_displacement_m": last["displacement_m"],
        "other_displacement_m": last["disturbance_m"],
        "lift_m": last["lifted_m"],
    }
