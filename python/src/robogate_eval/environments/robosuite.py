"""robosuite 1.5: Lift, Can, Stack and NutAssembly of a Panda arm."""

from __future__ import annotations

import math
from dataclasses import dataclass

try:
    import numpy as np
except ModuleNotFoundError:
    # The family is listed and installed by a Python without any packages.
    np = None

from ..serving.environment import Environment, FailureMode, Measure, Policy, Task
from .family import Family, installed, unknown
from .robosuite_world import ACTION_NAMES, PERIOD_S, REST_ACTION, RobosuiteWorld, after_rest, cameras, once

TIME_LIMIT_S = 15.0


@dataclass(frozen=True)
class Kind:
    """One of robosuite's tasks."""

    cls: str
    instruction: str
    # The body that the robot moves. NutAssembly has two; the square one comes first.
    body: str


KINDS = {
    "Lift": Kind("Lift", "lift the cube", "cube_main"),
    "Can": Kind("PickPlaceCan", "put the can into its bin", "Can_main"),
    "Stack": Kind("Stack", "put the red cube on the green cube", "cubeA_main"),
    "NutAssembly": Kind("NutAssembly", "put both nuts on their pegs", "SquareNut_main"),
}


def names() -> list[str]:
    return list(KINDS)


class World(RobosuiteWorld):
    """A robosuite environment with Gymnasium's interface. Its randomness depends on the seed of `reset` only."""

    def __init__(self, kind: Kind):
        import robosuite
        from gymnasium import spaces
        from robosuite.controllers import load_composite_controller_config

        self._kind = kind
        self._env = robosuite.make(
            kind.cls, robots="Panda", controller_configs=load_composite_controller_config(controller="BASIC"), has_renderer=False,
            has_offscreen_renderer=False, use_camera_obs=False, use_object_obs=True, control_freq=round(1 / PERIOD_S), horizon=10**6,
            ignore_done=True,
        )  # fmt: skip
        low, high = self._env.action_spec
        self.action_space = spaces.Box(low.astype(np.float64), high.astype(np.float64))
        first, _ = self.reset(0)
        self.observation_space = spaces.Dict({name: spaces.Box(-np.inf, np.inf, value.shape) for name, value in first.items()})

    def reset(self, seed: int):
        # In place, because robosuite's samplers keep a reference to the generator.
        self._env.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
        seen = self._env.reset()
        self.begin()
        return self._encode(seen), {}

    def begin(self):
        self._start = self.position()
        self._lifted = 0.0

    def step(self, action):
        seen, reward, *_ = self._env.step(action)
        self._lifted = max(self._lifted, float(self.position()[2] - self._start[2]))
        info = {
            "success": bool(self._env._check_success()),
            "lifted_m": self._lifted,
            "displacement_m": float(np.linalg.norm(self.position() - self._start)),
        }
        return self._encode(seen), float(reward), False, False, info

    def observe(self):
        """The observation in the present state."""
        return self._encode(self._env._get_observations(force_update=True))

    def _encode(self, seen):
        return {name: np.asarray(seen[name], dtype=float) for name in ("robot0_proprio-state", "object-state")}

    def position(self):
        """The position of the body that the robot moves."""
        return self.data.body(self._kind.body).xpos.copy()

    def close(self):
        self._env.close()


def _failure(trajectory):
    if not trajectory.over:
        return None
    return "not_grasped" if trajectory.info["lifted_m"] < 0.02 else "not_completed"


def _measure(trajectory):
    return {"lift_m": trajectory.info["lifted_m"], "displacement_m": trajectory.info["displacement_m"]}


def _lift(env):
    """Ours: a grasp from above, and up."""
    from ..scripted import skills
    from ..scripted.motion import CLOSE, go
    from ..scripted.scene import Scene

    prefix = "gripper0_right_"
    scene = Scene(env.model, env.data, ("robot0_", "gripper0_", "fixed_mount0_"), f"{prefix}grip_site",
                  (f"{prefix}finger_joint1", f"{prefix}finger_joint2"), "robot0_link2")  # fmt: skip

    def plan():
        while True:
            yield from skills.pick(scene, "cube_main")
            yield from go(scene, scene.hand + [0.0, 0.0, 0.05], scene.hand_axes, CLOSE, steps=20)

    actions = plan()
    return lambda observation: np.asarray(next(actions, np.array(REST_ACTION)), dtype=float)


def environment(name: str) -> Environment:
    kind = KINDS.get(name)
    if kind is None:
        raise unknown("task", name, KINDS, "robosuite:")
    from ..serving.model import Model, rigid

    first = World(kind)
    body, model = kind.body, Model(first)
    mass = float(model.model.body_mass[rigid(model.model, model.names("body").index(body))].sum())
    space = {
        f"mass:{body}": (0.3 * mass, 3.0 * mass, "log"),
        f"friction:{body}": (0.05, 2.0, "log"),
        f"shift_x:{body}": (-0.03, 0.03),
        f"shift_y:{body}": (-0.03, 0.03),
        f"turn:{body}": (-math.pi / 4, math.pi / 4),
        "gain": (0.5, 1.5),
        "action_delay": (0, 8),
    }
    scripted = Policy(_lift, "Ours. It reads the state of the scene, grasps the cube from above and lifts it.")
    return Environment(
        make=once(first, lambda: World(kind)),
        task=Task(
            name=f"robosuite.{name}",
            instruction=kind.instruction,
            control_period_s=PERIOD_S,
            time_limit_s=TIME_LIMIT_S,
            failure_modes=[
                FailureMode("not_grasped", "The object was never lifted by 2 cm."),
                FailureMode("not_completed", "The object was lifted, but the task was not completed in time."),
            ],
            failure=_failure,
            measures=[
                Measure("lift_m", "m", "Largest height of the object above its start.", "neither"),
                Measure("displacement_m", "m", "Distance of the object from its start at the end.", "neither"),
            ],
            measure=_measure,
            # A knob may have moved the object.
            prepare=after_rest(1),
            cameras=cameras(),
            action_names=ACTION_NAMES,
            rest_action=REST_ACTION,
        ),
        source=installed("robosuite"),
        space=space,
        policies={"scripted": scripted} if name == "Lift" else {},
        observe=lambda env: env.observe(),
    )


FAMILY = Family(
    name="robosuite",
    package="robosuite",
    summary="robosuite 1.5: Lift, Can, Stack, NutAssembly of a Panda arm; a scripted controller for Lift",
    requirements=["robosuite==1.5.2", "mujoco==3.3.7", "gymnasium==1.4.0"],
    names=names,
    environment=environment,
)
