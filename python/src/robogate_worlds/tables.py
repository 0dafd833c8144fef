"""The arrays that both processes share: one file for each group of worlds."""

import numpy as np

# Per-world numbers of a model, as RoboGate sends them: the field of mujoco_warp's Model, in this order. `opt.gravity` is a
# field of its options.
FIELDS = (
    "opt.gravity", "qpos0", "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_subtreemass",
    "body_inertia", "body_invweight0", "jnt_axis", "dof_armature", "dof_invweight0", "geom_size", "geom_aabb",
    "geom_rbound", "geom_pos", "geom_quat", "geom_friction", "actuator_gainprm", "actuator_biasprm", "eq_data",
)

# Columns of a command: before them are three control points of each joint's servo.
COMMAND = ("goal", "lead", "speed", "softness", "selected", "elapsed", "grip")

# Columns of a report of one time step. A force of -1 means that there is no contact.
REPORT = (
    "opening", "finger_0", "finger_1", "flags", "hit_body", "hit_other", "hit_force", "peak",
    "tcp_x", "tcp_y", "tcp_z", *(f"tcp_{row}{column}" for row in range(3) for column in range(3)),
    *(f"support_{axis}" for axis in ("fx", "fy", "fz", "tx", "ty", "tz")), "holding", "cup_travel",
)
# Pose and velocity of each free body follow.
BODY = 13

BODY_ON_OBJECT, OBJECT_ON_FIXTURE, NOT_FINITE = 1, 2, 4


class Tables:
    """The arrays of one group, mapped from its file."""

    def __init__(self, path, shapes):
        sizes = [int(np.prod(shape)) for shape in shapes.values()]
        self._all = np.memmap(path, dtype=np.float32, mode="w+", shape=(max(1, sum(sizes)),))
        self.layout, at = {}, 0
        for (name, shape), size in zip(shapes.items(), sizes):
            setattr(self, name, self._all[at : at + size].reshape(shape))
            self.layout[name] = {"offset": at, "shape": list(shape)}
            at += size
