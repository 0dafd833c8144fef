"""Tests of the server without Isaac Sim: the stage is a real USD stage, its joints place the links as MuJoCo does, and the protocol is
tested with fakes of Isaac Sim's classes."""

import sys
import unittest
from math import degrees, radians
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from fakes import GRAVITY_SAG, Fakes  # noqa: E402

FAKES = Fakes().install()

from pxr import UsdGeom, UsdPhysics, UsdShade  # noqa: E402
from robogate_bridge import Problem, Server, codec  # noqa: E402
from robogate_isaac.robot import Robot  # noqa: E402
from robogate_isaac.runtime import Runtime, version  # noqa: E402
from robogate_isaac.simulator import Isaac  # noqa: E402
from robogate_isaac.stage import damped, principal  # noqa: E402
from robogate_isaac.version import check  # noqa: E402

FOLDER = HERE.parents[2] / "assets" / "robots" / "franka"
FRANKA = Robot.read(FOLDER)
UP = [1.0, 0.0, 0.0, 0.0]
HOME = [0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398]


def cell():
    """A cell of the Franka with every kind of item."""
    motion = {"velocity_m_s": [0.0, 0.2, 0.0], "starts_s": 0.02, "ends_s": 1.0}
    place = {"position": [0.5, -0.4, 0.041], "orientation": UP}
    box = {"kind": "box", "half": [0.03, 0.03, 0.04]}
    yaw = [np.cos(0.3), 0.0, 0.0, np.sin(0.3)]
    table = {"position": [0.55, 0.0, -0.02], "orientation": UP}
    return {
        "control_period_s": 0.05,
        "gravity_m_s2": 6.0,
        "friction": 0.4,
        "table_friction": 0.1,
        "objects": [{
            "name": "object",
            "parts": [
                {"primitive": {"kind": "box", "half": [0.03, 0.02, 0.01]},
                 "pose": {"position": [0.0, 0.0, -0.015], "orientation": UP}},
                {"primitive": {"kind": "sphere", "radius": 0.011},
                 "pose": {"position": [0.01, 0.0, 0.01], "orientation": UP}},
                {"primitive": {"kind": "cylinder", "radius": 0.01, "half_height": 0.02},
                 "pose": {"position": [0.0, 0.0, 0.005], "orientation": yaw}},
            ],
            "pose": {"position": [0.47, 0.05, 0.025], "orientation": yaw},
            "mass_kg": 0.25,
            "centre_of_mass": [0.004, 0.0, -0.003],
            "inertia_kg_m2": [[2e-4, 1e-5, 0.0], [1e-5, 1e-4, 0.0], [0.0, 0.0, 1.5e-4]],
        }, {
            "name": "other",
            "parts": [{"primitive": {"kind": "box", "half": [0.02, 0.02, 0.02]},
                       "pose": {"position": [0.0, 0.0, 0.0], "orientation": UP}}],
            "pose": {"position": [0.4, -0.1, 0.02], "orientation": UP},
            "mass_kg": 0.5,
            "centre_of_mass": [0.0, 0.0, 0.0],
            "inertia_kg_m2": [[1e-4, 0.0, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 1e-4]],
        }],
        "fixtures": [
            {"name": "table", "kind": "table", "primitive": {"kind": "box", "half": [0.4, 0.7, 0.02]}, "pose": table,
             "motion": None},
            {"name": "obstacle_1", "kind": "obstacle",
             "primitive": {"kind": "cylinder", "radius": 0.02, "half_height": 0.06},
             "pose": {"position": [0.6, 0.21, 0.06], "orientation": yaw}, "motion": None},
            {"name": "disturbance", "kind": "disturbance", "primitive": box, "pose": place, "motion": motion},
        ],
        "robot": {
            "name": "franka", "sha256": FRANKA.sha256, "joints": FRANKA.joints, "home_rad": HOME,
            "position_limit_rad": [[-2.8973, 2.8973], [-1.7628, 1.7628], [-2.8973, 2.8973], [-3.0718, -0.0698],
                                   [-2.8973, 2.8973], [-0.0175, 3.7525], [-2.8973, 2.8973]],
            "velocity_limit_rad_s": [2.175] * 4 + [2.61] * 3,
            "acceleration_limit_rad_s2": [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0],
            "torque_limit_nm": [87.0] * 4 + [12.0] * 3,
            "stiffness_nm_rad": [4500.0, 4500.0, 3500.0, 3500.0, 2000.0, 2000.0, 2000.0],
            "damping_nms_rad": [300.0, 300.0, 250.0, 250.0, 100.0, 100.0, 100.0],
            "tcp_site": "tcp",
            "gripper": {"kind": "parallel_jaw", "finger_joints": ["finger_joint1", "finger_joint2"],
                        "finger_bodies": ["left_finger", "right_finger"], "opening_m": 0.08,
                        "finger_speed_m_s": 0.05, "force_n": 30.0, "stiffness_n_m": 10000.0, "damping_ns_m": 50.0,
                        "pad_friction": 0.6},
        },
        "visual": {},
    }  # fmt: skip


