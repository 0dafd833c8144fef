//! Builds a robot and a scene in Rapier.

use nalgebra::Isometry3;
use rapier3d_f64::dynamics::{
    GenericJoint, GenericJointBuilder, JointAxesMask, JointAxis, MotorModel, MultibodyDofCoupling,
    MultibodyJointHandle, RigidBodyBuilder, RigidBodyHandle, SpringCoefficients,
};
use rapier3d_f64::geometry::{ColliderBuilder, ColliderHandle, Group, InteractionGroups, InteractionTestMode};
use rapier3d_f64::math::Vector;
use rapier3d_f64::prelude::{CoefficientCombineRule, PhysicsWorld};
use robogate_core::{Fault, FaultKind, Region};

use super::convert::{mass_properties, pose, primitive, solid};
use super::{Kind, Loaded, RapierEngine, SUBSTEPS, joints};
use crate::contact_sums::ContactSums;
use crate::description::{Description, Link};
use crate::region::region;
use crate::{BELLOWS_JOINT, Object, Primitive, Scene, Touches};

/// Collision groups. The robot does not collide with itself.
const ROBOT: Group = Group::GROUP_1;
const OBJECT: Group = Group::GROUP_2;
const FIXTURE: Group = Group::GROUP_3;
/// A body on a joint collides with the robot and with free bodies: its joint guides it through its fixtures.
const JOINTED: Group = Group::GROUP_4;

/// Natural frequency with which a contact separates penetrating shapes, in Hz. Rapier detects a contact again only
/// after a rotation by one degree; until then the contact point moves with the object. With stiffer contacts (150 Hz) a
/// cylinder between two pads therefore rotates faster and faster. From 60 to 100 Hz it is stable, with a penetration of
/// 0.1 mm in each pad.
pub(super) const CONTACT_HZ: f64 = 80.0;

/// Damping ratio of contacts.
pub(super) const CONTACT_DAMPING: f64 = 5.0;

/// A scene under construction.
struct Build<'a> {
    engine: &'a RapierEngine,
    scene: &'a Scene,
    world: PhysicsWorld,
    /// Names of the robot's bodies.
    bodies: Vec<String>,
    colliders: Vec<(ColliderHandle, Kind)>,
    /// Rapier's body of each link.
    links: Vec<RigidBodyHandle>,
    /// Rapier's joint of each link, if it has one.
    joints: Vec<Option<MultibodyJointHandle>>,
}

impl RapierEngine {
    /// Builds robot and scene with the arm at `joints` (rad) and the gripper open.
    pub(super) fn build_scene(&self, scene: &Scene, joints: &[f64]) -> Result<Loaded, Fault> {
        scene.pad_friction()?;
        let mut build = Build {
            engine: self,
            scene,
            world: self.world(scene),
            bodies: Vec::new(),
            colliders: Vec::new(),
            links: Vec::new(),
            joints: Vec::new(),
        };
        // The order of insertion affects the results.
        build.add_links()?;
        build.add_joints()?;
        build.configure_drives(joints)?;
        let movers = build.add_fixtures()?;
        let free = build.add_free_bodies()?;
        for (_, body) in build.world.bodies.iter_mut() {
            // Set before the first step, because the read-back happens before it.
            body.recompute_mass_properties_from_colliders(&build.world.colliders);
        }
        let joints = build.add_scene_joints(&free)?;
        // Colliders follow their bodies during a step, but no step has run yet.
        build.world.bodies.propagate_modified_body_positions_to_colliders(&mut build.world.colliders);
        let settings = &self.robot.settings;
        let fingers = settings.gripper.jaw().map_or(&[][..], |jaw| jaw.slides());
        Ok(Loaded {
            arm: build.joint_handles(&settings.arm.joints)?,
            fingers: build.joint_handles(fingers)?,
            bellows: self.description.link_of(BELLOWS_JOINT).and_then(|link| build.joints[link]),
            tcp: build.links[self.description.tcp.0],
            free,
            joints,
            threads: Vec::new(),
            selected: 0,
            joined: None,
            cup_load: None,
            ball: scene.object.parts.iter().all(|part| matches!(part.primitive, Primitive::Sphere { .. })),
            touches: Touches::default(),
            forces: ContactSums::default(),
            scene: scene.clone(),
            movers,
            steps: 0,
            world: build.world,
            regions: build.bodies.iter().map(|body| self.region_of(body)).collect(),
            bodies: build.bodies,
            colliders: build.colliders,
        })
    }

