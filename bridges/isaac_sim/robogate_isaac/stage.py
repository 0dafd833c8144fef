"""A cell as a USD stage, with the schemas of UsdPhysics and, as plain attributes, of PhysX. It needs no module of Isaac Sim: any
USD tool can open the authored stage."""

from math import degrees, radians, sqrt

import mujoco
import numpy as np
from pxr import Gf, Sdf, UsdGeom, UsdPhysics, UsdShade
from robogate_bridge import Part, Problem, combined, is_table, parallel_jaw, table_friction, turned

ROBOT = "/World/robot"
OBJECTS = "/World/objects"
FIXTURES = "/World/fixtures"
MATERIALS = "/World/materials"
SCENE = "/physicsScene"


class Cell:
    """A cell on a stage: writes it and reads it back."""

    def __init__(self, stage, robot, cell, time_step_s):
        self._stage, self._robot, self._cell = stage, robot, cell
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
        self._scene(time_step_s)
        self._materials()
        self._add_robot()
        self._add_fixtures()
        for i, thing in enumerate(cell["objects"]):
            self._add_object(object_path(i), thing)

    def _scene(self, time_step_s):
        scene = UsdPhysics.Scene.Define(self._stage, SCENE)
        scene.CreateGravityDirectionAttr(Gf.Vec3f(0.0, 0.0, -1.0))
        scene.CreateGravityMagnitudeAttr(self._cell["gravity_m_s2"])
        prim = scene.GetPrim()
        prim.AddAppliedSchema("PhysxSceneAPI")
        # With one scene and one environment, the CPU is faster and its results are reproducible.
        _set(prim, "physxScene:enableGPUDynamics", Sdf.ValueTypeNames.Bool, False)
        _set(prim, "physxScene:broadphaseType", Sdf.ValueTypeNames.Token, "MBP")
        _set(prim, "physxScene:solverType", Sdf.ValueTypeNames.Token, "TGS")
        _set(prim, "physxScene:enableEnhancedDeterminism", Sdf.ValueTypeNames.Bool, True)
        _set(prim, "physxScene:timeStepsPerSecond", Sdf.ValueTypeNames.UInt, round(1.0 / time_step_s))

    def _materials(self):
        """Sets the friction. PhysX multiplies the coefficients of two shapes, so the objects have the square root of theirs, and all
        others have what gives the requested product."""
        friction = self._cell["friction"]
        own = {"other": friction, "table": table_friction(self._cell), "pad": parallel_jaw(self._cell)["pad_friction"]}
        if friction == 0.0 and any(own.values()):
            raise Problem("setup", "PhysX multiplies coefficients, so objects without friction cannot have friction on the table or the pads")
        root = sqrt(friction)
        for name, coefficient in {"object": root, **{name: mu / root if root else 1.0 for name, mu in own.items()}}.items():
            material = UsdShade.Material.Define(self._stage, f"{MATERIALS}/{name}")
            held = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
            held.CreateStaticFrictionAttr(coefficient)
            held.CreateDynamicFrictionAttr(coefficient)
            held.CreateRestitutionAttr(0.0)
            material.GetPrim().AddAppliedSchema("PhysxMaterialAPI")
            _set(material.GetPrim(), "physxMaterial:frictionCombineMode", Sdf.ValueTypeNames.Token, "multiply")

    def _add_robot(self):
        drives = self._cell["robot"]
        gripper = drives["gripper"]
        home = dict(zip(drives["joints"], drives["home_rad"], strict=True))
        home |= {name: 0.5 * gripper["opening_m"] for name in gripper["finger_joints"]}
        root = UsdGeom.Xform.Define(self._stage, ROBOT).GetPrim()
        UsdPhysics.ArticulationRootAPI.Apply(root)
        root.AddAppliedSchema("PhysxArticulationAPI")
        _set(root, "physxArticulation:enabledSelfCollisions", Sdf.ValueTypeNames.Bool, False)
        _set(root, "physxArticulation:solverPositionIterationCount", Sdf.ValueTypeNames.Int, 32)
        _set(root, "physxArticulation:solverVelocityIterationCount", Sdf.ValueTypeNames.Int, 4)
        _set(root, "physxArticulation:sleepThreshold", Sdf.ValueTypeNames.Float, 0.0)
        places = self._robot.places(home)
        for body in self._robot.bodies:
            path = f"{ROBOT}/{body.name}"
            link = self._rigid(path, places[body.name], body.mass, body.centre, body.inertia, body.axes)
            # The weight of the arm itself is compensated, as in the controller of a real arm.
            _set(link, "physxRigidBody:disableGravity", Sdf.ValueTypeNames.Bool, True)
            for i, shape in enumerate(body.shapes):
                material = "pad" if body.name in gripper["finger_bodies"] else "other"
                self._collider(f"{path}/shape_{i}", shape.kind, shape.size, shape.pose, material)
            if body.parent is None:
                # The base stands on the table, so its contacts with fixtures are ignored.
                filtered = UsdPhysics.FilteredPairsAPI.Apply(link).CreateFilteredPairsRel()
                for i in range(len(self._cell["fixtures"])):
                    filtered.AddTarget(f"{FIXTURES}/fixture_{i}")
            self._add_joint(body, drives)

    def _add_joint(self, body, drives):
        joint = body.joint
        path = f"{ROBOT}/joints/{joint.name if joint else body.name + '_fixed'}"
        if joint is None:
            made = UsdPhysics.FixedJoint.Define(self._stage, path)
            anchor, turn = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
        else:
            kind = UsdPhysics.PrismaticJoint if joint.slides else UsdPhysics.RevoluteJoint
            made = kind.Define(self._stage, path)
            made.CreateAxisAttr("Z")
            # USD's limits of hinges are in degrees.
            low, high = joint.range if joint.slides else map(degrees, joint.range)
            made.CreateLowerLimitAttr(low)
            made.CreateUpperLimitAttr(high)
            anchor, turn = joint.anchor, _z_to(joint.axis)
        inside = {"position": anchor, "orientation": turn}
        outside = combined(body.pose, inside)
        if body.parent is not None:
            made.CreateBody0Rel().SetTargets([f"{ROBOT}/{body.parent}"])
        made.CreateBody1Rel().SetTargets([f"{ROBOT}/{body.name}"])
        made.CreateLocalPos0Attr(Gf.Vec3f(*outside["position"]))
        made.CreateLocalRot0Attr(Gf.Quatf(*outside["orientation"]))
        made.CreateLocalPos1Attr(Gf.Vec3f(*inside["position"]))
        made.CreateLocalRot1Attr(Gf.Quatf(*inside["orientation"]))
        if joint is None:
            return
        prim = made.GetPrim()
        prim.AddAppliedSchema("PhysxJointAPI")
        _set(prim, "physxJoint:armature", Sdf.ValueTypeNames.Float, joint.armature)
        _set(prim, "physxJoint:jointFriction", Sdf.ValueTypeNames.Float, 0.0)
        gains = drive_of(joint.name, drives)
        if gains is None:
            return
        stiffness, damping, most = gains
        # The joint's own damping acts through the drive: see `damped`. USD's gains of hinges are per degree.
        unit = 1.0 if joint.slides else radians(1.0)
        drive = UsdPhysics.DriveAPI.Apply(prim, "linear" if joint.slides else "angular")
        drive.CreateTypeAttr("force")
        drive.CreateStiffnessAttr(stiffness * unit)
        drive.CreateDampingAttr((damping + joint.damping) * unit)
        drive.CreateMaxForceAttr(most)

    def _add_fixtures(self):
        UsdGeom.Scope.Define(self._stage, FIXTURES)
        for i, fixture in enumerate(self._cell["fixtures"]):
            path = f"{FIXTURES}/fixture_{i}"
            body = UsdGeom.Xform.Define(self._stage, path)
            _place(body, fixture["pose"])
            if fixture["motion"] is not None:
                held = UsdPhysics.RigidBodyAPI.Apply(body.GetPrim())
                held.CreateKinematicEnabledAttr(True)
            still = {"position": [0.0, 0.0, 0.0], "orientation": [1.0, 0.0, 0.0, 0.0]}
            self._collider(f"{path}/shape", *_sizes(fixture["primitive"]), still, "table" if is_table(fixture) else "other")

    def _add_object(self, path, thing):
        moments, axes = principal(thing["inertia_kg_m2"])
        prim = self._rigid(path, thing["pose"], thing["mass_kg"], thing["centre_of_mass"], moments, axes)
        _set(prim, "physxRigidBody:linearDamping", Sdf.ValueTypeNames.Float, 0.0)
        _set(prim, "physxRigidBody:angularDamping", Sdf.ValueTypeNames.Float, 0.0)
        _set(prim, "physxRigidBody:sleepThreshold", Sdf.ValueTypeNames.Float, 0.0)
        _set(prim, "physxRigidBody:solverPositionIterationCount", Sdf.ValueTypeNames.Int, 32)
        _set(prim, "physxRigidBody:solverVelocityIterationCount", Sdf.ValueTypeNames.Int, 4)
        for i, part in enumerate(thing["parts"]):
            self._collider(f"{path}/shape_{i}", *_sizes(part["primitive"]), part["pose"], "object")

    def _rigid(self, path, pose, mass, centre, inertia, axes):
        body = UsdGeom.Xform.Define(self._stage, path)
        _place(body, pose)
        prim = body.GetPrim()
        UsdPhysics.RigidBodyAPI.Apply(prim)
        held = UsdPhysics.MassAPI.Apply(prim)
        held.CreateMassAttr(mass)
        held.CreateCenterOfMassAttr(Gf.Vec3f(*centre))
        held.CreateDiagonalInertiaAttr(Gf.Vec3f(*inertia))
        held.CreatePrincipalAxesAttr(Gf.Quatf(*axes))
        prim.AddAppliedSchema("PhysxRigidBodyAPI")
        # Every contact of the robot and of the object is reported, even without a minimum force.
        prim.AddAppliedSchema("PhysxContactReportAPI")
        _set(prim, "physxContactReport:threshold", Sdf.ValueTypeNames.Float, 0.0)
        return prim

    def _collider(self, path, kind, size, pose, material):
        stage, scale = self._stage, [1.0, 1.0, 1.0]
        match kind:
            case "box":
                shape, scale = UsdGeom.Cube.Define(stage, path), size
                shape.CreateSizeAttr(2.0)
            case "sphere":
                shape = UsdGeom.Sphere.Define(stage, path)
                shape.CreateRadiusAttr(size[0])
            case "cylinder" | "capsule":
                shape = (UsdGeom.Cylinder if kind == "cylinder" else UsdGeom.Capsule).Define(stage, path)
                shape.CreateRadiusAttr(size[0])
                shape.CreateHeightAttr(2.0 * size[1])
                shape.CreateAxisAttr("Z")
            case _:
                raise Problem("setup", f"unknown primitive {kind!r}")
        _place(shape, pose, scale)
        UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
        binding = UsdShade.MaterialBindingAPI.Apply(shape.GetPrim())
        bound = UsdShade.Material.Get(stage, f"{MATERIALS}/{material}")
        binding.Bind(bound, UsdShade.Tokens.weakerThanDescendants, "physics")

    def move(self, fixture, position):
        """Moves a fixture to a position by the end of the next time step. PhysX computes its velocity."""
        prim = self._stage.GetPrimAtPath(f"{FIXTURES}/fixture_{fixture}")
        prim.GetAttribute("xformOp:translate").Set(Gf.Vec3d(*position))

    def part(self, path):
        """The owner of the rigid body or fixture at this path. None for any other path."""
        for kind, prefix in (("object", f"{OBJECTS}/object_"), ("fixture", f"{FIXTURES}/fixture_")):
            root, _, rest = path.partition(prefix)
            if not root and rest:
                return Part(kind, index=int(rest.split("/")[0]))
        root, _, rest = path.partition(f"{ROBOT}/")
        if root or not rest:
            return None
        body, fingers = rest.split("/")[0], self._cell["robot"]["gripper"]["finger_bodies"]
        return Part("robot", body, fingers.index(body) if body in fingers else None)

    def friction(self):
        """Friction coefficients of the objects with everything but the table and the pads, with the table, and with the pads."""
        held = {
            name: UsdPhysics.MaterialAPI(self._stage.GetPrimAtPath(f"{MATERIALS}/{name}")).GetStaticFrictionAttr().Get()
            for name in ("object", "other", "table", "pad")
        }
        return tuple(held["object"] * held[name] for name in ("other", "table", "pad"))

    def parts(self, index):
        """The primitives of an object."""
        count = len(self._cell["objects"][index]["parts"])
        return [_primitive(self._stage, f"{object_path(index)}/shape_{i}") for i in range(count)]

    def stiffness(self):
        """Stiffness of the drives of the arm, in Nm/rad, and of the fingers, in N/m."""
        arm, fingers = self._cell["robot"]["joints"], parallel_jaw(self._cell)["finger_joints"]
        return [self._gain(name, "angular") for name in arm], [self._gain(name, "linear") for name in fingers]

    def _gain(self, joint, kind):
        prim = self._stage.GetPrimAtPath(f"{ROBOT}/joints/{joint}")
        unit = 1.0 if kind == "linear" else radians(1.0)
        return UsdPhysics.DriveAPI(prim, kind).GetStiffnessAttr().Get() / unit

    def fixtures(self):
        """The fixtures in their current state."""
        out = []
        for i, fixture in enumerate(self._cell["fixtures"]):
            prim = self._stage.GetPrimAtPath(f"{FIXTURES}/fixture_{i}")
            driven = bool(UsdPhysics.RigidBodyAPI(prim).GetKinematicEnabledAttr().Get())
            place = UsdGeom.Xformable(prim).GetLocalTransformation()
            turn = place.ExtractRotationQuat()
            out.append({
                "fixture": i,
                "primitive": _primitive(self._stage, f"{FIXTURES}/fixture_{i}/shape"),
                "pose": {"position": list(place.ExtractTranslation()),
                         "orientation": [turn.GetReal(), *turn.GetImaginary()]},
                "motion": fixture["motion"] if driven else None,
            })
        return out


