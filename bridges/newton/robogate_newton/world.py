"""A cell as a Newton model: the robot from its MJCF file, the objects, the fixtures."""

from dataclasses import dataclass

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverMuJoCo, SolverSteel
from robogate_bridge import Contact, Part, Problem, is_table, parallel_jaw, table_friction, unit

# MuJoCo's defaults for midpoint and power of solimp. They follow the impedance of a cell.
IMPEDANCE_SHAPE = (0.5, 2.0)

# Newton uses solref unchanged.
SOLREF_AS_IT_IS = 1


@dataclass(frozen=True)
class Mover:
    """A moving fixture: its index in the cell, its body, the start of its joint in the coordinates and in the
    velocities, and its motion."""

    fixture: int
    body: int
    q: int
    qd: int
    motion: dict


@dataclass(frozen=True)
class World:
    """A model, with the indices of the cell's items in it."""

    model: newton.Model
    # The part that each shape belongs to. None for a shape without contacts.
    parts: list[Part | None]
    # Pairs of shapes that may collide.
    pairs: list[tuple[int, int]]
    # Indices of the arm's and fingers' joints in the joint coordinates (and in the velocities, because they are first).
    arm: list[int]
    fingers: list[int]
    robot_bodies: list[int]
    # For each object its body, its shapes, and whether it is a ball.
    object_bodies: list[int]
    object_shapes: list[list[int]]
    balls: list[bool]
    fixture_shapes: list[int]
    table_shape: int
    pad_shape: int
    movers: list[Mover]
    # The tool centre point: its body, and its pose in the body's frame.
    tcp_body: int
    tcp_pose: dict


