"""Runs RoboGate against the server code of other projects, and compares what each end received with what the other sent.

Called by scripts/live_servers.sh. For each case: a server (serve_*.py) with a known model (model.py), an environment with known images
and states (scene.py), `robogate policy check`, and three episodes. Then:

- the images, states and instruction of every request are compared with the environment's, converted as the clients of the
  model's authors do;
- every action that reached the environment is compared with the model's numbers, converted as those clients do.

The conversions are written here a second time, in NumPy and Pillow, from the sources that each case names. They use nothing of RoboGate.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import re
import socket
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import scene
from PIL import Image

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
EPISODES = 3
# The gripper of the model: the number that opens, and the one that closes.
SIGNED, FRACTION, DROID = (-1.0, 1.0), (1.0, 0.0), (0.0, 1.0)


def rotated(camera: int, episode: int, tick: int) -> np.ndarray:
    """LIBERO: robosuite's frame buffer is upside down, and clients rotate it by 180 degrees."""
    buffer = scene.upright(camera, episode, tick)[::-1]
    return buffer[::-1, ::-1]


def resized(image: np.ndarray, width: int, height: int, pillow=Image.Resampling.BILINEAR) -> np.ndarray:
    """With the aspect ratio kept and black borders, as openpi's `resize_with_pad`."""
    ratio = max(image.shape[1] / width, image.shape[0] / height)
    inner = Image.fromarray(np.ascontiguousarray(image)).resize((int(image.shape[1] / ratio), int(image.shape[0] / ratio)), pillow)
    canvas = Image.new("RGB", (width, height))
    canvas.paste(inner, ((width - inner.width) // 2, (height - inner.height) // 2))
    return np.array(canvas)


def cropped(*at) -> np.ndarray:
    """OpenVLA: the centre with 90 % of the area, at 224 x 224 pixels."""
    image = np.ascontiguousarray(rotated(*at))
    kept = int(round(image.shape[0] * 0.9**0.5))
    begin = (image.shape[0] - kept) // 2
    return np.array(Image.fromarray(image[begin : begin + kept, begin : begin + kept]).resize((224, 224), Image.Resampling.LANCZOS))


def libero_state(seen: dict) -> np.ndarray:
    return np.concatenate([seen["eef_pos"], seen["eef_axis_angle"], seen["gripper_qpos"]])


def libero_parts(seen: dict) -> dict:
    numbers = libero_state(seen)
    names = ("x", "y", "z", "roll", "pitch", "yaw")
    return {name: numbers[i : i + 1] for i, name in enumerate(names)} | {"gripper": numbers[6:]}


def signed(chunk_row: np.ndarray) -> np.ndarray:
    """LIBERO's action: the gripper is -1 (open) or 1 (closed)."""
    return np.append(chunk_row[:6], np.where(chunk_row[6] > 0.0, 1.0, -1.0))


def from_fraction(chunk_row: np.ndarray) -> np.ndarray:
    """The gripper of GR00T and OpenVLA: 0 is closed and 1 is open."""
    return np.append(chunk_row[:6], np.where(chunk_row[6] > 0.5, -1.0, 1.0))


def libero_executed(chunk_row, convert, _seen):
    return {"space": "vector", "numbers": convert(chunk_row)}


@dataclass
class Case:
    """A server, a profile, and the conversions of the model's own client."""

    name: str
    # Name of the checkout, and of the server script.
    checkout: str
    script: str
    profile: str
    scheme: str
    # Where the conversions come from.
    source: str
    model: dict
    options: dict
    images: dict
    states: object
    executed: object
    kind: str = "libero"
    period_s: float = 0.05
    # Actions of a chunk that are executed before the next request.
    execute: int = 5
    # Control periods of an action.
    periods: int = 1
    state_tolerance: float = 1e-6
    image_tolerance: int = 0
    instruction: object = field(default=lambda text: text)


def libero_case(name, checkout, script, profile, scheme, source, size, gripper, options, images, states, execute, **more):
    convert = signed if gripper == SIGNED else from_fraction
    return Case(
        name, checkout, script, profile, scheme, source,
        {"length": size, "size": 7, "magnitude": 0.9, "gripper": list(gripper)}, options, images, states,
        lambda row, seen: libero_executed(row, convert, seen), execute=execute, **more)  # fmt: skip


def droid_executed(row: np.ndarray, seen: dict) -> dict:
    """examples/droid/main.py: velocities clipped to 1, 0.2 rad each; the gripper closes above 0.5."""
    joints = np.array(seen["joint_positions"]) + 0.2 * np.clip(row[:7], -1.0, 1.0)
    return {"space": "joint_position", "numbers": joints, "gripper": 1.0 if row[7] > 0.5 else -1.0}


def droid_tool(seen: dict) -> np.ndarray:
    """Isaac-GR00T examples/DROID/main_gr00t.py (`compute_eef_9d`): two rows of the rotation of DROID's hand, with its correction.

    DROID's hand is the tool of the scene (z out of the tool, fingers along y) rotated by -90 degrees about z.
    """
    x, y, z, w, a, b, c = seen["tool_pose"]
    turn = np.array([
        [1 - 2 * (b * b + c * c), 2 * (a * b - c * w), 2 * (a * c + b * w)],
        [2 * (a * b + c * w), 1 - 2 * (a * a + c * c), 2 * (b * c - a * w)],
        [2 * (a * c - b * w), 2 * (b * c + a * w), 1 - 2 * (a * a + b * b)],
    ])  # fmt: skip
    hand = turn @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    corrected = hand @ np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]])
    return np.concatenate([[x, y, z], corrected[:2].ravel()])


