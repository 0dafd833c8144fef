"""A package of which there are several versions: a bar that pushes a block in MuJoCo. `BEHAVIOUR` says what a version changes."""

import gymnasium
import mujoco
import numpy as np

BEHAVIOUR = "base"
XML = """<mujoco><option timestep="0.004"/><worldbody>
<geom name="floor" type="plane" size="2 2 .1" friction="0.5"/>
<body name="bar" pos="-.1 0 {height}"><joint name="x" type="slide" axis="1 0 0" damping="20"/>
<geom type="box" size=".02 .06 .03" mass="1"/></body>
<body name="block" pos="0 0 .03"><freejoint/><geom name="block" type="box" size=".03 .03 .03" mass=".3" friction="0.5"/></body>
</worldbody><actuator><position joint="x" kp="300"/></actuator></mujoco>"""


class Push(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (4,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    metadata = {"render_fps": 25}

    def __init__(self):
        if BEHAVIOUR == "broken":
            raise RuntimeError("eq_data has 12 numbers")
        self.model = mujoco.MjModel.from_xml_string(XML.format(height=0.5 if BEHAVIOUR == "meaning" else 0.05))
        if BEHAVIOUR == "solver":
            self.model.opt.solver, self.model.opt.tolerance, self.model.opt.iterations = mujoco.mjtSolver.mjSOL_CG, 0.0, 60
        self.data = mujoco.MjData(self.model)

    def observe(self):
        return np.array([self.data.qpos[0], self.data.qpos[1], self.data.qpos[2], self.target])

    def reset(self, seed=None, options=None):
        super().reset(seed=None if seed is None else seed + (1000 if BEHAVIOUR == "seeds" else 0))
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[1:3] = self.np_random.uniform((0.0, -0.02), (0.05, 0.02))
        self.data.qpos[2] += {"starts": 0.015, "rounding": 1e-12}.get(BEHAVIOUR, 0.0)
        self.target = self.np_random.uniform(0.12, 0.2)
        mujoco.mj_forward(self.model, self.data)
        return self.observe(), {}

    def step(self, action):
        if BEHAVIOUR == "raises":
            raise RuntimeError("the joint has no such type")
        self.data.ctrl[0] = np.clip(self.data.ctrl[0] + 0.02 * float(action[0]), -0.5, 0.5)
        mujoco.mj_step(self.model, self.data, 10)
        reached = self.data.qpos[0 if BEHAVIOUR == "meaning" else 1] >= self.target
        heavy = BEHAVIOUR == "success" and self.model.body("block").mass[0] > 0.3
        success = bool(reached) and not heavy
        return self.observe(), 0.0, success, False, {"success": success}
