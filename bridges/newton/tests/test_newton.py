"""Tests of physics and server. References: Coulomb's law, free fall, MuJoCo's kinematics.

Each test runs with both solvers.
"""

import json
import subprocess
import sys
import unittest
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import warp as wp

wp.config.log_level = wp.LOG_WARNING
sys.path.insert(0, str(Path(__file__).resolve().parent))

from hand import Chain, Hand  # noqa: E402
from robogate_bridge import Action, Client, Problem, Refused, Server, codec  # noqa: E402
from robogate_newton.example import UP, example_cell  # noqa: E402
from robogate_newton.robot import Robot  # noqa: E402
from robogate_newton.simulator import ENGINES, Newton  # noqa: E402

HERE = Path(__file__).resolve().parent
FOLDER = HERE.parents[2] / "assets" / "robots" / "franka"
FRANKA = Robot.read(FOLDER)
CHAIN = Chain(FRANKA)
SIMULATORS = {solver: Newton(FRANKA, solver) for solver in ENGINES}
G = 9.81


def fixture(kind, primitive, position, yaw=0.0, motion=None):
    turn = [np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)]
    return {"name": kind, "kind": kind, "primitive": primitive, "pose": {"position": position, "orientation": turn},
            "motion": motion}


def begun(solver, shape="box", fixtures=(), **values):
    return Hand(SIMULATORS[solver], CHAIN, example_cell(FRANKA, shape, fixtures=fixtures, **values))