def droid_joints(row: np.ndarray, _seen: dict) -> dict:
    """Absolute positions; the gripper closes above 0.5."""
    return {"space": "joint_position", "numbers": row[:7], "gripper": 1.0 if row[7] > 0.5 else -1.0}


def bridge_executed(row: np.ndarray, _seen: dict) -> dict:
    """Metres, and roll, pitch and yaw in radians, spread over four control periods; 1 opens the gripper."""
    roll, pitch, yaw = (0.5 * row[3:6]).tolist()
    c, s = np.cos, np.sin
    # The quaternion of rotations about the fixed axes x, y, z.
    w = c(roll) * c(pitch) * c(yaw) + s(roll) * s(pitch) * s(yaw)
    v = np.array([
        s(roll) * c(pitch) * c(yaw) - c(roll) * s(pitch) * s(yaw),
        c(roll) * s(pitch) * c(yaw) + s(roll) * c(pitch) * s(yaw),
        c(roll) * c(pitch) * s(yaw) - s(roll) * s(pitch) * c(yaw),
    ])  # fmt: skip
    turn = 2.0 * np.arctan2(np.linalg.norm(v), w) * v / np.linalg.norm(v)
    numbers = np.concatenate([row[:3] / 4 / scene.DELTA_M, turn / 4 / scene.DELTA_RAD])
    return {"space": "tool_delta", "numbers": numbers, "gripper": -1.0 if row[6] > 0.5 else 1.0}


# Between the signs of ALOHA's joints and those of openpi's own robots, and the numbers of the two grippers.
ALOHA_SIGNS, ALOHA_GRIPPERS = np.array([1, -1, -1, 1, 1, 1, 1] * 2), [6, 13]


def aloha_state(seen: dict) -> dict:
    """src/openpi/policies/aloha_policy.py: linear opening of a gripper from 0 to 1 to the angle of its motor."""
    numbers = ALOHA_SIGNS * np.array(seen["agent_pos"])
    opening = 0.01844 + numbers[ALOHA_GRIPPERS] * (0.05800 - 0.01844)
    angle = np.arcsin(np.clip((0.022**2 + opening**2 - 0.036**2) / (2 * 0.022 * opening), -1.0, 1.0))
    numbers[ALOHA_GRIPPERS] = (angle - 0.5476) / (1.6296 - 0.5476)
    return {"state": numbers}


def aloha_executed(row: np.ndarray, _seen: dict) -> dict:
    """The same back, for actions: angle of the motor from the range of openpi's robots to that of ALOHA's."""
    numbers = ALOHA_SIGNS * row
    numbers[ALOHA_GRIPPERS] = (numbers[ALOHA_GRIPPERS] + 0.5476 + 0.6213) / (1.4910 + 0.6213)
    return {"space": "vector", "numbers": numbers}


