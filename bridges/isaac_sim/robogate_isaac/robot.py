"""Reads a robot's folder: bodies, joints and shapes, from its MJCF file with MuJoCo's parser."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from robogate_bridge import Problem, robot_sha256


@dataclass(frozen=True)
class Shape:
    """A collision shape in the frame of its body: `box` by half extents; `sphere`, `capsule` and `cylinder` (axis z) by
    radius and half height."""

    kind: str
    size: list[float]
    pose: dict


@dataclass(frozen=True)
class Joint:
    """A hinge or slide about or along `axis` (in the body's frame) through `anchor`. It is 0 at the pose in the file."""

    name: str
    slides: bool
    axis: list[float]
    anchor: list[float]
    range: list[float]
    armature: float
    damping: float


@dataclass(frozen=True)
class Body:
    """A body. `pose` is in its parent's frame, or in the world frame if it has no parent. It is fixed if it has no joint."""

    name: str
    parent: str | None
    pose: dict
    mass: float
    centre: list[float]
    inertia: list[float]
    axes: list[float]
    joint: Joint | None
    shapes: list[Shape]


@dataclass(frozen=True)
class Robot:
    """A robot without its drives, which come with each cell."""

    name: str
    sha256: str
    joints: list[str]
    bodies: list[Body]
    sites: dict[str, tuple[str, dict]]
    model: mujoco.MjModel

    @classmethod
    def read(cls, folder):
        """Reads the robot of this folder. Raises a `Problem` if it cannot be used."""
        file = Path(folder) / "robot.toml"
        try:
            settings = tomllib.loads(file.read_text(encoding="utf-8"))
            name, arm, gripper = settings["name"], settings["arm"], settings["gripper"]["kind"]
            model = mujoco.MjModel.from_xml_path(str(file.parent / settings["model"]))
        except OSError as why:
            raise Problem("setup", f"{file}: {why.strerror}. Expected a folder with robot.toml and the model of the robot") from why
        except (tomllib.TOMLDecodeError, KeyError, ValueError) as why:
            raise Problem("setup", f"{file}: {type(why).__name__}: {why}") from why
        if gripper != "parallel_jaw":
            raise Problem("setup", f"{file}: expected a parallel gripper, found {gripper}")
        bodies = [_body(model, body) for body in range(1, model.nbody)]
        sites = {
            model.site(site).name: (model.body(model.site_bodyid[site]).name,
                                    _pose(model.site_pos[site], model.site_quat[site]))
            for site in range(model.nsite)
        }  # fmt: skip
        return cls(name, robot_sha256(folder), arm["joints"], bodies, sites, model)

    def places(self, joints):
        """The pose of each body at these joint positions, by name."""
        data = mujoco.MjData(self.model)
        for name, q in joints.items():
            data.qpos[self.model.joint(name).qposadr[0]] = q
        mujoco.mj_kinematics(self.model, data)
        return {body.name: _pose(data.body(body.name).xpos, data.body(body.name).xquat) for body in self.bodies}


def _body(model, body):
    name, parent = model.body(body).name, int(model.body_parentid[body])
    count = int(model.body_jntnum[body])
    if count > 1:
        raise Problem("setup", f"the body {name} has {count} joints. Expected at most one, because a link of PhysX has one")
    shapes = []
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] == body and (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            kind = mujoco.mjtGeom(model.geom_type[geom]).name.removeprefix("mjGEOM_").lower()
            if kind not in ("box", "sphere", "capsule", "cylinder"):
                raise Problem("setup", f"the body {name} has a shape of kind {kind}. Expected a primitive")
            shapes.append(Shape(kind, model.geom_size[geom].tolist(), _pose(model.geom_pos[geom], model.geom_quat[geom])))
    return Body(
        name=name,
        parent=model.body(parent).name if parent else None,
        pose=_pose(model.body_pos[body], model.body_quat[body]),
        mass=float(model.body_mass[body]),
        centre=model.body_ipos[body].tolist(),
        inertia=model.body_inertia[body].tolist(),
        axes=model.body_iquat[body].tolist(),
        joint=_joint(model, int(model.body_jntadr[body])) if count else None,
        shapes=shapes,
    )


def _joint(model, joint):
    kind = mujoco.mjtJoint(model.jnt_type[joint])
    if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        raise Problem("setup", f"the joint {model.joint(joint).name} is neither a hinge nor a slide")
    dof = int(model.jnt_dofadr[joint])
    return Joint(
        name=model.joint(joint).name,
        slides=kind == mujoco.mjtJoint.mjJNT_SLIDE,
        axis=model.jnt_axis[joint].tolist(),
        anchor=model.jnt_pos[joint].tolist(),
        range=model.jnt_range[joint].tolist(),
        armature=float(model.dof_armature[dof]),
        damping=float(np.asarray(model.dof_damping[dof]).reshape(-1)[0]),
    )


def _pose(position, orientation):
    return {"position": np.asarray(position).tolist(), "orientation": np.asarray(orientation).tolist()}
