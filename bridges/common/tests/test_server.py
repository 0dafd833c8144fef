"""Tests of the server: it answers every request, checks everything, and sends only valid replies."""

import importlib.util
import json
import math
import os
import random
import subprocess
import sys
import unittest
from array import array
from pathlib import Path

import msgpack

sys.path.insert(0, str(Path(__file__).resolve().parent))

from robogate_bridge import Client, Contact, Fingers, Part, Problem, Server, Servo, Touches, codec
from robogate_bridge.server import loopback
from toy import Gantry, Still, Tank

ROOT = Path(__file__).resolve().parents[3]

CELL = {
    "control_period_s": 0.05,
    "gravity_m_s2": 9.81,
    "friction": 0.8,
    "table_friction": None,
    "contact": {
        "patch_radius_m": 0.006,
        "rolling_m": 0.0004,
        "time_constant_s": 0.005,
        "impedance": [0.9, 0.95, 0.002],
        "limit_impedance": [0.98, 0.99, 0.001],
        "driven_mass_kg": 500.0,
    },
    "objects": [
        {
            "name": name,
            "parts": [{"primitive": {"kind": "sphere", "radius": 0.02}, "pose": None}],
            "pose": {"position": [0.5, y, 0.02], "orientation": [1.0, 0.0, 0.0, 0.0]},
            "mass_kg": 0.3,
            "centre_of_mass": [0.0, 0.0, 0.0],
        }
        for name, y in (("a", 0.0), ("b", 0.1))
    ],
    "fixtures": [],
    "robot": {
        "stiffness_nm_rad": [100.0],
        "home_rad": [0.0],
        "position_limit_rad": [[-1.0, 1.0]],
        "velocity_limit_rad_s": [2.0],
        "acceleration_limit_rad_s2": [10.0],
    },
}


def ask(server, op, episode=7, **fields):
    frames = server.answer([codec.encode({"v": codec.VERSION, "op": op, "episode": episode, **fields})])
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


class TheTouches(unittest.TestCase):
    """Object 0 lies on fixture 3 and carries object 1, which both fingers and the hand touch."""

    def touches(self):
        touches = Touches(3)
        below, above = Part("object", index=0), Part("object", index=1)
        left, hand = Part("robot", "left", finger=0), Part("robot", "hand")
        table = Part("fixture", index=3)
        touches.add(table, below, 5.0, (0.0, 0.0, -5.0))
        touches.add(below, table, 3.0, (0.5, 0.0, 3.0))
        touches.add(above, below, 2.0, (0.0, 0.0, 2.0))
        touches.add(left, above, 10.0, (0.0, 10.0, 0.0))
        touches.add(above, left, 5.0)
        touches.add(above, Part("robot", "right", finger=1), 12.0)
        touches.add(hand, above, 1.0)
        touches.add(hand, table, 4.0)
        for one, two in ((table, Part("fixture", index=0)), (left, hand), (None, above), (above, above)):
            touches.add(one, two, 99.0)
        return touches

    def test_sum_by_object(self):
        below, above, alone = (self.touches().sight(index) for index in range(3))
        self.assertEqual((below["fingers"], below["body_on_object"], below["object_on_fixture"]), ([None, None], False, True))
        # The weight of the upper object acts on the lower one.
        self.assertEqual(below["support_n"], [0.5, 0.0, 6.0])
        self.assertEqual((above["fingers"], above["body_on_object"], above["object_on_fixture"]), ([15.0, 12.0], True, True))
        self.assertEqual(above["support_n"], [0.0, 0.0, 2.0])
        self.assertEqual((alone["fingers"], alone["object_on_fixture"]), ([None, None], False))
        self.assertEqual(self.touches().on_object_n, [10.0, 30.0, 0.0])

    def test_share_collision_and_peak(self):
        for index in range(3):
            sight = self.touches().sight(index)
            self.assertEqual(sight["collision"], {"robot_body": "hand", "fixture": 3, "force_n": 4.0})
            self.assertEqual((sight["peak_force_n"], sight["object"]), (15.0, index))