class ThePhysics(unittest.TestCase):
    def test_lifts_every_primitive(self):
        for solver, shape in product(ENGINES, ("box", "cylinder", "sphere")):
            with self.subTest(solver=solver, shape=shape):
                hand = begun(solver, shape)
                hand.grasp()
                self.assertTrue(hand.sight["object_on_fixture"])
                hand.lift()
                self.assertGreater(hand.object[2], 0.19)
                self.assertFalse(hand.sight["object_on_fixture"])
                for force in hand.sight["fingers"]:
                    self.assertAlmostEqual(force, 30.0, delta=0.3)
                self.assertAlmostEqual(hand.sight["opening_m"], 0.05, delta=5e-4)

    def test_grip_follows_coulombs_law(self):
        # 2 mu F carries m (g + a). The acceleration of the lift is at most 1.02 m/s^2: 0.175 m, from rest to rest, in 1 s.
        mass, force = 0.5, 15.0
        law = mass * G / (2.0 * force)
        for solver, share in product(ENGINES, (0.95, 1.15)):
            with self.subTest(solver=solver, share=share):
                hand = begun(solver, mass_kg=mass, friction=share * law, force_n=force)
                hand.grasp()
                hand.lift()
                self.assertEqual(hand.object[2] > 0.19, share > 1.0, hand.object)

    def test_pads_have_their_own_friction(self):
        # As above, with the friction of the pads only: the object has another coefficient.
        mass, force = 0.5, 15.0
        law = mass * G / (2.0 * force)
        for solver, (pads, other, holds) in product(ENGINES, ((1.3, 0.5, True), (0.7, 2.0, False))):
            with self.subTest(solver=solver, pads=pads):
                cell = example_cell(FRANKA, mass_kg=mass, friction=other * law, force_n=force)
                cell["robot"]["gripper"]["pad_friction"] = pads * law
                hand = Hand(SIMULATORS[solver], CHAIN, cell)
                hand.grasp()
                hand.lift()
                self.assertEqual(hand.object[2] > 0.19, holds, hand.object)

    def test_stacks_carry_their_weight(self):
        # Three cubes stand on each other, and a fourth one beside them. The gripper may act on any of them.
        for solver in ENGINES:
            with self.subTest(solver=solver):
                cell = example_cell(FRANKA, at=(0.5, 0.2), mass_kg=0.2)
                (first,) = cell["objects"]
                places = ([0.5, 0.2, 0.025], [0.505, 0.2, 0.075], [0.51, 0.2, 0.125], [0.5, -0.2, 0.025])
                cell["objects"] = [
                    first | {"name": f"object_{i}", "pose": {"position": list(place), "orientation": UP}}
                    for i, place in enumerate(places)
                ]
                hand = Hand(SIMULATORS[solver], CHAIN, cell)
                self.assertEqual(len(hand.start["readback"]["objects"]), 4)
                hand.wait(1.0)
                for index in range(4):
                    action = Action("joint_position", list(hand.joints), -1.0, index)
                    sight = hand.simulator.step(action)["sights"][-1]
                    for state, place in zip(sight["objects"], places):
                        np.testing.assert_allclose(state["pose"]["position"], place, atol=1e-3)
                    # The force of what is below minus that of what is above is the weight.
                    np.testing.assert_allclose(sight["support_n"], [0.0, 0.0, 0.2 * G], atol=0.1)
                    self.assertTrue(sight["object_on_fixture"])
                    self.assertEqual((sight["object"], sight["fingers"]), (index, [None, None]))

    def test_free_fall(self):
        # The solvers' integrators give h - g t (t + dt) / 2.
        for solver, gravity in product(ENGINES, (9.81, 3.7)):
            with self.subTest(solver=solver, gravity=gravity):
                cell = example_cell(FRANKA, at=(0.6, 0.3)) | {"gravity_m_s2": gravity}
                cell["objects"][0]["pose"]["position"][2] = 1.0
                hand = Hand(SIMULATORS[solver], CHAIN, cell)
                hand.wait(0.3)
                fallen = 0.5 * gravity * 0.3 * (0.3 + SIMULATORS[solver].hello()["time_step_s"])
                self.assertAlmostEqual(hand.object[2], 1.0 - fallen, delta=2e-5)
                self.assertAlmostEqual(hand.sight["objects"][0]["linear_m_s"][2], -gravity * 0.3, delta=1e-4)

    def test_kinematics_match_mujoco(self):
        for solver in ENGINES:
            with self.subTest(solver=solver):
                hand = begun(solver)
                hand.go([0.45, 0.2, 0.3], 1.0)
                hand.wait(0.5)
                at, turn = CHAIN.tool(hand.observation["vectors"]["joint_positions"])
                pose = hand.observation["vectors"]["tool_pose"]
                np.testing.assert_allclose(pose[:3], at, atol=2e-6)
                w, x, y, z = pose[3:]
                np.testing.assert_allclose(
                    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], turn[:, 0], atol=5e-6
                )
                # The drives move the arm to its commanded position.
                np.testing.assert_allclose(hand.observation["vectors"]["joint_positions"], hand.joints, atol=1e-3)

    def test_reads_back_requested_values(self):
        motion = {"velocity_m_s": [0.0, 0.2, 0.0], "starts_s": 0.5, "ends_s": 2.0}
        more = [
            fixture("obstacle", {"kind": "cylinder", "radius": 0.02, "half_height": 0.06}, [0.6, 0.21, 0.06], 0.3),
            fixture("obstacle", {"kind": "box", "half": [0.02, 0.02, 0.05]}, [0.3, -0.2, 0.05], 1.1),
            fixture("disturbance", {"kind": "box", "half": [0.03, 0.03, 0.04]}, [0.5, -0.5, 0.041], 0.7, motion),
        ]
        cell = example_cell(FRANKA, mass_kg=0.123, friction=0.37, at=(0.47, 0.05), fixtures=more)
        cell |= {"gravity_m_s2": 6.0, "table_friction": 0.11}
        cell["robot"]["gripper"]["pad_friction"] = 0.52
        (thing,) = cell["objects"]
        thing["centre_of_mass"] = [0.004, 0.0, -0.003]
        thing["parts"] = [
            {"primitive": {"kind": "box", "half": [0.03, 0.02, 0.01]}, "pose": {"position": [0, 0, -0.015],
                                                                            "orientation": UP}},
            {"primitive": {"kind": "sphere", "radius": 0.011}, "pose": {"position": [0.01, 0, 0.01], "orientation": UP}},
        ]  # fmt: skip
        for solver in ENGINES:
            with self.subTest(solver=solver):
                read = Hand(SIMULATORS[solver], CHAIN, cell).start["readback"]
                for key in ("friction", "table_friction", "gravity_m_s2"):
                    self.assertAlmostEqual(read[key], cell[key], delta=1e-6 * cell[key], msg=key)
                self.assertAlmostEqual(read["pad_friction"], 0.52, delta=1e-6)
                self.assertAlmostEqual(read["grip_force_n"], 30.0, delta=1e-4)
                np.testing.assert_allclose(read["stiffness_nm_rad"], cell["robot"]["stiffness_nm_rad"], rtol=1e-6)
                (held,) = read["objects"]
                self.assertAlmostEqual(held["mass_kg"], 0.123, delta=1e-7)
                np.testing.assert_allclose(held["centre_of_mass"], thing["centre_of_mass"], atol=1e-8)
                self.assertSame(held["pose"], thing["pose"])
                self.assertEqual(len(held["parts"]), 2)
                for got, part in zip(held["parts"], thing["parts"]):
                    self.assertSame(got, part["primitive"])
                self.assertEqual([one["fixture"] for one in read["fixtures"]], [0, 1, 2, 3])
                for got, want in zip(read["fixtures"], cell["fixtures"]):
                    self.assertSame(got["primitive"], want["primitive"])
                    self.assertSame(got["pose"], want["pose"])
                    self.assertEqual(got["motion"], want["motion"])

    def assertSame(self, got, want):
        """Checks for equal keys and strings, and for numbers that are equal in single precision."""
        self.assertEqual(got.keys(), want.keys())
        for key, value in want.items():
            if isinstance(value, str):
                self.assertEqual(got[key], value)
            else:
                np.testing.assert_allclose(got[key], value, atol=1e-7, err_msg=key)

    def test_mujoco_has_robogates_settings(self):
        hand = begun("mujoco", "cylinder", friction=0.3)
        model = hand.simulator._engine._model
        self.assertEqual((model.opt.impratio, model.opt.cone, model.opt.integrator, model.opt.disableflags),
                         (10.0, mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 0))  # fmt: skip
        thing = model.ngeom - 1
        self.assertEqual((model.geom_condim[thing], model.geom_priority[thing]), (4, 1))
        np.testing.assert_allclose(model.geom_solref[thing], [0.004, 1.0])
        np.testing.assert_allclose(model.geom_solimp[thing], [0.95, 0.99, 0.001, 0.5, 2.0], rtol=1e-6)
        np.testing.assert_allclose(model.geom_friction[thing], [0.3, 0.001, 5e-4], rtol=1e-6)
        np.testing.assert_allclose(model.jnt_solref[:9], [[0.004, 1.0]] * 9)
        np.testing.assert_allclose(model.eq_solref, [[0.004, 1.0]])
        np.testing.assert_allclose(model.dof_armature[:9], [0.1] * 7 + [0.5] * 2)
        np.testing.assert_allclose(model.body_gravcomp[1:12], 1.0)

    def test_contact_constants_come_from_the_cell(self):
        contact = {
            "patch_radius_m": 9e-3,
            "rolling_m": 2e-4,
            "time_constant_s": 6e-3,
            "impedance": [0.9, 0.98, 0.002],
            "limit_impedance": [0.97, 0.99, 2e-4],
            "driven_mass_kg": 200.0,
        }
        motion = {"velocity_m_s": [0.0, 0.2, 0.0], "starts_s": 0.2, "ends_s": 1.2}
        pusher = fixture("disturbance", {"kind": "box", "half": [0.03, 0.03, 0.04]}, [0.5, -0.3, 0.041], 0.0, motion)
        cell = example_cell(FRANKA, "cylinder", friction=0.3, fixtures=[pusher]) | {"contact": contact}
        model = Hand(SIMULATORS["mujoco"], CHAIN, cell).simulator._engine._model
        thing = model.ngeom - 1
        np.testing.assert_allclose(model.geom_friction[thing], [0.3, 0.0018, 2e-4], rtol=1e-6)
        np.testing.assert_allclose(model.geom_solref[thing], [0.006, 1.0], rtol=1e-6)
        np.testing.assert_allclose(model.geom_solimp[thing], [0.9, 0.98, 0.002, 0.5, 2.0], rtol=1e-6)
        np.testing.assert_allclose(model.jnt_solref[:9], [[0.006, 1.0]] * 9, rtol=1e-6)
        np.testing.assert_allclose(model.jnt_solimp[:9], [[0.97, 0.99, 2e-4, 0.5, 2.0]] * 9, rtol=1e-6)
        self.assertAlmostEqual(max(model.body_mass), 200.0, places=3)

    def test_driven_fixtures_push_the_object(self):
        motion = {"velocity_m_s": [0.0, 0.2, 0.0], "starts_s": 0.2, "ends_s": 1.2}
        pusher = fixture("disturbance", {"kind": "box", "half": [0.03, 0.03, 0.04]}, [0.5, -0.1, 0.041], 0.0, motion)
        for solver in ENGINES:
            with self.subTest(solver=solver):
                hand = begun(solver, fixtures=[pusher])
                hand.wait(1.5)
                # It ends with its front at y = -0.1 + 0.2 + 0.03, with the box of 5 cm in front of it.
                # MuJoCo's soft contact pushes it farther, see README.md.
                delta = {"mujoco": 0.03, "steel": 3e-3}[solver]
                self.assertAlmostEqual(hand.object[1], 0.13 + 0.025, delta=delta)
                self.assertLess(abs(hand.object[0] - 0.5), 5e-3)

    def test_sliding_stops_by_coulombs_law(self):
        # Released at 0.3 m/s, the object slides v^2 / (2 mu g) further. The table has its own friction.
        motion = {"velocity_m_s": [0.0, 0.3, 0.0], "starts_s": 0.1, "ends_s": 0.6}
        pusher = fixture("disturbance", {"kind": "box", "half": [0.03, 0.03, 0.04]}, [0.5, -0.11, 0.041], 0.0, motion)
        for solver, (friction, on_table) in product(ENGINES, ((0.8, 0.1), (0.2, 0.6))):
            with self.subTest(solver=solver, friction=friction, on_table=on_table):
                cell = example_cell(FRANKA, friction=friction, fixtures=[pusher]) | {"table_friction": on_table}
                hand = Hand(SIMULATORS[solver], CHAIN, cell)
                hand.wait(1.3)
                slid = hand.object[1] - (-0.11 + 0.5 * 0.3 + 0.03 + 0.025)
                delta = {"mujoco": 2.5e-3, "steel": 1e-3}[solver]
                self.assertAlmostEqual(slid, 0.3**2 / (2.0 * on_table * G), delta=delta)

    def test_rolling_balls_come_to_rest(self):
        # At 0.2 m/s, rolling friction of 0.5 mm stops a ball with a radius of 2.5 cm. The deceleration is 5/7 of g times
        # 0.5 mm over the radius, 0.14 m/s^2, so it rolls 14 cm in 1.4 s.
        motion = {"velocity_m_s": [0.0, 0.2, 0.0], "starts_s": 0.0, "ends_s": 0.3}
        pusher = fixture("disturbance", {"kind": "box", "half": [0.03, 0.03, 0.04]}, [0.5, -0.09, 0.041], 0.0, motion)
        for solver in ENGINES:
            with self.subTest(solver=solver):
                hand = begun(solver, "sphere", fixtures=[pusher])
                hand.wait(3.0)
                self.assertGreater(hand.object[1], 0.03)
                self.assertLess(np.linalg.norm(hand.sight["objects"][0]["linear_m_s"]), 0.005)

    def test_names_the_collision(self):
        wall = fixture("obstacle", {"kind": "box", "half": [0.03, 0.03, 0.1]}, [0.5, 0.2, 0.1])
        for solver in ENGINES:
            with self.subTest(solver=solver):
                hand = begun(solver, at=(0.6, -0.2), fixtures=[wall])
                hand.go([0.5, 0.0, 0.15], 1.0)
                free = hand.steps[-1]["clearance_m"]
                self.assertIsNotNone(free)
                # The hand is 20.4 cm wide across the finger motion, at 3 to 9 cm above the tool: its side is at y = 0.102.
                self.assertAlmostEqual(free, 0.17 - 0.102, delta=0.005)
                self.assertTrue(all(sight["collision"] is None for step in hand.steps for sight in step["sights"]))
                hand.go([0.5, 0.1, 0.15], 1.0)
                hits = [sight["collision"] for step in hand.steps for sight in step["sights"] if sight["collision"]]
                self.assertEqual({(hit["robot_body"], hit["fixture"]) for hit in hits}, {("hand", 1)})
                self.assertGreater(max(hit["force_n"] for hit in hits), 1.0)
                self.assertEqual(hand.steps[-1]["clearance_m"], 0.0)

    def test_reports_contact_at_the_start(self):
        at = CHAIN.tool(example_cell(FRANKA)["robot"]["home_rad"])[0].tolist()
        block = fixture("obstacle", {"kind": "box", "half": [0.05, 0.05, 0.05]}, at)
        for solver in ENGINES:
            with self.subTest(solver=solver):
                self.assertIsNotNone(begun(solver, fixtures=[block]).start["sight"]["collision"])
                sight = begun(solver).start["sight"]
                self.assertEqual((sight["collision"], sight["fingers"]), (None, [None, None]))

    def test_hashes_do_not_depend_on_history(self):
        for solver in ENGINES:
            with self.subTest(solver=solver):
                hashes = []
                for shape in ("box", "sphere", "box"):
                    hand = begun(solver, shape)
                    hand.grasp(0.03)
                    hashes.append([step["state_hash"] for step in hand.steps])
                self.assertEqual(hashes[0], hashes[2])
                self.assertNotEqual(hashes[0][-1], hashes[1][-1])


