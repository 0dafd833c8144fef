"""The physics of an episode is recorded without changing it."""

import json
import tempfile
import unittest
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from robogate_bridge import Action, Scenario

from robogate_eval import Environment, Task
from robogate_eval.serving.adapter import Adapter
from robogate_eval.serving.probe import SIGNALS, Probe

XML = """<mujoco><worldbody><geom type="plane" size="2 2 .1"/>
<body name="hand" pos="0 0 .3"><joint name="up" type="slide" axis="0 0 1"/><geom type="sphere" size=".05"/></body>
<body name="box" pos="0 0 .08"><freejoint/><geom type="box" size=".05 .05 .05"/></body>
</worldbody><actuator><position joint="up" kp="500" kv="20"/></actuator></mujoco>"""


class Press(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (1,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    metadata = {"render_fps": 25}

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(XML)
        self.data = mujoco.MjData(self.model)

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[1] = self.np_random.uniform(-0.02, 0.02)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qpos[:1].copy(), {}

    def step(self, action):
        self.data.ctrl[0] = 0.3 * float(action[0])
        mujoco.mj_step(self.model, self.data, 20)
        return self.data.qpos[:1].copy(), 0.0, False, False, {"success": False}


class Probing(unittest.TestCase):
    def setUp(self):
        self.adapter = Adapter(Environment(make=Press, task=Task(name="press", control_period_s=0.04, time_limit_s=1.2)))
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def states(self, parameters):
        self.adapter.reset(Scenario(index=3, seed=1, parameters=parameters))
        states, ending = [self.adapter.state_hash()], None
        while ending is None:
            reply = self.adapter.step(Action("vector", [-1.0]))
            states.append(reply["state_hash"])
            ending = reply["ending"]
        return states

    def test_probe_changes_nothing(self):
        for parameters in ({}, {"mass_box": 2.0}):
            alone = self.states(parameters)
            self.adapter.probe = Probe(self.folder)
            self.assertEqual(self.states(parameters), alone)
            self.adapter.probe = None

    def test_episode_is_one_file(self):
        self.adapter.probe = Probe(self.folder)
        steps = len(self.states({}))
        self.assertEqual([path.name for path in self.folder.iterdir()], ["3.probe"])
        header, _, numbers = (self.folder / "3.probe").read_bytes().partition(b"\n")
        header = json.loads(header)
        rows = np.frombuffer(numbers).reshape(steps, -1)
        self.assertEqual(header["frames"], steps)
        self.assertEqual(header["bodies"], [{"name": "hand", "robot": True}, {"name": "box", "robot": False}])
        self.assertEqual(header["pairs"], ["box and robot", "box and surroundings"])
        self.assertEqual(rows.shape[1], len(SIGNALS) + 2 * 7 + 2)
        # The box falls on the floor at first, and the hand presses it later.
        self.assertEqual(rows[0, -2:].tolist(), [0.0, 0.0])
        self.assertEqual(rows[-1, -2:].tolist(), [1.0, 1.0])
        self.assertGreater(rows[-1, SIGNALS.index("penetration_m")], 0.0)
        self.assertGreater(rows[:, SIGNALS.index("solver_iterations")].max(), 0.0)


if __name__ == "__main__":
    unittest.main()