class Proposing(Tank):
    """Proposes to open the inlet by half, and the outlet by a number that is not finite if the tank leaks."""

    def hello(self):
        return super().hello() | {"policies": [{"name": "half", "meaning": "opens by half", "version": "2"}, "none"]}

    def reset(self, scenario):
        self.proposing = scenario.policy == "half"
        return super().reset(scenario) | self.proposal()

    def step(self, action):
        return super().step(action) | self.proposal()

    def proposal(self):
        outlet = float("nan") if self.values["leaks"] else 0.25
        return {"proposed": {"action_space": "vector", "action": [0.5, outlet]}} if self.proposing else {}


class ThePolicies(unittest.TestCase):
    def begun(self, **fields):
        server = Server(Proposing())
        return server, ask(server, "reset", index=0, seed=1, parameters={"goal_m": 0.5}, **fields)

    def test_are_declared(self):
        hello = ask(Server(Proposing()), "hello", episode=0)
        expected = [{"name": "half", "meaning": "opens by half", "version": "2"}, {"name": "none", "meaning": "", "version": ""}]
        self.assertEqual(hello["policies"], expected)

    def test_propose_each_action(self):
        server, reply = self.begun(policy="half")
        expected = {"action_space": "vector", "action": [0.5, 0.25]}
        self.assertEqual(reply["proposed"], expected)
        reply = ask(server, "step", tick=0, action_space="vector", actions=[[0.5, 0.25]])
        self.assertEqual(reply["steps"][0]["proposed"], expected)

    def test_are_silent_unless_requested(self):
        server, reply = self.begun()
        self.assertNotIn("proposed", reply)
        reply = ask(server, "step", tick=0, action_space="vector", actions=[[0.5, 0.25]])
        self.assertNotIn("proposed", reply["steps"][0])

    def test_must_be_declared(self):
        _, reply = self.begun(policy="full")
        self.assertEqual(reply["error"]["kind"], "setup")
        self.assertIn("half", reply["error"]["detail"])

    def test_must_keep_their_promise(self):
        _, reply = self.begun(policy="none")
        self.assertEqual(reply["error"]["kind"], "internal")
        self.assertIn("proposed", reply["error"]["detail"])

    def test_must_be_finite(self):
        server = Server(Proposing())
        reply = ask(server, "reset", index=0, seed=1, parameters={"goal_m": 0.5, "leaks": 1}, policy="half")
        self.assertEqual(reply["error"]["kind"], "bad_action")

    def test_run_ahead_as_far_as_requested(self):
        server, _ = self.begun(policy="half")
        ahead = ask(server, "step", tick=0, action_space="vector", actions=[[0.5, 0.25]], ahead=5)["steps"]
        other, _ = self.begun(policy="half")
        single = [ask(other, "step", tick=tick, action_space="vector", actions=[[0.5, 0.25]])["steps"][0] for tick in range(6)]
        self.assertEqual(ahead, single)
        self.assertTrue(ask(server, "step", tick=6, action_space="vector", actions=[[0.5, 0.25]])["ok"])

    def test_run_ahead_to_the_end_of_the_episode(self):
        server, _ = self.begun(policy="half")
        steps = ask(server, "step", tick=0, action_space="vector", actions=[[0.5, 0.25]], ahead=256)["steps"]
        while steps[-1]["ending"] is None:
            steps += ask(server, "step", tick=len(steps), action_space="vector", actions=[[0.5, 0.25]], ahead=256)["steps"]
        self.assertTrue(all(step["ending"] is None for step in steps[:-1]))
        self.assertEqual(ask(server, "step", tick=len(steps), action_space="vector", actions=[[0.5, 0.25]])["error"]["kind"], "bad_request")

    def test_run_ahead_only_with_a_policy(self):
        server, _ = self.begun()
        self.assertEqual(len(ask(server, "step", tick=0, action_space="vector", actions=[[0.5, 0.25]], ahead=5)["steps"]), 1)

    def test_report_an_error_ahead_when_the_client_gets_there(self):
        server, _ = self.begun(policy="half")
        simulator, step, calls = server._simulator, server._simulator.step, []

        def third_fails(action):
            calls.append(action)
            if len(calls) == 3:
                raise Problem("diverged", "the water is gone")
            return step(action)

        simulator.step = third_fails
        reply = ask(server, "step", tick=0, action_space="vector", actions=[[0.5, 0.25]], ahead=5)
        self.assertEqual(len(reply["steps"]), 2)
        reply = ask(server, "step", tick=2, action_space="vector", actions=[[0.5, 0.25]], ahead=5)
        self.assertEqual(reply["error"], {"kind": "diverged", "detail": "the water is gone"})

    def test_report_a_number_ahead_that_is_not_finite(self):
        server, _ = self.begun(policy="half")
        simulator, step, calls = server._simulator, server._simulator.step, []

        def third_is_nan(action):
            calls.append(action)
            answer = step(action)
            if len(calls) == 3:
                answer["observation"]["vectors"]["levels"][0] = float("nan")
            return answer

        simulator.step = third_is_nan
        reply = ask(server, "step", tick=0, action_space="vector", actions=[[0.5, 0.25]], ahead=5)
        self.assertEqual(len(reply["steps"]), 2)
        reply = ask(server, "step", tick=2, action_space="vector", actions=[[0.5, 0.25]], ahead=5)
        self.assertEqual(reply["error"]["kind"], "diverged")

    def test_run_ahead_with_views_of_their_memory(self):
        def episode(as_view):
            server, _ = self.begun(policy="half")
            simulator, step, memory = server._simulator, server._simulator.step, array("d", [0.0, 0.0])

            def viewed(action):
                answer = step(action)
                memory[:] = array("d", answer["observation"]["vectors"]["levels"])
                answer["observation"]["vectors"]["levels"] = memory
                return answer

            if as_view:
                simulator.step = viewed
            return ask(server, "step", tick=0, action_space="vector", actions=[[0.5, 0.25]], ahead=5)["steps"]

        self.assertEqual(episode(True), episode(False))


