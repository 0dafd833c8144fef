//! Rapier under the cell: pure Rust, another solver, the same robot folders, objects and scenes.
//!
//! The arm is a multibody in reduced coordinates. Settings that make grasps right (each measured against the
//! claims, `robogate check physics --engine rapier`): contacts found anew in every step and stiff, a small prediction distance,
//! friction solved together with position correction, friction coefficients that are the object's alone.
//! What Rapier lacks and MuJoCo has, a ball's rolling friction, is added as a moment.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rapier3d_f64::dynamics::{
    GenericJoint, GenericJointBuilder, ImpulseJointHandle, JointAxesMask, JointAxis, MassProperties, MotorModel,
    MultibodyDofCoupling, MultibodyJointHandle, RigidBodyBuilder, RigidBodyHandle, SpringCoefficients,
};
use rapier3d_f64::geometry::{
    Collider, ColliderBuilder, ColliderHandle, Contact, ContactManifold, ContactPair, Group, InteractionGroups,
    InteractionTestMode, SharedShape,
};
use rapier3d_f64::math::{Matrix, Pose, Rotation, Vector};
use rapier3d_f64::prelude::{CoefficientCombineRule, PhysicsWorld};
use robogate_core::{Fault, FaultKind};

use crate::description::{Description, Link, Solid, isometry};
use crate::engine::Collision;
use crate::friction::{Coefficients, Friction};
use crate::{
    Arm, Chain, Engine, EngineBuild, FixtureKind, FixtureRead, JointTargets, ParallelJaw, Primitive, Readback, Robot,
    RobotError, Scene, Touches, Wrench,
};

/// Who meets whom: the robot does not meet itself.
const ROBOT: Group = Group::GROUP_1;
const OBJECT: Group = Group::GROUP_2;
const FIXTURE: Group = Group::GROUP_3;

/// Rolling friction of a ball, in metres, as MuJoCo has it here.
const ROLLING: f64 = 5e-4;

/// Into how many parts the solver divides a time step.
const SUBSTEPS: usize = 4;

/// How fast a contact drives shapes apart that stand in each other, in Hz. A contact is found anew only after a degree of
/// turning, and until then its point goes with the object: under stiffer contacts (150 Hz) a cylinder between
/// two pads therefore turns faster and faster; from 60 to 100 Hz it stays, 0.1 mm deep in each pad.
const CONTACT_HZ: f64 = 80.0;

/// The damping of that, as a multiple of the critical one.
const CONTACT_DAMPING: f64 = 5.0;

/// How stiffly a lip holds what hangs at it, in N/m: 3 kg pull it down by 0.3 mm. A joint without any give would share
/// with the table what the arm's own give does when it lifts: a few newtons across, and a moment that peels the lip off.
const LIP_STIFFNESS_N_M: f64 = 1e5;

/// Its damping, in N s/m: critical for half a kilogram.
const LIP_DAMPING_NS_M: f64 = 450.0;

/// Rapier with one robot.
pub struct RapierEngine {
    robot: Robot,
    description: Description,
    time_step: f64,
    loaded: Option<Loaded>,
}

/// What a collider is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Robot { body: usize, finger: Option<usize>, fixed: bool },
    Object,
    Fixture(usize),
}

/// A scene under way.
struct Loaded {
    world: PhysicsWorld,
    /// The robot's bodies by name, as the model's file has them.
    bodies: Vec<String>,
    /// Every collider with what it is, in the order in which they were made.
    colliders: Vec<(ColliderHandle, Kind)>,
    arm: Vec<MultibodyJointHandle>,
    /// The finger joints; none for a gripper without fingers.
    fingers: Vec<MultibodyJointHandle>,
    tcp: RigidBodyHandle,
    object: RigidBodyHandle,
    object_shapes: Vec<ColliderHandle>,
    /// The joint between cup and object, while there is one.
    joined: Option<ImpulseJointHandle>,
    /// What the cup did to the object in the last step.
    cup_load: Option<Wrench>,
    /// A ball's rolling friction acts where its surface is pressed.
    ball: bool,
    touches: Touches,
    /// Force of each touching pair in the last step: robot body, and fixture or object.
    forces: Vec<((usize, Option<usize>), f64)>,
    scene: Scene,
    /// Fixtures that move: their position in the scene, and the body that is driven along.
    movers: Vec<(usize, RigidBodyHandle)>,
    /// Steps taken since the scene was loaded.
    steps: u64,
}

impl RapierEngine {
    /// The default time step in seconds.
    pub const TIME_STEP_S: f64 = 0.0025;

    /// An engine for this robot, with this time step in seconds.
    pub fn new(robot: Robot, time_step: f64) -> Result<Self, RobotError> {
        let description = Description::read(&robot)?;
        Ok(Self { robot, description, time_step, loaded: None })
    }

    /// The scene that [`Engine::load`] put there; every reading of a world needs one.
    fn loaded(&self) -> &Loaded {
        self.loaded.as_ref().expect("a scene is loaded before it is read")
    }

