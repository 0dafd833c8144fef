//! Converts a scene to a MuJoCo model.

use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_editing::{MjsBody, MjsGeom};
use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion};

use super::{FIXTURE, JOINTED, MujocoEngine, OBJECT, PREFIX, joints, wxyz};
use crate::{JointKind, Motion, Part, Primitive, Scene, contact};

impl MujocoEngine {
    /// Adds a scene to the robot's model.
    pub fn furnish(&self, spec: &mut MjSpec, scene: &Scene) -> Result<(), MjEditError> {
        spec.option_mut().gravity = [0.0, 0.0, -scene.gravity];
        self.set_stiffness(spec, scene.arm_stiffness);
        self.set_pad_friction(spec, scene);
        let degrees = spec.compiler().degree();
        add_meshes(spec, scene);
        let world = spec.world_body_mut();
        for fixture in &scene.fixtures {
            let name = format!("{PREFIX}{}", fixture.name);
            let Part { primitive, pose } = &fixture.part;
            let geom = if let Some(motion) = &fixture.motion {
                // Its joint is set to the prescribed position at every step. The joint gives contacts the correct
                // speed, and the large mass keeps pushed objects from slowing it down.
                let body = world.add_body().with_name(&name);
                place(pose, body.pos_mut());
                *body.quat_mut() = wxyz(&pose.rotation);
                let (kind, axis, anchor) = motion.joint();
                // Weight would accelerate it along a joint that is not horizontal.
                if !matches!(motion, Motion::Straight { .. }) {
                    body.set_gravcomp(1.0);
                }
                let joint = body.add_joint().with_name(&name);
                joint.set_type(joints::kind(kind));
                *joint.axis_mut() = (pose.rotation.inverse() * axis).into();
                if kind == JointKind::Hinge {
                    *joint.pos_mut() = pose.inverse_transform_point(&anchor.into()).into();
                }
                let geom = body.add_geom().with_name(&name);
                shape(geom, primitive, &Isometry3::identity());
                geom.set_mass(contact::DRIVEN_MASS_KG);
                geom
            } else {
                let geom = world.add_geom().with_name(&name);
                shape(geom, primitive, pose);
                geom
            };
            geom.set_contype(FIXTURE.0);
            geom.set_conaffinity(FIXTURE.1);
            // A table with a separate friction coefficient takes precedence over the object. With a coefficient of its own, the
            // larger one of both acts.
            let table =
                scene.table_friction.filter(|_| fixture.kind.has_table_friction()).map(|friction| (2, friction));
            if let Some((priority, friction)) = table.or(fixture.friction.map(|friction| (1, friction))) {
                geom.set_priority(priority);
                let mut parts = scene.free_bodies().flat_map(|(object, _)| &object.parts);
                object_contact(geom, friction, parts.any(Part::rolls));
            }
        }
        // Free bodies collide with each other.
        let affinity = if scene.others.is_empty() { OBJECT.1 } else { OBJECT.1 | OBJECT.0 };
        for (index, (object, pose)) in scene.free_bodies().enumerate() {
            let name = free_name(index);
            let body = world.add_body().with_name(&name);
            place(pose, body.pos_mut());
            *body.quat_mut() = wxyz(&pose.rotation);
            let mass = &object.mass;
            body.set_explicitinertial(true);
            body.set_mass(mass.mass_kg);
            place(&Isometry3::from_parts(Translation3::from(mass.centre), UnitQuaternion::identity()), body.ipos_mut());
            let m: &Matrix3<f64> = &mass.inertia;
            *body.fullinertia_mut() = [m[(0, 0)], m[(1, 1)], m[(2, 2)], m[(0, 1)], m[(0, 2)], m[(1, 2)]];
            match &object.joint {
                Some(joint) => joints::add(body, &name, joint, degrees),
                None => body.add_free_joint().set_name(&name)?,
            }
            for (i, part) in object.parts.iter().enumerate() {
                let geom = body.add_geom().with_name(&format!("{name}_{i}"));
                shape(geom, &part.primitive, &part.pose);
                let (contype, conaffinity) = if object.joint.is_some() { JOINTED } else { (OBJECT.0, affinity) };
                geom.set_contype(contype);
                geom.set_conaffinity(conaffinity);
                geom.set_mass(0.0);
                // The object's friction coefficient applies to all of its contacts.
                geom.set_priority(1);
                object_contact(geom, scene.friction_of(object), matches!(part.primitive, Primitive::Sphere { .. }));
            }
        }
        let cup = self.robot.settings.gripper.cup();
        for (index, (object, _)) in scene.free_bodies().enumerate() {
            if let Some(cup) = cup {
                add_weld(spec, &weld_name(index), [&cup.cup_body, &free_name(index)]);
            }
            if let Some(joint) = &object.joint {
                joints::couple(spec, &free_name(index), joint);
                if let Some(thread) = joint.thread {
                    add_weld(spec, &thread_name(index), [&free_name(index), &free_name(thread.body)]);
                }
            }
        }
        Ok(())
    }
}

