"""The recorded motion of MuJoCo environments, compared with what follows from the model by hand."""

import unittest

import gymnasium
import mujoco
import numpy as np
from robogate_bridge import Action, Scenario, Server, codec
from robogate_eval.serving import Task
from robogate_eval.serving.adapter import Adapter
from robogate_eval.serving.environment import Environment
from robogate_eval.serving.motion import Scene, sides

# A box of 2 kg at rest on the floor, a ball that a hand presses on it, and one geom of each other shape.
MODEL = """
<mujoco>
  <asset>
    <material name="blue" rgba="0 0 1 1"/>
    <texture name="grey" type="2d" builtin="flat" rgb1="0.2 0.4 0.6" width="8" height="8"/>
    <material name="painted" texture="grey" rgba="0.5 1 1 1"/>
    <mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1" scale="0.1 0.1 0.1"/>
    <hfield name="hills" nrow="3" ncol="4" size="1 2 0.5 0.1" elevation="0 0 0 0  0 1 1 0  0 0 0 0"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="2 3 0.1" material="blue"/>
    <geom name="hills" type="hfield" hfield="hills" pos="9 9 0"/>
    <geom name="hidden" type="box" size="1 1 1" group="3" contype="0" conaffinity="0"/>
    <geom name="clear" type="box" size="1 1 1" rgba="1 0 0 0" contype="0" conaffinity="0"/>
    <site name="mark" pos="0 1 0.2" size="0.03" rgba="0 1 0 0.5"/>
    <body name="box" pos="0 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="2" rgba="1 0 0 1"/></body>
    <body name="hand" pos="0 0 1">
      <joint name="down" type="slide" axis="0 0 -1" damping="50"/>
      <geom type="capsule" size="0.02 0.05" mass="0.1" material="painted"/>
      <body name="finger" pos="0 0 -0.1">
        <geom type="ellipsoid" size="0.01 0.02 0.03" mass="0.1"/><geom type="mesh" mesh="wedge" mass="0" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="down" ctrlrange="-20 20"/></actuator>
</mujoco>
"""