    fn world(&self, scene: &Scene) -> PhysicsWorld {
        let mut world = PhysicsWorld { gravity: Vector::new(0.0, 0.0, -scene.gravity), ..PhysicsWorld::default() };
        let settings = &mut world.integration_parameters;
        settings.dt = self.time_step;
        settings.contact_recycling = false;
        settings.num_solver_iterations = SUBSTEPS;
        settings.normalized_prediction_distance = 0.002;
        settings.friction_in_bias_pass = true;
        settings.contact_softness = SpringCoefficients::new(CONTACT_HZ, CONTACT_DAMPING);
        settings.static_contact_softness = SpringCoefficients::new(CONTACT_HZ, CONTACT_DAMPING);
        world
    }
}

fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

fn pose(pose: &Isometry3<f64>) -> Pose {
    let q = pose.rotation;
    Pose { translation: vector(&pose.translation.vector), rotation: Rotation::from_xyzw(q.i, q.j, q.k, q.w) }
}

/// Rapier's cylinders and capsules stand along y, ours along z.
fn quarter() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2)
}

fn solid(solid: &Solid, at: &Isometry3<f64>) -> Result<(SharedShape, Isometry3<f64>), String> {
    Ok(match solid {
        Solid::Box { half: [x, y, z] } => (SharedShape::cuboid(*x, *y, *z), *at),
        Solid::Sphere { radius } => (SharedShape::ball(*radius), *at),
        Solid::Cylinder { radius, half_height } => (SharedShape::cylinder(*half_height, *radius), at * quarter()),
        Solid::Capsule { radius, half_height } => (SharedShape::capsule_y(*half_height, *radius), at * quarter()),
        Solid::Hull { points } => {
            let points: Vec<Vector> = points.iter().map(|p| vector(&p.coords)).collect();
            let hull = SharedShape::convex_hull(&points).ok_or("a mesh has no convex hull: its vertices lie flat")?;
            (hull, *at)
        }
    })
}

fn primitive(primitive: &Primitive) -> Solid {
    match *primitive {
        Primitive::Box { half } => Solid::Box { half },
        Primitive::Cylinder { radius, half_height } => Solid::Cylinder { radius, half_height },
        Primitive::Sphere { radius } => Solid::Sphere { radius },
    }
}

fn read_primitive(collider: &Collider) -> Option<Primitive> {
    let shape = collider.shape();
    if let Some(b) = shape.as_cuboid() {
        Some(Primitive::Box { half: [b.half_extents.x, b.half_extents.y, b.half_extents.z] })
    } else if let Some(c) = shape.as_cylinder() {
        Some(Primitive::Cylinder { radius: c.radius, half_height: c.half_height })
    } else {
        shape.as_ball().map(|b| Primitive::Sphere { radius: b.radius })
    }
}

fn mass_properties(link: &Link) -> MassProperties {
    let columns: Vec<f64> = link.inertia.iter().copied().collect();
    let mut matrix = [0.0; 9];
    matrix.copy_from_slice(&columns);
    MassProperties::with_inertia_matrix(vector(&link.centre), link.mass, Matrix::from_cols_array(&matrix))
}

/// The table's own coefficient that gives a contact with an object of coefficient `object` the coefficient `friction`.
///
/// The geometric mean is the only rule that takes precedence over the object's own rule and can give any coefficient.
fn table_coefficient(friction: f64, object: f64) -> Result<f64, String> {
    if friction > 0.0 && object <= 0.0 {
        return Err(format!("table_friction = {friction}: in Rapier an object without friction has none on the table"));
    }
    Ok(if friction > 0.0 { friction * friction / object } else { 0.0 })
}

fn groups(member: Group, meets: Group) -> InteractionGroups {
    InteractionGroups::new(member, meets, InteractionTestMode::And)
}

impl Engine for RapierEngine {
    fn build(&self) -> EngineBuild {
        EngineBuild { name: "rapier", version: rapier3d_f64::VERSION.to_owned(), library: None }
    }

    fn robot(&self) -> &Robot {
        &self.robot
    }

    fn chain(&self) -> &Chain {
        &self.description.chain
    }

    fn time_step(&self) -> f64 {
        self.time_step
    }

