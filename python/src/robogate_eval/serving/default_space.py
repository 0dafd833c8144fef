"""What a run samples in an environment that declares no space of its own.

Knobs that the environment declares as functions are sampled over their ranges. Of the knobs of a MuJoCo model, a moderate range
around the nominal value is sampled: of those that the environment names, and otherwise of the things that the robot handles, the
force of the actuators, and the delay. The limits of a knob say what can be set, for example no gravity at all. A policy need not
work there, so they are not sampled by default.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from . import friction
from .knobs import Knob
from .model import Model, rigid

# The longest delay, in seconds. At least one control period.
DELAY_S = 0.1


def _factor(nominal: float) -> tuple:
    """Half to twice the nominal value."""
    return (0.5 * nominal, 2.0 * nominal, "log")


# By the first word of a knob's name: from its nominal value to what is sampled.
RANGES: dict[str, Callable[[float], tuple]] = {
    **dict.fromkeys(("mass", "inertia", "friction", "damping", "friction_loss"), _factor),
    "gain": lambda nominal: (0.8 * nominal, 1.25 * nominal, "log"),
    "gravity": lambda nominal: (0.9 * nominal, 1.1 * nominal),
    "size": lambda nominal: (0.9 * nominal, 1.1 * nominal),
    "light": _factor,
    **dict.fromkeys(("shift_x", "shift_y"), lambda nominal: (-0.03, 0.03)),
    "turn": lambda nominal: (-0.3, 0.3),
    **dict.fromkeys(("camera_x", "camera_y", "camera_z"), lambda nominal: (-0.02, 0.02)),
    "camera_turn": lambda nominal: (-0.05, 0.05),
    "noise": lambda nominal: (0.0, 0.01),
}


def default_space(knobs: Sequence[Knob], own: set[str], named: set[str], model: Model | None, period_s: float) -> dict[str, tuple]:
    """The ranges to sample, by the names of `knobs`. `own`: the names of knobs that are functions of the environment. `named`:
    those that it names, with `*` for all."""
    usual = {"gain", "action_delay", *(handled(model) if model is not None else ())} if "*" in named else set()
    space = {}
    for knob in knobs:
        if knob.name in own:
            space[knob.name] = tuple(knob.choices) if knob.choices else (knob.low, knob.high)
        elif knob.name in named or knob.name in usual:
            space[knob.name] = _range(knob, period_s)
    return {name: domain for name, domain in space.items() if domain}


def _range(knob: Knob, period_s: float) -> tuple:
    """A moderate range of a knob of the model. Empty if there is none around its nominal value."""
    if knob.name == "action_delay":
        steps = min(int(knob.high), round(DELAY_S / period_s))
        return (0, steps) if steps > 0 else ()
    kind = knob.name.partition(":")[0]
    low, high, *scale = RANGES[kind](float(knob.nominal))
    low, high = max(low, knob.low), min(high, knob.high)
    return (low, high, *scale) if low < high else ()


def handled(model: Model) -> list[str]:
    """The knobs of mass, friction and joints of the things that the robot handles: bodies that move, can touch something, and
    belong to a kinematic tree without an actuator."""
    m, robot = model.model, _actuated(model)
    names, joints, out = model.names("body"), model.names("joint"), []
    for body in range(1, m.nbody):
        if m.body_rootid[body] in robot or m.body_weldid[body] != body:
            continue
        if friction.geoms(m, rigid(m, body)):
            out += [f"mass:{names[body]}", f"friction:{names[body]}"]
            first = int(m.body_jntadr[body])
            for joint in range(first, first + int(m.body_jntnum[body])):
                out += [f"damping:{joints[joint]}", f"friction_loss:{joints[joint]}"]
    return out


def _actuated(model: Model) -> set[int]:
    """The roots of the kinematic trees that an actuator or a mocap body moves."""
    import mujoco

    m = model.model
    moved = [body for body in range(m.nbody) if m.body_mocapid[body] >= 0]
    for actuator in range(m.nu):
        kind, target = int(m.actuator_trntype[actuator]), int(m.actuator_trnid[actuator, 0])
        if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
            moved.append(int(m.jnt_bodyid[target]))
        elif kind == mujoco.mjtTrn.mjTRN_TENDON:
            moved += _pulled(m, target)
        elif kind == mujoco.mjtTrn.mjTRN_BODY:
            moved.append(target)
        elif target >= 0:
            # A site, or a slider-crank, which is given by two sites.
            moved.append(int(m.site_bodyid[target]))
    robot = {int(m.body_rootid[body]) for body in moved}
    # A mocap body moves an arm through a weld.
    mocap = {int(m.body_rootid[body]) for body in range(m.nbody) if m.body_mocapid[body] >= 0}
    return robot | {root for pair in _linked(m) if mocap.intersection(pair) for root in pair}


def _pulled(m: Any, tendon: int) -> list[int]:
    """The bodies that a tendon pulls."""
    import mujoco

    first = int(m.tendon_adr[tendon])
    bodies = []
    for wrap in range(first, first + int(m.tendon_num[tendon])):
        kind, what = int(m.wrap_type[wrap]), int(m.wrap_objid[wrap])
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            bodies.append(int(m.jnt_bodyid[what]))
        elif kind == mujoco.mjtWrap.mjWRAP_SITE:
            bodies.append(int(m.site_bodyid[what]))
    return bodies


def _linked(m: Any) -> list[tuple[int, int]]:
    """The roots of the two trees of each constraint that connects or welds bodies."""
    import mujoco

    def body(kind: int, index: int) -> int:
        return int(m.site_bodyid[index]) if kind == mujoco.mjtObj.mjOBJ_SITE else index

    kinds = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
    out = []
    for e in range(m.neq):
        if int(m.eq_type[e]) in kinds:
            # Older versions of MuJoCo connect bodies only.
            of = int(m.eq_objtype[e]) if hasattr(m, "eq_objtype") else int(mujoco.mjtObj.mjOBJ_BODY)
            first, second = (int(m.body_rootid[body(of, int(index))]) for index in (m.eq_obj1id[e], m.eq_obj2id[e]))
            out.append((first, second))
    return out
