"""Knobs of a MuJoCo model, by name.

| name | parameter | unit |
|---|---|---|
| `mass:BODY` | mass of the body; its inertia scales with it | kg |
| `inertia:BODY` | factor of the body's inertia | |
| `friction:BODY` | coefficient of sliding friction of all contacts of the body | |
| `size:BODY` | factor of the size of the body's geoms | |
| `shift_x:BODY`, `shift_y:BODY` | translation of a free body after the reset | m |
| `turn:BODY` | rotation of a free body about the vertical after the reset | rad |
| `damping:JOINT`, `friction_loss:JOINT` | of a joint with one degree of freedom | N m s/rad or N s/m; N m or N |
| `gain`, `gain:ACTUATOR` | factor of the force of all actuators, or of one (its name or index) | |
| `gravity` | along the direction of the model | m/s^2 |
| `light` | factor of the brightness of all lights | |
| `camera_x:CAMERA`, `camera_y:CAMERA`, `camera_z:CAMERA` | translation of a camera, in the frame of the body that holds it | m |
| `camera_turn:CAMERA` | rotation of a camera about the z axis of that body | rad |

A body or joint without a name has its number in the model, if the environment names a knob of it. A body that moves includes the bodies that are fixed to it. Every value is read from the model that the environment steps, friction from contacts (`friction.py`). A knob whose effect cannot be
read is not in the catalogue.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from . import friction, view_knobs
from .knobs import Knob
from .model import Model, rigid

SMALLEST_MASS_KG = 1e-3


def catalogue(model: Model, can_observe: bool, named: set[str], images: bool = False) -> list[Knob]:
    """The knobs of a model, in its nominal state after a reset. `can_observe`: the observation can be taken again after a change.
    `images`: the observation contains images.

    No two of them change the same quantity, unless `named` contains them: a part of a body, or a single actuator. What has no name
    has its number, if `named` contains a knob of it.
    """
    knobs = _gravity(model) + _gains(model, named)
    if can_observe or not images:
        knobs += view_knobs.catalogue(model, moves=images)
    of = {knob.partition(":")[2] for knob in named}
    for body, name in enumerate(model.names("body")):
        part = model.model.body_weldid[body] not in (0, body)
        own = name or str(body)
        if body and ((name and not part) or own in of):
            knobs += _body(model, body, own, can_observe)
    for joint, name in enumerate(model.names("joint")):
        own = name or str(joint)
        if name or own in of:
            knobs += _joint(model, joint, own)
    return knobs


def unnamed(model: Model, named: set[str]) -> list[tuple[str, str]]:
    """The bodies and joints that could be varied if they had a name, with what to do."""
    m, of, out = model.model, {knob.partition(":")[2] for knob in named}, []
    bodies = [body for body, name in enumerate(model.names("body")) if body and not name and m.body_weldid[body] == body]
    joints = [joint for joint, name in enumerate(model.names("joint")) if not name and m.jnt_type[joint] in (2, 3)]
    for kind, knob, found in (("body", "mass", bodies), ("joint", "damping", joints)):
        found = [str(index) for index in found if str(index) not in of]
        if found:
            what = f"{kind} {found[0]}" if len(found) == 1 else f"{len(found)} {'bodies' if kind == 'body' else 'joints'}"
            which = "" if len(found) == 1 else f" (numbers {', '.join(found[:8])}{', ...' if len(found) > 8 else ''})"
            out.append((what, f'no name{which}. To vary one, name it in the model, or use its number: knobs=["*", "{knob}:{found[0]}"]'))
    return out


def has_free_body(model: Model) -> bool:
    """Whether a body of the model moves freely."""
    return bool((model.model.jnt_type == 0).any())


def _gravity(model: Model) -> list[Knob]:
    g = float(np.linalg.norm(model.model.opt.gravity))
    if g == 0.0:
        return []
    direction = model.model.opt.gravity.copy() / g

    def write(env: Any, value: float) -> None:
        model.edit(model.model.opt.gravity, slice(None), direction * value)

    return [
        Knob("gravity", write, lambda env: float(np.linalg.norm(model.model.opt.gravity)), 0.0, 2.0 * g, nominal=g, unit="m/s^2",
             meaning="Gravitational acceleration.", read_from="opt.gravity of the model that is stepped")
    ]  # fmt: skip


def _gains(model: Model, named: set[str]) -> list[Knob]:
    names = model.names("actuator")
    count = len(names)
    if not count:
        return []
    knobs = [_gain(model, "gain", list(range(count)), "Factor of the force of all actuators.")]
    for i, name in enumerate(names):
        if f"gain:{name or i}" in named:
            knobs.append(_gain(model, f"gain:{name or i}", [i], f"Factor of the force of the actuator {name or i}."))
    return knobs


def _gain(model: Model, name: str, which: list[int], meaning: str) -> Knob:
    gain, bias = model.model.actuator_gainprm[which].copy(), model.model.actuator_biasprm[which].copy()

    def write(env: Any, value: float) -> None:
        # The bias has the position and velocity feedback of a servo, which scales with its gain.
        model.edit(model.model.actuator_gainprm, which, gain * value)
        model.edit(model.model.actuator_biasprm, which, bias * value)

    def read(env: Any) -> float:
        return _factor(model.model.actuator_gainprm[which], gain)

    return Knob(name, write, read, 0.1, 3.0, nominal=1.0, family="motors", meaning=meaning,
                read_from="actuator_gainprm of the model that is stepped")  # fmt: skip


def _factor(now: np.ndarray, base: np.ndarray) -> float:
    """The factor between two arrays. If the entries have different factors, their mean, so that an entry which does not follow is
    noticed."""
    used = base != 0.0
    if not used.any():
        return 1.0
    factors = now[used] / base[used]
    return float(factors[0] if np.ptp(factors) <= 1e-9 * abs(factors[0]) else factors.mean())


def _body(model: Model, body: int, name: str, can_observe: bool) -> list[Knob]:
    m, knobs = model.model, []
    bodies = rigid(m, body) if m.body_weldid[body] else [body]
    mass = float(m.body_mass[bodies].sum())
    free = m.body_jntnum[body] == 1 and m.jnt_type[m.body_jntadr[body]] == 0
    # A body that is welded to the world does not move, so its mass has no effect. Models give a negligible mass to bodies that
    # only hold a frame.
    if mass >= SMALLEST_MASS_KG and m.body_weldid[body] != 0:
        masses, inertias = m.body_mass[bodies].copy(), m.body_inertia[bodies].copy()
        knobs += [_mass(model, bodies, name, masses, inertias), _inertia(model, bodies, name, masses, inertias)]
    mine = friction.geoms(m, bodies)
    if mine:
        base = friction.read(model, bodies)
        if base is not None:
            knobs.append(_friction(model, bodies, name, base))
        # Meshes, planes and height fields have no size that can be scaled, and a body with parts would fall apart.
        if m.body_weldid[body] != 0 and bodies == [body] and all(2 <= m.geom_type[g] <= 6 for g in mine):
            knobs.append(_size(model, body, name, can_observe))
    if free and can_observe:
        knobs += _pose(model, body, name)
    return knobs


def _mass(model: Model, bodies: list[int], name: str, masses: np.ndarray, inertias: np.ndarray) -> Knob:
    mass = float(masses.sum())

    def write(env: Any, value: float) -> None:
        model.edit(model.model.body_mass, bodies, masses * (value / mass))
        model.edit(model.model.body_inertia, bodies, inertias * (value / mass))

    return Knob(
        f"mass:{name}", write, lambda env: float(model.model.body_mass[bodies].sum()), mass / 10.0, mass * 10.0, nominal=mass, unit="kg",
        family="bodies", meaning=f"Mass of {name}; its inertia scales with it.", read_from="body_mass of the model that is stepped",
    )  # fmt: skip


def _inertia(model: Model, bodies: list[int], name: str, masses: np.ndarray, inertias: np.ndarray) -> Knob:
    def unit() -> np.ndarray:
        return inertias * float(model.model.body_mass[bodies].sum() / masses.sum())

    def write(env: Any, value: float) -> None:
        model.edit(model.model.body_inertia, bodies, unit() * value)

    return Knob(
        f"inertia:{name}", write, lambda env: _factor(model.model.body_inertia[bodies], unit()), 0.1, 10.0, nominal=1.0,
        family="bodies", meaning=f"Factor of the inertia of {name} at its mass.", read_from="body_inertia of the model that is stepped",
    )  # fmt: skip


def _friction(model: Model, bodies: list[int], name: str, nominal: float) -> Knob:
    wanted: list[float] = [nominal]

    def write(env: Any, value: float) -> None:
        wanted[0] = value
        friction.write(model, bodies, value)

    def read(env: Any) -> float | None:
        return friction.read(model, bodies, wanted[0])

    def watch(env: Any) -> float | None:
        return friction.acting(model, bodies, wanted[0])

    return Knob(
        f"friction:{name}", write, read, 0.01, max(4.0, nominal), nominal=nominal, watch=watch,
        family="bodies", meaning=f"Coefficient of sliding friction of all contacts of {name}.", read_from="contacts of the body, in every step",
    )  # fmt: skip


def _size(model: Model, body: int, name: str, can_observe: bool) -> Knob:
    m = model.model
    first, count = int(m.body_geomadr[body]), int(m.body_geomnum[body])
    which = list(range(first, first + count))
    # Everything that is measured from the frame of the body, and the bounds that the collision detection uses.
    fields = [("geom_size", which), ("geom_pos", which), ("geom_rbound", which), ("body_ipos", body)]
    if hasattr(m, "geom_aabb"):
        fields.append(("geom_aabb", which))
    if hasattr(m, "bvh_aabb") and m.body_bvhnum[body]:
        start = int(m.body_bvhadr[body])
        fields.append(("bvh_aabb", list(range(start, start + int(m.body_bvhnum[body])))))
    base = {field: getattr(m, field)[index].copy() for field, index in fields}

    def write(env: Any, value: float) -> None:
        for field, index in fields:
            model.edit(getattr(model.model, field), index, base[field] * value)

    def read(env: Any) -> float:
        return _factor(model.model.geom_size[which], base["geom_size"])

    return Knob(
        f"size:{name}", write, read, 0.5, 2.0, nominal=1.0, moves=can_observe,
        family="bodies", meaning=f"Factor of the size of {name}. Its mass stays.", read_from="geom_size of the model that is stepped",
    )  # fmt: skip


def _pose(model: Model, body: int, name: str) -> list[Knob]:
    address = int(model.model.jnt_qposadr[model.model.body_jntadr[body]])
    def shift(axis: int) -> tuple[Callable, Callable]:
        def write(env: Any, value: float) -> None:
            model.data.qpos[address + axis] = model.start[address + axis] + value

        return write, lambda env: float(model.data.qpos[address + axis] - model.start[address + axis])

    def turn(env: Any, value: float) -> None:
        w, x, y, z = model.start[address + 3 : address + 7]
        c, s = math.cos(value / 2.0), math.sin(value / 2.0)
        # A rotation about the vertical of the world, then the orientation of the body.
        model.data.qpos[address + 3 : address + 7] = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)

    def turned(env: Any) -> float:
        w0, x0, y0, z0 = model.start[address + 3 : address + 7]
        w, x, y, z = model.data.qpos[address + 3 : address + 7]
        # The w and z components of (orientation now) x (inverse of that after the reset).
        cosine, sine = w * w0 + x * x0 + y * y0 + z * z0, -w * z0 - x * y0 + y * x0 + z * w0
        return 2.0 * math.atan2(sine, cosine)

    where = "qpos of the free joint"
    knobs = [
        Knob(f"shift_{axis}:{name}", *shift(i), -0.2, 0.2, nominal=0.0, unit="m", moves=True, read_from=where,
             family="layout", meaning=f"Translation of {name} along {axis}, from where the reset put it.")
        for i, axis in enumerate("xy")
    ]  # fmt: skip
    knobs.append(
        Knob(f"turn:{name}", turn, turned, -3.1, 3.1, nominal=0.0, unit="rad", moves=True, read_from=where,
             family="layout", meaning=f"Rotation of {name} about the vertical, from where the reset put it.")
    )  # fmt: skip
    return knobs


def _joint(model: Model, joint: int, name: str) -> list[Knob]:
    m = model.model
    kind, dof = int(m.jnt_type[joint]), int(m.jnt_dofadr[joint])
    if kind not in (2, 3):
        return []
    slides = kind == 2
    fields = [
        ("damping", "dof_damping", "N s/m" if slides else "N m s/rad", "Viscous damping"),
        ("friction_loss", "dof_frictionloss", "N" if slides else "N m", "Dry friction"),
    ]
    knobs = []
    for word, field, unit, meaning in fields:
        base = float(getattr(m, field)[dof])

        def write(env: Any, value: float, field: str = field) -> None:
            model.edit(getattr(model.model, field), dof, value)

        def read(env: Any, field: str = field) -> float:
            return float(getattr(model.model, field)[dof])

        high = 10.0 * base if base > 0.0 else 10.0
        knobs.append(
            Knob(f"{word}:{name}", write, read, 0.0, high, nominal=base, unit=unit, meaning=f"{meaning} of the joint {name}.",
                 family="joints", read_from=f"{field} of the model that is stepped")
        )  # fmt: skip
    return knobs


def self_test(model: Model, knobs: list[Knob], env: Any) -> tuple[list[Knob], list[tuple[str, str]]]:
    """Try every knob with a value that is not its nominal one. Returns those that read back, and the others with the reason."""
    kept, dropped = [], []
    for knob in knobs:
        # Not nominal, and inside the range.
        value = knob.low + 0.37 * (knob.high - knob.low)
        qpos = model.data.qpos.copy()
        try:
            knob.set(env, value)
            model.finish()
            found = knob.read(env)
        finally:
            model.data.qpos[:] = qpos
            model.restore()
        if found is None or not math.isclose(found, value, rel_tol=1e-6, abs_tol=1e-7):
            dropped.append((knob.name, f"{value:.6g} was written, but {'nothing' if found is None else format(found, '.6g')} acts"))
        else:
            kept.append(knob)
    model.finish()
    return kept, dropped


__all__ = ["catalogue", "has_free_body", "self_test", "unnamed"]
