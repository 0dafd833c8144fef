"""What happens in the physics of an episode: contacts, motion, energy and the solver, for `robogate requalify`.

A probe never writes to the model or the state that is stepped: it copies the state into data of its own and computes there.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from .model import Model
from .motion import sides

# The numbers of a frame before the poses, in this order.
SIGNALS = ("contacts", "penetration_m", "solver_iterations", "solver_residual", "potential_energy_j", "kinetic_energy_j", "warnings")
# The largest number of frames of an episode, and of bodies in a frame.
MAX_FRAMES, MAX_BODIES = 20_000, 200


class Probe:
    """Writes a file for each episode below a folder: a line of JSON, then 64-bit floats, one row for each control period.

    A row has the signals, the pose of each moving body (x, y, z, then the quaternion w, x, y, z), and 1 or 0 for each pair of things
    that touch in some row.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._model: Any = None
        self._index: int | None = None

    def begin(self, index: int, model: Model | None) -> None:
        """Start an episode in its initial state."""
        self._index = None
        if model is None:
            return
        if self._model is not model.model:
            self._bind(model.model)
        self._data, self._index, self._rows, self._touching = model.data, index, [], []
        self._copy()
        self._start = {name: self._pose(body) for body, name in self._placed}
        self.take()

    def take(self) -> None:
        """Add the present state."""
        if self._index is None or len(self._rows) >= MAX_FRAMES:
            return
        if not self._rows or self._copied != self._data.time:
            self._copy()
        poses = np.hstack([self._scratch.xpos[self._bodies], self._scratch.xquat[self._bodies]]) if self._bodies else np.zeros((0, 7))
        self._rows.append(np.concatenate([self._signals(), poses.ravel()]))

    def end(self) -> None:
        """Write the file of the episode."""
        if self._index is None:
            return
        pairs = sorted(set().union(*self._touching))
        columns = np.array([[float(pair in touching) for pair in pairs] for touching in self._touching]).reshape(len(self._rows), len(pairs))
        header = {
            "signals": SIGNALS,
            "bodies": [{"name": self._names[body], "robot": self._sides[body] == "robot"} for body in self._bodies],
            "pairs": pairs,
            "frames": len(self._rows),
            "start": self._start,
        }
        path, part = self._folder / f"{self._index}.probe", self._folder / f"{self._index}.{os.getpid()}.part"
        with open(part, "wb") as file:
            file.write(json.dumps(header).encode() + b"\n")
            file.write(np.hstack([np.array(self._rows), columns]).astype("<f8").tobytes())
        part.replace(path)
        self._index = None

    def _bind(self, model: Any) -> None:
        import mujoco

        self._model, self._scratch = model, mujoco.MjData(model)
        self._size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._state = np.empty(self._size)
        of = mujoco.mjtObj.mjOBJ_BODY
        self._names = [mujoco.mj_id2name(model, of, body) or f"body {body}" for body in range(model.nbody)]
        self._sides = sides(model)
        moving = [body for body in range(1, model.nbody) if model.body_weldid[body] == body and model.body_jntnum[body] > 0]
        self._bodies = moving[:MAX_BODIES]
        self._placed = [(body, self._names[body]) for body in range(1, model.nbody) if self._sides[body] != "robot"][:MAX_BODIES]
        # What touches: the robot, each moving body with what is fixed to it, and all that does not move.
        self._owner = []
        for body in range(model.nbody):
            fixed = int(model.body_weldid[body])
            side = self._sides[body]
            self._owner.append("robot" if side == "robot" else "surroundings" if fixed == 0 else self._names[fixed])

    def _copy(self) -> None:
        """Copy the state, and compute there what follows from it."""
        import mujoco

        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        mujoco.mj_getState(self._model, self._data, self._state, kind)
        mujoco.mj_setState(self._model, self._scratch, self._state, kind)
        mujoco.mj_forward(self._model, self._scratch)
        mujoco.mj_energyPos(self._model, self._scratch)
        mujoco.mj_energyVel(self._model, self._scratch)
        self._copied = self._data.time

    def _signals(self) -> list[float]:
        scratch, model = self._scratch, self._model
        touching, deepest, count = set(), 0.0, 0
        if scratch.ncon:
            contacts = scratch.contact
            geoms, distance = np.asarray(contacts.geom).reshape(-1, 2), np.asarray(contacts.dist)
            for (one, two), dist in zip(geoms, distance):
                if one < 0 or two < 0 or dist > 0.0:
                    continue
                count += 1
                deepest = max(deepest, -float(dist))
                pair = sorted((self._owner[model.geom_bodyid[one]], self._owner[model.geom_bodyid[two]]))
                if pair[0] != pair[1]:
                    touching.add(" and ".join(pair))
        self._touching.append(touching)
        # Of the last time step that the environment ran: what is computed here starts from its solution.
        iterations, residual = solver(self._data)
        energy = scratch.energy
        return [float(count), deepest, iterations, residual, float(energy[0]), float(energy[1]), float(self._data.warning.number.sum())]

    def _pose(self, body: int) -> list[float]:
        return [*self._scratch.xpos[body].tolist(), *self._scratch.xquat[body].tolist()]


def solver(data: Any) -> tuple[float, float]:
    """The iterations of the constraint solver, and the norm of its gradient at the end; NaN for what this version does not report."""
    counts = np.atleast_1d(getattr(data, "solver_niter", math.nan)).astype(float)
    iterations = float(counts.sum())
    try:
        largest = [
            float(data.solver.gradient.reshape(-1)[island * (len(data.solver) // len(counts)) + int(count) - 1])
            for island, count in enumerate(counts)
            if count > 0
        ]
        return iterations, max(largest, default=0.0)
    except Exception:  # the fields of the statistics differ between versions
        return iterations, math.nan


__all__ = ["Probe", "SIGNALS", "solver"]
