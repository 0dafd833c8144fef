"""The server's claims: it answers everything, believes nothing, and passes on only what keeps the protocol."""

import math
import random
import sys
import unittest
from pathlib import Path

import msgpack

sys.path.insert(0, str(Path(__file__).resolve().parent))

from robogate_bridge import Contact, Fingers, Problem, Server, Servo, codec
from robogate_bridge.server import loopback
from toy import Gantry, Still

CELL = {
    "control_period_s": 0.05,
    "gravity_m_s2": 9.81,
    "friction": 0.8,
    "table_friction": 0.8,
    "contact": {
        "patch_radius_m": 0.006,
        "rolling_m": 0.0004,
        "time_constant_s": 0.005,
        "impedance": [0.9, 0.95, 0.002],
        "limit_impedance": [0.98, 0.99, 0.001],
        "driven_mass_kg": 500.0,
    },
    "object": {
        "parts": [{"primitive": {"kind": "sphere", "radius": 0.02}, "pose": None}],
        "pose": {"position": [0.5, 0.0, 0.02], "orientation": [1.0, 0.0, 0.0, 0.0]},
        "mass_kg": 0.3,
        "centre_of_mass": [0.0, 0.0, 0.0],
    },
    "fixtures": [],
    "robot": {
        "home_rad": [0.0],
        "position_limit_rad": [[-1.0, 1.0]],
        "velocity_limit_rad_s": [2.0],
        "acceleration_limit_rad_s2": [10.0],
    },
}


def ask(server, op, episode=7, **fields):
    frames = server.answer([codec.encode({"v": 1, "op": op, "episode": episode, **fields})])
    return codec.decode(frames[0]) | {"frames": frames[1:]}


def begun(simulator=None, **fields):
    server = Server(simulator or Gantry())
    reply = ask(server, "reset", index=0, seed=1, parameters={}, **fields)
    assert reply["ok"], reply
    return server


class TheContact(unittest.TestCase):
    def test_is_read_from_the_cell(self):
        contact = Contact.of(CELL)
        self.assertEqual(contact.rolling_m, 0.0004)
        self.assertEqual(contact.impedance, [0.9, 0.95, 0.002])
        self.assertAlmostEqual(contact.torsional(0.5), 0.002)

    def test_is_required(self):
        with self.assertRaises(KeyError):
            Contact.of({"contact": {"patch_radius_m": 0.005}})