class TheServer(unittest.TestCase):
    def test_serves_over_a_socket(self):
        for solver in ENGINES:
            with self.subTest(solver=solver):
                self.drive(solver)

    def drive(self, solver):
        command = [HERE.parent / "start.sh", "--solver", solver, "--port", "0"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            try:
                # The first line on standard output is the address.
                address = json.loads(server.stdout.readline())["listening"]
                with Client(address, timeout_s=60.0) as client:
                    hello = client.hello()
                    self.assertEqual(hello["engine"]["name"], "newton")
                    self.assertIn(solver, hello["engine"]["solver"])
                    self.assertEqual(hello["robot"]["sha256"], FRANKA.sha256)
                    cell = example_cell(FRANKA)
                    home = cell["robot"]["home_rad"]
                    for broken in ({}, cell | {"objects": [{}]}, cell | {"fixtures": []}):
                        with self.assertRaises(Refused) as refused:
                            client.reset(cell=broken | {"control_period_s": 0.05})
                        self.assertEqual(refused.exception.kind, "setup")
                    client.reset(cell=cell)
                    here = begun(solver)
                    for steps in (client.step([[*home, -1.0]], "joint_position"),
                                  client.step([[*home, 1.0]] * 3, "joint_position")):  # fmt: skip
                        self.assertEqual(len(steps[-1]["sights"]), round(0.05 / hello["time_step_s"]))
                    here.run()
                    here.closed = True
                    here.wait(0.15)
                    # Another process gives identical results.
                    self.assertEqual(client.state_hash(), here.steps[-1]["state_hash"])
            finally:
                server.terminate()
                server.wait(30)

    def test_rejects_unsupported_robots(self):
        with self.assertRaisesRegex(Problem, "expected a parallel gripper"):
            Robot.read(FOLDER.parent / "ur5e")
        with self.assertRaisesRegex(Problem, "robot.toml"):
            Robot.read(HERE)

    def test_reports_divergence(self):
        cell = example_cell(FRANKA) | {"gravity_m_s2": 1e37}
        home = cell["robot"]["home_rad"]
        for solver in ENGINES:
            with self.subTest(solver=solver):
                server = Server(SIMULATORS[solver])

                def ask(op, server=server, **fields):
                    request = codec.encode({"v": codec.VERSION, "op": op, "episode": 1, **fields})
                    return codec.decode(server.answer([request])[0])

                self.assertTrue(ask("reset", index=0, seed=0, parameters={}, cell=cell)["ok"])
                reply = ask("step", tick=0, action_space="joint_position", actions=[[*home, -1.0]] * 20)
                self.assertEqual(reply["error"]["kind"], "diverged")


if __name__ == "__main__":
    unittest.main()