    fn load(&mut self, scene: &Scene, joints: &[f64]) -> Result<(), Fault> {
        let setup = |why: String| Fault::new(FaultKind::Setup, why);
        let jaw = self.robot.settings.gripper.jaw();
        let finger_joints: &[String] = jaw.map_or(&[], |jaw| &jaw.finger_joints);
        let finger_bodies: &[String] = jaw.map_or(&[], |jaw| &jaw.finger_bodies);
        let arm = &self.robot.settings.arm;
        let mut world = self.world(scene);
        let (mut bodies, mut colliders) = (Vec::<String>::new(), Vec::new());

        // The robot: links and shapes, then joints from the base outwards.
        let mut handles = Vec::with_capacity(self.description.links.len());
        let mut places = Vec::with_capacity(self.description.links.len());
        for link in &self.description.links {
            let place = link.joint.as_ref().map_or_else(Isometry3::identity, |joint| {
                let parent: Isometry3<f64> = places[joint.parent];
                parent * joint.in_parent * joint.in_link.inverse()
            });
            places.push(place);
            let builder = match link.joint {
                Some(_) => RigidBodyBuilder::dynamic()
                    .additional_mass_properties(mass_properties(link))
                    // As every arm's controller does: the weight of the arm itself is compensated.
                    .gravity_scale(0.0)
                    .can_sleep(false),
                None => RigidBodyBuilder::fixed(),
            };
            let handle = world.insert_body(builder.pose(pose(&place)));
            handles.push(handle);
            for shape in &link.shapes {
                let body = bodies.iter().position(|name| *name == shape.body).unwrap_or_else(|| {
                    bodies.push(shape.body.clone());
                    bodies.len() - 1
                });
                let (shared, at) = solid(&shape.solid, &shape.pose).map_err(setup)?;
                let collider = ColliderBuilder::new(shared)
                    .position(pose(&at))
                    .density(0.0)
                    .friction(0.0)
                    .friction_combine_rule(CoefficientCombineRule::Max)
                    .collision_groups(groups(ROBOT, OBJECT | FIXTURE))
                    .user_data(colliders.len() as u128);
                let finger = finger_bodies.iter().position(|name| *name == shape.body);
                let kind = Kind::Robot { body, finger, fixed: link.joint.is_none() };
                colliders.push((world.insert_collider(collider, Some(handle)), kind));
            }
        }
        let mut movable = vec![None; handles.len()];
        for (id, link) in self.description.links.iter().enumerate() {
            let Some(joint) = &link.joint else { continue };
            let (free, axis) = if joint.slides {
                (JointAxesMask::LOCKED_PRISMATIC_AXES, JointAxis::LinX)
            } else {
                (JointAxesMask::LOCKED_REVOLUTE_AXES, JointAxis::AngX)
            };
            let mut data: GenericJoint = GenericJointBuilder::new(free)
                .local_frame1(pose(&joint.in_parent))
                .local_frame2(pose(&joint.in_link))
                .motor_model(axis, MotorModel::ForceBased)
                .build();
            if let Some(range) = joint.range {
                data.set_limits(axis, range);
            }
            let limit = match arm.joints.iter().position(|name| *name == joint.name) {
                Some(j) => arm.torque_limit_nm[j],
                None => jaw.map_or(0.0, |jaw| jaw.force_limit_n),
            };
            data.set_motor_max_force(axis, limit);
            let handle = world
                .insert_multibody_joint(handles[joint.parent], handles[id], data)
                .ok_or_else(|| setup(format!("Rapier takes no joint `{}`", joint.name)))?;
            movable[id] = Some(handle);
        }
        let joint_of = |name: &str| {
            let link = self.description.link_of(name);
            link.and_then(|link| movable[link]).ok_or_else(|| setup(format!("there is no joint `{name}`")))
        };
        let arm_joints = arm.joints.iter().map(|name| joint_of(name)).collect::<Result<Vec<_>, _>>()?;
        let fingers = finger_joints.iter().map(|name| joint_of(name)).collect::<Result<Vec<_>, _>>()?;

        // Positions at the start, and what the drives are like.
        let (multibody, _) =
            world.multibody_joints.get_mut(arm_joints[0]).ok_or_else(|| setup("the arm has no joint".to_owned()))?;
        multibody.set_self_contacts_enabled(false);
        // Only after this call do the per-joint vectors have their final order.
        multibody.forward_kinematics(&world.bodies, true);
        let mut start = vec![0.0; multibody.ndofs()];
        let at_start = arm.joints.iter().zip(joints).map(|(name, q)| (name, *q));
        for (name, q) in
            at_start.chain(finger_joints.iter().map(|name| (name, 0.5 * jaw.map_or(0.0, |jaw| jaw.opening_m))))
        {
            let link = self
                .description
                .link_of(name)
                .and_then(|link| multibody.links().find(|l| l.rigid_body_handle() == handles[link]));
            if let Some(link) = link {
                start[link.assembly_id()] = q;
            }
        }
        multibody.apply_displacements(&start);
        let order: Vec<(usize, usize)> = self
            .description
            .links
            .iter()
            .enumerate()
            .filter(|(_, link)| link.joint.is_some())
            .filter_map(|(id, _)| {
                let link = multibody.links().find(|l| l.rigid_body_handle() == handles[id])?;
                Some((id, link.assembly_id()))
            })
            .collect();
        for (id, dof) in &order {
            if let Some(joint) = &self.description.links[*id].joint {
                multibody.armature_mut()[*dof] = joint.armature;
                multibody.damping_mut()[*dof] = joint.damping;
            }
        }
        for coupling in &self.description.couplings {
            let link = |name: &str| {
                let id = self.description.link_of(name)?;
                let slides = self.description.links[id].joint.as_ref()?.slides;
                let link = multibody.links().find(|l| l.rigid_body_handle() == handles[id])?;
                Some((link.link_id(), if slides { 0 } else { 3 }))
            };
            let (Some((link1, axis1)), Some((link2, axis2))) = (link(&coupling.first), link(&coupling.second)) else {
                return Err(setup(format!("there is no joint `{}` or `{}`", coupling.first, coupling.second)));
            };
            multibody.add_dof_coupling(MultibodyDofCoupling {
                link1,
                dof1: 0,
                axis1,
                link2,
                dof2: 0,
                axis2,
                coeff: coupling.factor,
                offset: coupling.offset,
            });
        }
        multibody.forward_kinematics(&world.bodies, true);
        multibody.update_rigid_bodies(&mut world.bodies, true);

        // Table and obstacles, and what crosses the workspace.
        let ground = world.insert_body(RigidBodyBuilder::fixed());
        let mut movers = Vec::new();
        for (i, fixture) in scene.fixtures.iter().enumerate() {
            let (shared, at) = solid(&primitive(&fixture.part.primitive), &Isometry3::identity()).map_err(setup)?;
            let (body, at) = if fixture.motion.is_some() {
                let driven = RigidBodyBuilder::kinematic_position_based().pose(pose(&fixture.part.pose));
                let body = world.insert_body(driven.can_sleep(false));
                movers.push((i, body));
                (body, at)
            } else {
                (ground, fixture.part.pose * at)
            };
            let (friction, rule) = match scene.table_friction.filter(|_| fixture.kind == FixtureKind::Table) {
                Some(friction) => {
                    (table_coefficient(friction, scene.friction).map_err(setup)?, CoefficientCombineRule::GeometricMean)
                }
                None => (0.0, CoefficientCombineRule::Max),
            };
            let collider = ColliderBuilder::new(shared)
                .position(pose(&at))
                .friction(friction)
                .friction_combine_rule(rule)
                .collision_groups(groups(FIXTURE, ROBOT | OBJECT))
                .user_data(colliders.len() as u128);
            colliders.push((world.insert_collider(collider, Some(body)), Kind::Fixture(i)));
        }

        // The object: its friction is that of each of its contacts, whatever it touches.
        let mass = &scene.object.mass;
        let link = Link {
            joint: None,
            mass: mass.mass_kg,
            centre: mass.centre,
            inertia: mass.inertia,
            shapes: Vec::new(),
            looks: Vec::new(),
        };
        let object = world.insert_body(
            RigidBodyBuilder::dynamic()
                .pose(pose(&scene.object_pose))
                .additional_mass_properties(mass_properties(&link))
                .can_sleep(false),
        );
        let mut object_shapes = Vec::new();
        for part in &scene.object.parts {
            let (shared, at) = solid(&primitive(&part.primitive), &part.pose).map_err(setup)?;
            let collider = ColliderBuilder::new(shared)
                .position(pose(&at))
                .density(0.0)
                .friction(scene.friction)
                .friction_combine_rule(CoefficientCombineRule::Max)
                .collision_groups(groups(OBJECT, ROBOT | FIXTURE))
                .user_data(colliders.len() as u128);
            let handle = world.insert_collider(collider, Some(object));
            object_shapes.push(handle);
            colliders.push((handle, Kind::Object));
        }
        for (_, body) in world.bodies.iter_mut() {
            // Known before the first step: what is read back is what will move.
            body.recompute_mass_properties_from_colliders(&world.colliders);
        }
        // Shapes follow their bodies in a step, and none has been taken yet.
        world.bodies.propagate_modified_body_positions_to_colliders(&mut world.colliders);
        let tcp = handles[self.description.tcp.0];
        let ball = scene.object.parts.iter().all(|part| matches!(part.primitive, Primitive::Sphere { .. }));
        let loaded = self.loaded.insert(Loaded {
            world,
            bodies,
            colliders,
            arm: arm_joints,
            fingers,
            tcp,
            object,
            object_shapes,
            joined: None,
            cup_load: None,
            ball,
            touches: Touches::default(),
            forces: Vec::new(),
            scene: scene.clone(),
            movers,
            steps: 0,
        });
        let targets = JointTargets {
            positions: joints.to_vec(),
            velocities: vec![0.0; joints.len()],
            finger: jaw.map_or(0.0, |jaw| 0.5 * jaw.opening_m),
        };
        loaded.drive(arm, jaw, &targets);
        loaded.touch_at_start();
        Ok(())
    }