def object_path(index):
    """The path of an object."""
    return f"{OBJECTS}/object_{index}"


def drive_of(joint, drives):
    """Stiffness, damping and maximum torque or force of a joint's drive. None for a joint without one."""
    if joint in drives["joints"]:
        i = drives["joints"].index(joint)
        return drives["stiffness_nm_rad"][i], drives["damping_nms_rad"][i], drives["torque_limit_nm"][i]
    gripper = drives["gripper"]
    if joint in gripper["finger_joints"]:
        # The grip force is limited by how far the fingers' target is ahead of them.
        return gripper["stiffness_n_m"], gripper["damping_ns_m"], 10.0 * gripper["force_n"]
    return None


def damped(velocity, damping, own):
    """The target velocity with which a joint with its own damping follows a joint without one. The drive's damping is
    d + own, and (d + own)(v' - v) = d (target - v) - own v for v' = target d / (d + own)."""
    total = damping + own
    return velocity * damping / total if total > 0.0 else 0.0


def principal(inertia):
    """Principal moments, and the rotation (w, x, y, z) from their axes to those of the body."""
    moments, axes = np.linalg.eigh(np.asarray(inertia, dtype=float))
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, np.ascontiguousarray(axes).reshape(9))
    return moments.tolist(), turn.tolist()


