"""The MuJoCo model inside an environment, and edits of it that can be undone."""

from __future__ import annotations

import copy
import hashlib
from typing import Any

import numpy as np

from .layers import attribute as _get
from .layers import layers


class NoModel(LookupError):
    """The environment has no MuJoCo model that can be found."""


def find(env: Any) -> tuple[Any, Any]:
    """The `MjModel` and `MjData` that an environment steps.

    Looks through wrappers (`env`, `unwrapped`) for `model` and `data`, `_model` and `_data`, robosuite's `sim` and dm_control's
    `physics`.

    Raises:
        NoModel: None of them has one.
    """
    import mujoco

    for here in layers(env):
        simulation, physics = _get(here, "sim"), _get(here, "physics")
        candidates = [
            (_get(here, "model"), _get(here, "data")),
            (_get(here, "_model"), _get(here, "_data")),
            (_get(_get(simulation, "model"), "_model"), _get(_get(simulation, "data"), "_data")),
            (_get(simulation, "model"), _get(simulation, "data")),
            (_get(_get(physics, "model"), "ptr"), _get(_get(physics, "data"), "ptr")),
        ]
        for model, data in candidates:
            if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData):
                return model, data
    raise NoModel(f"no MuJoCo model in {type(env).__name__}")


def rigid(model: Any, body: int) -> list[int]:
    """A body, and the bodies below it that are fixed to it."""
    bodies = [body]
    for other in range(body + 1, model.nbody):
        if int(model.body_parentid[other]) in bodies and model.body_weldid[other] == model.body_weldid[body]:
            bodies.append(other)
    return bodies


def _layout(model: Any) -> tuple:
    """What the numbers of bodies, joints and geoms of a model mean."""
    arrays = (model.body_parentid, model.body_weldid, model.jnt_type, model.jnt_bodyid, model.jnt_qposadr, model.geom_bodyid, model.geom_type)
    return (model.names, model.nu, *(array.tobytes() for array in arrays))


# What MuJoCo derives from masses, sizes and the reference configuration (`mj_setConst`). From 3.17 on, that function rewrites
# further fields, such as the relative poses of welds in `eq_data`.
DERIVED = (
    "body_subtreemass", "body_invweight0", "dof_invweight0", "dof_M0", "tendon_length0", "tendon_invweight0", "actuator_length0",
    "actuator_acc0", "cam_pos0", "cam_poscom0", "cam_mat0", "light_pos0", "light_poscom0", "light_dir0",
)  # fmt: skip
STATISTICS = ("meaninertia", "meanmass", "meansize", "extent")
# Large fields that do not depend on masses.
CONTENT = ("mesh_", "tex_", "hfield_", "skin_", "flex_", "name_", "text_", "bvh_", "oct_", "paths")


def _numbers(model: Any) -> dict[str, Any]:
    """The numeric fields of a model, as views of its memory."""
    fields = ((name, _get(model, name)) for name in dir(model) if not name.startswith(("_", *CONTENT)))
    return {name: value for name, value in fields if isinstance(value, np.ndarray) and value.dtype.kind in "fiub"}


def _values(array: Any, content: bytes) -> Any:
    """Bytes of an array as an array of the same kind and shape."""
    return np.frombuffer(content, array.dtype).reshape(array.shape)