/// Adds a weld between two bodies, which is switched on and off.
fn add_weld(spec: &mut MjSpec, name: &str, [first, second]: [&str; 2]) {
    let weld = spec.add_equality().with_name(name);
    weld.set_type(MjtEq::mjEQ_WELD);
    weld.set_objtype(MjtObjBase::mjOBJ_BODY);
    weld.set_name1(first);
    weld.set_name2(second);
    weld.set_active(false);
    // Without these numbers MuJoCo's compiler would compute reference poses from the initial state.
    weld.data_mut()[..11].copy_from_slice(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    weld.solref_mut()[..2].copy_from_slice(&[contact::TIME_CONSTANT_S, 1.0]);
    weld.solimp_mut()[..3].copy_from_slice(&contact::IMPEDANCE);
}

impl MujocoEngine {
    /// Multiplies the stiffness of the arm's servos, at a constant damping ratio.
    fn set_stiffness(&self, spec: &mut MjSpec, scale: f64) {
        let arm = &self.robot.settings.arm;
        for i in (0..arm.joints.len()).filter(|i| self.strong.arm[*i]) {
            if let Some(joint) = spec.joint_mut(&arm.joints[i]) {
                let added = self.time_step * arm.damping_nms_rad[i] * (scale.sqrt() - 1.0);
                joint.set_armature(joint.armature() + added);
            }
        }
        for actuator in spec.actuator_iter_mut() {
            let arm = &self.robot.settings.arm.joints;
            if actuator.name().strip_prefix(PREFIX).is_some_and(|name| arm.iter().any(|joint| joint == name)) {
                actuator.gainprm_mut()[0] *= scale;
                actuator.biasprm_mut()[1] *= scale;
                actuator.biasprm_mut()[2] *= scale.sqrt();
            }
        }
    }
}

impl MujocoEngine {
    /// Gives the pads their own friction coefficient, if it is not that of the object. It takes precedence over the
    /// object's and the table's.
    fn set_pad_friction(&self, spec: &mut MjSpec, scene: &Scene) {
        let Some(friction) = scene.gripper.pad_friction(scene.friction) else { return };
        let mut parts = scene.free_bodies().flat_map(|(object, _)| &object.parts);
        let rolls = parts.any(Part::rolls);
        let bodies = self.robot.settings.gripper.jaw().map_or(&[][..], |jaw| &jaw.finger_bodies);
        set_finger_friction(spec.world_body_mut(), bodies, friction, rolls);
    }
}

/// Sets the friction coefficient of all bodies that are welded to one of these.
fn set_finger_friction(body: &mut MjsBody, fingers: &[String], friction: f64, rolls: bool) {
    for child in body.body_iter_mut() {
        if child.joint_iter(false).next().is_some() && carries(child, fingers) {
            set_friction(child, friction, rolls);
        }
        set_finger_friction(child, fingers, friction, rolls);
    }
}

/// Whether a body is one of these, or one of these is welded to it as a descendant.
fn carries(body: &MjsBody, fingers: &[String]) -> bool {
    let welded = |child: &MjsBody| child.joint_iter(false).next().is_none() && carries(child, fingers);
    fingers.iter().any(|finger| finger == body.name()) || body.body_iter(false).any(welded)
}

/// Sets the friction coefficient of a body and of the bodies that are welded to it.
fn set_friction(body: &mut MjsBody, friction: f64, rolls: bool) {
    for geom in body.geom_iter_mut(false) {
        if geom.contype() != 0 || geom.conaffinity() != 0 {
            geom.set_priority(3);
            object_contact(geom, friction, rolls);
        }
    }
    for child in body.body_iter_mut() {
        if child.joint_iter(false).next().is_none() {
            set_friction(child, friction, rolls);
        }
    }
}

/// Name of a free body and of its joint in the compiled model.
pub(super) fn free_name(index: usize) -> String {
    match index {
        0 => format!("{PREFIX}object"),
        other => format!("{PREFIX}object@{other}"),
    }
}

/// Name of the weld between cup and a free body in the compiled model.
pub(super) fn weld_name(index: usize) -> String {
    match index {
        0 => format!("{PREFIX}cup"),
        other => format!("{PREFIX}cup@{other}"),
    }
}

/// Name of the weld between the body on a screw and what it takes up, in the compiled model.
pub(super) fn thread_name(screw: usize) -> String {
    format!("{}/thread", free_name(screw))
}

/// Adds the piece of each geom that is one, as a mesh with the name of the geom. The compiler finds its hull.
fn add_meshes(spec: &mut MjSpec, scene: &Scene) {
    let fixtures = scene.fixtures.iter().map(|fixture| (format!("{PREFIX}{}", fixture.name), &fixture.part));
    let parts = scene.free_bodies().enumerate().flat_map(|(index, (object, _))| {
        object.parts.iter().enumerate().map(move |(i, part)| (format!("{}_{i}", free_name(index)), part))
    });
    for (name, part) in fixtures.chain(parts) {
        if let Primitive::Hull(hull) = &part.primitive {
            let corners: Vec<f32> = hull.corners().iter().flat_map(|corner| corner.iter().map(|x| *x as f32)).collect();
            spec.add_mesh().with_name(&name).set_uservert(&corners);
        }
    }
}

fn place(pose: &Isometry3<f64>, at: &mut [f64; 3]) {
    *at = pose.translation.vector.into();
}

fn shape(geom: &mut MjsGeom, primitive: &Primitive, pose: &Isometry3<f64>) {
    let (kind, size) = match *primitive {
        Primitive::Box { half } => (MjtGeomBase::mjGEOM_BOX, half),
        Primitive::Cylinder { radius, half_height } => (MjtGeomBase::mjGEOM_CYLINDER, [radius, half_height, 0.0]),
        Primitive::Sphere { radius } => (MjtGeomBase::mjGEOM_SPHERE, [radius, 0.0, 0.0]),
        Primitive::Hull(_) => (MjtGeomBase::mjGEOM_MESH, [0.0; 3]),
    };
    geom.set_type(kind);
    if let Primitive::Hull(_) = primitive {
        let name = geom.name().to_owned();
        geom.set_meshname(&name);
    }
    // The defaults of a robot's file do not apply to the scene.
    geom.set_margin(0.0);
    geom.set_gap(0.0);
    geom.set_condim(3);
    *geom.size_mut() = size;
    place(pose, geom.pos_mut());
    *geom.quat_mut() = wxyz(&pose.rotation);
}

/// Sets the contact properties of the object, or of a table that takes precedence over it.
fn object_contact(geom: &mut MjsGeom, friction: f64, rolls: bool) {
    // Sliding and torsional friction. A ball also has rolling friction; otherwise it would never come to rest.
    geom.set_condim(if rolls { 6 } else { 4 });
    *geom.friction_mut() = [friction, friction * contact::PATCH_RADIUS_M * 2.0 / 3.0, contact::ROLLING_M];
    geom.solref_mut()[..2].copy_from_slice(&[contact::TIME_CONSTANT_S, 1.0]);
    geom.solimp_mut()[..3].copy_from_slice(&contact::IMPEDANCE);
}
