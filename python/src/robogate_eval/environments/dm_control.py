"""Manipulation tasks of dm_control: a Jaco arm that reaches, lifts, places and stacks."""

from __future__ import annotations

from typing import Any

from ..serving.environment import Environment, FailureMode, Measure, Policy, Task
from ..serving.trajectory import Trajectory
from .family import Family, installed, unknown

SUFFIX = "_features"
# dm_control reports a reward from 0 to 1 and no success.
SUCCESS_REWARD = 0.99
ARM = "jaco_arm/"


def names() -> list[str]:
    from dm_control import manipulation

    return sorted(name.removesuffix(SUFFIX) for name in manipulation.ALL if name.endswith(SUFFIX))


class World:
    """A dm_control environment with Gymnasium's interface. Its randomness depends on the seed of `reset` only."""

    def __init__(self, name: str):
        import numpy as np
        from dm_control import manipulation
        from gymnasium import spaces

        self._env = manipulation.load(name + SUFFIX, seed=0)
        # A task that shuffles its bricks does so in place, so a reset would start from the order of the last one.
        order = getattr(self._env.task, "_initial_order", None)
        self._first_order = None if order is None else np.array(order)
        action = self._env.action_spec()
        self.action_space = spaces.Box(np.asarray(action.minimum), np.asarray(action.maximum), dtype=np.float64)
        self.action_names = [part.removeprefix(ARM).replace("/", "_") for part in action.name.split("\t")]
        first, _ = self.reset(0)
        self.observation_space = spaces.Dict({key: spaces.Box(-np.inf, np.inf, value.shape) for key, value in first.items()})
        self.dt = self._env.control_timestep()

    @property
    def unwrapped(self) -> World:
        return self

    @property
    def model(self) -> Any:
        return self._env.physics.model.ptr

    @property
    def data(self) -> Any:
        return self._env.physics.data.ptr

    def _flat(self, observation: Any) -> dict:
        import numpy as np

        # A vector has the same name in the observation and in RoboGate.
        return {key.replace("/", "."): np.ravel(value).astype(float) for key, value in observation.items()}

    def _get_obs(self) -> dict:
        physics, random = self._env.physics, self._env.random_state
        enabled = {key: observable for key, observable in self._env.task.observables.items() if observable.enabled}
        return self._flat({key: observable.observation_callable(physics, random)() for key, observable in enabled.items()})

    def reset(self, seed: int) -> tuple[dict, dict]:
        self._env.random_state.seed(seed)
        if self._first_order is not None:
            self._env.task._initial_order[:] = self._first_order
        return self._flat(self._env.reset().observation), {}

    def step(self, action: Any) -> tuple:
        step = self._env.step(action)
        return self._flat(step.observation), float(step.reward), False, step.last(), {"success": step.reward >= SUCCESS_REWARD}

    def close(self) -> None:
        self._env.close()


def _failure(trajectory: Trajectory) -> str | None:
    """How near the policy came, from the reward."""
    if not trajectory.over:
        return None
    return "not_completed" if max(trajectory.rewards) > 0.1 else "not_reached"


def _measure(trajectory: Trajectory) -> dict[str, float | None]:
    rewards = trajectory.rewards
    return {"largest_reward": max(rewards), "mean_reward": sum(rewards) / len(rewards)}


def _reach(target: str):
    """A policy that moves the point between the fingers to a target: resolved-rate control with damped least squares."""

    def make(env: World):
        import mujoco
        import numpy as np

        model, data = env.model, env.data
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"{ARM}jaco_hand/pinchsite")
        joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"{ARM}joint_{i}") for i in range(1, 7)]
        dofs = model.jnt_dofadr[joints]
        jacobian = np.zeros((3, model.nv))

        def act(observation: dict) -> Any:
            mujoco.mj_jacSite(model, data, jacobian, None, site)
            arm = jacobian[:, dofs]
            wanted = 4.0 * (observation[target][:3] - observation["jaco_arm.jaco_hand.pinch_site_pos"][:3])
            speed = arm.T @ np.linalg.solve(arm @ arm.T + 0.01 * np.eye(3), wanted)
            return np.clip(np.concatenate([speed, np.zeros(3)]), env.action_space.low, env.action_space.high)

        return act

    return Policy(make, "Moves the point between the fingers to the target.")


# The vector that holds the position to reach.
TARGETS = {"reach_site": "target_position", "reach_duplo": "duplo2x4.position"}


def environment(name: str) -> Environment:
    if name not in names():
        raise unknown("task", name, names(), "dm_control:")
    first = World(name)
    policies = {"scripted": _reach(TARGETS[name])} if name in TARGETS else {}
    made = [first]
    return Environment(
        make=lambda: made.pop() if made else World(name),
        task=Task(
            name=f"dm_control.{name}",
            instruction=name.replace("_", " "),
            time_limit_s=10.0,
            failure_modes=[
                FailureMode("not_reached", "The reward never exceeded 0.1."),
                FailureMode("not_completed", f"The reward exceeded 0.1, but did not reach {SUCCESS_REWARD}."),
            ],
            failure=_failure,
            measures=[
                Measure("largest_reward", "", "Largest reward of a step, from 0 to 1.", "higher"),
                Measure("mean_reward", "", "Mean of the reward over the steps.", "higher"),
            ],
            measure=_measure,
            # A random target may be where the hand is.
            starts_may_succeed=True,
            action_names=first.action_names,
        ),
        source=installed("dm_control"),
        space=_space(first),
        policies=policies,
    )


def _space(world: World) -> dict[str, tuple]:
    """What is sampled by default: mass, friction and position of the free bodies, the force of the arm, and the delay."""
    from ..serving import friction
    from ..serving.model import Model, rigid

    model = Model(world)
    m = model.model
    space: dict[str, tuple] = {}
    for seed in range(3):
        world.reset(seed)
        model.bind(world)
        if model.differs:
            # Which bricks are fixed changes from one episode to the next.
            return {"gain": (0.3, 2.0, "log"), "action_delay": (0, 8)}
    for body, name in enumerate(model.names("body")):
        if not m.body_jntnum[body] or m.jnt_type[m.body_jntadr[body]] != 0 or name.startswith(ARM):
            continue
        bodies = rigid(m, body)
        mass = float(m.body_mass[bodies].sum())
        space[f"mass:{name}"] = (0.3 * mass, 3.0 * mass, "log")
        if friction.geoms(m, bodies):
            space[f"friction:{name}"] = (0.05, 2.0, "log")
        space |= {f"shift_x:{name}": (-0.03, 0.03), f"shift_y:{name}": (-0.03, 0.03)}
    return space | {"gain": (0.3, 2.0, "log"), "action_delay": (0, 8)}


FAMILY = Family(
    name="dm_control",
    summary="dm_control manipulation: a Jaco arm reaches, lifts, places and stacks",
    package="dm_control",
    requirements=["dm_control==1.0.50", "mujoco==3.17.0", "gymnasium==1.4.0", "numpy==2.4.6"],
    names=names,
    environment=environment,
)