    fn read_back(&self) -> Result<Readback, Fault> {
        let loaded = self.loaded();
        let object = &loaded.world.bodies[loaded.object];
        let Friction { others, table } = loaded.friction()?;
        let parts = loaded.object_shapes.iter().filter_map(|shape| read_primitive(&loaded.world.colliders[*shape]));
        let mut fixtures = Vec::new();
        for (handle, kind) in &loaded.colliders {
            let Kind::Fixture(fixture) = *kind else { continue };
            let collider = &loaded.world.colliders[*handle];
            fixtures.push(FixtureRead {
                fixture,
                primitive: read_primitive(collider),
                pose: {
                    let upright = collider.shape().as_cylinder().map(|_| quarter().inverse());
                    isometry(collider.position()) * upright.unwrap_or_default()
                },
                motion: loaded.scene.fixtures[fixture].motion,
            });
        }
        let com = object.mass_properties().local_mprops.local_com;
        Ok(Readback {
            friction: others,
            table_friction: table,
            gravity: -loaded.world.gravity.z,
            mass_kg: object.mass(),
            centre_of_mass: Vector3::new(com.x, com.y, com.z),
            parts: parts.collect(),
            object: self.object(),
            fixtures,
        })
    }

    fn advance(&mut self, targets: &JointTargets) {
        let Some(loaded) = self.loaded.as_mut() else { return };
        loaded.drive(&self.robot.settings.arm, self.robot.settings.gripper.jaw(), targets);
        loaded.resist_rolling();
        loaded.move_fixtures(self.time_step);
        let before = loaded.momentum();
        loaded.world.step();
        loaded.steps += 1;
        loaded.read_touches();
        loaded.cup_load = loaded.joined.map(|_| loaded.load_about(&self.description.tcp.1, before));
    }

