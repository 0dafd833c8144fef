"""Reads a MuJoCo scene: poses, joints, and the heights of surfaces below the gripper.

This is privileged state. A scripted controller may use it, because it exists to show that a task can be solved. Lengths are
in metres, angles in radians, positions in the world frame.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

# In the copy of the model that rays are cast in, geoms of group 0 are surfaces, and rays pass through the others.
SURFACES = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Heights:
    """Heights of the highest surface in a grid of points, and whether the object is that surface.

    `top[i, j]` is the height at `x[i]`, `y[j]`.
    """

    x: np.ndarray
    y: np.ndarray
    top: np.ndarray
    mine: np.ndarray

    @property
    def spacing(self):
        """Distance between two points of the grid."""
        return self.x[1] - self.x[0]


class Scene:
    """A view of the state of a simulation. It reads the current state each time."""

    def __init__(self, model, data, robot, hand, fingers, shoulder):
        """`robot` lists prefixes of the names of the robot's bodies. `hand` is the site between the fingertips: its x axis is
        the direction in which the fingers close, and its z axis points out of the hand. `fingers` are the joints of the two
        fingers, whose positions differ by the width of the opening. `shoulder` is the body of the second joint."""
        self.model, self.data = model, data
        self._hand = self._id(mujoco.mjtObj.mjOBJ_SITE, hand)
        self._fingers = [model.jnt_qposadr[self._id(mujoco.mjtObj.mjOBJ_JOINT, name)] for name in fingers]
        self._shoulder = self._id(mujoco.mjtObj.mjOBJ_BODY, shoulder)
        mine = [i for i in range(model.nbody) if model.body(i).name.startswith(tuple(robot))]
        # MuJoCo's rays pass through geoms that are not visible, and most collision geoms are not.
        self._rays = copy.copy(model)
        self._rays.geom_rgba[:, 3] = 1.0
        self._rays.geom_matid[:] = -1
        collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        self._rays.geom_group[:] = np.where(collides & ~np.isin(model.geom_bodyid, mine), 0, 1)

    def _id(self, kind, name):
        found = mujoco.mj_name2id(self.model, kind, name)
        if found < 0:
            raise KeyError(f"the model has no {kind.name.removeprefix('mjOBJ_').lower()} {name!r}")
        return found

    # The hand

    @property
    def hand(self):
        """The position of the point between the fingertips."""
        return self.data.site_xpos[self._hand].copy()

    @property
    def hand_axes(self):
        """The orientation of the hand, as a matrix of its axes."""
        return self.data.site_xmat[self._hand].reshape(3, 3).copy()

    @property
    def shoulder(self):
        """The position of the robot's shoulder."""
        return self.data.xpos[self._shoulder].copy()

    @property
    def opening(self):
        """The distance between the fingers."""
        first, second = (float(self.data.qpos[address]) for address in self._fingers)
        return abs(first - second)

    # Bodies, joints and sites

    def body(self, name):
        """The position of a body."""
        return self.data.xpos[self._id(mujoco.mjtObj.mjOBJ_BODY, name)].copy()

    def body_axes(self, name):
        """The orientation of a body, as a matrix of its axes."""
        return self.data.xmat[self._id(mujoco.mjtObj.mjOBJ_BODY, name)].reshape(3, 3).copy()

    def site(self, name):
        """The position of a site."""
        return self.data.site_xpos[self._id(mujoco.mjtObj.mjOBJ_SITE, name)].copy()

    def site_axes(self, name):
        """The orientation of a site, as a matrix of its axes."""
        return self.data.site_xmat[self._id(mujoco.mjtObj.mjOBJ_SITE, name)].reshape(3, 3).copy()

    def site_half_size(self, name):
        """Half the size of a site, along its own axes."""
        return self.model.site_size[self._id(mujoco.mjtObj.mjOBJ_SITE, name)].copy()

    def site_body(self, name):
        """The name of the body that carries a site."""
        return self.model.body(self.model.site_bodyid[self._id(mujoco.mjtObj.mjOBJ_SITE, name)]).name

    def joint_of(self, body):
        """The joint of a body that slides or turns. None if it has none."""
        found = self._id(mujoco.mjtObj.mjOBJ_BODY, body)
        first, count = self.model.body_jntadr[found], self.model.body_jntnum[found]
        moving = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
        return next((j for j in range(first, first + count) if int(self.model.jnt_type[j]) in moving), None)

    def joint_position(self, joint):
        """The position of a joint: metres or radians."""
        return float(self.data.qpos[self.model.jnt_qposadr[joint]])

    def joint_axis(self, joint):
        """The axis of a joint in the world frame."""
        return self.data.xaxis[joint].copy()

    def joint_anchor(self, joint):
        """A point on the axis of a joint, in the world frame."""
        return self.data.xanchor[joint].copy()

    # Shapes

    def subtree(self, body):
        """The indices of a body and of all bodies that it carries."""
        found = self._id(mujoco.mjtObj.mjOBJ_BODY, body)
        inside = [found]
        for i in range(found + 1, self.model.nbody):
            if self.model.body_parentid[i] in inside:
                inside.append(i)
        return inside

    def collision_geoms(self, bodies):
        """The indices of the colliding geoms of these bodies."""
        collides = (self.model.geom_contype != 0) | (self.model.geom_conaffinity != 0)
        return np.flatnonzero(collides & np.isin(self.model.geom_bodyid, bodies))

    def corners(self, geoms):
        """Points of the boundary of these geoms, n x 3: the corners of their bounding boxes, the vertices of meshes."""
        return np.concatenate([self._corners(g) for g in geoms])

    def _corners(self, g):
        kind, size = self.model.geom_type[g], self.model.geom_size[g]
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = self.model.geom_dataid[g]
            first = self.model.mesh_vertadr[mesh]
            local = self.model.mesh_vert[first : first + self.model.mesh_vertnum[mesh]]
        else:
            half = {
                mujoco.mjtGeom.mjGEOM_BOX: size,
                mujoco.mjtGeom.mjGEOM_CYLINDER: [size[0], size[0], size[1]],
                mujoco.mjtGeom.mjGEOM_CAPSULE: [size[0], size[0], size[0] + size[1]],
                mujoco.mjtGeom.mjGEOM_ELLIPSOID: size,
            }.get(kind, [size[0]] * 3)
            local = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * half
        return self.data.geom_xpos[g] + local @ self.data.geom_xmat[g].reshape(3, 3).T

    def bounds(self, body):
        """The lowest and the highest coordinates of the colliding geoms of a body and of all that it carries."""
        points = self.corners(self.collision_geoms(self.subtree(body)))
        return points.min(axis=0), points.max(axis=0)

    # Heights

    def height(self, x, y, start, ignore=()):
        """The height of the highest surface below `start` at this point; -inf if there is none. The robot and the bodies in
        `ignore` (indices) are no surfaces."""
        return self.highest([(x, y)], start, ignore)

    def heights(self, x, y, start, mine=(), ignore=()):
        """Heights in the grid of these coordinates. `mine` are the indices of the object's bodies."""
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        top, geoms = self._cast(grid.reshape(-1, 2), start, ignore)
        is_mine = (geoms >= 0) & np.isin(self.model.geom_bodyid[geoms], list(mine))
        return Heights(np.asarray(x), np.asarray(y), top.reshape(grid.shape[:2]), is_mine.reshape(grid.shape[:2]))

    def highest(self, points, start, ignore=()):
        """The height of the highest surface below `start` at any of these points (n x 2); -inf if there is none."""
        return float(self._cast(points, start, ignore)[0].max())

    def _cast(self, points, start, ignore):
        group = self._rays.geom_group.copy()
        self._rays.geom_group[np.isin(self.model.geom_bodyid, list(ignore))] = 1
        top, geoms, geom = np.full(len(points), -np.inf), np.full(len(points), -1), np.array([-1], dtype=np.int32)
        for i, (x, y) in enumerate(points):
            distance = mujoco.mj_ray(self._rays, self.data, np.array([x, y, start]), DOWN, SURFACES, 1, -1, geom)
            if distance >= 0:
                top[i], geoms[i] = start - distance, geom[0]
        self._rays.geom_group[:] = group
        return top, geoms
