//! Bodies of the scene on joints.

use mujoco_rs::mujoco_c::mjtLimited;
use mujoco_rs::prelude::*;
use mujoco_rs::wrappers::mj_editing::MjsBody;
use nalgebra::{Isometry3, Vector3};

use super::Loaded;
use crate::{Joint, JointKind, contact};

/// A kind of joint as MuJoCo names it.
pub(super) fn kind(kind: JointKind) -> MjtJoint {
    match kind {
        JointKind::Hinge | JointKind::Screw => MjtJoint::mjJNT_HINGE,
        JointKind::Slide => MjtJoint::mjJNT_SLIDE,
    }
}

/// How firmly dry friction holds a joint: MuJoCo's largest impedance d. A part 1 - d of the acceleration is let through, so that a loaded
/// joint creeps at a speed that does not depend on its friction: with the default of 0.9 to 0.95, a lever of 0.4 kg sank by 4 degrees in a second.
const HOLDS: f64 = 0.9999;
/// The time in which dry friction stops a joint, in seconds, and the damping ratio.
const HOLDS_REFERENCE: [f64; 2] = [0.005, 1.0];

/// Adds the joint of a body. Angles are in degrees if the model says so.
pub(super) fn add(body: &mut MjsBody, name: &str, joint: &Joint, degrees: bool) {
    let angle = |value: f64| if degrees && joint.kind != JointKind::Slide { value.to_degrees() } else { value };
    // The first joint of the body has the value. A screw has a slide beside it, which follows the angle.
    let added = body.add_joint().with_name(name);
    added.set_type(kind(joint.kind));
    *added.pos_mut() = joint.anchor.into();
    *added.axis_mut() = joint.axis.into();
    *added.range_mut() = joint.range.map(angle);
    added.set_limited(mjtLimited::mjLIMITED_TRUE);
    // The defaults of a robot's file do not apply to the scene. With those of MuJoCo, a hand that pushes with 37 N moves a part of
    // 150 g by 5 mm past its stop.
    added.solref_limit_mut()[..2].copy_from_slice(&[contact::TIME_CONSTANT_S, 1.0]);
    added.solimp_limit_mut()[..3].copy_from_slice(&contact::LIMIT_IMPEDANCE);
    added.stiffness_mut().fill(0.0);
    added.stiffness_mut()[0] = joint.stiffness;
    added.damping_mut().fill(0.0);
    added.damping_mut()[0] = joint.damping;
    added.set_springref(angle(joint.rest));
    *added.ref_mut() = 0.0;
    added.set_frictionloss(joint.friction);
    *added.solref_friction_mut() = HOLDS_REFERENCE;
    added.solimp_friction_mut()[..2].fill(HOLDS);
    added.set_armature(0.0);
    added.set_margin(0.0);
    if joint.kind == JointKind::Screw {
        let along = body.add_joint().with_name(&along_name(name));
        along.set_type(MjtJoint::mjJNT_SLIDE);
        *along.axis_mut() = joint.axis.into();
        along.set_limited(mjtLimited::mjLIMITED_FALSE);
        along.stiffness_mut().fill(0.0);
        along.damping_mut().fill(0.0);
        along.set_frictionloss(0.0);
        along.set_armature(0.0);
    }
}

/// The name of the slide of a screw.
fn along_name(name: &str) -> String {
    format!("{name}/along")
}

/// Couples the slide of a screw to its angle.
pub(super) fn couple(spec: &mut MjSpec, name: &str, joint: &Joint) {
    if joint.kind != JointKind::Screw {
        return;
    }
    // An equality of joints would be as soft as the small inertia of a turning body allows. MuJoCo knows the inertia of a tendon.
    let tendon = spec.add_tendon().with_name(&along_name(name));
    tendon.wrap_joint(&along_name(name), 1.0);
    tendon.wrap_joint(name, -joint.lead_m_rad());
    let lead = spec.add_equality().with_name(&along_name(name));
    lead.set_type(MjtEq::mjEQ_TENDON);
    lead.set_objtype(MjtObjBase::mjOBJ_TENDON);
    lead.set_name1(&along_name(name));
    lead.data_mut()[..5].fill(0.0);
    lead.solref_mut()[..2].copy_from_slice(&[contact::TIME_CONSTANT_S, 1.0]);
    lead.solimp_mut()[..2].fill(HOLDS);
    if joint.thread.is_some() {
        // It does not turn before it takes something up.
        let lock = spec.add_equality().with_name(&lock_name(name));
        lock.set_type(MjtEq::mjEQ_JOINT);
        lock.set_objtype(MjtObjBase::mjOBJ_JOINT);
        lock.set_name1(name);
        lock.data_mut()[..5].copy_from_slice(&[joint.start, 0.0, 0.0, 0.0, 0.0]);
        lock.solref_mut()[..2].copy_from_slice(&[contact::TIME_CONSTANT_S, 1.0]);
        lock.solimp_mut()[..2].fill(HOLDS);
    }
}

