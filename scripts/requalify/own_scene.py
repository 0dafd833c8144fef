"""Scenes of RoboGate's own cell as an environment: episodes of `robogate export RUN FOLDER --mjcf INDEX`, repeated in plain MuJoCo.

The arm gets the recorded inputs. An episode succeeds if the object ends within 10 mm of where it ended in the run. SCENES names a folder with
the exported folders.
"""

import csv
import os
import pathlib

import gymnasium
import mujoco
import numpy as np
from robogate_eval import Environment, Knob, Policy, Task

SCENES = sorted(pathlib.Path(os.environ["SCENES"]).glob("*/scene.xml"))
STEPS = 25


def table(path):
    with open(path, newline="") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float)


class Scene(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-100.0, 100.0, (3,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def __init__(self):
        self.wanted = 0
        self.load()

    def load(self):
        folder = SCENES[self.wanted].parent
        self.model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
        self.data = mujoco.MjData(self.model)
        self.header, self.inputs = table(folder / "inputs.csv")
        _, trajectory = table(folder / "trajectory.csv")
        self.goal = trajectory[-1, self.model.nq - 7 : self.model.nq - 4]
        self.end = -(-len(self.inputs) // STEPS)

    def object(self):
        return self.data.qpos[self.model.nq - 7 : self.model.nq - 4].copy()

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.load()
        mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key("start").id)
        mujoco.mj_forward(self.model, self.data)
        self.at = 0
        return self.object(), {}

    def step(self, action):
        for row in self.inputs[self.at : self.at + STEPS]:
            for column, value in zip(self.header, row):
                kind, name = column.split(":", 1)
                if kind == "control":
                    self.data.actuator(name).ctrl = value
            mujoco.mj_step(self.model, self.data)
        self.at += STEPS
        over = self.at >= len(self.inputs)
        success = bool(over and np.linalg.norm(self.object() - self.goal) < 0.01)
        return self.object(), 0.0, over, False, {"success": success}


def choose(env, value):
    env.wanted = int(value)


environment = Environment(
    make=Scene,
    task=Task(name="own_scene", control_period_s=0.05, time_limit_s=20.0, starts_may_succeed=True),
    knobs=[Knob("scene", choose, lambda env: env.wanted, 0, len(SCENES) - 1, integer=True, before_reset=True, meaning="Exported scene.")],
    policies={"recorded": Policy(lambda env: lambda observation: np.zeros(1), "The recorded inputs.")},
)
