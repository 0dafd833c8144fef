"""An environment whose images, states and motion are known exactly: KIND PERIOD_S RECORD, over the bridge protocol.

It has no physics: each action moves the hand by a known amount. `libero` observes and acts as LIBERO's environment does, `arm` as a
Franka does, `aloha` as two arms of ALOHA do, `dual_arm` as two arms of XPolicyLab do. Each image differs from all others, and no part of it is symmetric. RECORD gets one line of JSON for each control
period: the observation before the action, and the action that RoboGate executed.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from robogate_bridge import Image, serve, state_hash

SIDE = 256
INSTRUCTION = "put the white mug on the left plate"
PERIODS = 40
WRISTS = ("cam_left_wrist", "cam_right_wrist")
CAMERAS = {"libero": ("agentview", "robot0_eye_in_hand"), "arm": ("front", "wrist"), "aloha": ("cam_high", *WRISTS), "dual_arm": ("cam_head", *WRISTS)}
# The vectors of two arms, and their parts of an action.
TWO_ARMS = {
    "aloha": {"agent_pos": 14},
    "dual_arm": {"left_arm_joint_state": 6, "left_ee_joint_state": 1, "right_arm_joint_state": 6, "right_ee_joint_state": 1},
}
# Largest motion of an action of 1.
DELTA_M, DELTA_RAD = 0.05, 0.5


def upright(camera: int, episode: int, tick: int) -> np.ndarray:
    """The image of a camera as a person would see it: 256 x 256 pixels, red grows downwards and green to the right."""
    row, column = np.mgrid[0:SIDE, 0:SIDE]
    image = np.stack([row, column, (row * 3 + column * 5 + 29 * tick + 101 * camera + 53 * episode) % 256], axis=-1).astype(np.uint8)
    # Marks in two corners: white on the top left, black on the bottom right.
    image[:40, :60] = 255
    image[-30:, -50:] = 0
    return image


def rotation_vector(quaternion_xyzw) -> np.ndarray:
    """The formula of robosuite: 2 acos(w) about the axis, without wrapping."""
    x, y, z, w = quaternion_xyzw
    length = np.sqrt(1.0 - w * w)
    return np.zeros(3) if length < 1e-9 else np.array([x, y, z]) * 2.0 * np.arccos(w) / length


class Scene:
    def __init__(self, kind: str, period_s: float, record: str):
        self.kind, self.period_s = kind, period_s
        self.episodes, self.tick = -1, 0
        self.record = open(record, "w", encoding="utf-8")

    def hello(self):
        me = {"name": "known-scene", "version": "1"}
        vectors = {"eef_pos": 3, "eef_axis_angle": 3, "gripper_qpos": 2, "joint_pos": 7}
        names = ["x", "y", "z", "a", "b", "c", "gripper"]
        action = {"spaces": [{"kind": "vector", "names": names, "low": [-1.0] * 7, "high": [1.0] * 7}]}
        if self.kind == "arm":
            vectors = {"joint_positions": 7, "joint_velocities": 7, "gripper_opening": 1, "tool_pose": 7}
            spaces = [{"kind": "tool_delta", "translation_m": DELTA_M, "rotation_rad": DELTA_RAD},
                      {"kind": "joint_position", "joints": [f"joint{i}" for i in range(1, 8)]}]
            action = {"spaces": spaces, "gripper": "binary"}
        elif self.kind in TWO_ARMS:
            vectors = TWO_ARMS[self.kind]
            action = {"spaces": [{"kind": "vector", "names": [f"q{i}" for i in range(14)], "low": [-4.0] * 14, "high": [4.0] * 14}]}
        task = {
            "name": "known_scene", "version": 1, "instruction": INSTRUCTION,
            "control_period_s": self.period_s, "time_limit_s": PERIODS * self.period_s, "failure_modes": [],
            "parameters": [{"name": "start", "kind": "continuous", "low": 0.0, "high": 1.0, "nominal": 0.5}],
            "observation": {"vectors": [{"name": name, "length": length} for name, length in vectors.items()],
                            "cameras": [{"name": name, "width": SIDE, "height": SIDE} for name in CAMERAS[self.kind]]},
            "action": action,
        }
        return {"server": me, "engine": me, "task": task, "scores_itself": True, "deterministic": False}

    def reset(self, scenario):
        self.episodes, self.tick = self.episodes + 1, 0
        self.position = np.array([-0.12, 0.05, 1.07]) if self.kind == "libero" else np.array([0.45, 0.1, 0.3])
        self.joints = np.array([0.1, 0.3, -0.2, -2.0, 0.15, 2.2, 0.7])
        if self.kind in TWO_ARMS:
            self.joints = np.append(self.joints, [-0.4, 0.6, -0.1, 0.9, -1.1, 0.25, 0.3])
        self.opening = 0.07
        self.start = scenario.values["start"]
        return {"observation": self.observation(), "applied": {"start": self.start}}

    def orientation(self) -> np.ndarray:
        """A hand that points down, tilted and turned a little (scalar last). It turns with time."""
        q = np.array([0.995, 0.05 + 0.002 * self.tick, 0.03, 0.04])
        return q / np.linalg.norm(q)

    def observation(self):
        q = self.orientation()
        fingers = [0.5 * self.opening, -0.5 * self.opening]
        if self.kind in TWO_ARMS:
            widths = TWO_ARMS[self.kind]
            vectors = dict(zip(widths, np.split(self.joints, np.cumsum(list(widths.values()))[:-1])))
        elif self.kind == "libero":
            vectors = {"eef_pos": self.position, "eef_axis_angle": rotation_vector(q), "gripper_qpos": fingers, "joint_pos": self.joints}
        else:
            vectors = {"joint_positions": self.joints, "joint_velocities": np.zeros(7), "gripper_opening": [self.opening],
                       "tool_pose": [*self.position, q[3], *q[:3]]}
        self.seen = {name: [float(n) for n in numbers] for name, numbers in vectors.items()}
        return {"vectors": self.seen}

    def step(self, action):
        line = {"episode": self.episodes, "tick": self.tick, "seen": self.seen, "space": action.space,
                "numbers": list(action.numbers), "gripper": action.gripper}
        self.record.write(json.dumps(line) + "\n")
        self.record.flush()
        numbers = np.array(action.numbers)
        gripper = action.gripper if action.gripper is not None else numbers[-1]
        if action.space == "joint_position" or self.kind in TWO_ARMS:
            self.joints = numbers
        else:
            self.position = self.position + DELTA_M * numbers[:3]
        self.opening = float(np.clip(self.opening - 0.01 * gripper, 0.0, 0.08))
        self.tick += 1
        return {"observation": self.observation(), "measures": {}, "ending": None}

    def state_hash(self):
        return state_hash(self.tick, *self.position, *self.joints, self.opening)

    def render(self, cameras):
        numbers = {name: i for i, name in enumerate(CAMERAS[self.kind])}
        return [Image(name, SIDE, SIDE, upright(numbers[name], self.episodes, self.tick).tobytes()) for name in cameras]


if __name__ == "__main__":
    serve(Scene(sys.argv[1], float(sys.argv[2]), sys.argv[3]), "tcp://127.0.0.1:*")