    fn health(&self) -> Result<(), Fault> {
        let mut finite = true;
        self.state_bits(&mut |bits| finite &= f64::from_bits(bits).is_finite());
        if finite { Ok(()) } else { Err(Fault::new(FaultKind::Diverged, "Rapier: the state is not finite")) }
    }

    fn joint_positions(&self) -> Vec<f64> {
        let loaded = self.loaded();
        loaded.arm.iter().map(|joint| loaded.position(*joint, 3)).collect()
    }

    fn joint_velocities(&self) -> Vec<f64> {
        let loaded = self.loaded();
        loaded.arm.iter().map(|joint| loaded.velocity(*joint)).collect()
    }

    fn opening(&self) -> Option<f64> {
        let loaded = self.loaded();
        let fingers = loaded.fingers.iter().map(|joint| loaded.position(*joint, 0));
        (!loaded.fingers.is_empty()).then(|| fingers.sum())
    }

    fn attach(&mut self) {
        let Some(cup) = self.robot.settings.gripper.cup() else { return };
        let (tcp, object) = (self.tcp(), self.object());
        let Some(loaded) = self.loaded.as_mut().filter(|loaded| loaded.joined.is_none()) else { return };
        // The middle of the lip, in the frame of the link that carries the cup and in the object's.
        let mut lip = GenericJointBuilder::new(JointAxesMask::empty())
            .local_frame1(pose(&self.description.tcp.1))
            .local_frame2(pose(&(object.inverse() * tcp)))
            // Joined they are one body: what they would do to each other by contact, the joint does.
            .contacts_enabled(false);
        for axis in [JointAxis::LinX, JointAxis::LinY, JointAxis::LinZ] {
            lip = lip.motor_model(axis, MotorModel::ForceBased).motor_position(
                axis,
                0.0,
                LIP_STIFFNESS_N_M,
                LIP_DAMPING_NS_M,
            );
        }
        // Springs evenly along a circle: half the radius squared. Rapier takes the sine of half an angle for the angle.
        let turning = 0.5 * (0.5 * cup.cup_diameter_m).powi(2);
        let (stiffness, damping) = (2.0 * turning * LIP_STIFFNESS_N_M, turning * LIP_DAMPING_NS_M);
        for axis in [JointAxis::AngX, JointAxis::AngY, JointAxis::AngZ] {
            lip = lip.motor_model(axis, MotorModel::ForceBased).motor_position(axis, 0.0, stiffness, damping);
        }
        loaded.joined = Some(loaded.world.insert_impulse_joint(loaded.tcp, loaded.object, lip.build()));
    }

    fn detach(&mut self) {
        if let Some(loaded) = self.loaded.as_mut()
            && let Some(joint) = loaded.joined.take()
        {
            loaded.world.remove_impulse_joint(joint);
            loaded.cup_load = None;
        }
    }

    fn cup_load(&self) -> Option<Wrench> {
        self.loaded().cup_load
    }

    fn tcp(&self) -> Isometry3<f64> {
        let loaded = self.loaded();
        isometry(loaded.world.bodies[loaded.tcp].position()) * self.description.tcp.1
    }

    fn object(&self) -> Isometry3<f64> {
        let loaded = self.loaded();
        isometry(loaded.world.bodies[loaded.object].position())
    }