class Press(gymnasium.Env):
    """The action is the force of the hand downwards, in N."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,))
    action_space = gymnasium.spaces.Box(-20.0, 20.0, (1,))
    dt = 0.02

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data = mujoco.MjData(self.model)

    def _get_obs(self):
        return self.data.qpos[7:8].copy()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        return self._get_obs(), {}

    def step(self, action):
        self.data.ctrl[:] = action
        mujoco.mj_step(self.model, self.data, nstep=10)
        return self._get_obs(), 0.0, False, False, {"success": False}


def press(force, record_s=None, steps=150):
    """The adapter after so many control periods with a force of the hand, and the state hashes."""
    adapter = Adapter(Environment(make=Press, task=Task(name="press", time_limit_s=100.0)))
    adapter.reset(Scenario(0, 1, {}, record_s=record_s))
    hashes = []
    for _ in range(steps):
        adapter.step(Action("vector", [force]))
        hashes.append(adapter.state_hash())
    return adapter, hashes


def contacts(recording):
    """The contacts of the last frame: kind, position, force."""
    last = recording.contacts[recording.contacts[:, 0] == recording.frames - 1]
    return [(int(row[1]), row[2:5], row[5:8]) for row in last]


class Forces(unittest.TestCase):
    def test_a_box_at_rest_is_carried_by_the_floor(self):
        # The motor holds the hand, which weighs 0.2 kg, against gravity.
        adapter, _ = press(-0.2 * 9.81, record_s=0.1)
        found = contacts(adapter.motion())
        self.assertEqual({kind for kind, _, _ in found}, {2})
        np.testing.assert_allclose(sum(force for _, _, force in found), [0.0, 0.0, 2.0 * 9.81], atol=0.05)
        self.assertTrue(all(abs(position[2]) < 1e-3 for _, position, _ in found))

    def test_a_hand_pushes_the_object_down(self):
        # The force on the box at the top, from the hand with its weight and its motor.
        adapter, _ = press(10.0, record_s=0.1, steps=300)
        found = contacts(adapter.motion())
        top = [force for kind, _, force in found if kind == 0]
        np.testing.assert_allclose(sum(top), [0.0, 0.0, -(10.0 + 0.2 * 9.81)], atol=0.2)
        floor = [force for kind, _, force in found if kind == 2]
        np.testing.assert_allclose(sum(floor)[2], 2.2 * 9.81 + 10.0, atol=0.3)

    def test_bodies_have_sides(self):
        model = Press().model
        of = dict(zip([model.body(i).name for i in range(model.nbody)], sides(model)))
        self.assertEqual(of, {"world": "surroundings", "box": "object", "hand": "robot", "finger": "robot"})


class Recordings(unittest.TestCase):
    def test_frames_have_the_poses_of_the_engine(self):
        adapter, _ = press(10.0, record_s=0.1, steps=33)
        recording = adapter.motion()
        # Control periods of 0.02 s: a frame in each fifth of them, and the last one.
        np.testing.assert_allclose(recording.motion[:, 0], [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.66], atol=1e-6)
        data = adapter._env.data
        for name, row in zip(recording.bodies, recording.motion[-1, 1:].reshape(-1, 7)):
            np.testing.assert_allclose(row, [*data.body(name).xpos, *data.body(name).xquat], atol=1e-6)

    def test_the_last_body_is_the_object_that_moved(self):
        # The box stays on the floor, so the path is that of the hand's parts.
        self.assertIn(press(-1.0, record_s=0.1)[0].motion().bodies[-1], ("hand", "finger"))
        adapter, _ = press(0.0, steps=1)
        adapter._env.reset = lambda seed=None: self.dropped(adapter._env)
        adapter.reset(Scenario(0, 1, {}, record_s=0.1))
        for _ in range(40):
            adapter.step(Action("vector", [0.0]))
        recording = adapter.motion()
        self.assertEqual(recording.bodies[-1], "box")
        red = next(solid for solid in recording.solids if solid["color"] == [255, 0, 0])
        self.assertEqual(recording.bodies[red["body"]], "box")

    @staticmethod
    def dropped(env):
        """A reset with the box 0.5 m above the floor, beside the hand."""
        mujoco.mj_resetData(env.model, env.data)
        env.data.qpos[:3] = [0.5, 0.5, 0.6]
        mujoco.mj_forward(env.model, env.data)
        return env._get_obs(), {}

    def test_recording_changes_nothing(self):
        self.assertEqual(press(10.0)[1], press(10.0, record_s=0.03)[1])

    def test_the_protocol_carries_it(self):
        server = Server(Adapter(Environment(make=Press, task=Task(name="press", time_limit_s=100.0))))

        def answer(op, episode=7, **keys):
            header, *frames = server.answer([codec.encode({"v": codec.VERSION, "op": op, "episode": episode, **keys})])
            return codec.decode(header), frames

        self.assertTrue(answer("hello", 0)[0]["records_motion"])
        answer("reset", index=0, seed=1, parameters={}, record_s=0.05)
        answer("step", tick=0, action_space="vector", actions=[[1.0]] * 10)
        answer("close")
        reply, frames = answer("motion")
        self.assertEqual((reply["ok"], reply["frames"], len(frames)), (True, 5, 3))
        self.assertEqual(len(frames[0]), 4 * 5 * (1 + 7 * len(reply["bodies"])))
        answer("reset", 8, index=0, seed=1, parameters={})
        self.assertIn("is not recorded", answer("motion", 8)[0]["error"]["detail"])
        self.assertIn("above 0", answer("reset", 9, index=0, seed=1, parameters={}, record_s=0)[0]["error"]["detail"])


class Geometry(unittest.TestCase):
    def setUp(self):
        self.scene = Scene(Press().model, (0, 1, 2))
        self.by_color = {tuple(solid["color"]): solid for solid in self.scene.solids}

    def test_hidden_and_clear_solids_are_left_out(self):
        # Floor, hills, box, capsule, ellipsoid, wedge, and the site.
        self.assertEqual(len(self.scene.solids), 7)
        self.assertEqual(set(self.scene.names), {"world", "box", "hand", "finger"})

    def test_colours_are_those_of_the_renderer(self):
        self.assertEqual(self.by_color[(0, 0, 255)]["shape"], {"kind": "box", "half": [2.0, 3.0, 0.001]})
        self.assertEqual(self.by_color[(0, 255, 0)]["opacity"], 0.5)
        # The mean of the texture times the colour of the material.
        self.assertIn((26, 102, 153), self.by_color)

    def test_meshes_have_their_size_and_orientation(self):
        triangles = self.scene.triangles().reshape(-1, 3, 3).astype(float)
        meshes = [solid["shape"] for solid in self.scene.solids if solid["shape"]["kind"] == "mesh"]
        volumes = []
        for mesh in meshes:
            a, b, c = triangles[mesh["first"] : mesh["first"] + mesh["count"]].transpose(1, 0, 2)
            volumes.append(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
        # Of the height field only the surface is shown. An ellipsoid of 128 corners is 7 % smaller than the exact one.
        self.assertAlmostEqual(volumes[-1], 0.1**3 / 6.0, places=7)
        exact = 4.0 / 3.0 * np.pi * 0.01 * 0.02 * 0.03
        self.assertTrue(0.88 * exact < volumes[-2] < exact, volumes)

    def test_height_fields_have_their_points(self):
        hills = next(solid["shape"] for solid in self.scene.solids if solid["shape"]["kind"] == "mesh")
        corners = self.scene.triangles()[hills["first"] : hills["first"] + hills["count"]].reshape(-1, 3)
        np.testing.assert_allclose(corners.min(axis=0), [-1.0, -2.0, 0.0], atol=1e-6)
        np.testing.assert_allclose(corners.max(axis=0), [1.0, 2.0, 0.5], atol=1e-6)
        top = corners[corners[:, 2] > 0.4]
        np.testing.assert_allclose(np.abs(top), [[1.0 / 3.0, 0.0, 0.5]] * len(top), atol=1e-6)


if __name__ == "__main__":
    unittest.main()
