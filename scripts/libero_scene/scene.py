"""One scene of LIBERO, as LIBERO itself gives it, and in the form of RoboGate's cell.

    scene.py reference SUITE TASK STATE FILE    LIBERO's own environment and renderer, as every client uses them; writes an .npz file
    scene.py cell SUITE TASK STATE              the same scene over the bridge protocol, with the vectors and cameras of a cell

The reference uses nothing of RoboGate but the order of the tasks. The cell form computes the tool frame from the bodies of the
gripper: z from the hand to the fingertips, y between the fingers.
"""

from __future__ import annotations

import sys

import numpy as np
import schedule
from robogate_eval.environments.robosuite_world import REST_ACTION
from robogate_eval.libero import initial_states, installation
from robogate_eval.libero.suites import REST_STEPS, SEED, SUITES

PIXELS = 256


def opened(suite: str, task: int, state: int, renders: bool):
    """LIBERO's environment in an initial state of its benchmark, after the actions that do nothing."""
    wrapper = installation.import_environments()
    place, folder = installation.folder(), SUITES[suite].folder
    name = installation.task_order()[folder][task]
    np.random.seed(SEED)
    env = (wrapper.OffScreenRenderEnv if renders else wrapper.ControlEnv)(
        bddl_file_name=str(place / "bddl_files" / folder / f"{name}.bddl"), camera_heights=PIXELS, camera_widths=PIXELS, horizon=10**6,
        ignore_done=True, hard_reset=False, **({} if renders else {"has_offscreen_renderer": False, "use_camera_obs": False}))  # fmt: skip
    states = initial_states.read(place / "init_files" / folder / f"{name}.pruned_init")
    np.random.seed(SEED + state)
    env.reset()
    env.set_init_state(states[state])
    for _ in range(REST_STEPS):
        seen, *_ = env.step(REST_ACTION)
    return env, seen


def axis_angle(quaternion) -> np.ndarray:
    """As the clients of openpi and OpenVLA-OFT write it (`_quat2axisangle`)."""
    w = np.clip(quaternion[3], -1.0, 1.0)
    length = np.sqrt(1.0 - w * w)
    return np.zeros(3) if np.isclose(length, 0.0) else quaternion[:3] * 2.0 * np.arccos(w) / length


def reference(suite: str, task: int, state: int, file: str) -> None:
    env, seen = opened(suite, task, state, renders=True)
    # The clients reverse both axes.
    pictures = {name: seen[f"{name}_image"][::-1, ::-1].copy() for name in ("agentview", "robot0_eye_in_hand")}
    env.close()
    # Without images, which take most of the time.
    env, seen = opened(suite, task, state, renders=False)
    states = []
    for step in range(len(schedule.MOTIONS) * schedule.LENGTH):
        states.append(np.concatenate([seen["robot0_eef_pos"], axis_angle(seen["robot0_eef_quat"]), seen["robot0_gripper_qpos"]]))
        seen, *_ = env.step(schedule.action(step))
    np.savez(file, states=states, base=env.env.sim.data.get_body_xpos("robot0_base"), **pictures)


class Cell:
    """LIBERO's scene with the vectors, cameras and actions of a cell. The arm does not move: only the first request is compared."""

    def __init__(self, suite: str, task: int, state: int):
        self.env, _ = opened(suite, task, state, renders=False)
        self.model, self.data = self.env.sim.model._model, self.env.sim.data._data
        self.base = np.array(self.data.body("robot0_base").xpos)
        self.renderer = None

    def hello(self):
        me = {"name": "libero-as-a-cell", "version": "1"}
        lengths = {"joint_positions": 7, "joint_velocities": 7, "gripper_opening": 1, "tool_pose": 7}
        task = {
            "name": "libero_as_a_cell", "version": 1, "instruction": "look", "control_period_s": 0.05, "time_limit_s": 0.1,
            "failure_modes": [],
            "parameters": [{"name": "start", "kind": "continuous", "low": 0.0, "high": 1.0, "nominal": 0.5}],
            "observation": {"vectors": [{"name": name, "length": length} for name, length in lengths.items()],
                            "cameras": [{"name": name, "width": PIXELS, "height": PIXELS} for name in ("front", "wrist")]},
            "action": {"spaces": [{"kind": "tool_delta", "translation_m": 0.05, "rotation_rad": 0.5}], "gripper": "binary"},
        }  # fmt: skip
        return {"server": me, "engine": me, "task": task, "scores_itself": True, "deterministic": False}

    def reset(self, scenario):
        return {"observation": self.observation(), "applied": {"start": scenario.values["start"]}}

    def step(self, _):
        return {"observation": self.observation(), "measures": {}, "ending": None}

    def observation(self):
        import mujoco

        site = np.array(self.data.site("gripper0_grip_site").xpos)
        left, right = (np.array(self.data.body(f"gripper0_{side}finger").xpos) for side in ("left", "right"))
        z = site - np.array(self.data.body("robot0_right_hand").xpos)
        z /= np.linalg.norm(z)
        y = left - right
        y -= z * (y @ z)
        y /= np.linalg.norm(y)
        frame = np.stack([np.cross(y, z), y, z], axis=1)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, frame.ravel())
        joint = lambda name: float(self.data.joint(name).qpos[0])
        opening = joint("gripper0_finger_joint1") - joint("gripper0_finger_joint2")
        return {"vectors": {
            "joint_positions": [joint(f"robot0_joint{i}") for i in range(1, 8)], "joint_velocities": [0.0] * 7,
            "gripper_opening": [opening], "tool_pose": [*(site - self.base), *quaternion]}}  # fmt: skip

    def state_hash(self):
        return 0

    def render(self, cameras):
        import mujoco
        from robogate_bridge import Image

        if self.renderer is None:
            self.renderer = mujoco.Renderer(self.model, PIXELS, PIXELS)
        option = mujoco.MjvOption()
        # Without the collision geometry.
        option.geomgroup[0] = 0
        images = []
        for name in cameras:
            self.renderer.update_scene(self.data, {"front": "agentview", "wrist": "robot0_eye_in_hand"}[name], option)
            images.append(Image(name, PIXELS, PIXELS, self.renderer.render().tobytes()))
        return images


if __name__ == "__main__":
    what, suite, task, state = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    if what == "reference":
        reference(suite, task, state, sys.argv[5])
    else:
        from robogate_bridge import serve

        serve(Cell(suite, task, state), "tcp://127.0.0.1:*")