class Workshop:
    """Builds worlds for one robot. `friction_is_mean` means that the solver uses the mean of two shapes' coefficients;
    otherwise the objects' coefficient is used. `gap` (m) is the distance below which the solver considers two shapes."""

    def __init__(self, robot, friction_is_mean, gap):
        self._robot = robot
        self._friction_is_mean = friction_is_mean
        self._gap = gap
        self._base = self._builder()
        try:
            self._base.add_mjcf(
                str(robot.model), floating=False, enable_self_collisions=False, parse_mujoco_options=False
            )
        except Exception as why:
            raise Problem("setup", f"Newton cannot read {robot.model}: {why}") from why

    def _builder(self):
        builder = newton.ModelBuilder()
        SolverMuJoCo.register_custom_attributes(builder)
        SolverSteel.register_custom_attributes(builder)
        builder.default_shape_cfg.gap = self._gap
        builder.rigid_gap = self._gap
        return builder

    def build(self, cell):
        """The world of a cell, with the arm at home and the gripper open."""
        drives, gripper = cell["robot"], parallel_jaw(cell)
        contact = Contact.of(cell)
        builder = self._builder()
        # A copied builder brings its own gravity.
        builder.add_builder(self._base)
        builder.gravity = (0.0, 0.0, -cell["gravity_m_s2"])
        bodies = [label.rsplit("/", 1)[-1] for label in builder.body_label]
        robot_shapes = builder.shape_count

        # The robot: drives, gravity compensation, initial state.
        arm = [self._coordinate(builder, name) for name in drives["joints"]]
        fingers = [self._coordinate(builder, name) for name in gripper["finger_joints"]]
        for i, q in enumerate(arm):
            builder.joint_target_ke[q] = drives["stiffness_nm_rad"][i]
            builder.joint_target_kd[q] = drives["damping_nms_rad"][i]
            builder.joint_effort_limit[q] = drives["torque_limit_nm"][i]
            builder.joint_q[q] = builder.joint_target_q[q] = drives["home_rad"][i]
        for q in fingers:
            builder.joint_target_ke[q] = gripper["stiffness_n_m"]
            builder.joint_target_kd[q] = gripper["damping_ns_m"]
            # The grip force is limited by how far the fingers' target is ahead of them.
            builder.joint_effort_limit[q] = 10.0 * gripper["force_n"]
            builder.joint_q[q] = builder.joint_target_q[q] = 0.5 * gripper["opening_m"]
        for q in arm + fingers:
            builder.joint_target_mode[q] = int(newton.JointTargetMode.POSITION_VELOCITY)
            self._set(builder, "mujoco:jnt_actgravcomp", q, True)
            self._set(builder, "mujoco:solreflimit", q, solref(contact))
            self._set(builder, "mujoco:solreflimit_mode", q, SOLREF_AS_IT_IS)
            self._set(builder, "mujoco:solimplimit", q, solimp(contact.limit_impedance))
        for body in range(len(bodies)):
            self._set(builder, "mujoco:gravcomp", body, 1.0)

        friction, table, pads = cell["friction"], table_friction(cell), gripper["pad_friction"]
        rolls = any(_rolls(thing) for thing in cell["objects"])
        parts: list[Part | None] = []
        static = self._static(builder)
        for shape in range(robot_shapes):
            builder.shape_material_mu[shape] = friction
            builder.shape_gap[shape] = self._gap
            self._set(builder, "mujoco:geom_priority", shape, 0)
            body = bodies[builder.shape_body[shape]]
            finger = gripper["finger_bodies"].index(body) if body in gripper["finger_bodies"] else None
            if finger is not None and pads != friction:
                mu = builder.shape_material_mu[shape] = self._own(pads, friction)
                builder.shape_material_mu_torsional[shape] = contact.torsional(mu)
                builder.shape_material_mu_rolling[shape] = contact.rolling_m
                for name, value in _contact(contact, 3, rolls).items():
                    self._set(builder, name, shape, value)
            collides = builder.shape_flags[shape] & newton.ShapeFlags.COLLIDE_SHAPES
            parts.append(Part("robot", body, finger) if collides else None)

        # The fixtures. In Newton, a shape with body -1 is fixed in the world.
        movers, fixture_shapes = [], []
        for i, fixture in enumerate(cell["fixtures"]):
            place, body = transform(fixture["pose"]), -1
            if fixture["motion"] is not None:
                q, qd = len(builder.joint_q), len(builder.joint_qd)
                body = builder.add_body(
                    xform=place, mass=contact.driven_mass_kg, inertia=wp.mat33(np.eye(3) * contact.driven_mass_kg),
                    lock_inertia=True, is_kinematic=True,
                )
                movers.append(Mover(i, body, q, qd, fixture["motion"]))
                place = wp.transform_identity()
            own = table != friction and is_table(fixture)
            mu, priority = (self._own(table, friction), 2) if own else (friction, 0)
            shape = self._shape(builder, contact, fixture["primitive"], body, place, mu, priority, rolls)
            fixture_shapes.append(shape)
            parts.append(Part("fixture", index=i))

        object_bodies, object_shapes = [], []
        for i, thing in enumerate(cell["objects"]):
            body = builder.add_body(
                xform=transform(thing["pose"]), com=wp.vec3(*thing["centre_of_mass"]), mass=thing["mass_kg"],
                inertia=wp.mat33(np.array(thing["inertia_kg_m2"], dtype=np.float32)), lock_inertia=True,
            )
            self._set(builder, "steel:rigid_body_angular_damping", body, 0.0)
            object_bodies.append(body)
            object_shapes.append([])
            for part in thing["parts"]:
                ball = part["primitive"]["kind"] == "sphere"
                place = transform(part["pose"])
                shape = self._shape(builder, contact, part["primitive"], body, place, friction, 1, ball)
                object_shapes[-1].append(shape)
                parts.append(Part("object", index=i))

        pairs = self._pairs(parts, static)
        allowed = set(pairs)
        met = [shape for shape, part in enumerate(parts) if part is not None]
        for i, a in enumerate(met):
            for b in met[i + 1 :]:
                if (a, b) not in allowed:
                    builder.add_shape_collision_filter_pair(a, b)
        model = builder.finalize(device="cpu")
        tcp = next((s for s, l in enumerate(builder.shape_label) if l.rsplit("/", 1)[-1] == drives["tcp_site"]), None)
        if tcp is None:
            raise Problem("setup", f"the robot's model has no site {drives['tcp_site']!r}")
        flat = next((shape for shape, fixture in zip(fixture_shapes, cell["fixtures"]) if is_table(fixture)), None)
        pad = next((shape for shape, part in enumerate(parts) if part is not None and part.finger is not None), None)
        if flat is None or pad is None:
            raise Problem("setup", "the cell has no table" if flat is None else "the fingers have no shapes")
        return World(
            model=model,
            parts=parts,
            pairs=pairs,
            arm=arm,
            fingers=fingers,
            robot_bodies=list(range(len(bodies))),
            object_bodies=object_bodies,
            object_shapes=object_shapes,
            balls=[all(_is_ball(part) for part in thing["parts"]) for thing in cell["objects"]],
            fixture_shapes=fixture_shapes,
            table_shape=flat,
            pad_shape=pad,
            movers=movers,
            tcp_body=builder.shape_body[tcp],
            tcp_pose=pose(builder.shape_transform[tcp]),
        )

    def _own(self, friction, objects):
        """The coefficient of a shape that has this friction against the objects, whose coefficient is `objects`."""
        # This gives the requested mean. It may be negative; the mean is not.
        return 2.0 * friction - objects if self._friction_is_mean else friction

    def _coordinate(self, builder, joint):
        for index, label in enumerate(builder.joint_label):
            if label.rsplit("/", 1)[-1] == joint:
                return builder.joint_q_start[index]
        raise Problem("setup", f"the robot's model has no joint {joint!r}")

    @staticmethod
    def _set(builder, name, index, value):
        attribute = builder.custom_attributes[name]
        if attribute.values is None:
            attribute.values = {}
        attribute.values[index] = value

    @staticmethod
    def _static(builder):
        """Bodies that no joint can move."""
        fixed = {-1}
        for joint, kind in enumerate(builder.joint_type):
            if kind == newton.JointType.FIXED and builder.joint_parent[joint] in fixed:
                fixed.add(builder.joint_child[joint])
        return {shape for shape, body in enumerate(builder.shape_body) if body in fixed}

    @staticmethod
    def _pairs(parts, static):
        """Pairs that may collide: robot and objects, robot and fixtures (except its base), objects with fixtures and with each
        other."""
        out = []
        for a, one in enumerate(parts):
            for b in range(a + 1, len(parts)):
                other = parts[b]
                if one is None or other is None:
                    continue
                kinds = {one.kind, other.kind}
                base = one.kind == "robot" and a in static
                different = len(kinds) == 2 or (one.kind == "object" and one != other)
                if different and not (base and "fixture" in kinds):
                    out.append((a, b))
        return out

    def _shape(self, builder, contact, primitive, body, place, mu, priority, rolls):
        config = builder.default_shape_cfg.copy()
        config.density, config.gap, config.margin = 0.0, self._gap, 0.0
        config.mu, config.mu_torsional, config.mu_rolling = mu, contact.torsional(mu), contact.rolling_m
        config.collision_filter_parent = False
        custom = _contact(contact, priority, rolls) if priority else {}
        more = {"xform": place, "cfg": config, "custom_attributes": custom}
        match primitive["kind"]:
            case "box":
                x, y, z = primitive["half"]
                return builder.add_shape_box(body, hx=x, hy=y, hz=z, **more)
            case "cylinder":
                radius, half_height = primitive["radius"], primitive["half_height"]
                return builder.add_shape_cylinder(body, radius=radius, half_height=half_height, **more)
            case "sphere":
                return builder.add_shape_sphere(body, radius=primitive["radius"], **more)
        raise Problem("setup", f"unknown primitive {primitive['kind']!r}")


