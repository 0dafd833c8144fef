"""Checks that RoboGate's own edits of a MuJoCo model leave nothing behind, in the MuJoCo of this Python. Prints one JSON document.

An environment with a weld to a mocap body, contacts, a tendon and a position servo is varied in every knob that RoboGate offers. After each
one is undone, all fields of the model must have the bytes of before, and an episode without knobs must be the one of before.
"""

import json

import gymnasium
import mujoco
import numpy as np
from robogate_bridge import Action, Scenario
from robogate_eval import Environment, Task
from robogate_eval.serving.adapter import Adapter
from robogate_eval.serving.model import DERIVED, _numbers

XML = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="2 2 .1"/>
<body name="mocap" mocap="true" pos="0 0 .5"><geom type="sphere" size=".01" contype="0" conaffinity="0"/></body>
<body name="hand" pos="0 0 .55"><freejoint/><geom name="hand" type="box" size=".03 .03 .03" mass="1"/></body>
<body name="block" pos=".3 0 .05"><freejoint/><geom type="box" size=".05 .05 .05" mass=".4"/></body>
<body name="door" pos="-.4 0 .2"><joint name="hinge" axis="0 0 1" damping=".1" range="-90 90"/><geom type="box" size=".1 .01 .1"/></body>
</worldbody><equality><weld body1="mocap" body2="hand" solref=".01 1"/></equality>
<tendon><fixed name="pull"><joint joint="hinge" coef="1"/></fixed></tendon>
<actuator><position joint="hinge" kp="5"/></actuator></mujoco>"""


class Weld(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (3,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(XML)
        # Poses that an author sets: mj_setConst computes others.
        self.model.eq_data[0, 3:6] = (0.0, 0.0, 0.1)
        self.model.eq_data[0, 6:10] = (1.0, 0.0, 0.0, 0.0)
        self.data = mujoco.MjData(self.model)

    def _get_obs(self):
        return self.data.xpos[2].copy()

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[7] += self.np_random.uniform(-0.02, 0.02)
        mujoco.mj_forward(self.model, self.data)
        return self._get_obs(), {}

    def step(self, action):
        self.data.mocap_pos[0][0] = 0.2 * float(action[0])
        self.data.ctrl[0] = float(action[0])
        mujoco.mj_step(self.model, self.data, 10)
        return self._get_obs(), 0.0, False, False, {"success": False}


def main():
    adapter = Adapter(Environment(make=Weld, task=Task(name="weld", control_period_s=0.02, time_limit_s=0.6)))
    model = adapter._model.model

    def fields():
        return {name: value.tobytes() for name, value in _numbers(model).items()}

    def episode(parameters):
        adapter.reset(Scenario(index=1, seed=3, parameters=parameters))
        states, ending = [adapter.state_hash()], None
        while ending is None:
            reply = adapter.step(Action("vector", [1.0]))
            states.append(reply["state_hash"])
            ending = reply["ending"]
        return states

    before, plain = fields(), episode({})
    left, differ, tried = {}, [], 0
    for knob in adapter.knobs:
        if knob.parameter in ("action_delay",) or knob.choices:
            continue
        tried += 1
        value = knob.low + 0.37 * (knob.high - knob.low)
        episode({knob.parameter: int(value) if knob.integer else value})
        if episode({}) != plain:
            differ.append(knob.name)
        now = fields()
        changed = [name for name in before if before[name] != now[name]]
        if changed:
            left[knob.name] = changed
    # A value that is not changed must not change the episode.
    nominal = [knob.name for knob in adapter.knobs if knob.nominal is not None and not knob.choices and episode({knob.parameter: knob.nominal}) != plain]
    scratch = mujoco.MjModel.from_xml_string(XML)
    scratch.eq_data[0, 3:6], scratch.eq_data[0, 6:10] = (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 0.0)
    then = {name: value.copy() for name, value in _numbers(scratch).items()}
    mujoco.mj_setConst(scratch, mujoco.MjData(scratch))
    rewrites = [name for name, value in _numbers(scratch).items() if name not in DERIVED and not np.array_equal(value, then[name], equal_nan=True)]
    print(json.dumps({"mujoco": mujoco.__version__, "knobs": tried, "rewritten": rewrites, "left": left, "differ": differ, "nominal": nominal}))


if __name__ == "__main__":
    main()