    fn fixture(&self, fixture: usize) -> Isometry3<f64> {
        let loaded = self.loaded();
        match loaded.movers.iter().find(|(moving, _)| *moving == fixture) {
            Some((_, body)) => isometry(loaded.world.bodies[*body].position()),
            None => loaded.scene.fixtures[fixture].part.pose,
        }
    }

    fn object_velocity(&self) -> (Vector3<f64>, Vector3<f64>) {
        let loaded = self.loaded();
        let body = &loaded.world.bodies[loaded.object];
        let at = body.velocity_at_point(body.position().translation);
        let turn = body.angvel();
        (Vector3::new(at.x, at.y, at.z), Vector3::new(turn.x, turn.y, turn.z))
    }

    fn touches(&self) -> &Touches {
        &self.loaded().touches
    }

    fn clearance_below(&mut self, bound: f64) -> Option<f64> {
        let loaded = self.loaded();
        let mut best = bound;
        for (robot, kind) in &loaded.colliders {
            // A part of the base that stands on the table's level has no clearance to lose.
            let Kind::Robot { fixed: false, .. } = kind else { continue };
            let robot = &loaded.world.colliders[*robot];
            let ball = robot.shape().compute_bounding_sphere(robot.position());
            for (other, kind) in &loaded.colliders {
                let Kind::Fixture(fixture) = kind else { continue };
                let centre = [ball.center.x, ball.center.y, ball.center.z];
                let place = self.fixture(*fixture);
                if loaded.scene.fixtures[*fixture].distance_bound_at(&place, centre, ball.radius) >= best {
                    continue;
                }
                let other = &loaded.world.colliders[*other];
                let near = rapier3d_f64::parry::query::contact(
                    robot.position(),
                    robot.shape(),
                    other.position(),
                    other.shape(),
                    best,
                );
                if let Ok(Some(contact)) = near {
                    best = best.min(contact.dist);
                }
            }
        }
        (best < bound).then_some(best)
    }

    fn robot_body(&self, body: usize) -> String {
        self.loaded().bodies.get(body).cloned().unwrap_or_else(|| format!("body {body}"))
    }

    fn state_bits(&self, sink: &mut dyn FnMut(u64)) {
        let loaded = self.loaded();
        let mut put = |x: f64| sink(x.to_bits());
        for joint in &loaded.arm {
            put(loaded.position(*joint, 3));
            put(loaded.velocity(*joint));
        }
        for joint in &loaded.fingers {
            put(loaded.position(*joint, 0));
            put(loaded.velocity(*joint));
        }
        let object = &loaded.world.bodies[loaded.object];
        let (t, r) = (object.position().translation, object.position().rotation);
        let (v, w) = (object.linvel(), object.angvel());
        [t.x, t.y, t.z, r.x, r.y, r.z, r.w, v.x, v.y, v.z, w.x, w.y, w.z].into_iter().for_each(put);
    }
}

impl Loaded {
    /// The friction coefficients that act between the object and everything that it can touch, by Rapier's rule.
    fn friction(&self) -> Result<Friction, Fault> {
        let mut friction = Coefficients::default();
        for (handle, kind) in &self.colliders {
            let table = match *kind {
                Kind::Fixture(fixture) => self.scene.fixtures[fixture].kind == FixtureKind::Table,
                Kind::Robot { .. } => false,
                Kind::Object => continue,
            };
            let other = &self.world.colliders[*handle];
            for part in self.object_shapes.iter().map(|shape| &self.world.colliders[*shape]) {
                friction.add(
                    table,
                    CoefficientCombineRule::combine(
                        part.friction(),
                        other.friction(),
                        part.friction_combine_rule(),
                        other.friction_combine_rule(),
                    ),
                );
            }
        }
        friction.finish()
    }

    /// Position of a joint; 0 is the axis that slides, 3 the one that turns.
    fn position(&self, joint: MultibodyJointHandle, axis: usize) -> f64 {
        let link = self.world.multibody_joints.get(joint).and_then(|(body, id)| body.link(id));
        link.map_or(f64::NAN, |link| link.joint().coords()[axis])
    }

    fn velocity(&self, joint: MultibodyJointHandle) -> f64 {
        let Some((body, id)) = self.world.multibody_joints.get(joint) else { return f64::NAN };
        body.link(id).map_or(f64::NAN, |link| body.joint_velocity(link)[0])
    }

    /// Sets the drives' targets.
    fn drive(&mut self, arm: &Arm, jaw: Option<&ParallelJaw>, targets: &JointTargets) {
        let mut set = |joint: MultibodyJointHandle, axis, position, velocity, stiffness, damping| {
            if let Some((body, id)) = self.world.multibody_joints.get_mut(joint)
                && let Some(link) = body.link_mut(id)
            {
                link.joint.data.set_motor(axis, position, velocity, stiffness, damping);
            }
        };
        for (j, joint) in self.arm.iter().enumerate() {
            let (stiffness, damping) = (arm.stiffness_nm_rad[j], arm.damping_nms_rad[j]);
            set(*joint, JointAxis::AngX, targets.positions[j], targets.velocities[j], stiffness, damping);
        }
        for (joint, jaw) in self.fingers.iter().zip(jaw.into_iter().cycle()) {
            set(*joint, JointAxis::LinX, targets.finger, 0.0, jaw.stiffness_n_m, jaw.damping_ns_m);
        }
    }