def cases() -> list[Case]:
    at_224 = lambda convert: lambda *at: resized(convert(*at), 224, 224)
    mirrored = {"image": (0, rotated), "wrist_image": (1, rotated)}
    droid_image = lambda *at: resized(scene.upright(*at), 224, 224)
    seven = {"x": 1, "y": 1, "z": 1, "roll": 1, "pitch": 1, "yaw": 1, "gripper": 1}
    found = [
        libero_case(
            "openpi, LIBERO", "openpi", "openpi", "pi05-libero", "ws", "examples/libero/main.py", 10, SIGNED,
            {"environment": "libero"}, {"base_0_rgb": (0, at_224(rotated)), "left_wrist_0_rgb": (1, at_224(rotated))},
            lambda seen: {"state": libero_state(seen)}, 5),
        Case(
            "openpi, DROID", "openpi", "openpi", "pi05-droid", "ws", "examples/droid/main.py",
            {"length": 15, "size": 8, "magnitude": 1.2, "gripper": list(DROID)}, {"environment": "droid"},
            {"base_0_rgb": (0, droid_image), "left_wrist_0_rgb": (1, droid_image)},
            lambda seen: {"state": np.append(seen["joint_positions"], 1.0 - seen["gripper_opening"][0] / 0.08)},
            droid_executed, kind="arm", period_s=1.0 / 15.0, execute=8),
    ]  # fmt: skip
    for wrapper in (False, True):
        layout = "simulation wrapper" if wrapper else "nested"
        for name, checkout, tag, profile, length in (
            ("GR00T N1.7", "gr00t", "libero_sim", "gr00t-n1.7-libero", 16),
            ("GR00T N1.6", "gr00t-n1.6", "libero_panda", "gr00t-n1.6-libero", 16),
        ):
            found.append(libero_case(
                f"{name}, LIBERO, {layout}", checkout, "gr00t", profile, "tcp", "gr00t/eval/sim/LIBERO/libero_env.py", length,
                FRACTION, {"embodiment_tag": tag, "wrapper": wrapper, "widths": seven},
                {name: (camera, lambda *at, f=convert: f(*at)[None]) for name, (camera, convert) in mirrored.items()},
                libero_parts, 8))  # fmt: skip
    wide = lambda *at: resized(scene.upright(*at), 320, 180)
    history = lambda camera, episode, tick: np.stack([wide(camera, episode, max(0, tick - 15)), wide(camera, episode, tick)])
    found.append(Case(
        "GR00T N1.7, DROID", "gr00t", "gr00t", "gr00t-n1.7-droid", "tcp", "examples/DROID/main_gr00t.py",
        {"length": 40, "size": 8, "magnitude": 0.9, "gripper": list(DROID)},
        {"embodiment_tag": "oxe_droid_relative_eef_relative_joint", "widths": {"joint_position": 7, "gripper_position": 1}},
        {"exterior_image_1_left": (0, history), "wrist_image_left": (1, history)},
        lambda seen: {"eef_9d": droid_tool(seen), "joint_position": seen["joint_positions"],
                      "gripper_position": [1.0 - seen["gripper_opening"][0] / 0.08]},
        droid_joints, kind="arm", period_s=1.0 / 15.0, execute=15))  # fmt: skip
    for http in (False, True):
        found.append(libero_case(
            f"GR00T N1.5, LIBERO, {'HTTP' if http else 'ZeroMQ'}", "gr00t-n1.5", "gr00t_n15",
            "gr00t-n1.5-libero" if not http else "gr00t-n1.5-libero-http", "http" if http else "tcp",
            "examples/Libero/eval/run_libero_eval.py", 16, FRACTION, {"http": http},
            {name: (camera, lambda *at, f=convert: f(*at)[None]) for name, (camera, convert) in mirrored.items()},
            libero_parts, 8))  # fmt: skip
    two_arms = {"length": 50, "size": 14, "magnitude": 0.9, "gripper": list(FRACTION)}
    upright_at_224 = at_224(scene.upright)
    for name, profile, source, images, execute, instruction in (
        ("simulation", "pi0-aloha-sim", "examples/aloha_sim/env.py", {"base_0_rgb": 0}, 10, lambda _: "Transfer cube"),
        ("robot", "pi05-aloha", "examples/aloha_real/env.py", {"base_0_rgb": 0, "left_wrist_0_rgb": 1, "right_wrist_0_rgb": 2}, 25, str),
    ):
        found.append(Case(
            f"openpi, ALOHA, {name}", "openpi", "openpi", profile, "ws", source, two_arms, {"environment": "aloha"},
            {image: (camera, upright_at_224) for image, camera in images.items()}, aloha_state, aloha_executed, kind="aloha",
            period_s=0.02, execute=execute, instruction=instruction))  # fmt: skip
    widths = scene.TWO_ARMS["dual_arm"]
    wide_640 = lambda *at: np.array(Image.fromarray(scene.upright(*at)).resize((640, 480), Image.Resampling.BILINEAR))
    found += [
        Case(
            "XPolicyLab, two arms", "xpolicylab", "xpolicylab", "xpolicylab-dual-arm", "ws", "policy/demo_policy/model.py",
            {**two_arms, "length": 5}, {"widths": widths}, {name: (i, wide_640) for i, name in enumerate(scene.CAMERAS["dual_arm"])},
            lambda seen: {name: seen[name] for name in widths}, lambda row, _: {"space": "vector", "numbers": row}, kind="dual_arm", execute=1),
        libero_case(
            "LeRobot, SmolVLA", "lerobot", "lerobot", "smolvla", "grpc", "src/lerobot/processor/env_processor.py", 50, SIGNED, {},
            {"image": (0, rotated), "image2": (1, rotated)}, lambda seen: {"state": libero_state(seen)}, 10),
        libero_case(
            "OpenVLA, LIBERO", "openvla", "openvla", "openvla-libero", "http", "experiments/robot/libero/run_libero_eval.py", 1,
            FRACTION, {"unnorm_key": "libero_spatial"}, {"image": (0, cropped)}, lambda seen: {}, 1, instruction=str.lower),
        Case(
            "OpenVLA, BridgeData V2", "openvla", "openvla", "openvla", "http", "vla-scripts/deploy.py",
            {"length": 1, "size": 7, "magnitude": 0.02, "gripper": list(FRACTION)}, {"unnorm_key": "bridge_orig"},
            {"image": (0, lambda *at: resized(scene.upright(*at), 224, 224, Image.Resampling.LANCZOS))}, lambda seen: {},
            bridge_executed, kind="arm", execute=1, periods=4, instruction=str.lower),
        libero_case(
            "OpenVLA-OFT", "openvla-oft", "openvla_oft", "openvla-oft", "http", "experiments/robot/libero/run_libero_eval.py", 8,
            FRACTION, {}, {"full_image": (0, rotated), "wrist_image": (1, rotated)},
            lambda seen: {"state": libero_state(seen)}, 8),
        libero_case(
            "StarVLA, LIBERO", "starvla", "starvla", "starvla-server-libero", "ws", "examples/simBenchmarks/LIBERO/eval_files/eval_libero.py", 8,
            FRACTION, {}, {"image_0": (0, at_224(rotated)), "image_1": (1, at_224(rotated))}, lambda seen: {}, 8),
        libero_case(
            "vla-eval, SmolVLA", "vla-eval", "vla_eval", "smolvla-vla-eval", "ws",
            "src/vla_eval/benchmarks/libero/benchmark.py", 10, SIGNED, {"chunk_size": 10},
            {"agentview": (0, rotated), "wrist": (1, rotated)}, lambda seen: {"states": libero_state(seen)}, 10),
    ]  # fmt: skip
    return found


