"""Fakes of the classes of Isaac Sim that the server uses, so that all other code can be tested on any machine.

They have no physics: joints reach any command immediately, the object stays at rest and its weight acts on the table. The stage is
real, and the links are placed by the joints on it. The fakes check that only documented parameters are used, that `initialize` is
called before use, that indices do not follow the order of the chain, and that `World.reset` runs a step.
"""

import sys
from math import degrees
from types import ModuleType, SimpleNamespace

import numpy as np
import pxr
from pxr import Gf, Usd, UsdGeom, UsdPhysics

GRAVITY_SAG = 0.01


class Fakes:
    """One Isaac Sim: the stage, the state, and the contacts to report in addition to those of object and table."""

    def __init__(self):
        self.stage = None
        self.version = ("5.1.0-rc.19", "5.1.0", "rc.19", "5", "1", "0", "", "")
        self.more_contacts = []
        self.paths = {}
        self.apps = []

    def install(self):
        """Installs the fake modules for imports."""
        modules = {
            "isaacsim": {"SimulationApp": self._app()},
            "isaacsim.core": {},
            "isaacsim.core.api": {"World": self._world()},
            "isaacsim.core.prims": {"SingleArticulation": self._articulation(), "SingleRigidPrim": self._rigid()},
            "isaacsim.core.utils": {},
            "isaacsim.core.utils.types": {"ArticulationAction": Action},
            "isaacsim.core.version": {"get_version": lambda: self.version},
            "omni": {},
            "omni.usd": {"get_context": lambda: self},
            "omni.physx": {"get_physx_simulation_interface": lambda: self},
            "pxr.PhysicsSchemaTools": {"intToSdfPath": lambda number: self.paths[number]},
        }
        for name, content in modules.items():
            module = ModuleType(name)
            vars(module).update(content)
            sys.modules[name] = module
            parent, _, child = name.rpartition(".")
            if parent:
                setattr(sys.modules[parent] if parent != "pxr" else pxr, child, module)
        return self

    # omni.usd's context
    def new_stage(self):
        self.stage = Usd.Stage.CreateInMemory()

    def get_stage(self):
        return self.stage

    # omni.physx's simulation interface
    def get_full_contact_report(self):
        scene = UsdPhysics.Scene(self.stage.GetPrimAtPath("/physicsScene"))
        headers, points, anchors, contacts = [], [], [], []
        for path in self.objects:
            mass = UsdPhysics.MassAPI(self.stage.GetPrimAtPath(path)).GetMassAttr().Get()
            weight = mass * scene.GetGravityMagnitudeAttr().Get()
            # Two contact points share the weight.
            contacts.append((path, "/World/fixtures/fixture_0", [weight / 2, weight / 2]))
        contacts += self.more_contacts
        for one, two, forces in contacts:
            header = SimpleNamespace(actor0=self._number(one), actor1=self._number(two),
                                     contact_data_offset=len(points), num_contact_data=len(forces),
                                     friction_anchors_offset=len(anchors), num_friction_anchors_data=1)
            # A lateral force of 0.5 N.
            anchors.append(SimpleNamespace(impulse=SimpleNamespace(x=0.5 * self.dt, y=0.0, z=0.0)))
            headers.append(header)
            for force in forces:
                up = SimpleNamespace(x=0.0, y=0.0, z=1.0)
                points.append(SimpleNamespace(normal=up, impulse=SimpleNamespace(x=0.0, y=0.0, z=force * self.dt)))
        return headers, points, anchors

    def _number(self, path):
        number = abs(hash(path))
        self.paths[number] = path
        return number

    def _app(fakes):
        class SimulationApp:
            def __init__(self, launch_config=None, experience=""):
                fakes.apps.append(launch_config)

            def close(self, wait_for_replicator=True, skip_cleanup=False):
                pass

        return SimulationApp

    def _world(fakes):
        class World:
            def __init__(self, physics_dt=None, rendering_dt=None, stage_units_in_meters=None,
                         physics_prim_path="/physicsScene", sim_params=None, set_defaults=True, backend="numpy",
                         device=None):  # fmt: skip
                assert not set_defaults and fakes.stage.GetPrimAtPath(physics_prim_path).IsA(UsdPhysics.Scene)
                fakes.dt, self.path = physics_dt, physics_prim_path
                fakes.ready = False

            @classmethod
            def clear_instance(cls):
                pass

            def reset(self, soft=False):
                fakes.begin()
                # It runs a step, in which the object falls a little.
                for place, _ in fakes.objects.values():
                    place[2] -= GRAVITY_SAG
                fakes.ready = True

            def step(self, render=True, update_fabric=False):
                assert fakes.ready and not render
                fakes.advance()

            def get_physics_context(self):
                scene = UsdPhysics.Scene(fakes.stage.GetPrimAtPath(self.path))
                return SimpleNamespace(
                    get_gravity=lambda: (tuple(scene.GetGravityDirectionAttr().Get()), scene.GetGravityMagnitudeAttr().Get())
                )

        return World

    def _articulation(fakes):
        class SingleArticulation:
            def __init__(self, prim_path, name="articulation", position=None, translation=None, orientation=None,
                         scale=None, visible=None, reset_xform_properties=True, articulation_controller=None,
                         enable_residual_reports=False):  # fmt: skip
                assert fakes.stage.GetPrimAtPath(prim_path).HasAPI(UsdPhysics.ArticulationRootAPI)
                self.live = False

            def initialize(self, physics_sim_view=None):
                assert fakes.ready
                self.live = True

            def get_dof_index(self, dof_name):
                assert self.live
                return list(fakes.q).index(dof_name)

            def set_joint_positions(self, positions, joint_indices=None):
                fakes.write(fakes.q, positions, joint_indices)

            def set_joint_velocities(self, velocities, joint_indices=None):
                fakes.write(fakes.v, velocities, joint_indices)

            def get_joint_positions(self, joint_indices=None):
                return np.array(list(fakes.q.values()), dtype=np.float32)[joint_indices]

            def get_joint_velocities(self, joint_indices=None):
                return np.array(list(fakes.v.values()), dtype=np.float32)[joint_indices]

            def apply_action(self, control_actions):
                assert self.live
                fakes.target = control_actions

        return SingleArticulation

    def _rigid(fakes):
        class SingleRigidPrim:
            def __init__(self, prim_path, name="rigid_prim", position=None, translation=None, orientation=None, scale=None,
                         visible=None, reset_xform_properties=True, mass=None, density=None, linear_velocity=None,
                         angular_velocity=None):  # fmt: skip
                prim = fakes.stage.GetPrimAtPath(prim_path)
                assert prim.HasAPI(UsdPhysics.RigidBodyAPI), prim_path
                self.path, self.held = prim_path, UsdPhysics.MassAPI(prim)

            def initialize(self, physics_sim_view=None):
                assert fakes.ready

            def get_world_pose(self):
                if self.path in fakes.objects:
                    place, turn = fakes.objects[self.path]
                    return place.astype(np.float32), turn.astype(np.float32)
                return fakes.link(self.path)

            def set_world_pose(self, position=None, orientation=None):
                fakes.objects[self.path] = (np.array(position), np.array(orientation))

            def set_linear_velocity(self, velocity):
                assert velocity.shape == (3,)

            def set_angular_velocity(self, velocity):
                assert velocity.shape == (3,)

            def get_linear_velocity(self):
                return np.zeros(3, dtype=np.float32)

            def get_angular_velocity(self):
                return np.zeros(3, dtype=np.float32)

            def get_mass(self):
                return self.held.GetMassAttr().Get()

            def get_com(self):
                centre = np.array(self.held.GetCenterOfMassAttr().Get(), dtype=np.float32)
                return centre.reshape(1, 3), np.array([[1.0, 0.0, 0.0, 0.0]])

        return SingleRigidPrim

    def begin(self):
        """Bodies as on the stage, with joints in another order than that of the chain."""
        joints = [prim for prim in self.stage.Traverse() if prim.IsA(UsdPhysics.Joint)]
        self.joints = {str(joint.GetRelationship("physics:body1").GetTargets()[0]): joint for joint in joints}
        moving = sorted((prim.GetName() for prim in joints if not prim.IsA(UsdPhysics.FixedJoint)), reverse=True)
        self.q, self.v = {name: 0.0 for name in moving}, {name: 0.0 for name in moving}
        self.objects = {}
        for prim in self.stage.GetPrimAtPath("/World/objects").GetChildren():
            place = UsdGeom.Xformable(prim).GetLocalTransformation()
            turn = place.ExtractRotationQuat()
            self.objects[str(prim.GetPath())] = (
                np.array(place.ExtractTranslation()), np.array([turn.GetReal(), *turn.GetImaginary()])
            )  # fmt: skip

    def write(self, into, values, indices):
        names = list(into)
        for index, value in zip(indices, values, strict=True):
            into[names[index]] = float(value)

    def advance(self):
        names = list(self.q)
        for index, q in zip(self.target.joint_indices, self.target.joint_positions, strict=True):
            joint = self.stage.GetPrimAtPath(f"/World/robot/joints/{names[index]}")
            hinge = joint.IsA(UsdPhysics.RevoluteJoint)
            held = (UsdPhysics.RevoluteJoint if hinge else UsdPhysics.PrismaticJoint)(joint)
            unit = 1.0 / degrees(1.0) if hinge else 1.0
            low, high = held.GetLowerLimitAttr().Get() * unit, held.GetUpperLimitAttr().Get() * unit
            q = float(np.clip(q, low, high))
            name = names[index]
            self.v[name], self.q[name] = (q - self.q[name]) / self.dt, q

    def link(self, path):
        """The pose of a link from the joints on the stage."""
        matrix = self._matrix(path)
        turn = matrix.ExtractRotationQuat()
        return (np.array(matrix.ExtractTranslation(), dtype=np.float32),
                np.array([turn.GetReal(), *turn.GetImaginary()], dtype=np.float32))

    def _matrix(self, path):
        # USD's matrices multiply row vectors, so the first transform is on the left.
        joint = UsdPhysics.Joint(self.joints[path])
        parents = joint.GetBody0Rel().GetTargets()
        outer = self._matrix(str(parents[0])) if parents else Gf.Matrix4d(1.0)
        prim = joint.GetPrim()
        moved = Gf.Matrix4d(1.0)
        if prim.IsA(UsdPhysics.RevoluteJoint):
            assert UsdPhysics.RevoluteJoint(prim).GetAxisAttr().Get() == "Z"
            moved.SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), degrees(self.q[prim.GetName()])))
        elif prim.IsA(UsdPhysics.PrismaticJoint):
            assert UsdPhysics.PrismaticJoint(prim).GetAxisAttr().Get() == "Z"
            moved.SetTranslate(Gf.Vec3d(0, 0, self.q[prim.GetName()]))
        frames = []
        for side in (0, 1):
            frame = Gf.Matrix4d(1.0)
            frame.SetRotate(Gf.Quatd(prim.GetAttribute(f"physics:localRot{side}").Get()))
            frame.SetTranslateOnly(Gf.Vec3d(prim.GetAttribute(f"physics:localPos{side}").Get()))
            frames.append(frame)
        return frames[1].GetInverse() * moved * frames[0] * outer


class Action:
    """`ArticulationAction`."""

    def __init__(self, joint_positions=None, joint_velocities=None, joint_efforts=None, joint_indices=None):
        self.joint_positions, self.joint_velocities, self.joint_indices = joint_positions, joint_velocities, joint_indices