    /// Sends every moving fixture to where it is at the end of the step to come.
    fn move_fixtures(&mut self, time_step: f64) {
        let time = (self.steps + 1) as f64 * time_step;
        for (fixture, body) in &self.movers {
            let fixture = &self.scene.fixtures[*fixture];
            let (Some(motion), Some(body)) = (fixture.motion, self.world.bodies.get_mut(*body)) else { continue };
            let at = fixture.part.pose.translation.vector + motion.offset(time);
            body.set_next_kinematic_translation(vector(&at));
        }
    }

    /// The object's momentum (kg m/s) and its moment of momentum about its centre of mass (kg m^2/s).
    fn momentum(&self) -> [Vector3<f64>; 2] {
        let body = &self.world.bodies[self.object];
        let (speed, spin) = (body.linvel(), body.angvel());
        let turn = isometry(body.position()).rotation;
        let mass = &self.scene.object.mass;
        let spin = turn.inverse() * Vector3::new(spin.x, spin.y, spin.z);
        [Vector3::new(speed.x, speed.y, speed.z) * mass.mass_kg, turn * (mass.inertia * spin)]
    }

    /// What moved the object in the last step beside its weight and what it stood on, about the tool centre point,
    /// which the cup's link has at `lip`: Newton's and Euler's laws, read the other way round, from what the
    /// momentum was `before`. (Rapier keeps a joint's impulse of its last iteration only, along axes of the solver's choice.)
    fn load_about(&self, lip: &Isometry3<f64>, before: [Vector3<f64>; 2]) -> Wrench {
        let dt = self.world.integration_parameters.dt;
        let tcp = isometry(self.world.bodies[self.tcp].position()) * lip;
        let support = self.support();
        let [linear, turning] = self.momentum();
        let weight = Vector3::new(0.0, 0.0, -self.scene.gravity * self.scene.object.mass.mass_kg);
        let force = (linear - before[0]) / dt - weight - support.force;
        let centre = self.world.bodies[self.object].center_of_mass();
        let arm = Vector3::new(centre.x, centre.y, centre.z) - tcp.translation.vector;
        let torque = (turning - before[1]) / dt - support.torque + arm.cross(&force);
        Wrench { force: tcp.inverse_transform_vector(&force), torque: tcp.inverse_transform_vector(&torque) }
    }

    /// What table and obstacles did to the object in the last step, about its centre of mass, along the world's axes.
    fn support(&self) -> Wrench {
        let settings = &self.world.integration_parameters;
        let plain = |v: Vector| Vector3::new(v.x, v.y, v.z);
        let mut support = Wrench::ZERO;
        let pairs = self.object_shapes.iter().flat_map(|shape| self.world.narrow_phase.contact_pairs_with(*shape));
        for pair in pairs.filter(|pair| self.on_fixture(pair)) {
            for manifold in pair.manifolds() {
                let first = manifold.data.rigid_body1 == Some(self.object);
                // The normal points from the first body to the second.
                let sign = if first { -1.0 } else { 1.0 };
                let mut middle = Vector3::zeros();
                let mut pressed = 0.0;
                let mut last = None;
                for point in solved(manifold).filter(|point| point.data.impulse > 0.0) {
                    let arm = plain(if first { point.data.solver_dp1 } else { point.data.solver_dp2 });
                    let force = plain(manifold.data.normal) * (sign * point.data.impulse / settings.dt);
                    support.force += force;
                    support.torque += arm.cross(&force);
                    middle += arm * point.data.impulse;
                    pressed += point.data.impulse;
                    last = Some(&point.data);
                }
                // One friction for the whole manifold, kept on each of its points as the last iteration had it.
                if let Some(last) = last {
                    let share = SUBSTEPS as f64 / settings.dt;
                    let rub = plain(last.warmstart_tangent_world) * (-sign * share);
                    support.force += rub;
                    support.torque += (middle / pressed).cross(&rub);
                    support.torque += plain(manifold.data.normal) * (sign * last.warmstart_twist_impulse * share);
                }
            }
        }
        support
    }

    /// Whether a pair of shapes is the object and a fixture.
    fn on_fixture(&self, pair: &ContactPair) -> bool {
        [pair.collider1, pair.collider2].into_iter().any(|handle| {
            let collider = self.world.colliders.get(handle);
            let kind = collider.and_then(|collider| self.colliders.get(collider.user_data as usize));
            matches!(kind, Some((_, Kind::Fixture(_))))
        })
    }