/// The name of what keeps a screw from turning.
fn lock_name(name: &str) -> String {
    format!("{name}/lock")
}

impl Loaded {
    /// The joint of a body, with the body's pose at its value 0, and value and speed.
    pub(super) fn jointed(&self, body: usize) -> Option<(&Joint, &Isometry3<f64>, [f64; 2])> {
        let (object, pose) = self.scene.free_bodies().nth(body)?;
        let free = self.free[body];
        Some((object.joint.as_ref()?, pose, [self.data.qpos()[free.qpos], self.data.qvel()[free.qvel]]))
    }

    pub(super) fn jointed_pose(&self, body: usize) -> Option<Isometry3<f64>> {
        self.jointed(body).map(|(joint, pose, [value, _])| pose * joint.motion(value))
    }

    /// As that of a free body: the linear velocity along the world's axes, the angular one along the body's own.
    pub(super) fn jointed_velocity(&self, body: usize) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (joint, pose, [value, speed]) = self.jointed(body)?;
        let (linear, angular) = joint.velocity(value, speed);
        Some((pose * linear, angular))
    }

    /// The joints as they act.
    pub(super) fn joints_read(&self) -> Vec<(usize, Joint)> {
        let model = self.data.model();
        let read = |body: usize| {
            let (joint, _, [value, _]) = self.jointed(body)?;
            let (dof, of) = (self.free[body].qvel, model.body_jntadr()[self.free[body].body] as usize);
            let acting = Joint {
                range: model.jnt_range()[of],
                start: value,
                damping: model.dof_damping()[dof],
                friction: model.dof_frictionloss()[dof],
                stiffness: model.jnt_stiffness()[of],
                rest: model.qpos_spring()[self.free[body].qpos],
                pitch_m: self.lead(body).map_or(0.0, |lead| lead * std::f64::consts::TAU),
                ..*joint
            };
            Some((body, acting))
        };
        (0..self.free.len()).filter_map(read).collect()
    }

    /// How far a screw moves along its axis per angle, in m/rad.
    fn lead(&self, body: usize) -> Option<f64> {
        let model = self.data.model();
        let name = along_name(&super::scene::free_name(body));
        let tendon = model.name_to_id(MjtObjBase::mjOBJ_TENDON, &name)?;
        // Its second joint is the angle.
        Some(-model.wrap_prm()[model.tendon_adr()[tendon] as usize + 1])
    }

    /// Switches the weld of the thread of a body on a screw on or off. Returns it.
    pub(super) fn thread(&mut self, screw: usize, holds: bool) -> Option<usize> {
        let find = |name: &str| self.data.model().name_to_id(MjtObjBase::mjOBJ_EQUALITY, name);
        let weld = find(&super::scene::thread_name(screw))?;
        let lock = find(&lock_name(&super::scene::free_name(screw)))?;
        self.data.eq_active_mut()[weld] = holds;
        self.data.eq_active_mut()[lock] = !holds;
        Some(weld)
    }

    /// Switches a weld on for two bodies at these poses, at this point.
    pub(super) fn join(&mut self, equality: usize, [first, second]: [&Isometry3<f64>; 2], at: &Vector3<f64>) {
        let rotation = first.rotation.inverse() * second.rotation;
        let at = nalgebra::Point3::from(*at);
        let (in_second, in_first) = (second.inverse_transform_point(&at), first.inverse_transform_point(&at));
        // SAFETY: only numbers of an equality of this model change; no size and no address depends on them.
        #[expect(unsafe_code, reason = "the binding has no safe setter")]
        let numbers = unsafe { &mut self.data.model_mut().eq_data_mut()[equality] };
        numbers[..3].copy_from_slice(in_second.coords.as_slice());
        numbers[3..6].copy_from_slice(in_first.coords.as_slice());
        numbers[6..10].copy_from_slice(&super::wxyz(&rotation));
        self.data.eq_active_mut()[equality] = true;
    }
}
