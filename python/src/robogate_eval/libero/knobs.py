"""What can be varied in LIBERO, with the reader of each value.

The axes are those of LIBERO-Plus and LIBERO-PRO (layout, camera, initial state of the robot, instruction, light, background, noise of
sensors) and physics. Every value is read from the model or the state that is stepped.
"""

from __future__ import annotations

import math

import numpy as np

from ..serving import friction
from ..serving.knobs import Knob

WORDINGS = ("file_name", "task_file", "upper_case", "polite", "none")
CAMERA = "agentview"
ARM = slice(0, 7)
# The joint limits of the arm leave this much around the start.
LARGEST_OFFSET_RAD = 0.3


def knobs(world):
    """The knobs of an environment."""
    own = [] if world.only is not None else [_task(world)]
    return [*own, _initial_state(), *_layout(), _robot(), *_camera(), _light(), _background(), _image_noise(), _instruction(), *_physics()]


def _task(world):
    def choose(env, value):
        env.wanted_task = env.names.index(value)

    return Knob("task", choose, lambda env: env.name, choices=world.names, before_reset=True,
                meaning="Task of the suite.", read_from="the task file that is loaded")  # fmt: skip


def _initial_state():
    def choose(env, value):
        env.wanted_state = int(value)

    def read(env):
        states = env.states[:, 1 : 1 + env.model.nq]
        return int(np.abs(states - env.start).sum(axis=1).argmin())

    return Knob("initial_state", choose, read, 0, 49, integer=True, before_reset=True,
                meaning="Index of the benchmark's initial state.", read_from="positions of all joints after the reset")  # fmt: skip


def _layout():
    def shift(axis):
        def write(env, value):
            body = env.placed
            if env.moved:
                address = _address(env, body)
                env.data.qpos[address + axis] = env.start[address + axis] + value
            else:
                env.edits.edit(env.model.body_pos, (body, axis), _base(env, "body_pos")[body, axis] + value)

        def read(env):
            body = env.placed
            if env.moved:
                address = _address(env, body)
                return float(env.data.qpos[address + axis] - env.start[address + axis])
            return float(env.model.body_pos[body, axis] - _base(env, "body_pos")[body, axis])

        return write, read

    def turn(env, value):
        body, half = env.placed, value / 2
        spin = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
        if env.moved:
            address = _address(env, body) + 3
            env.data.qpos[address : address + 4] = _product(spin, env.start[address : address + 4])
        else:
            env.edits.edit(env.model.body_quat, body, _product(spin, _base(env, "body_quat")[body]))

    def turned(env):
        body = env.placed
        if env.moved:
            address = _address(env, body) + 3
            now, before = env.data.qpos[address : address + 4], env.start[address : address + 4]
        else:
            now, before = env.model.body_quat[body], _base(env, "body_quat")[body]
        w, _, _, z = _product(now, before * [1, -1, -1, -1])
        return 2.0 * math.atan2(z, w)

    where = "qpos of the object, or body_pos and body_quat of the fixture"
    out = [
        Knob(f"layout_{axis}_m", *shift(i), -0.1, 0.1, nominal=0.0, unit="m", moves=True, read_from=where, family="layout",
             meaning=f"Translation along {axis} of the object or fixture that the task is about, from its initial state.")
        for i, axis in enumerate("xy")
    ]  # fmt: skip
    return [*out, Knob("layout_turn_rad", turn, turned, -3.1, 3.1, nominal=0.0, unit="rad", moves=True, read_from=where,
                       family="layout", meaning="Rotation of it about the vertical, from its initial state.")]  # fmt: skip


def _robot():
    def direction(env):
        numbers = np.random.default_rng(env.state_index).normal(size=7)
        return numbers / np.linalg.norm(numbers)

    def write(env, value):
        import mujoco

        env.data.qpos[ARM] = env.start[ARM] + direction(env) * value
        mujoco.mj_forward(env.model, env.data)
        env.renew_robot_goal()

    return Knob("robot_offset_rad", write, lambda env: float(np.linalg.norm(env.data.qpos[ARM] - env.start[ARM])), 0.0,
                LARGEST_OFFSET_RAD, nominal=0.0, unit="rad", moves=True, read_from="qpos of the arm", family="start",
                meaning="Distance of the arm's start from the initial state, in joint space. Each initial state has its own direction.")  # fmt: skip


def _camera():
    def index(env):
        return env.model.camera(CAMERA).id

    def shift(axis):
        def write(env, value):
            env.edits.edit(env.model.cam_pos, (index(env), axis), _base(env, "cam_pos")[index(env), axis] + value)

        def read(env):
            return float(env.data.cam_xpos[index(env), axis] - _base(env, "cam_pos")[index(env), axis])

        return write, read

    def turn(env, value):
        spin = np.array([math.cos(value / 2), 0.0, 0.0, math.sin(value / 2)])
        env.edits.edit(env.model.cam_quat, index(env), _product(spin, _base(env, "cam_quat")[index(env)]))

    def turned(env):
        w, _, _, z = _product(env.model.cam_quat[index(env)], _base(env, "cam_quat")[index(env)] * [1, -1, -1, -1])
        return 2.0 * math.atan2(z, w)

    out = [
        Knob(f"camera_{axis}_m", *shift(i), -0.5, 0.5, nominal=0.0, unit="m", read_from="cam_xpos of the state", family="camera",
             meaning=f"Translation of the camera {CAMERA} along {axis}.")
        for i, axis in enumerate("xyz")
    ]  # fmt: skip
    return [*out, Knob("camera_turn_rad", turn, turned, -0.6, 0.6, nominal=0.0, unit="rad", read_from="cam_quat of the model",
                       family="camera", meaning=f"Rotation of the camera {CAMERA} about the vertical.")]  # fmt: skip