class Model:
    """The model and data of an environment. Edits are undone before the next reset."""

    def __init__(self, env: Any):
        self._edits: list[tuple[Any, Any, Any]] = []
        # What the model had before the first derivation: the fields that it changed, and the statistics.
        self._before: tuple[dict[str, tuple[Any, Any]], dict[str, float]] | None = None
        # The fields of a model, and those that a derivation must leave alone, found once for each model.
        self._fields: tuple[Any, dict[str, Any], list[str]] | None = None
        # A model and a state of it, from which each reset starts.
        self._kept: tuple[Any, Any] | None = None
        # Friction that was requested in this episode, by geom.
        self.friction: dict[int, float] = {}
        self.model: Any = None
        self.data: Any = None
        # Whether a reset built a model with other bodies, joints or geoms than the first one.
        self.differs = False
        self._layout: tuple | None = None
        self.bind(env)

    def bind(self, env: Any) -> None:
        """Find the model again. An environment may build a new one in each reset."""
        model, data = find(env)
        if model is not self.model:
            import mujoco

            # For computations that must not change the episode.
            self.scratch = mujoco.MjData(model)
            layout = _layout(model)
            self._layout = self._layout or layout
            self.differs = layout != self._layout
        self.model, self.data = model, data
        # Views of the memory of the engine.
        self._state = (data.qpos, data.qvel, data.act, data.mocap_pos, data.mocap_quat, data.qacc_warmstart)
        self._warnings = data.warning.number
        self._no_warnings = bytes(self._warnings.nbytes)
        # Positions after the reset.
        self.start = data.qpos.copy()
        self._time = float(data.time)

    def keep_state(self) -> None:
        """Let each reset start from the present state. Some environments reset positions and velocities only, and what the solver
        remembers of the last episode then acts in the next one."""
        import mujoco

        state = np.empty(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._kept = (self.model, state)

    def before_reset(self) -> None:
        """Undo all edits, and return to the state that was kept."""
        self.restore()
        if self._kept is not None and self._kept[0] is self.model:
            import mujoco

            mujoco.mj_setState(self.model, self.data, self._kept[1], mujoco.mjtState.mjSTATE_INTEGRATION)

    def edit(self, array: Any, index: Any, value: Any) -> None:
        """Write to an array of the model, and remember what was there."""
        self._edits.append((array, index, array[index].copy()))
        array[index] = value

    def finish(self) -> None:
        """Compute what depends on edited fields, in the model and in the state."""
        import mujoco

        if self._edits:
            self.derive()
        # What the solver starts from is kept, so that nominal values give the episode of the environment alone.
        warm_start = self.data.qacc_warmstart.copy()
        mujoco.mj_forward(self.model, self.data)
        self.data.qacc_warmstart[:] = warm_start

    def derive(self) -> None:
        """Compute the constants that depend on masses and sizes, such as the inverse weights of constraints. Nothing else changes."""
        import mujoco

        model = self.model
        if self._fields is None or self._fields[0] is not model:
            self._fields = (model, _numbers(model), self._authored())
        _, fields, authored = self._fields
        if self._before is None:
            self._before = ({}, {name: getattr(model.stat, name) for name in STATISTICS})
        then = {name: array.tobytes() for name, array in fields.items()}
        mujoco.mj_setConst(model, self.scratch)
        for name in authored:
            fields[name][...] = _values(fields[name], then[name])
        for name, array in fields.items():
            if array.tobytes() != then[name]:
                self._before[0].setdefault(name, (array, _values(array, then[name])))

    def _authored(self) -> list[str]:
        """The fields that a derivation changes in the model without edits: the author set them, and they must stay."""
        import mujoco

        edited = [array[index].copy() for array, index, _ in self._edits]
        for array, index, value in reversed(self._edits):
            array[index] = value
        twin = copy.copy(self.model)
        for (array, index, _), value in zip(self._edits, edited):
            array[index] = value
        fields = {name: array for name, array in _numbers(twin).items() if name not in DERIVED}
        then = {name: array.tobytes() for name, array in fields.items()}
        mujoco.mj_setConst(twin, mujoco.MjData(twin))
        return [name for name, array in fields.items() if array.tobytes() != then[name]]

    def restore(self) -> None:
        """Undo all edits."""
        self.friction.clear()
        if self._before is not None:
            # The bytes of the environment's author, and not a new derivation.
            for array, values in self._before[0].values():
                array[...] = values
            for name, value in self._before[1].items():
                setattr(self.model.stat, name, value)
            self._before = None
        while self._edits:
            array, index, value = self._edits.pop()
            array[index] = value

    def advanced(self) -> bool:
        """Whether the data moved on in time since the last call. If not, the environment steps another model."""
        before, self._time = self._time, float(self.data.time)
        return self._time > before

    def diverged(self) -> str | None:
        """MuJoCo's warning about a state that is not finite, after which it resets the state silently."""
        # The same as `not self._warnings.any()`, five times as fast.
        if self._warnings.tobytes() == self._no_warnings:
            return None
        import mujoco

        for kind in ("BADQPOS", "BADQVEL", "BADQACC"):
            if self._warnings[int(getattr(mujoco.mjtWarning, f"mjWARN_{kind}"))]:
                return f"MuJoCo reported {kind} at {self.data.time:.3f} s"
        return None

    def hash(self) -> int:
        """A 64-bit hash of the full state."""
        return self.hash_of(self.state())

    def state(self) -> bytes:
        """The full state."""
        return b"".join(self._state)

    @staticmethod
    def hash_of(state: bytes) -> int:
        """The 64-bit hash of a full state."""
        return int.from_bytes(hashlib.blake2b(state, digest_size=8).digest(), "little")

    def names(self, kind: str) -> list[str]:
        """The names of all bodies, joints, actuators, cameras or lights; empty for one without a name."""
        import mujoco

        count = {"body": "nbody", "joint": "njnt", "actuator": "nu", "camera": "ncam", "light": "nlight"}[kind]
        of = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
        return [mujoco.mj_id2name(self.model, of, i) or "" for i in range(getattr(self.model, count))]