def _z_to(axis):
    turn = np.zeros(4)
    mujoco.mju_quatZ2Vec(turn, np.asarray(axis, dtype=float))
    assert np.allclose(turned(turn.tolist(), [0.0, 0.0, 1.0]), axis)
    return turn.tolist()


def _sizes(primitive):
    match primitive["kind"]:
        case "box":
            return "box", primitive["half"]
        case "cylinder":
            return "cylinder", [primitive["radius"], primitive["half_height"]]
        case "sphere":
            return "sphere", [primitive["radius"]]
    raise Problem("setup", f"unknown primitive {primitive['kind']!r}")


def _primitive(stage, path):
    prim = stage.GetPrimAtPath(path)
    if prim.IsA(UsdGeom.Cube):
        half = 0.5 * UsdGeom.Cube(prim).GetSizeAttr().Get()
        return {"kind": "box", "half": [half * x for x in prim.GetAttribute("xformOp:scale").Get()]}
    if prim.IsA(UsdGeom.Cylinder):
        shape = UsdGeom.Cylinder(prim)
        radius, height = shape.GetRadiusAttr().Get(), shape.GetHeightAttr().Get()
        return {"kind": "cylinder", "radius": radius, "half_height": 0.5 * height}
    if prim.IsA(UsdGeom.Sphere):
        return {"kind": "sphere", "radius": UsdGeom.Sphere(prim).GetRadiusAttr().Get()}
    return None


def _place(shape, pose, scale=(1.0, 1.0, 1.0)):
    """Adds translate, orient and scale, in this order and in double precision, as Isaac Sim's wrappers do."""
    shape.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*pose["position"]))
    shape.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*pose["orientation"]))
    shape.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*scale))


def _set(prim, name, kind, value):
    prim.CreateAttribute(name, kind).Set(value)
