"""A MuJoCo environment of the tests: a slider pushes a box over a table. It has no package of its own."""

import gymnasium
import mujoco
import numpy as np

XML = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <light name="lamp" pos="0 0 2"/>
    <camera name="front" pos="1 0 0.5" xyaxes="0 1 0 -0.4 0 1"/>
    <geom name="table" type="plane" size="2 2 0.1" friction="1.5"/>
    <body name="pusher" pos="-0.2 0 0.06">
      <joint name="slide" type="slide" axis="1 0 0" damping="20"/>
      <camera name="on_pusher" pos="0 0 0.2"/>
      <geom name="plate" type="box" size="0.01 0.1 0.05" mass="1" friction="0.2"/>
    </body>
    <body name="box" pos="0 0 0.05">
      <freejoint/>
      <geom name="block" type="box" size="0.05 0.05 0.05" mass="0.5" friction="0.6"/>
    </body>
  </worldbody>
  <actuator><position name="push" joint="slide" kp="200"/></actuator>
</mujoco>
"""
STEPS = 10


class SlidingBox(gymnasium.Env):
    """Success: the box has moved by 10 cm."""

    observation_space = gymnasium.spaces.Dict({
        "box": gymnasium.spaces.Box(-np.inf, np.inf, (3,)),
        "pusher": gymnasium.spaces.Dict({"x": gymnasium.spaces.Box(-np.inf, np.inf, (1,))}),
    })
    action_space = gymnasium.spaces.Box(-0.2, 0.4, (1,))
    dt = 0.05
    max_path_length = 40

    def __init__(self, rebuild=False):
        self._rebuild = rebuild
        self._build()

    def _build(self):
        self.model = mujoco.MjModel.from_xml_string(XML)
        self.data = mujoco.MjData(self.model)

    def _get_obs(self):
        return {"box": self.data.body("box").xpos.copy(), "pusher": {"x": self.data.qpos[:1].copy()}}

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        if self._rebuild:
            self._build()
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[1] = self.np_random.uniform(-0.02, 0.02)
        mujoco.mj_forward(self.model, self.data)
        self.start = float(self.data.qpos[1])
        return self._get_obs(), {}

    def step(self, action):
        self.data.ctrl[:] = action
        for _ in range(STEPS):
            mujoco.mj_step(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        return self._get_obs(), 0.0, False, False, {"success": bool(self.data.qpos[1] - self.start > 0.1)}
