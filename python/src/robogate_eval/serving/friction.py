"""Friction of bodies, written so that it acts and read from contacts.

MuJoCo takes the larger friction of the two geoms of a contact, unless one of them has a higher priority. A value that is only
written to the geoms of a body therefore has no effect where the other geom has more friction, although it reads back from the
model. So the priority of the body's geoms is raised, and friction is read from contacts that the engine made.

A contact takes its stiffness from the geom of higher priority too. So with this knob the contacts of the body have the `solref`,
`solimp` and `condim` of the body's own geoms. A `<pair>` of the model keeps what it declares, apart from the friction.
"""

from __future__ import annotations

from typing import Any

import numpy as np


from .model import Model


def geoms(model: Any, bodies: list[int]) -> list[int]:
    """The geoms of these bodies that can collide."""
    paired = _paired(model)
    return [g for g in _all_geoms(model, bodies) if model.geom_contype[g] or model.geom_conaffinity[g] or any(g in pair for pair in paired)]


def _paired(model: Any) -> list[tuple[int, int]]:
    """The pairs of geoms that the model declares. They collide in any case."""
    return list(zip(model.pair_geom1.tolist(), model.pair_geom2.tolist()))


def _all_geoms(model: Any, bodies: list[int]) -> list[int]:
    return [g for b in bodies for g in range(int(model.body_geomadr[b]), int(model.body_geomadr[b] + model.body_geomnum[b]))]


def write(model: Model, bodies: list[int], value: float, raise_priority: bool = True) -> None:
    """Set the coefficient of sliding friction of every contact of these bodies with others.

    All bodies whose friction is set have the same priority, so MuJoCo's own rule holds between two of them: the larger counts.
    """
    m, mine = model.model, geoms(model.model, bodies)
    raised = max(m.geom_priority[geom] for geom in range(m.ngeom) if geom not in model.friction) + 1
    model.edit(m.geom_friction, (mine, 0), value)
    model.friction.update(dict.fromkeys(mine, value))
    for number, pair in enumerate(_paired(m)):
        # A declared pair has its own friction, in two directions.
        if any(geom in mine for geom in pair):
            model.edit(m.pair_friction, (number, slice(0, 2)), max(model.friction.get(geom, 0.0) for geom in pair))
    if raise_priority:
        model.edit(m.geom_priority, mine, raised)


def live(model: Model, bodies: list[int]) -> list[float]:
    """The coefficients of sliding friction of the present contacts of these bodies with others."""
    return [found for found, _ in _of(model.model, model.data, bodies)]


def acting(model: Model, bodies: list[int], wanted: float) -> float | None:
    """The coefficient that acts on these bodies now, None without a contact. It is `wanted` if all contacts are as they must be."""
    return _judged(model, _of(model.model, model.data, bodies), wanted)


def _judged(model: Model, contacts: list[tuple[float, int]], wanted: float) -> float | None:
    """The value of the contacts, each with the geom of the other body: `wanted`, or that of the first contact which is wrong."""
    for found, other in contacts:
        # The other body may have a requested friction too.
        due = max(wanted, model.friction.get(other, 0.0))
        if abs(found - due) > 1e-9 * max(1.0, due):
            return found
    return wanted if contacts else None


def _of(m: Any, data: Any, bodies: list[int]) -> list[tuple[float, int]]:
    """The contacts of these bodies with others: coefficient of sliding friction, and geom of the other body."""
    count = data.ncon
    if not count:
        return []
    contact = data.contact
    if not hasattr(contact, "friction"):
        pairs = ((c, m.geom_bodyid[c.geom1] in bodies, m.geom_bodyid[c.geom2] in bodies) for c in (contact[i] for i in range(count)))
        return [(float(c.friction[0]), int(c.geom2 if first else c.geom1)) for c, first, second in pairs if first != second]
    first, second = (np.isin(m.geom_bodyid[geom], bodies) for geom in (contact.geom1, contact.geom2))
    touching = first != second
    if not touching.any():
        return []
    others = np.where(first, contact.geom2, contact.geom1)[touching]
    return list(zip(contact.friction[touching, 0].tolist(), others.tolist()))


def read(model: Model, bodies: list[int], wanted: float | None = None) -> float | None:
    """The coefficient that the contacts of these bodies have. None if they have none and none can be made.

    If they touch nothing, a copy of the state is taken in which they do, and the engine makes the contact. Without `wanted`, the
    largest value is returned; with it, `wanted` if all contacts are as they must be, otherwise a value that is not.
    """
    contacts = _of(model.model, model.data, bodies) or _probe(model, bodies)
    if wanted is not None:
        return _judged(model, contacts, wanted)
    return max((found for found, _ in contacts), default=None)


def _probe(model: Model, bodies: list[int]) -> list[tuple[float, int]]:
    """Move the geoms of these bodies onto those of other bodies, in a copy of the state, and collide."""
    import mujoco

    m, scratch = model.model, model.scratch
    scratch.qpos[:] = model.data.qpos
    if m.nmocap:
        scratch.mocap_pos[:], scratch.mocap_quat[:] = model.data.mocap_pos, model.data.mocap_quat
    mujoco.mj_kinematics(m, scratch)
    mujoco.mj_comPos(m, scratch)
    all_of_body = _all_geoms(m, bodies)
    places = scratch.geom_xpos[all_of_body].copy()
    flags = int(m.opt.disableflags)
    # The midphase uses positions of bodies, which are not moved here.
    m.opt.disableflags = flags | int(getattr(mujoco.mjtDisableBit, "mjDSBL_MIDPHASE", 0))
    found: list[tuple[float, int]] = []
    try:
        for mine in geoms(m, bodies):
            for other in _partners(m, bodies[0], mine):
                scratch.geom_xpos[all_of_body] = places + (scratch.geom_xpos[other] - scratch.geom_xpos[mine])
                mujoco.mj_collision(m, scratch)
                met = _of(m, scratch, bodies)
                scratch.geom_xpos[all_of_body] = places
                if met:
                    found += met
                    break
    finally:
        m.opt.disableflags = flags
    return found


def _partners(m: Any, body: int, geom: int) -> list[int]:
    """Up to eight geoms that this geom can touch: movable ones first, since these are what a policy brings to it."""
    out = []
    paired = {other for pair in _paired(m) if geom in pair for other in pair}
    for other in range(m.ngeom):
        its = int(m.geom_bodyid[other])
        if m.body_weldid[its] == m.body_weldid[body]:
            continue
        if other in paired or (m.geom_contype[geom] & m.geom_conaffinity[other]) or (m.geom_contype[other] & m.geom_conaffinity[geom]):
            out.append((m.body_weldid[its] == 0, -other, other))
    return [other for _, _, other in sorted(out)][:8]