def solref(contact):
    """MuJoCo's solref: the time constant, with critical damping."""
    return wp.vec2(contact.time_constant_s, 1.0)


def solimp(impedance):
    """MuJoCo's solimp from the impedance of a cell."""
    return wp.types.vector(5, float)(*impedance, *IMPEDANCE_SHAPE)


def _contact(contact, priority, rolls):
    """MuJoCo's attributes of a shape that takes precedence in a contact."""
    return {
        "mujoco:geom_priority": priority,
        "mujoco:condim": 6 if rolls else 4,
        "mujoco:solref": solref(contact),
        "mujoco:solref_mode": SOLREF_AS_IT_IS,
        "mujoco:geom_solimp": solimp(contact.impedance),
    }


def _is_ball(part):
    return part["primitive"]["kind"] == "sphere"


def _rolls(thing):
    """Whether an object has a spherical part, so that it can roll."""
    return any(_is_ball(part) for part in thing["parts"])


def transform(pose):
    """Converts a pose of the protocol to Newton's: x, y, z, and the quaternion with its scalar last."""
    w, x, y, z = pose["orientation"]
    return wp.transform(wp.vec3(*pose["position"]), wp.quat(x, y, z, w))


def pose(values):
    """Converts seven numbers of Newton to a pose of the protocol, with its quaternion normalised in double precision."""
    x, y, z, a, b, c, w = map(float, values)
    return {"position": [x, y, z], "orientation": unit([w, a, b, c])}


def primitive(model, shape):
    """The primitive that Newton stores. None for any other shape."""
    kind, (a, b, c) = int(model.shape_type.numpy()[shape]), model.shape_scale.numpy()[shape].tolist()
    if kind == int(newton.GeoType.BOX):
        return {"kind": "box", "half": [a, b, c]}
    if kind == int(newton.GeoType.CYLINDER):
        return {"kind": "cylinder", "radius": a, "half_height": b}
    if kind == int(newton.GeoType.SPHERE):
        return {"kind": "sphere", "radius": a}
    return None
