"""A cell from a robot's folder with one primitive on the table, for warming up and for tests."""

import tomllib

import mujoco
import numpy as np

UP = [1.0, 0.0, 0.0, 0.0]


def example_cell(robot, shape="box", size_m=0.05, mass_kg=0.3, friction=0.8, at=(0.5, 0.0), force_n=None, fixtures=()):
    """A homogeneous `box`, `cylinder` or `sphere` on the table, with optional further fixtures."""
    settings = tomllib.loads((robot.model.parent / "robot.toml").read_text(encoding="utf-8"))
    arm, gripper = settings["arm"], settings["gripper"]
    model = mujoco.MjModel.from_xml_path(str(robot.model))
    half = 0.5 * size_m
    primitive, inertia = {
        "box": ({"kind": "box", "half": [half] * 3}, np.full(3, 2.0 / 3.0)),
        "cylinder": ({"kind": "cylinder", "radius": half, "half_height": half}, np.array([7.0, 7.0, 6.0]) / 12.0),
        "sphere": ({"kind": "sphere", "radius": half}, np.full(3, 0.4)),
    }[shape]
    table = {
        "name": "table",
        "kind": "table",
        "primitive": {"kind": "box", "half": [0.4, 0.7, 0.02]},
        "pose": {"position": [0.55, 0.0, -0.02], "orientation": UP},
        "motion": None,
    }
    jaw = ("kind", "finger_joints", "finger_bodies", "opening_m", "finger_speed_m_s", "stiffness_n_m", "damping_ns_m")
    drives = (
        "joints", "home_rad", "velocity_limit_rad_s", "acceleration_limit_rad_s2", "torque_limit_nm", "stiffness_nm_rad",
        "damping_nms_rad", "tcp_site",
    )  # fmt: skip
    return {
        "control_period_s": 0.05,
        "gravity_m_s2": 9.81,
        "friction": friction,
        "table_friction": None,
        "contact": {
            "patch_radius_m": 5e-3,
            "rolling_m": 5e-4,
            "time_constant_s": 4e-3,
            "impedance": [0.95, 0.99, 0.001],
            "limit_impedance": [0.99, 0.999, 1e-4],
            "driven_mass_kg": 1e3,
        },
        "objects": [
            {
                "name": "object",
                "parts": [{"primitive": primitive, "pose": {"position": [0.0, 0.0, 0.0], "orientation": UP}}],
                "pose": {"position": [*at, half], "orientation": UP},
                "mass_kg": mass_kg,
                "centre_of_mass": [0.0, 0.0, 0.0],
                "inertia_kg_m2": np.diag(inertia * mass_kg * half * half).tolist(),
                "color": "#c83c28",
            }
        ],
        "fixtures": [table, *fixtures],
        "robot": {key: arm[key] for key in drives}
        | {
            "name": robot.name,
            "sha256": robot.sha256,
            "position_limit_rad": [model.joint(name).range.tolist() for name in arm["joints"]],
            "gripper": {key: gripper[key] for key in jaw} | {"force_n": force_n or gripper["force_n"], "pad_friction": friction},
            "scales": {"stiffness": 1.0, "grip_force": 1.0, "pad_friction": 1.0},
        },
        "visual": {},
    }