def _light():
    def write(env, value):
        env.edits.edit(env.model.light_diffuse, slice(None), _base(env, "light_diffuse") * value)
        env.edits.edit(env.model.vis.headlight.diffuse, slice(None), env.base["headlight"] * value)

    return Knob("light", write, lambda env: _factor(env.model.light_diffuse, _base(env, "light_diffuse")), 0.0, 3.0, nominal=1.0,
                read_from="light_diffuse of the model", family="light", meaning="Factor of the brightness of all lights.")  # fmt: skip


def _background():
    def materials(env):
        m = env.model
        objects = tuple(f"{name}_" for kinds in (env.task.objects, env.task.fixtures) for names in kinds.values() for name in names)
        arena = [b for b in range(m.nbody) if not m.body(b).name.startswith(("robot0_", "gripper0_", "mount0_", *objects))]
        used = m.geom_matid[np.isin(m.geom_bodyid, arena)]
        return np.unique(used[used >= 0])

    def write(env, value):
        chosen = materials(env)
        tinted = _base(env, "mat_rgba")[chosen]
        tinted[:, 1:3] *= 1.0 - value
        env.edits.edit(env.model.mat_rgba, chosen, tinted)

    def read(env):
        chosen = materials(env)
        return None if not len(chosen) else 1.0 - _factor(env.model.mat_rgba[chosen, 1:3], _base(env, "mat_rgba")[chosen, 1:3])

    return Knob("background_tint", write, read, 0.0, 1.0, nominal=0.0, read_from="mat_rgba of the model", family="background",
                meaning="Tint of the textures of table, floor and walls: at 1 they are red, at 0 unchanged.")  # fmt: skip


def _image_noise():
    def write(env, value):
        env.image_noise = value

    return Knob("image_noise", write, lambda env: env.image_noise, 0.0, 80.0, nominal=0.0, unit="levels",
                read_from="the renderer", family="image", meaning="Standard deviation of the noise of each colour of a pixel, of 255 levels.")  # fmt: skip


def _instruction():
    def write(env, value):
        env.wording = value

    return Knob("instruction", write, lambda env: env.wording, choices=WORDINGS, nominal="file_name", read_from="the instruction that is sent",
                family="wording", meaning="Wording: LIBERO's `task.language`, which follows from the file name; the text of the task file; upper case; with please; none.")  # fmt: skip


def _physics():
    wanted = [0.0]

    def rub(env, value):
        wanted[0] = value
        friction.write(env.edits, [env.handled], value)

    def rubbing(env):
        return friction.read(env.edits, [env.handled], wanted[0])

    def watch(env):
        values = friction.live(env.edits, [env.handled])
        return max(values, key=lambda value: abs(value - wanted[0])) if values else None

    def load(env, value):
        for field in ("body_mass", "body_inertia"):
            env.edits.edit(getattr(env.model, field), env.handled, _base(env, field)[env.handled] * value)
        env.edits.derive()

    def push(env, value):
        env.edits.edit(env.model.actuator_gainprm, (ARM, 0), _base(env, "actuator_gainprm")[ARM, 0] * value)

    return [
        Knob("friction", rub, rubbing, 0.02, 4.0, watch=watch, read_from="contacts of the body, in every step",
             meaning="Coefficient of sliding friction of all contacts of the object, drawer or knob that the task is about."),
        Knob("mass_factor", load, lambda env: float(env.model.body_mass[env.handled] / _base(env, "body_mass")[env.handled]), 0.1, 100.0,
             nominal=1.0, read_from="body_mass of the model", family="object", meaning="Factor of its mass and inertia."),
        Knob("torque_factor", push, lambda env: _factor(env.model.actuator_gainprm[ARM, 0], _base(env, "actuator_gainprm")[ARM, 0]), 0.1, 3.0,
             nominal=1.0, read_from="actuator_gainprm of the model", family="motors", meaning="Factor of the torques of the arm's motors."),
    ]  # fmt: skip


def _address(env, body):
    return int(env.model.jnt_qposadr[env.model.body_jntadr[body]])


def _base(env, field):
    """The value of a field before any edit."""
    return env.base[field].copy()


def _factor(now, base):
    """The common factor of two arrays. None if they have no common factor."""
    nonzero = base != 0.0
    factors = now[nonzero] / base[nonzero]
    if not len(factors) or not np.allclose(factors, factors[0], rtol=1e-6, atol=1e-9):
        return None
    return float(factors[0])


def _product(a, b):
    """The product of two quaternions (w, x, y, z)."""
    w, x, y, z = a
    p, q, r, s = b
    return np.array([w * p - x * q - y * r - z * s, w * q + x * p + y * s - z * r, w * r - x * s + y * p + z * q, w * s + x * r - y * q + z * p])