class TheServer(unittest.TestCase):
    def rejects(self, reply, kind):
        self.assertFalse(reply["ok"], reply)
        self.assertEqual(reply["error"]["kind"], kind, reply)

    def test_endings_stop_the_episode(self):
        server = Server(Gantry())
        reply = ask(server, "reset", index=3, seed=1, parameters={"offset_x_m": 0.01, "mass_kg": 1})
        self.assertEqual(reply["applied"]["mass_kg"], 1.0)
        position = reply["observation"]["vectors"]["tool_pose"][:3]
        self.assertEqual(reply["instance"]["instruction"], "carry the box to the target")
        self.assertEqual(position, Gantry.START)
        to_object = [0.51, 0.0, 0.025, -1.0]
        actions = [to_object, to_object[:3] + [1.0], [0.4, 0.4, 0.1, 1.0], [0.4, 0.4, 0.1, -1.0], [0.0] * 4]
        reply = ask(server, "step", tick=0, action_space="joint_position", actions=actions)
        self.assertEqual(len(reply["steps"]), 4)
        self.assertEqual(reply["steps"][-1]["ending"], {"failure": None, "time_s": 0.2, "contact": None})
        self.rejects(ask(server, "step", tick=4, action_space="joint_position", actions=[[0.0] * 4]), "bad_request")

    def test_tool_deltas_are_clipped_and_scaled(self):
        server = begun()
        reply = ask(server, "step", tick=0, action_space="tool_delta", actions=[[0.5, -9.0, 0, 0, 0, 0, -1]])
        x, y, z = reply["steps"][0]["observation"]["vectors"]["tool_pose"][:3]
        self.assertAlmostEqual(x, 0.51)
        self.assertAlmostEqual(y, -0.02)
        self.assertAlmostEqual(z, 0.3)

    def test_other_episodes_and_ticks_are_rejected(self):
        server = begun()
        action = {"action_space": "joint_position", "actions": [[0.5, 0, 0.3, -1]]}
        self.rejects(ask(server, "step", episode=8, tick=0, **action), "bad_request")
        self.rejects(ask(server, "step", tick=1, **action), "bad_request")
        self.assertTrue(ask(server, "step", tick=0, **action)["ok"])
        self.rejects(ask(server, "step", tick=0, **action), "bad_request")
        self.assertTrue(ask(server, "close")["ok"])
        self.rejects(ask(server, "hash"), "bad_request")

    def test_invalid_actions_and_parameters_are_rejected(self):
        server = begun()
        for space, action in [
            ("joint_position", [0.0] * 3),
            ("joint_position", ["0"] * 4),
            ("tool_delta", [0.0] * 8),
            ("tool_delta", [True] * 7),
        ]:
            self.rejects(ask(server, "step", tick=0, action_space=space, actions=[action]), "bad_action")
        nan = msgpack.packb({"v": codec.VERSION, "op": "step", "episode": 7, "actions": [[math.nan]]})
        self.rejects(codec.decode(server.answer([nan])[0]), "bad_request")
        self.rejects(ask(server, "reset", index=0, seed=0, parameters={"friction": 1.0}), "not_applied")
        self.rejects(ask(server, "reset", index=0, seed=0, parameters={"mass_kg": 0.0}), "setup")
        self.rejects(ask(server, "reset", index=-1, seed=0, parameters={}), "bad_request")

    def test_images_have_the_declared_size(self):
        reply = ask(begun(), "render")
        self.assertEqual(reply["images"], [{"camera": "front", "width": 256, "height": 256, "frame": 1}])
        self.assertEqual([len(frame) for frame in reply["frames"]], [3 * 256 * 256])
        self.rejects(ask(begun(), "render", cameras=["behind"]), "bad_request")

    def test_invalid_replies_are_not_sent(self):
        changes = {
            "diverged": lambda joints: joints.__setitem__(1, math.nan),
            "internal": lambda joints: joints.append(0.0),
        }
        for kind, change in changes.items():

            class Broken(Gantry):
                def observation(self):
                    observation = super().observation()
                    if self.ticks == 1:
                        change(observation["vectors"]["joint_positions"])
                    return observation

            server = begun(Broken())
            reply = ask(server, "step", tick=0, action_space="tool_delta", actions=[[0.0] * 7])
            self.rejects(reply, kind)
            self.rejects(ask(server, "hash"), "bad_request")
            self.assertTrue(ask(server, "reset", index=0, seed=1, parameters={})["ok"])

    def test_physics_servers_report_every_time_step(self):
        server = begun(Still(), cell=CELL)
        reply = ask(server, "step", tick=0, action_space="joint_position", actions=[[0.01, 1.0], [0.01, 1.0]])
        self.assertEqual([len(step["sights"]) for step in reply["steps"]], [5, 5])
        self.assertEqual(len(reply["steps"][0]["sights"][0]["objects"]), 2)
        self.rejects(ask(server, "reset", index=0, seed=1, parameters={}), "bad_request")

    def test_clients_choose_the_object(self):
        server, action = begun(Still(), cell=CELL), {"action_space": "joint_position", "actions": [[0.01, 1.0]]}
        chosen = []
        for tick, more in enumerate(({}, {"object": 1}, {}, {"object": 0})):
            reply = ask(server, "step", tick=tick, **action, **more)
            chosen.append(reply["steps"][0]["sights"][-1]["object"])
        self.assertEqual(chosen, [0, 1, 1, 0])
        self.rejects(ask(server, "step", tick=4, **action, object=2), "bad_request")
        self.rejects(ask(server, "step", tick=4, **action, object=-1), "bad_request")
        self.assertTrue(ask(server, "step", tick=4, **action)["ok"])
        joints = {"action_space": "joint_position", "actions": [[0.5, 0, 0.3, -1]]}
        self.rejects(ask(begun(), "step", tick=0, **joints, object=0), "bad_request")

    def test_every_request_gets_a_reply(self):
        server = begun()
        stream = random.Random(1)
        whole = codec.encode({"v": codec.VERSION, "op": "step", "episode": 7, "tick": 0, "action_space": "tool_delta",
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
            self.rejects(codec.decode(server.answer([data])[0]), "bad_request")
        self.rejects(codec.decode(server.answer([whole, b""])[0]), "bad_request")

    def test_loopback_addresses_are_recognised(self):
        for address in ("tcp://127.0.0.1:5570", "tcp://localhost:1", "tcp://[::1]:*"):
            self.assertTrue(loopback(address), address)
        for address in ("tcp://0.0.0.0:1", "tcp://*:1", "tcp://eth0:1", "tcp://192.168.1.2:1"):
            self.assertFalse(loopback(address), address)

    def test_unknown_kinds_of_problem_are_rejected(self):
        with self.assertRaises(ValueError):
            Problem("oops", "")


class DeclaredTasks(unittest.TestCase):
    """A task without a robot, with its own failure modes, measures, parameters and action vector."""

    def ask_tank(self, **parameters):
        server = Server(Tank())
        return server, ask(server, "reset", index=0, seed=1, parameters=parameters)

    def test_defaults_are_filled_in(self):
        task = ask(Server(Tank()), "hello")["task"]
        self.assertEqual(task["failure_modes"][0], {"name": "overflow", "meaning": "", "severity": "major"})
        self.assertEqual(task["measures"][0]["better"], "neither")
        self.assertNotIn("gripper", task["action"])

    def test_episodes_end_with_declared_failures(self):
        server, reply = self.ask_tank(goal_m=0.5, liquid="oil")
        self.assertEqual(reply["instance"]["instruction"], "fill the tank with oil")
        self.assertEqual(reply["observation"], {"time_s": 0.0, "vectors": {"levels": [0.0, 0.5]}})
        # 21 periods of full inflow raise the level above 1 m.
        reply = ask(server, "step", tick=0, action_space="vector", actions=[[1.0, 0.0]] * 8)
        self.assertEqual(len(reply["steps"]), 8)
        self.assertIsNone(reply["steps"][-1]["measures"]["spilled_l"])
        reply = ask(server, "step", tick=8, action_space="vector", actions=[[1.0, 0.0]] * 20)
        self.assertEqual(reply["steps"][-1]["ending"]["failure"], "overflow")
        server, _ = self.ask_tank(goal_m=0.5)
        reply = ask(server, "step", tick=0, action_space="vector", actions=[[1.0, 0.0]] * 10 + [[0.0, 0.0]] * 9)
        ending = reply["steps"][-1]["ending"]
        self.assertEqual((ending["failure"], len(reply["steps"])), (None, 14))
        self.assertAlmostEqual(ending["time_s"], 1.4)

    def test_values_and_actions_are_checked(self):
        for parameters, kind in [
            ({"goal_m": 0.9}, "setup"),
            ({"goal_m": 0.5, "leaks": 1.5}, "setup"),
            ({"goal_m": 0.5, "liquid": "milk"}, "setup"),
            ({"goal_m": 0.5, "colour": "red"}, "not_applied"),
            ({}, "setup"),
        ]:
            _, reply = self.ask_tank(**parameters)
            self.assertEqual(reply["error"]["kind"], kind, reply)
        server, _ = self.ask_tank(goal_m=0.5)
        for action in ([1.0], [1.0, 0.6], [1.0, 0.0, -1.0]):
            reply = ask(server, "step", tick=0, action_space="vector", actions=[action])
            self.assertEqual(reply["error"]["kind"], "bad_action", action)

    def test_undeclared_failures_are_sent(self):
        for failure, sent in [("jammed at 40 N", "jammed at 40 N"), (7, "7"), (["a"], "['a']"), (False, "False")]:

            class Jams(Tank):
                def step(self, action):
                    return super().step(action) | {"ending": {"failure": failure}}

            server = Server(Jams())
            ask(server, "reset", index=0, seed=1, parameters={"goal_m": 0.5})
            reply = ask(server, "step", tick=0, action_space="vector", actions=[[1.0, 0.0]])
            self.assertEqual(reply["steps"][0]["ending"]["failure"], sent)

    def test_invalid_declarations_are_named(self):
        def changed(change):
            class Changed(Tank):
                def hello(self):
                    hello = super().hello()
                    change(hello, hello["task"])
                    return hello

            with self.assertRaises(Problem) as caught:
                Server(Changed())
            return caught.exception.detail

        for part, change in [
            ("without the key 'judges'", lambda hello, task: hello.update(judges=True)),
            ("without the key 'meassures'", lambda hello, task: task.update(meassures=[])),
            ("without 'dry' twice", lambda hello, task: task["failure_modes"].append("dry")),
            ("another name than success", lambda hello, task: task["failure_modes"].append("success")),
            ("hello.task.time_limit_s", lambda hello, task: task.update(time_limit_s=0.0)),
            ("nominal must be an integer from 0 to 3", lambda hello, task: task["parameters"][1].update(nominal=4)),
            ("with a nominal value, because it has a family", lambda hello, task: task["parameters"][0].update(family="goal")),
            ("action.spaces[0].high", lambda hello, task: task["action"]["spaces"][0].update(high=[1])),
        ]:
            self.assertIn(part, changed(change))

    def test_other_versions_are_rejected(self):
        reply = codec.decode(Server(Tank()).answer([codec.encode({"v": 2, "op": "hello", "episode": 0})])[0])
        self.assertEqual((reply["v"], reply["error"]["kind"]), (3, "bad_request"))
        self.assertIn("uses protocol version 3, but the request has version 2", reply["error"]["detail"])


class TheExamples(unittest.TestCase):
    def test_task_server_scores_a_controller(self):
        spec = importlib.util.spec_from_file_location("task_server", ROOT / "examples/task_server.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        outcomes = []
        for controller in (lambda s, c, v: 5.0 if v >= 0.0 else -5.0, lambda s, c, v: -20.0 * s - 6.0 * v):
            server = Server(module.Pendulum())
            reply = ask(server, "reset", index=0, seed=1, parameters={"start": "tilted", "mass_kg": 0.2})
            observation, ending, tick = reply["observation"], None, 0
            while ending is None and tick < 200:
                (s, c), (v,) = observation["vectors"]["direction"], observation["vectors"]["speed"]
                action = [min(max(controller(s, c, v), -5.0), 5.0)]
                (step,) = ask(server, "step", tick=tick, action_space="vector", actions=[action])["steps"]
                observation, ending, tick = step["observation"], step["ending"], tick + 1
            outcomes.append(ending["failure"])
        self.assertEqual(outcomes, ["overspeed", None])

    def test_drive_script_needs_no_installation(self):
        done = subprocess.run(
            [sys.executable, ROOT / "bridges/examples/drive.py", "--help"], capture_output=True, text=True, env={}
        )
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_server_is_reachable_over_a_socket(self):
        environment = os.environ | {"PYTHONPATH": str(ROOT / "bridges/common")}
        script = ROOT / "bridges/common/tests/toy.py"
        with subprocess.Popen([sys.executable, script, "--kind", "tank"], stdout=subprocess.PIPE, env=environment) as peer:
            try:
                with Client(json.loads(peer.stdout.readline())["listening"]) as client:
                    self.assertEqual(client.hello()["task"]["name"], "tank")
                    client.reset({"goal_m": 0.5})
                    (step,) = client.step([[1.0, 0.0]], "vector")
                    self.assertAlmostEqual(step["measures"]["level_m"], 0.05)
            finally:
                peer.terminate()
                peer.wait(timeout=10)


class TheServo(unittest.TestCase):
    """Comparison with the closed form: a spline with control points 0, 0, p ends half way, with the velocity p / period."""

    robot = CELL["robot"]

    def test_targets_trail_by_half_a_period(self):
        servo = Servo(self.robot, 0.05)
        servo.command([0.02])
        (q,), (v,) = servo.targets(1.0)
        self.assertAlmostEqual(q, 0.01)
        self.assertAlmostEqual(v, 0.4)
        servo.command([0.02])
        (q,), (v,) = servo.targets(1.0)
        self.assertAlmostEqual(q, 0.02)
        self.assertAlmostEqual(v, 0.0)

    def test_limits_are_kept(self):
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