def begun(world=None):
    simulator = Isaac(FRANKA, Runtime, version())
    server = Server(simulator)
    reply = ask(server, "reset", index=0, seed=1, parameters={}, cell=world or cell())
    return server, reply


def ask(server, op, **fields):
    return codec.decode(server.answer([codec.encode({"v": codec.VERSION, "op": op, "episode": 7, **fields})])[0])


class TheStage(unittest.TestCase):
    def setUp(self):
        begun()
        self.stage = FAKES.stage

    def test_link_poses_match_mujoco(self):
        moved = dict(zip(FRANKA.joints, [0.4, -0.3, 0.2, -1.9, -0.5, 2.0, 1.1])) | {
            "finger_joint1": 0.013, "finger_joint2": 0.031}  # fmt: skip
        home = dict(zip(FRANKA.joints, HOME)) | {"finger_joint1": 0.04, "finger_joint2": 0.04}
        for joints in (home, moved):
            FAKES.q = {name: joints[name] for name in FAKES.q}
            for body, pose in FRANKA.places(joints).items():
                at, turn = FAKES.link(f"/World/robot/{body}")
                np.testing.assert_allclose(at, pose["position"], atol=1e-6, err_msg=body)
                self.assertAlmostEqual(abs(float(np.dot(turn, pose["orientation"]))), 1.0, places=6, msg=body)
        for body, pose in FRANKA.places(home).items():
            authored = UsdGeom.Xformable(self.stage.GetPrimAtPath(f"/World/robot/{body}")).GetLocalTransformation()
            np.testing.assert_allclose(authored.ExtractTranslation(), pose["position"], atol=1e-9)

    def test_drive_gains_have_usd_units(self):
        joint = self.stage.GetPrimAtPath("/World/robot/joints/joint3")
        drive = UsdPhysics.DriveAPI(joint, "angular")
        self.assertAlmostEqual(drive.GetStiffnessAttr().Get(), 3500.0 * radians(1.0), places=4)
        self.assertAlmostEqual(drive.GetDampingAttr().Get(), (250.0 + 1.0) * radians(1.0), places=4)
        self.assertAlmostEqual(drive.GetMaxForceAttr().Get(), 87.0, places=4)
        self.assertAlmostEqual(joint.GetAttribute("physxJoint:armature").Get(), 0.1, places=6)
        limits = UsdPhysics.RevoluteJoint(joint)
        self.assertAlmostEqual(limits.GetUpperLimitAttr().Get(), degrees(2.8973), places=4)
        finger = UsdPhysics.DriveAPI(self.stage.GetPrimAtPath("/World/robot/joints/finger_joint1"), "linear")
        self.assertAlmostEqual(finger.GetStiffnessAttr().Get(), 10000.0)
        self.assertAlmostEqual(finger.GetDampingAttr().Get(), 100.0)

    def test_joint_damping_follows_the_law(self):
        # d (target - v) - own v, for any velocity.
        for v in (-1.0, 0.0, 2.0):
            self.assertAlmostEqual((250.0 + 1.0) * (damped(0.7, 250.0, 1.0) - v), 250.0 * (0.7 - v) - 1.0 * v)

    def test_inertia_is_preserved(self):
        inertia = np.array(cell()["objects"][0]["inertia_kg_m2"])
        moments, (w, x, y, z) = principal(inertia)
        turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])  # fmt: skip
        np.testing.assert_allclose(turn @ np.diag(moments) @ turn.T, inertia, atol=1e-12)

    def test_only_allowed_pairs_collide(self):
        base = UsdPhysics.FilteredPairsAPI(self.stage.GetPrimAtPath("/World/robot/link0"))
        self.assertEqual(len(base.GetFilteredPairsRel().GetTargets()), 3)
        root = self.stage.GetPrimAtPath("/World/robot")
        self.assertFalse(root.GetAttribute("physxArticulation:enabledSelfCollisions").Get())
        for path in ("/World/objects/object_1", "/World/robot/hand"):
            # The schemas of PhysX are not part of USD, so only their names are checked.
            schemas = self.stage.GetPrimAtPath(path).GetMetadata("apiSchemas").GetAddedOrExplicitItems()
            self.assertIn("PhysxContactReportAPI", schemas)
        moving = UsdPhysics.RigidBodyAPI(self.stage.GetPrimAtPath("/World/fixtures/fixture_2"))
        self.assertTrue(moving.GetKinematicEnabledAttr().Get())
        self.assertFalse(self.stage.GetPrimAtPath("/World/fixtures/fixture_0").HasAPI(UsdPhysics.RigidBodyAPI))

    def test_every_shape_has_a_physics_material(self):
        shapes = [prim for prim in self.stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
        self.assertEqual(len(shapes), 18 + 3 + 4)
        for prim in shapes:
            material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
            self.assertTrue(material.GetPrim().HasAPI(UsdPhysics.MaterialAPI), prim.GetPath())


class TheServer(unittest.TestCase):
    def setUp(self):
        FAKES.more_contacts = []

    def test_reset_reads_back_and_undoes_its_step(self):
        self.assertGreater(GRAVITY_SAG, 0.0)
        _, reply = begun()
        self.assertTrue(reply["ok"], reply)
        world, read = cell(), reply["readback"]
        for key, value in (("friction", 0.4), ("table_friction", 0.1), ("gravity_m_s2", 6.0),
                           ("pad_friction", 0.6), ("grip_force_n", 30.0)):
            self.assertAlmostEqual(read[key], value, places=5, msg=key)
        np.testing.assert_allclose(read["stiffness_nm_rad"], world["robot"]["stiffness_nm_rad"], rtol=1e-6)
        for held, thing in zip(read["objects"], world["objects"], strict=True):
            self.assertAlmostEqual(held["mass_kg"], thing["mass_kg"], places=6)
            np.testing.assert_allclose(held["centre_of_mass"], thing["centre_of_mass"], atol=1e-8)
            np.testing.assert_allclose(held["pose"]["position"], thing["pose"]["position"], atol=1e-7)
            for got, part in zip(held["parts"], thing["parts"], strict=True):
                self.assertEqual(got, part["primitive"])
        for i, (got, want) in enumerate(zip(read["fixtures"], world["fixtures"], strict=True)):
            self.assertEqual((got["fixture"], got["motion"]), (i, want["motion"]))
            self.assertEqual(got["primitive"], want["primitive"])
            np.testing.assert_allclose(got["pose"]["orientation"], want["pose"]["orientation"], atol=1e-9)
            np.testing.assert_allclose(got["pose"]["position"], want["pose"]["position"], atol=1e-9)
        np.testing.assert_allclose(reply["observation"]["vectors"]["joint_positions"], HOME, atol=1e-6)
        self.assertAlmostEqual(reply["observation"]["vectors"]["gripper_opening"][0], 0.08, places=6)

    def test_drives_the_arm_and_reports_every_time_step(self):
        server, reply = begun()
        first = reply["observation"]["vectors"]["tool_pose"][:3]
        goal = [q + 0.01 for q in HOME]
        reply = ask(server, "step", tick=0, action_space="joint_position", actions=[[*goal, -1.0]] * 4)
        self.assertTrue(reply["ok"], reply)
        self.assertEqual([len(step["sights"]) for step in reply["steps"]], [20] * 4)
        last = reply["steps"][-1]["observation"]["vectors"]
        np.testing.assert_allclose(last["joint_positions"], goal, atol=1e-6)
        self.assertGreater(np.linalg.norm(np.subtract(last["tool_pose"][:3], first)), 1e-3)
        # The weight, from both points of contact, is never attributed to the robot. Sliding contacts have no force.
        sight = reply["steps"][-1]["sights"][-1]
        self.assertTrue(sight["object_on_fixture"])
        self.assertEqual((sight["fingers"], sight["collision"], sight["peak_force_n"]), ([None, None], None, None))

    def test_contacts_are_summed_by_owner(self):
        server, _ = begun()
        FAKES.more_contacts = [
            ("/World/robot/left_finger", "/World/objects/object_0", [10.0, 5.0]),
            ("/World/objects/object_0", "/World/robot/right_finger", [12.0]),
            ("/World/robot/link5", "/World/fixtures/fixture_1", [3.0]),
            ("/World/robot/hand", "/World/fixtures/fixture_2", [0.0]),
        ]
        reply = ask(server, "step", tick=0, action_space="joint_position", actions=[[*HOME, 1.0]])
        sight = reply["steps"][0]["sights"][0]
        np.testing.assert_allclose(sight["fingers"], [15.0, 12.0])
        self.assertEqual((sight["collision"]["robot_body"], sight["collision"]["fixture"]), ("link5", 1))
        self.assertAlmostEqual(sight["collision"]["force_n"], 3.0)
        self.assertAlmostEqual(sight["peak_force_n"], 15.0)
        self.assertFalse(sight["body_on_object"])

    def test_support_has_the_friction(self):
        server, _ = begun()
        FAKES.more_contacts = [("/World/objects/object_0", "/World/objects/object_1", [2.0])]
        action = {"action_space": "joint_position", "actions": [[*HOME, -1.0]]}
        for tick, (index, up) in enumerate(((0, 0.25 * 6.0 + 2.0), (1, 0.5 * 6.0 - 2.0))):
            sight = ask(server, "step", tick=tick, object=index, **action)["steps"][0]["sights"][-1]
            self.assertEqual((sight["object"], sight["object_on_fixture"]), (index, True))
            np.testing.assert_allclose(sight["support_n"], [1.0 if index == 0 else 0.0, 0.0, up], atol=1e-5)

    def test_moving_fixtures_move(self):
        server, _ = begun()
        ask(server, "step", tick=0, action_space="joint_position", actions=[[*HOME, -1.0]] * 2)
        place = FAKES.stage.GetPrimAtPath("/World/fixtures/fixture_2").GetAttribute("xformOp:translate").Get()
        np.testing.assert_allclose(place, [0.5, -0.4 + 0.2 * 0.08, 0.041])

    def test_hashes_are_reproducible(self):
        runs = []
        for _ in range(2):
            server, _ = begun()
            actions = [[q + 0.01 * k for q in HOME] + [1.0] for k in range(5)]
            reply = ask(server, "step", tick=0, action_space="joint_position", actions=actions)
            runs.append([step["state_hash"] for step in reply["steps"]])
        self.assertEqual(runs[0], runs[1])
        self.assertEqual(len(set(runs[0])), 5)

    def test_rejects_unsupported_cells(self):
        for broken in ({"objects": [{}]}, {"fixtures": []}, {"friction": 0.0}, {"robot": cell()["robot"] | {"tcp_site": "no"}}):
            _, reply = begun(cell() | broken)
            self.assertEqual(reply["error"]["kind"], "setup", reply)

    def test_requires_one_version(self):
        self.assertEqual(check(version()), "5.1.0-rc.19")
        for other in ("4.5.0", "5.0.0", "6.0.1", "newest"):
            with self.assertRaises(Problem):
                check(other)

    def test_rejects_unsupported_robots(self):
        with self.assertRaisesRegex(Problem, "expected a parallel gripper"):
            Robot.read(FOLDER.parent / "ur5e")
        with self.assertRaisesRegex(Problem, "robot.toml"):
            Robot.read(HERE)


if __name__ == "__main__":
    unittest.main()
