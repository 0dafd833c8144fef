"""Writes the fixture of LIBERO's conventions: crates/robogate-policy/tests/libero/.

Run it with robosuite 1.4.1 and MuJoCo 2.3.7 (`robogate env setup libero` installs them), and with LIBERO on PYTHONPATH:

    MUJOCO_GL=egl python scripts/libero_fixture.py crates/robogate-policy/tests/libero

The fixture contains what robosuite itself returns, before any client of a model changes it:

- pictures.rgb: frame buffers of `agentview` for three positions of a cube, and one of the camera on the hand;
- robosuite.json: where the cube is in each picture, states of the arm, and motions of ten actions.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import robosuite
from robosuite.controllers import load_controller_config
from robosuite.utils.transform_utils import quat2axisangle

SIDE = 96
CAMERAS = ("agentview", "robot0_eye_in_hand")
REST = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]
# Left and right of the robot, and nearer to the camera, in metres.
CUBES = ((0.0, 0.2), (0.0, -0.2), (0.15, 0.0))
# Name of a motion, and the element of the action that it sets.
AXES = {"x": 0, "y": 1, "z": 2, "about_z": 5}
MAGNITUDES = (1.0, 0.5, 0.2)
STEPS = 10
REST_STEPS = 20


def listed(values, digits: int = 7):
    return [round(float(value), digits) for value in values]


def lift():
    return robosuite.make(
        "Lift",
        robots="Panda",
        controller_configs=load_controller_config(default_controller="OSC_POSE"),
        has_renderer=False,
        has_offscreen_renderer=True,
        use_camera_obs=True,
        camera_names=list(CAMERAS),
        camera_heights=SIDE,
        camera_widths=SIDE,
        control_freq=20,
        initialization_noise=None,
        ignore_done=True,
    )


def rested(env):
    """An observation after actions that do nothing."""
    env.reset()
    for _ in range(REST_STEPS):
        observation, *_ = env.step(REST)
    return observation


def pictures(env):
    """Frame buffers with the cube at known positions, and the pixel of the cube's centre in each."""
    frames, places = [], []
    for x, y in CUBES:
        rested(env)
        joint = env.cube.joints[0]
        pose = env.sim.data.get_joint_qpos(joint).copy()
        pose[:2] = x, y
        env.sim.data.set_joint_qpos(joint, pose)
        env.sim.forward()
        observation = env._get_observations(force_update=True)
        frame = observation["agentview_image"]
        # The cube is the only red object.
        colour = frame.astype(float)
        red = (colour[:, :, 0] > 90.0) & (colour[:, :, 0] > 2.0 * colour[:, :, 1]) & (colour[:, :, 0] > 2.0 * colour[:, :, 2])
        rows, columns = np.nonzero(red)
        frames.append(frame)
        places.append({"cube_m": [x, y], "row": round(float(rows.mean()), 2), "column": round(float(columns.mean()), 2), "pixels": len(rows)})
    frames.append(rested(env)["robot0_eye_in_hand_image"])
    return frames, places


def state(observation):
    return {
        "joints_rad": listed(observation["joints"]),
        "position_m": listed(observation["robot0_eef_pos"]),
        "quaternion_xyzw": listed(observation["robot0_eef_quat"]),
        "axis_angle_rad": listed(quat2axisangle(np.array(observation["robot0_eef_quat"]))),
        "gripper_m": listed(observation["robot0_gripper_qpos"]),
        "controller_rotation": listed(observation["controller_rotation"].reshape(9)),
    }


def with_joints(env, observation):
    robot = env.robots[0]
    joints = [env.sim.data.qpos[i] for i in robot._ref_joint_pos_indexes]
    # The controller refers to another frame of the hand than the observation.
    return {**observation, "joints": joints, "controller_rotation": robot.controller.ee_ori_mat.copy()}


def turned(first, now):
    """The rotation vector from one orientation to the other, in the world frame."""
    result, back, total = np.zeros(3), np.zeros(4), np.zeros(4)
    wxyz = lambda q: np.array([q[3], *q[:3]], dtype=float)
    mujoco.mju_negQuat(back, wxyz(first))
    mujoco.mju_mulQuat(total, wxyz(now), back)
    mujoco.mju_quat2Vel(result, total, 1.0)
    return result


def motions(env):
    """Displacement of the hand after each of ten equal actions from rest, and after five that do nothing."""
    found = []
    for name, index in AXES.items():
        for magnitude in MAGNITUDES:
            first = rested(env)
            action = list(REST)
            action[index] = magnitude
            positions, rotations = [], []
            for step in range(STEPS + 5):
                seen, *_ = env.step(action if step < STEPS else REST)
                positions.append(listed(seen["robot0_eef_pos"] - first["robot0_eef_pos"], 6))
                rotations.append(listed(turned(first["robot0_eef_quat"], seen["robot0_eef_quat"]), 6))
            found.append({"axis": name, "magnitude": magnitude, "steps": STEPS, "translation_m": positions, "rotation_rad": rotations})
    return found


def suites():
    """The base of the robot and the state at rest in each suite of LIBERO."""
    from libero.libero import get_libero_path
    from libero.libero.envs.env_wrapper import ControlEnv

    found = []
    for suite in ("libero_spatial", "libero_object", "libero_goal", "libero_10"):
        paths = sorted((Path(get_libero_path("bddl_files")) / suite).glob("*.bddl"))
        for path in (paths[0], paths[5]):
            env = ControlEnv(bddl_file_name=str(path), has_offscreen_renderer=False, use_camera_obs=False)
            env.seed(7)
            env.reset()
            for _ in range(REST_STEPS):
                observation, *_ = env.step(REST)
            base = env.env.robots[0].base_pos
            found.append({"suite": suite, "task": path.stem, "base_m": listed(base), "state": state(with_joints(env.env, observation))})
            env.close()
    return found


def main() -> None:
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    np.random.seed(0)
    libero = suites()
    env = lift()
    frames, places = pictures(env)
    (folder / "pictures.rgb").write_bytes(b"".join(np.ascontiguousarray(frame).tobytes() for frame in frames))
    rest = with_joints(env, rested(env))
    opened = state(rest)
    states = [opened]
    # Other poses and a closed gripper.
    for index, value, gripper in ((1, 1.0, -1.0), (5, 1.0, 1.0), (3, 0.7, 1.0)):
        rested(env)
        action = list(REST)
        action[index], action[6] = value, gripper
        for _ in range(STEPS):
            env.step(action)
        for _ in range(REST_STEPS):
            seen, *_ = env.step([0.0] * 6 + [gripper])
        states.append({**state(with_joints(env, seen)), "gripper_command": gripper})
    document = {
        "versions": {"robosuite": robosuite.__version__, "mujoco": mujoco.__version__},
        "controller": {"kind": "OSC_POSE", "position_m": 0.05, "rotation_rad": 0.5, "rate_hz": 20},
        "pictures": {"side": SIDE, "cubes": places, "hand": len(places)},
        "base_m": listed(env.robots[0].base_pos),
        "states": states,
        "motions": motions(env),
        "libero": libero,
    }
    (folder / "robosuite.json").write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