class Failed(Exception):
    """A difference between what one end sent and the other received."""


def same(what: str, got, expected, tolerance: float) -> float:
    got, expected = np.asarray(got, dtype=float), np.asarray(expected, dtype=float)
    if got.shape != expected.shape:
        raise Failed(f"{what}: shape {got.shape}, expected {expected.shape}")
    worst = float(np.abs(got - expected).max()) if got.size else 0.0
    if worst > tolerance:
        raise Failed(f"{what}: differs by {worst:.6g}. Got {got.ravel()[:8]}, expected {expected.ravel()[:8]}")
    return worst


def compare(case: Case, requests: list[Path], lines: list[dict]) -> dict:
    """Compares the requests of the episodes, and the actions that were executed. Returns counts and the largest differences."""
    by_place = {(line["episode"], line["tick"]): line for line in lines}
    episodes = sorted({line["episode"] for line in lines})
    stride = case.execute * case.periods
    places = [(e, t) for e in episodes for t in range(0, scene.PERIODS, stride)]
    if len(requests) != len(places):
        raise Failed(f"{len(requests)} requests for {len(places)} chunks")
    worst = {"image": 0.0, "state": 0.0, "action": 0.0}
    actions = 0
    for path, (episode, tick) in zip(requests, places):
        request = np.load(path)
        where = f"episode {episode}, control period {tick}"
        seen = by_place[episode, tick]["seen"]
        for name, (camera, convert) in case.images.items():
            image = request[f"image/{name}"]
            if image.dtype != np.uint8:
                raise Failed(f"{where}: image {name} has the type {image.dtype}")
            expected = convert(camera, episode, tick)
            worst["image"] = max(worst["image"], same(f"{where}: image {name}", image, expected, case.image_tolerance))
        states = case.states(seen)
        known = {key for key in request.files if key.startswith(("image/", "state/"))}
        wanted = {f"image/{name}" for name in case.images} | {f"state/{name}" for name in states}
        if known != wanted:
            raise Failed(f"{where}: the model was given {sorted(known)}, expected {sorted(wanted)}")
        for name, numbers in states.items():
            worst["state"] = max(worst["state"], same(f"{where}: state {name}", request[f"state/{name}"], numbers, case.state_tolerance))
        text = str(request["instruction"])
        if text != case.instruction(scene.INSTRUCTION):
            raise Failed(f"{where}: the instruction is {text!r}")
        for step in range(stride):
            line = by_place.get((episode, tick + step))
            if line is None:
                continue
            actions += 1
            row = request["actions"][step // case.periods]
            expected = case.executed(row, by_place[episode, tick + step]["seen"])
            if line["space"] != expected["space"]:
                raise Failed(f"{where}: executed {line['space']}")
            worst["action"] = max(worst["action"], same(f"{where}: action {step}", line["numbers"], expected["numbers"], 1e-6))
            if "gripper" in expected and line["gripper"] != expected["gripper"]:
                raise Failed(f"{where}: gripper {line['gripper']}, expected {expected['gripper']}")
    return {"requests": len(requests), "actions": actions, **worst}


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Process:
    """A process that is stopped at the end of the block. Its output is in a file."""

    def __init__(self, command: list, log: Path, environment: dict):
        self.log = log
        self.child = subprocess.Popen(
            [str(part) for part in command], stdout=log.open("w"), stderr=subprocess.STDOUT, env=environment, cwd=log.parent)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.child.terminate()
        try:
            self.child.wait(5)
        except subprocess.TimeoutExpired:
            self.child.kill()
            self.child.wait()

    def wait_for(self, pattern: str) -> str:
        until = time.monotonic() + 60.0
        while time.monotonic() < until:
            found = re.search(pattern, self.log.read_text())
            if found:
                return found[1]
            if self.child.poll() is not None:
                break
            time.sleep(0.05)
        raise Failed(f"{self.log} did not start: {self.log.read_text()[-800:]}")


def robogate(binary: str, *arguments) -> str:
    done = subprocess.run([binary, *map(str, arguments)], capture_output=True, text=True, timeout=300)
    # 1 and 3: problems found, or a verdict. The comparison decides here.
    if done.returncode not in (0, 1):
        raise Failed(f"robogate {arguments[0]} ended with {done.returncode}: {done.stderr[-1200:]}")
    return done.stdout + done.stderr


def profile_of(binary: str, case: Case, folder: Path) -> str:
    """The built-in profile, or a copy with another dialect."""
    if not case.profile.endswith("-http"):
        return case.profile
    text = robogate(binary, "list", "profiles", case.profile.removesuffix("-http"))
    path = folder / "profile.toml"
    path.write_text(text.replace('name = "gr00t-n1.5"', 'name = "gr00t-n1.5-http"'))
    return str(path)


def run(case: Case, options: argparse.Namespace, checkout: Path, folder: Path) -> dict:
    folder.mkdir(parents=True)
    python = options.lerobot_python if case.script == "lerobot" else options.python
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1"}
    bridge = {**environment, "PYTHONPATH": str(ROOT / "python/src")}
    port, requests, record = free_port(), folder / "requests", folder / "executed.jsonl"
    settings = json.dumps({"model": case.model, **case.options})
    server = [python, HERE / f"serve_{case.script}.py", checkout, port, requests, settings]
    world = [options.python, HERE / "scene.py", case.kind, case.period_s, record]
    with Process(server, folder / "server.log", environment), Process(world, folder / "scene.log", bridge) as scene_server:
        simulator = scene_server.wait_for(r'"listening": "([^"]+)"')
        address = f"{case.scheme}://127.0.0.1:{port}"
        profile = profile_of(options.robogate, case, folder)
        common = (address, "--profile", profile, "--wait", "60s", "--simulator", simulator)
        check = robogate(options.robogate, "policy", "check", *common)
        (folder / "check.txt").write_text(check)
        before, lines = len(list(requests.glob("*.npz"))), len(record.read_text().splitlines())
        output = robogate(options.robogate, "run", "--policy", *common, "-n", EPISODES, "--threads", 1, "--out", folder / "run")
        (folder / "run.txt").write_text(output)
    made = sorted(requests.glob("*.npz"))[before:]
    executed = [json.loads(line) for line in record.read_text().splitlines()[lines:]]
    problems = [line.removeprefix("problem: ") for line in check.splitlines() if line.startswith("problem: ")]
    return {**compare(case, made, executed), "problems": problems}


def commit(checkout: Path) -> str:
    """Commit and date of a checkout, if it is one of git."""
    done = subprocess.run(["git", "-C", str(checkout), "log", "-1", "--format=%h, %cs"], capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else "not a git checkout"


def page(results: list, checkouts: dict, options: argparse.Namespace) -> str:
    """The table of docs/results/live-servers.md."""
    version = subprocess.run([options.robogate, "--version"], capture_output=True, text=True).stdout.strip()
    lines = [f"Run on {datetime.date.today()} with {version}.", "",
             "| server | commit | profile | client of the model's authors | requests | actions | image | state | action | `policy check` |",
             "|---|---|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for case, result in results:
        if "skipped" in result:
            lines.append(f"| {case.name} | - | `{case.profile}` | not run: {result['skipped']} | | | | | | |")
        elif "failed" in result:
            lines.append(f"| {case.name} | {commit(checkouts[case.checkout])} | `{case.profile}` | **failed**: {result['failed']} | | | | | | |")
        else:
            check = "; ".join(result["problems"]) or "no problems"
            lines.append(
                f"| {case.name} | {commit(checkouts[case.checkout])} | `{case.profile}` | `{case.source}` | {result['requests']} | {result['actions']} | "
                f"{result['image']:.0f} | {result['state']:.1e} | {result['action']:.1e} | {check} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser()
    names = list(dict.fromkeys(case.checkout for case in cases()))
    for name in names:
        parser.add_argument(f"--{name}", dest=f"checkout_{name}", type=Path)
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--lerobot-python", default=sys.executable)
    parser.add_argument("--robogate", required=True)
    parser.add_argument("--only", default="", help="part of the names of the cases to run")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    checkouts = {name: getattr(options, f"checkout_{name}") for name in names}
    results, failed = [], 0
    for number, case in enumerate(cases()):
        checkout = checkouts[case.checkout]
        if options.only not in case.name:
            continue
        if checkout is None:
            result = {"skipped": f"no --{case.checkout}"}
        else:
            try:
                result = run(case, options, checkout.resolve(), options.out.resolve() / f"{number:02}-{case.script}")
            except (Failed, subprocess.TimeoutExpired) as why:
                result, failed = {"failed": str(why)}, failed + 1
        print(f"{case.name}: {result}", flush=True)
        results.append((case, result))
    (options.out / "results.md").write_text(page(results, checkouts, options))
    print(f"{sum('requests' in result for _, result in results)} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
