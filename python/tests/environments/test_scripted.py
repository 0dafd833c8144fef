"""Tests of the scripted controller's parts: rotations, grasps in maps of heights, plans, scoring. They need NumPy and MuJoCo."""

import unittest
from types import SimpleNamespace

import mujoco
import numpy as np
from robogate_eval.libero import plans, scoring
from robogate_eval.scripted import clearance, grasp, motion
from robogate_eval.scripted.scene import Heights, Scene

SPACING = 0.004


def heights(top, mine):
    """A map of heights around the origin from two functions of x and y."""
    x = y = np.arange(-0.2, 0.2, SPACING)
    gx, gy = np.meshgrid(x, y, indexing="ij")
    inside = mine(gx, gy)
    return Heights(x, y, np.where(inside, top(gx, gy), 0.0), inside)


def box(half_x, half_y, height):
    return heights(lambda x, y: np.full_like(x, height), lambda x, y: (abs(x) <= half_x) & (abs(y) <= half_y))


def found(scene, **options):
    return grasp.grasps(scene, current=(0.0, 1.0), centre=np.zeros(2), floor=0.002, **options)


class Rotations(unittest.TestCase):
    def test_have_their_vector(self):
        random = np.random.default_rng(1)
        for angle in (0.0, 1e-4, 1.0, 3.0, np.pi):
            axis = random.normal(size=3)
            axis /= np.linalg.norm(axis)
            vector = motion.rotation_vector(motion.rotation(axis, angle))
            self.assertAlmostEqual(np.linalg.norm(vector), angle, places=5)
            if 0.0 < angle < np.pi:
                np.testing.assert_allclose(vector / angle, axis, atol=1e-4)

    def test_of_a_hand_are_right_handed(self):
        axes = motion.axes_of(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0]))
        np.testing.assert_allclose(np.cross(axes[:, 0], axes[:, 1]), axes[:, 2])


class Grasps(unittest.TestCase):
    def test_close_across_the_narrow_side(self):
        best = found(box(0.06, 0.02, 0.05))[0]
        self.assertGreater(abs(best.closing[1]), 0.9)

    def test_turn_for_a_box_that_lies_across(self):
        best = found(box(0.02, 0.06, 0.05))[0]
        self.assertGreater(abs(best.closing[0]), 0.9)

    def test_of_a_bowl_hold_its_rim(self):
        def radius(x, y):
            return np.hypot(x, y)

        bowl = heights(lambda x, y: np.where(radius(x, y) > 0.05, 0.05, 0.01), lambda x, y: radius(x, y) <= 0.058)
        best = found(bowl)[0]
        self.assertGreater(np.linalg.norm(best.position[:2]), 0.04)
        # The fingers close across the rim, which means towards the centre.
        towards = best.position[:2] / np.linalg.norm(best.position[:2])
        self.assertGreater(abs(best.closing[:2] @ towards), 0.8)

    def test_of_a_wide_block_do_not_exist(self):
        self.assertEqual(found(box(0.07, 0.07, 0.05)), [])

    def test_avoid_a_wall(self):
        scene = box(0.06, 0.02, 0.05)
        # A wall beside the box, where the right finger would be.
        scene.top[:, (scene.y > 0.024) & (scene.y < 0.09)] = 0.2
        self.assertTrue(all(abs(g.closing[1]) < 0.9 or g.position[2] > 0.1 for g in found(scene)))

    def test_stay_above_the_floor(self):
        for g in found(box(0.04, 0.02, 0.015)):
            self.assertGreaterEqual(g.position[2] + grasp.PANDA.tip, 0.0019)


class TheReach(unittest.TestCase):
    def test_is_where_the_arm_is_stretched(self):
        shoulder = np.array([-0.66, 0.0, 1.245])
        height = clearance.highest_reach(shoulder, [0.05, -0.2])
        self.assertAlmostEqual(clearance.stretch(shoulder, np.array([0.05, -0.2, height])), clearance.REACH_M)
        self.assertEqual(clearance.highest_reach(shoulder, [0.5, 0.0]), -np.inf)


SCENE = """
<mujoco>
  <worldbody>
    <geom name="table" type="plane" size="1 1 .1"/>
    <body name="robot0_link2" pos="0 0 2"><geom size=".05"/></body>
    <body name="hand" pos="0 0 1"><site name="grip" euler="180 0 0"/><joint name="left" type="slide"/><geom size=".01" contype="0" conaffinity="0"/>
      <body name="tip"><joint name="right" type="slide"/><geom size=".01" contype="0" conaffinity="0"/></body></body>
    <body name="part" pos=".3 0 .05"><freejoint/><geom type="box" size=".02 .03 .05" rgba="1 1 1 0"/></body>
  </worldbody>
</mujoco>
"""


class TheScene(unittest.TestCase):
    def setUp(self):
        model = mujoco.MjModel.from_xml_string(SCENE)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        self.scene = Scene(model, data, ("robot0_",), "grip", ("left", "right"), "robot0_link2")

    def test_sees_geoms_that_are_not_drawn(self):
        self.assertAlmostEqual(self.scene.height(0.3, 0.0, 1.0), 0.1, places=6)

    def test_does_not_see_the_robot(self):
        self.assertAlmostEqual(self.scene.height(0.0, 0.0, 3.0), 0.0, places=6)

    def test_ignores_what_it_is_told_to(self):
        part = self.scene.subtree("part")
        self.assertAlmostEqual(self.scene.height(0.3, 0.0, 1.0, ignore=part), 0.0, places=6)

    def test_knows_bounds(self):
        low, high = self.scene.bounds("part")
        np.testing.assert_allclose([low, high], [[0.28, -0.03, 0.0], [0.32, 0.03, 0.1]], atol=1e-9)

    def test_names_what_is_missing(self):
        with self.assertRaisesRegex(KeyError, "no body 'cup'"):
            self.scene.body("cup")


class Plans(unittest.TestCase):
    def test_open_before_they_put_and_close_after(self):
        goal = (("close", "drawer"), ("in", "bowl", "drawer"), ("open", "drawer"))
        self.assertEqual([part[0] for part in plans.ordered(goal)], ["open", "in", "close"])


def trajectory(infos, moved=("bowl",), grip=-1.0, over=True):
    base = {"satisfied": 0.0, "held": False, "lifted_m": 0.0, "actuated": 0.0}
    actions = [np.array([0, 0, 0, 0, 0, 0, grip])] * len(infos)
    infos = [base | info for info in infos]
    return SimpleNamespace(env=SimpleNamespace(moved=list(moved)), infos=infos, info=infos[-1], actions=actions, steps=len(infos), over=over)


class FailureModes(unittest.TestCase):
    def test_are_given_at_the_end_only(self):
        self.assertIsNone(scoring.failure(trajectory([{}], over=False)))

    def test_follow_from_the_trajectory(self):
        lifted = {"lifted_m": 0.1}
        cases = {
            "not_grasped": trajectory([{}]),
            "not_placed": trajectory([lifted | {"held": True}]),
            "wrong_place": trajectory([lifted | {"held": True}, lifted]),
            "dropped": trajectory([lifted | {"held": True}, lifted], grip=1.0),
            "half_done": trajectory([lifted | {"satisfied": 0.5}]),
            "not_actuated": trajectory([{}], moved=()),
        }
        for expected, given in cases.items():
            self.assertEqual(scoring.failure(given), expected)

    def test_leave_a_drawer_that_moved_to_the_time_limit(self):
        self.assertIsNone(scoring.failure(trajectory([{"actuated": 0.1}], moved=())))


if __name__ == "__main__":
    unittest.main()