    /// The region of the robot to which a body belongs.
    fn region_of(&self, body: &str) -> Region {
        let Description { links, bodies, .. } = &self.description;
        let settings = &self.robot.settings;
        let last = settings.arm.joints.last().and_then(|joint| self.description.link_of(joint)).unwrap_or(0);
        let mut of_last = bodies.iter().filter(|(_, link, _)| *link == last).map(|(name, ..)| name);
        let is_wrist = of_last.next().is_some_and(|own| own == body) && of_last.next().is_some();
        let link = bodies.iter().find(|(name, ..)| name == body).map_or(0, |(_, link, _)| *link);
        let parent = |link: usize| links[link].joint.as_ref().map(|joint| joint.parent);
        region(link, is_wrist, last, parent, &settings.gripper)
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

pub(super) fn setup(why: String) -> Fault {
    Fault::new(FaultKind::Setup, why)
}

impl Build<'_> {
    /// The robot's links and their shapes, at joint positions 0.
    fn add_links(&mut self) -> Result<(), Fault> {
        let jaw = self.engine.robot.settings.gripper.jaw();
        let link_of = |body: &String| {
            self.engine.description.bodies.iter().find(|(name, ..)| name == body).map(|(_, link, _)| *link)
        };
        let finger_links: Vec<Option<usize>> =
            jaw.map_or(&[][..], |jaw| &jaw.finger_bodies).iter().map(link_of).collect();
        let mut places = Vec::with_capacity(self.engine.description.links.len());
        for (id, link) in self.engine.description.links.iter().enumerate() {
            let place = link.joint.as_ref().map_or_else(Isometry3::identity, |joint| {
                let parent: Isometry3<f64> = places[joint.parent];
                parent * joint.in_parent * joint.in_link.inverse()
            });
            places.push(place);
            let builder = match link.joint {
                Some(_) => RigidBodyBuilder::dynamic()
                    .additional_mass_properties(mass_properties(link))
                    // The weight of the arm is compensated, as in every arm's controller.
                    .gravity_scale(0.0)
                    .can_sleep(false),
                None => RigidBodyBuilder::fixed(),
            };
            let handle = self.world.insert_body(builder.pose(pose(&place)));
            self.links.push(handle);
            for shape in &link.shapes {
                let body = self.bodies.iter().position(|name| *name == shape.body).unwrap_or_else(|| {
                    self.bodies.push(shape.body.clone());
                    self.bodies.len() - 1
                });
                let (shared, at) = solid(&shape.solid, &shape.pose).map_err(setup)?;
                // Bodies that are welded to a finger belong to it.
                let finger = finger_links.iter().position(|link| *link == Some(id));
                let object = self.scene.friction;
                let (friction, rule) = match self.scene.gripper.pad_friction(object).filter(|_| finger.is_some()) {
                    Some(friction) => {
                        let friction = precedent_coefficient("pad_friction", friction, object).map_err(setup)?;
                        (friction, CoefficientCombineRule::GeometricMean)
                    }
                    None => (0.0, CoefficientCombineRule::Max),
                };
                let collider = ColliderBuilder::new(shared)
                    .position(pose(&at))
                    .density(0.0)
                    .friction(friction)
                    .friction_combine_rule(rule)
                    .collision_groups(groups(ROBOT, OBJECT | FIXTURE | JOINTED));
                let kind = Kind::Robot { body, finger, fixed: link.joint.is_none() };
                self.add_collider(collider, handle, kind);
            }
        }
        Ok(())
    }

    fn add_collider(&mut self, collider: ColliderBuilder, body: RigidBodyHandle, kind: Kind) -> ColliderHandle {
        let collider = collider.user_data(self.colliders.len() as u128);
        let handle = self.world.insert_collider(collider, Some(body));
        self.colliders.push((handle, kind));
        handle
    }

    /// The robot's joints, from the base outwards.
    fn add_joints(&mut self) -> Result<(), Fault> {
        let settings = &self.engine.robot.settings;
        let (arm, jaw) = (&settings.arm, settings.gripper.jaw());
        self.joints = vec![None; self.links.len()];
        for (id, link) in self.engine.description.links.iter().enumerate() {
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
            let spring = settings.gripper.cup().and_then(|cup| cup.bellows).filter(|_| joint.name == BELLOWS_JOINT);
            if let Some(bellows) = spring {
                data.set_motor(axis, 0.0, 0.0, bellows.stiffness_n_m, bellows.damping_ns_m(link.mass));
            } else {
                let limit = match arm.joints.iter().position(|name| *name == joint.name) {
                    Some(j) => arm.torque_limit_nm[j],
                    None => jaw.map_or(0.0, |jaw| jaw.force_limit_n),
                };
                data.set_motor_max_force(axis, limit);
            }
            let handle = self
                .world
                .insert_multibody_joint(self.links[joint.parent], self.links[id], data)
                .ok_or_else(|| setup(format!("Rapier does not accept the joint `{}`", joint.name)))?;
            self.joints[id] = Some(handle);
        }
        Ok(())
    }

    fn joint_handles(&self, names: &[String]) -> Result<Vec<MultibodyJointHandle>, Fault> {
        let handle = |name: &String| {
            let link = self.engine.description.link_of(name);
            link.and_then(|link| self.joints[link]).ok_or_else(|| setup(format!("the model has no joint `{name}`")))
        };
        names.iter().map(handle).collect()
    }

    /// Joint positions at the start, armature and damping of the joints, and their couplings.
    fn configure_drives(&mut self, joints: &[f64]) -> Result<(), Fault> {
        let settings = &self.engine.robot.settings;
        let (arm, jaw) = (&settings.arm, settings.gripper.jaw());
        let finger_joints = jaw.map_or(&[][..], |jaw| jaw.slides());
        let (description, links) = (&self.engine.description, &self.links);
        let first = self.joint_handles(&arm.joints)?.first().copied();
        let (multibody, _) = first
            .and_then(|joint| self.world.multibody_joints.get_mut(joint))
            .ok_or_else(|| setup("the arm has no joint".to_owned()))?;
        multibody.set_self_contacts_enabled(false);
        // The per-joint vectors have their final order only after this call.
        multibody.forward_kinematics(&self.world.bodies, true);
        let mut start = vec![0.0; multibody.ndofs()];
        let at_start = arm.joints.iter().zip(joints).map(|(name, q)| (name, *q));
        let open = 0.5 * jaw.map_or(0.0, |jaw| jaw.opening_m);
        for (name, q) in at_start.chain(finger_joints.iter().map(|name| (name, open))) {
            let link = description
                .link_of(name)
                .and_then(|link| multibody.links().find(|l| l.rigid_body_handle() == links[link]));
            if let Some(link) = link {
                start[link.assembly_id()] = q;
            }
        }
        multibody.apply_displacements(&start);
        let order: Vec<(usize, usize)> = description
            .links
            .iter()
            .enumerate()
            .filter(|(_, link)| link.joint.is_some())
            .filter_map(|(id, _)| {
                let link = multibody.links().find(|l| l.rigid_body_handle() == links[id])?;
                Some((id, link.assembly_id()))
            })
            .collect();
        for (id, dof) in &order {
            if let Some(joint) = &description.links[*id].joint {
                let mut inertia = joint.armature;
                // Fingers so light that their servo stops them within a time step h chatter against a part. As in MuJoCo
                // (`mujoco/damping`), they get the inertia h D + h^2 K, which vanishes with the time step.
                if let Some(jaw) = jaw.filter(|_| finger_joints.contains(&joint.name)) {
                    let step = self.engine.time_step;
                    let added = step * (jaw.damping_ns_m + step * jaw.stiffness_n_m);
                    if added > description.links[*id].mass + inertia {
                        inertia += added;
                    }
                }
                multibody.armature_mut()[*dof] = inertia;
                multibody.damping_mut()[*dof] = joint.damping;
            }
        }
        for coupling in &description.couplings {
            let link = |name: &str| {
                let id = description.link_of(name)?;
                let slides = description.links[id].joint.as_ref()?.slides;
                let link = multibody.links().find(|l| l.rigid_body_handle() == links[id])?;
                Some((link.link_id(), if slides { 0 } else { 3 }))
            };
            let (Some((link1, axis1)), Some((link2, axis2))) = (link(&coupling.first), link(&coupling.second)) else {
                return Err(setup(format!("the model has no joint `{}` or `{}`", coupling.first, coupling.second)));
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
        multibody.forward_kinematics(&self.world.bodies, true);
        multibody.update_rigid_bodies(&mut self.world.bodies, true);
        Ok(())
    }

    /// Adds the fixtures. Returns the index and body of each moving one.
    fn add_fixtures(&mut self) -> Result<Vec<(usize, RigidBodyHandle)>, Fault> {
        let ground = self.world.insert_body(RigidBodyBuilder::fixed());
        let mut movers = Vec::new();
        for (i, fixture) in self.scene.fixtures.iter().enumerate() {
            let (shared, at) = solid(&primitive(&fixture.part.primitive), &Isometry3::identity()).map_err(setup)?;
            let (body, at) = if fixture.motion.is_some() {
                let driven = RigidBodyBuilder::kinematic_position_based().pose(pose(&fixture.part.pose));
                let body = self.world.insert_body(driven.can_sleep(false));
                movers.push((i, body));
                (body, at)
            } else {
                (ground, fixture.part.pose * at)
            };
            let (friction, rule) = match self.scene.table_friction.filter(|_| fixture.kind.has_table_friction()) {
                Some(friction) => (
                    precedent_coefficient("table_friction", friction, self.scene.friction).map_err(setup)?,
                    CoefficientCombineRule::GeometricMean,
                ),
                None => (fixture.friction.unwrap_or(0.0), CoefficientCombineRule::Max),
            };
            let collider = ColliderBuilder::new(shared)
                .position(pose(&at))
                .friction(friction)
                .friction_combine_rule(rule)
                .collision_groups(groups(FIXTURE, ROBOT | OBJECT));
            self.add_collider(collider, body, Kind::Fixture(i));
        }
        Ok(movers)
    }

    /// Adds the free bodies: body and shapes of each.
    fn add_free_bodies(&mut self) -> Result<Vec<(RigidBodyHandle, Vec<ColliderHandle>)>, Fault> {
        let scene = self.scene;
        scene.free_bodies().enumerate().map(|(index, (object, at))| self.add_free_body(index, object, at)).collect()
    }

    /// Adds the joints of the bodies that are on one.
    fn add_scene_joints(
        &mut self,
        free: &[(RigidBodyHandle, Vec<ColliderHandle>)],
    ) -> Result<Vec<Option<joints::Handles>>, Fault> {
        let scene = self.scene;
        let bodies = scene.free_bodies().zip(free);
        let add = |((object, at), (body, _)): ((&Object, &Isometry3<f64>), &(RigidBodyHandle, _))| {
            object.joint.as_ref().map(|joint| joints::add(&mut self.world, *body, at, joint)).transpose()
        };
        bodies.map(add).collect()
    }

    /// Adds a free body and its shapes. The object's friction coefficient applies to all of its contacts.
    fn add_free_body(
        &mut self,
        index: usize,
        object: &Object,
        at_start: &Isometry3<f64>,
    ) -> Result<(RigidBodyHandle, Vec<ColliderHandle>), Fault> {
        let mass = &object.mass;
        let link = Link {
            joint: None,
            mass: mass.mass_kg,
            centre: mass.centre,
            inertia: mass.inertia,
            shapes: Vec::new(),
            looks: Vec::new(),
        };
        let body = self.world.insert_body(
            RigidBodyBuilder::dynamic()
                .pose(pose(at_start))
                .additional_mass_properties(mass_properties(&link))
                .can_sleep(false),
        );
        let mut shapes = Vec::new();
        // Free bodies collide with each other.
        let (member, meets) = match object.joint {
            Some(_) => (JOINTED, ROBOT | OBJECT),
            None if self.scene.others.is_empty() => (OBJECT, ROBOT | FIXTURE),
            None => (OBJECT, ROBOT | FIXTURE | OBJECT | JOINTED),
        };
        for part in &object.parts {
            let (shared, at) = solid(&primitive(&part.primitive), &part.pose).map_err(setup)?;
            let collider = ColliderBuilder::new(shared)
                .position(pose(&at))
                .density(0.0)
                .friction(self.scene.friction_of(object))
                .friction_combine_rule(CoefficientCombineRule::Max)
                .collision_groups(groups(member, meets));
            shapes.push(self.add_collider(collider, body, Kind::Object(index)));
        }
        Ok((body, shapes))
    }
}

/// The coefficient of a table or a pad that gives `friction` in contact with an object of coefficient `object`.
///
/// The geometric mean is the only rule that takes precedence over the object's rule and can give any coefficient.
fn precedent_coefficient(what: &str, friction: f64, object: f64) -> Result<f64, String> {
    if friction > 0.0 && object <= 0.0 {
        return Err(format!(
            "{what} = {friction}: in Rapier an object without friction has no friction against anything"
        ));
    }
    Ok(if friction > 0.0 { friction * friction / object } else { 0.0 })
}

fn groups(member: Group, meets: Group) -> InteractionGroups {
    InteractionGroups::new(member, meets, InteractionTestMode::And)
}