    /// A ball's rolling friction: against its turning, at most `ROLLING` times the force that presses it.
    fn resist_rolling(&mut self) {
        let object = self.object;
        let dt = self.world.integration_parameters.dt;
        let pressed: f64 = if self.ball { self.pressure() } else { 0.0 };
        let Some(body) = self.world.bodies.get_mut(object) else { return };
        body.reset_torques(false);
        let turning = body.angvel();
        let speed = turning.length();
        if pressed > 0.0 && speed > 0.0 {
            // No more than what stops it within the step.
            let inertia = body.mass_properties().local_mprops.principal_inertia().x;
            let moment = (ROLLING * pressed).min(inertia * speed / dt);
            body.add_torque(turning * (-moment / speed), false);
        }
    }

    /// The sum of the forces on the object in the last step, in newtons.
    fn pressure(&self) -> f64 {
        let dt = self.world.integration_parameters.dt;
        let pairs = self.object_shapes.iter().flat_map(|shape| self.world.narrow_phase.contact_pairs_with(*shape));
        pairs.map(|pair| impulse(pair) / dt).sum()
    }

    /// Who touches whom before the first step, by distance: no force has acted yet.
    fn touch_at_start(&mut self) {
        self.touches = Touches::default();
        for (robot, kind) in &self.colliders {
            let Kind::Robot { body, finger, fixed } = *kind else { continue };
            for (other, kind) in &self.colliders {
                let (robot, other) = (&self.world.colliders[*robot], &self.world.colliders[*other]);
                let touch = || {
                    let (a, b) = (robot.position(), other.position());
                    rapier3d_f64::parry::query::contact(a, robot.shape(), b, other.shape(), 0.0).ok().flatten()
                };
                match kind {
                    Kind::Object if touch().is_some() => match finger {
                        Some(finger) => self.touches.fingers[finger] = Some(0.0),
                        None => self.touches.body_on_object = true,
                    },
                    Kind::Fixture(fixture) if !fixed && touch().is_some() => {
                        self.touches.collision = Some(Collision { robot_body: body, fixture: *fixture, force: 0.0 });
                    }
                    _ => {}
                }
            }
        }
    }

    /// Sums up the contacts of the last step: two bodies may touch at several points, and it is their
    /// force together that counts.
    fn read_touches(&mut self) {
        let dt = self.world.integration_parameters.dt;
        self.touches = Touches::default();
        self.forces.clear();
        for pair in self.world.narrow_phase.contact_pairs() {
            let kind = |handle: ColliderHandle| {
                let id = self.world.colliders.get(handle).map(|collider| collider.user_data as usize);
                id.and_then(|id| self.colliders.get(id)).map(|(_, kind)| *kind)
            };
            let (Some(one), Some(two)) = (kind(pair.collider1), kind(pair.collider2)) else { continue };
            let deepest = pair.find_deepest_contact().map(|(_, contact)| contact.dist);
            // A contact that is only near has no force.
            if deepest.is_none_or(|dist| dist > 0.0) && impulse(pair) == 0.0 {
                continue;
            }
            let force = impulse(pair) / dt;
            let touches = &mut self.touches;
            let (body, other) = match (one, two) {
                (Kind::Robot { body, finger, .. }, Kind::Object) | (Kind::Object, Kind::Robot { body, finger, .. }) => {
                    match finger {
                        Some(finger) => *touches.fingers[finger].get_or_insert(0.0) += force,
                        None => touches.body_on_object = true,
                    }
                    (body, None)
                }
                (Kind::Robot { body, .. }, Kind::Fixture(fixture))
                | (Kind::Fixture(fixture), Kind::Robot { body, .. }) => (body, Some(fixture)),
                (Kind::Object, Kind::Fixture(_)) | (Kind::Fixture(_), Kind::Object) => {
                    touches.object_on_fixture = true;
                    continue;
                }
                _ => continue,
            };
            match self.forces.iter_mut().find(|(known, _)| *known == (body, other)) {
                Some((_, sum)) => *sum += force,
                None => self.forces.push(((body, other), force)),
            }
        }
        for ((robot_body, other), force) in self.forces.iter().copied() {
            let touches = &mut self.touches;
            touches.peak_force = Some(touches.peak_force.unwrap_or(0.0).max(force));
            if let Some(fixture) = other
                && touches.collision.is_none_or(|strongest| force > strongest.force)
            {
                touches.collision = Some(Collision { robot_body, fixture, force });
            }
        }
    }
}

/// The points of a manifold that were in the last step's equations: the others keep what they once had.
fn solved(manifold: &ContactManifold) -> impl Iterator<Item = &Contact> {
    let ids = manifold.data.solver_contacts.iter().flat_map(|contact| contact.contact_indices());
    ids.filter_map(|id| manifold.points.get(id as usize))
}

/// The normal impulse of a pair over the last step, in N s.
fn impulse(pair: &ContactPair) -> f64 {
    pair.manifolds().iter().flat_map(solved).map(|point| point.data.impulse).sum()
}