class TheServer(unittest.TestCase):
    def refuses(self, reply, kind):
        self.assertFalse(reply["ok"], reply)
        self.assertEqual(reply["error"]["kind"], kind, reply)

    def test_carries_an_episode_to_its_end_and_no_further(self):
        server = Server(Gantry())
        reply = ask(server, "reset", index=3, seed=1, parameters={"offset_x_m": 0.01, "mass_kg": 1})
        self.assertEqual(reply["applied"]["mass_kg"], 1.0)
        position = reply["observation"]["tool_pose"]["position"]
        self.assertEqual(position, Gantry.START)
        to_object = [0.51, 0.0, 0.025, -1.0]
        actions = [to_object, to_object[:3] + [1.0], [0.4, 0.4, 0.1, 1.0], [0.4, 0.4, 0.1, -1.0], [0.0] * 4]
        reply = ask(server, "step", tick=0, action_space="joint_position", actions=actions)
        self.assertEqual(len(reply["steps"]), 4)
        self.assertEqual(reply["steps"][-1]["ending"], {"failure": None, "time_s": 0.2, "contact": None})
        self.refuses(ask(server, "step", tick=4, action_space="joint_position", actions=[[0.0] * 4]), "bad_request")

    def test_cuts_tool_deltas_to_one_and_scales_them(self):
        server = begun()
        reply = ask(server, "step", tick=0, action_space="tool_delta", actions=[[0.5, -9.0, 0, 0, 0, 0, -1]])
        x, y, z = reply["steps"][0]["observation"]["tool_pose"]["position"]
        self.assertAlmostEqual(x, 0.51)
        self.assertAlmostEqual(y, -0.02)
        self.assertAlmostEqual(z, 0.3)

    def test_answers_for_the_episode_and_tick_under_way_alone(self):
        server = begun()
        action = {"action_space": "joint_position", "actions": [[0.5, 0, 0.3, -1]]}
        self.refuses(ask(server, "step", episode=8, tick=0, **action), "bad_request")
        self.refuses(ask(server, "step", tick=1, **action), "bad_request")
        self.assertTrue(ask(server, "step", tick=0, **action)["ok"])
        self.refuses(ask(server, "step", tick=0, **action), "bad_request")
        self.assertTrue(ask(server, "close")["ok"])
        self.refuses(ask(server, "hash"), "bad_request")

    def test_refuses_actions_and_parameters_that_are_none(self):
        server = begun()
        for space, action in [
            ("joint_position", [0.0] * 3),
            ("joint_position", ["0"] * 4),
            ("tool_delta", [0.0] * 8),
            ("tool_delta", [True] * 7),
        ]:
            self.refuses(ask(server, "step", tick=0, action_space=space, actions=[action]), "bad_action")
        nan = msgpack.packb({"v": 1, "op": "step", "episode": 7, "actions": [[math.nan]]})
        self.refuses(codec.decode(server.answer([nan])[0]), "bad_request")
        self.refuses(ask(server, "reset", index=0, seed=0, parameters={"friction": 1.0}), "not_applied")
        self.refuses(ask(server, "reset", index=0, seed=0, parameters={"mass_kg": 0.0}), "setup")
        self.refuses(ask(server, "reset", index=-1, seed=0, parameters={}), "bad_request")

    def test_shows_pictures_of_the_size_that_it_said(self):
        reply = ask(begun(), "render")
        self.assertEqual(reply["images"], [{"camera": "front", "width": 256, "height": 256, "frame": 1}])
        self.assertEqual([len(frame) for frame in reply["frames"]], [3 * 256 * 256])
        self.refuses(ask(begun(), "render", cameras=["behind"]), "bad_request")

    def test_passes_on_no_answer_that_breaks_the_protocol(self):
        lies = {
            "diverged": lambda o: o["joint_positions"].__setitem__(1, math.nan),
            "internal": lambda o: o["joint_positions"].append(0.0),
        }
        for kind, lie in lies.items():

            class Liar(Gantry):
                def observation(self):
                    o = super().observation() | {"joint_positions": list(self.hand)}
                    if self.ticks == 1:
                        lie(o)
                    return o

            server = begun(Liar())
            reply = ask(server, "step", tick=0, action_space="tool_delta", actions=[[0.0] * 7])
            self.refuses(reply, kind)
            self.refuses(ask(server, "hash"), "bad_request")
            self.assertTrue(ask(server, "reset", index=0, seed=1, parameters={})["ok"])

    def test_reports_every_time_step_where_it_does_not_judge(self):
        server = begun(Still(), cell=CELL)
        reply = ask(server, "step", tick=0, action_space="joint_position", actions=[[0.01, 1.0], [0.01, 1.0]])
        self.assertEqual([len(step["sights"]) for step in reply["steps"]], [5, 5])
        self.refuses(ask(server, "reset", index=0, seed=1, parameters={}), "bad_request")

    def test_answers_whatever_it_is_sent(self):
        server = begun()
        stream = random.Random(1)
        whole = codec.encode({"v": 1, "op": "step", "episode": 7, "tick": 0, "action_space": "tool_delta",
                              "actions": [[0.0] * 7]})
        for _ in range(20_000):
            data = bytearray(whole)
            for _ in range(stream.randrange(1, 4)):
                data[stream.randrange(len(data))] = stream.randrange(256)
            reply = codec.decode(server.answer([bytes(data[: stream.randrange(len(data) + 1)])])[0])
            if reply["ok"]:
                server = begun()
        deep = b"\x91" * 5000 + b"\x90"
        for data in (b"", deep, b"\x81\xa1v" + deep, b"\xdf\xff\xff\xff\xff", bytes(codec.MAX_HEADER + 1)):
            self.refuses(codec.decode(server.answer([data])[0]), "bad_request")
        self.refuses(codec.decode(server.answer([whole, b""])[0]), "bad_request")

    def test_knows_which_addresses_others_reach(self):
        for address in ("tcp://127.0.0.1:5570", "tcp://localhost:1", "tcp://[::1]:*"):
            self.assertTrue(loopback(address), address)
        for address in ("tcp://0.0.0.0:1", "tcp://*:1", "tcp://eth0:1", "tcp://192.168.1.2:1"):
            self.assertFalse(loopback(address), address)

    def test_knows_its_kinds_of_problem(self):
        with self.assertRaises(ValueError):
            Problem("oops", "")


class TheServo(unittest.TestCase):
    """Against the closed form: a spline of control points 0, 0, p at share 1 is half way, at speed p / period."""

    robot = CELL["robot"]

    def test_trails_a_command_by_half_a_period(self):
        servo = Servo(self.robot, 0.05)
        servo.command([0.02])
        (q,), (v,) = servo.targets(1.0)
        self.assertAlmostEqual(q, 0.01)
        self.assertAlmostEqual(v, 0.4)
        servo.command([0.02])
        (q,), (v,) = servo.targets(1.0)
        self.assertAlmostEqual(q, 0.02)
        self.assertAlmostEqual(v, 0.0)

    def test_keeps_acceleration_speed_and_range(self):
        servo = Servo(self.robot, 0.05)
        last, before = 0.0, 0.0
        for _ in range(60):
            servo.command([9.0])
            (q,), _ = servo.targets(1.0)
            self.assertLessEqual(q - last, 2.0 * 0.05 + 1e-12)
            self.assertLessEqual(q - 2 * last + before, 10.0 * 0.05**2 + 1e-12)
            last, before = q, last
        self.assertAlmostEqual(last, 1.0)

    def test_fingers_press_with_the_grip_force(self):
        jaw = {"opening_m": 0.08, "force_n": 40.0, "stiffness_n_m": 2000.0, "finger_speed_m_s": 0.05}
        fingers = Fingers(jaw, 0.002)
        for _ in range(2000):
            target = fingers.target(True, 0.05)
        self.assertAlmostEqual((0.025 - target) * 2000.0, 40.0)
        for _ in range(2000):
            target = fingers.target(False, 0.08)
        self.assertAlmostEqual(target, 0.04)


if __name__ == "__main__":
    unittest.main()
