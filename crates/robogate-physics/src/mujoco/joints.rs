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
        JointKind::Hinge => MjtJoint::mjJNT_HINGE,
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
    let angle = |value: f64| if degrees && joint.kind == JointKind::Hinge { value.to_degrees() } else { value };
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
                ..*joint
            };
            Some((body, acting))
        };
        (0..self.free.len()).filter_map(read).collect()
    }
}
