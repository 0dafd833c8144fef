"""Meta-World: 50 manipulation tasks of a Sawyer arm, each with a scripted expert."""

from __future__ import annotations

from typing import Any

from ..serving.environment import Environment, FailureMode, Measure, Policy, Task
from ..serving.trajectory import Trajectory
from .family import Family, installed, unknown

# Bodies of the arm and its surroundings, which all tasks share. Every other body belongs to the task.
ARM = {
    "world", "tablelink", "RetainingWall", "base", "controller_box", "pedestal_feet", "torso", "pedestal", "right_arm_base_link",
    "head", "screen", "head_camera", "right_torso_itb", "right_arm_itb", "right_hand_camera", "right_wrist", "right_hand", "hand",
    "rightclaw", "rightpad", "leftclaw", "leftpad", "right_l4_2", "right_l2_2", "right_l1_2", "mocap",
    *(f"right_l{i}" for i in range(7)),
}  # fmt: skip
ARM_JOINTS = {"r_close", "l_close", *(f"right_j{i}" for i in range(7))}


def names() -> list[str]:
    from metaworld.env_dict import ALL_V3_ENVIRONMENTS

    return sorted(ALL_V3_ENVIRONMENTS)


class Seeded:
    """A Meta-World task whose goal and objects follow from the seed of `reset`.

    Meta-World draws them from one of 50 fixed tasks, which `gym.make` chooses without the seed of `reset`.
    """

    def __init__(self, cls: type):
        self.unwrapped = env = cls()
        # The goal is part of the observation, as in Meta-World's single-task benchmark MT1.
        env._partially_observable = False
        # The space was computed when the goal was still hidden, and observations are clipped to it.
        env.__dict__.pop("sawyer_observation_space", None)
        env._freeze_rand_vec = False
        env.seeded_rand_vec = True
        env._set_task_called = True
        self.action_space = env.action_space
        self.observation_space = env.sawyer_observation_space

    def reset(self, seed: int) -> tuple[Any, dict]:
        self.unwrapped.seed(seed)
        return self.unwrapped.reset()

    def step(self, action: Any) -> tuple:
        return self.unwrapped.step(action)

    def close(self) -> None:
        self.unwrapped.close()


def _failure(trajectory: Trajectory) -> str | None:
    """How far the policy came, from Meta-World's own indicators."""
    if not trajectory.over:
        return None
    infos = trajectory.infos
    if not any(info.get("near_object", 0.0) > 0.0 for info in infos):
        return "not_reached"
    if not any(info.get("grasp_success", 0.0) > 0.0 for info in infos):
        return "not_grasped"
    return "not_completed"


def _measure(trajectory: Trajectory) -> dict[str, float | None]:
    rewards = trajectory.rewards
    distances = [info["obj_to_target"] for info in trajectory.infos if "obj_to_target" in info]
    return {
        "final_distance_m": float(distances[-1]) if distances else None,
        "smallest_distance_m": float(min(distances)) if distances else None,
        "mean_reward": float(sum(rewards) / len(rewards)),
    }


def environment(name: str) -> Environment:
    from metaworld.env_dict import ALL_V3_ENVIRONMENTS
    from metaworld.policies import ENV_POLICY_MAP

    cls = ALL_V3_ENVIRONMENTS.get(name)
    if cls is None:
        raise unknown("task", name, names(), "metaworld:")
    policies = {}
    if name in ENV_POLICY_MAP:
        expert = ENV_POLICY_MAP[name]
        policies["expert"] = Policy(lambda env: expert().get_action, "Meta-World's scripted expert for this task.")
    return Environment(
        make=lambda: Seeded(cls),
        task=Task(
            name=f"metaworld.{name}",
            instruction=name.removesuffix("-v3").replace("-", " "),
            failure_modes=[
                FailureMode("not_reached", "The gripper was never near the object."),
                FailureMode("not_grasped", "The gripper reached the object, but never held it."),
                FailureMode("not_completed", "The object was held, but did not reach its goal in time."),
            ],
            failure=_failure,
            measures=[
                Measure("final_distance_m", "m", "Distance of the object from its goal at the end.", "lower"),
                Measure("smallest_distance_m", "m", "Smallest distance of the object from its goal.", "lower"),
                Measure("mean_reward", "", "Mean of the reward over the steps.", "higher"),
            ],
            measure=_measure,
            action_names=["x", "y", "z", "gripper"],
        ),
        source=installed("metaworld"),
        space=_space(cls),
        policies=policies,
    )


def _space(cls: type) -> dict[str, tuple]:
    """What is sampled by default: physics of the bodies and joints of the task, the gripper, and the delay."""
    from ..serving import friction
    from ..serving.model import Model, rigid

    model = Model(Seeded(cls))
    m = model.model
    space: dict[str, tuple] = {}
    for body, name in enumerate(model.names("body")):
        if not name or name in ARM or m.body_weldid[body] != body:
            continue
        bodies = rigid(m, body)
        mass = float(m.body_mass[bodies].sum())
        if mass > 0.0:
            space[f"mass:{name}"] = (0.3 * mass, 3.0 * mass, "log")
        if friction.geoms(m, bodies):
            space[f"friction:{name}"] = (0.05, 2.0, "log")
        if m.body_jntnum[body] and m.jnt_type[m.body_jntadr[body]] == 0:
            space |= {f"shift_x:{name}": (-0.03, 0.03), f"shift_y:{name}": (-0.03, 0.03)}
    for joint, name in enumerate(model.names("joint")):
        if name and name not in ARM_JOINTS and m.jnt_type[joint] in (2, 3):
            damping = float(m.dof_damping[m.jnt_dofadr[joint]])
            if damping > 0.0:
                space[f"damping:{name}"] = (0.3 * damping, 3.0 * damping, "log")
    return space | {"gain": (0.3, 2.0, "log"), "action_delay": (0, 8)}


FAMILY = Family(
    name="metaworld",
    summary="Meta-World: 50 tasks of a Sawyer arm, with scripted experts",
    package="metaworld",
    requirements=["metaworld==3.1.1", "mujoco==3.3.0", "gymnasium==1.4.0", "numpy==2.4.6", "packaging==26.3"],
    names=names,
    environment=environment,
)
