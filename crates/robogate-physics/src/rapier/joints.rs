//! Bodies of the scene on joints: a multibody of one link in reduced coordinates, with springs, damping and dry friction of its own.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rapier3d_f64::dynamics::{
    FixedJointBuilder, GenericJointBuilder, ImpulseJointHandle, JointAxesMask, JointAxis, MotorModel,
    MultibodyDofCoupling, MultibodyJointHandle, RigidBodyBuilder, RigidBodyHandle, SpringCoefficients,
};
use rapier3d_f64::prelude::PhysicsWorld;
use robogate_core::Fault;

use super::Loaded;
use super::convert::pose;
use super::load::{CONTACT_DAMPING, CONTACT_HZ, setup};
use crate::description::isometry;
use crate::{Joint, JointKind};

/// The indices of sliding and turning among the axes of a joint.
const SLIDES: usize = 0;
const TURNS: usize = 3;

/// The axis of Rapier that has the value of a joint, and its index.
fn axis(kind: JointKind) -> (JointAxis, usize) {
    match kind {
        JointKind::Slide => (JointAxis::LinX, SLIDES),
        JointKind::Hinge | JointKind::Screw => (JointAxis::AngX, TURNS),
    }
}

/// The number of a joint's coordinates, and which of them is its value. A screw slides first and then turns.
fn coordinates(kind: JointKind) -> (usize, usize) {
    if kind == JointKind::Screw { (2, 1) } else { (1, 0) }
}

/// Damping of the motor that acts as dry friction, in N s/m or N m s/rad: below its largest force the joint stands still.
const HOLDS: f64 = 1e6;

/// The joint of a body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Handles {
    link: MultibodyJointHandle,
    /// The motor that acts as dry friction.
    friction: Option<ImpulseJointHandle>,
}

/// Adds the joint of a body to the ground. The body has its pose at the value 0.
pub(super) fn add(
    world: &mut PhysicsWorld,
    body: RigidBodyHandle,
    at: &Isometry3<f64>,
    joint: &Joint,
) -> Result<Handles, Fault> {
    let locked = match joint.kind {
        JointKind::Slide => JointAxesMask::LOCKED_PRISMATIC_AXES,
        JointKind::Hinge => JointAxesMask::LOCKED_REVOLUTE_AXES,
        JointKind::Screw => JointAxesMask::LOCKED_REVOLUTE_AXES & JointAxesMask::LOCKED_PRISMATIC_AXES,
    };
    let along = UnitQuaternion::rotation_between(&Vector3::x(), &joint.direction())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
    let frame = Isometry3::from_parts(Translation3::from(joint.anchor), along);
    let (axis, index) = axis(joint.kind);
    let between =
        |locked| GenericJointBuilder::new(locked).local_frame1(pose(&(at * frame))).local_frame2(pose(&frame));
    let mut data = between(locked).build();
    data.set_limits(axis, joint.range);
    // A stop without give would stop what drives the joint within a time step.
    data.softness = SpringCoefficients::new(CONTACT_HZ, CONTACT_DAMPING);
    let ground = world.insert_body(RigidBodyBuilder::fixed());
    let refused = || setup("Rapier does not accept the joint of a part".to_owned());
    let handle = world.insert_multibody_joint(ground, body, data).ok_or_else(refused)?;
    let (multibody, id) = world.multibody_joints.get_mut(handle).ok_or_else(refused)?;
    // The vectors have their final size only after this call.
    multibody.forward_kinematics(&world.bodies, true);
    let (count, value) = coordinates(joint.kind);
    multibody.damping_mut().fill(0.0);
    multibody.damping_mut()[value] = joint.damping;
    if let Some(link) = multibody.link_mut(id) {
        link.joint.set_spring(index, joint.stiffness, joint.rest);
    }
    let mut start = vec![0.0; count];
    start[value] = joint.start;
    if joint.kind == JointKind::Screw {
        start[0] = joint.lead_m_rad() * joint.start;
        multibody.add_dof_coupling(MultibodyDofCoupling {
            link1: id,
            dof1: 1,
            axis1: TURNS,
            link2: id,
            dof2: 0,
            axis2: SLIDES,
            coeff: joint.lead_m_rad(),
            offset: 0.0,
        });
    }
    multibody.apply_displacements(&start);
    multibody.forward_kinematics(&world.bodies, true);
    multibody.update_rigid_bodies(&mut world.bodies, true);
    // The friction of a multibody would be as soft as its stops.
    let friction = (joint.friction > 0.0).then(|| {
        let motor = between(JointAxesMask::empty()).motor_model(axis, MotorModel::ForceBased);
        let motor = motor.motor_velocity(axis, 0.0, HOLDS).motor_max_force(axis, joint.friction);
        world.insert_impulse_joint(ground, body, motor.build())
    });
    Ok(Handles { link: handle, friction })
}

impl Loaded {
    /// The joint of a body of the scene, with its handle.
    fn jointed(&self, body: usize) -> Option<(&Joint, Handles)> {
        let joint = self.scene.free_body(body).joint.as_ref()?;
        Some((joint, self.joints.get(body).copied().flatten()?))
    }

    /// Value and speed of the joint of a body.
    pub(super) fn joint_state(&self, body: usize) -> Option<[f64; 2]> {
        let (joint, handles) = self.jointed(body)?;
        let (multibody, id) = self.world.multibody_joints.get(handles.link)?;
        let link = multibody.link(id)?;
        let (_, value) = coordinates(joint.kind);
        Some([link.joint().coords()[axis(joint.kind).1], multibody.joint_velocity(link)[value]])
    }

    /// The joints as they act.
    pub(super) fn joints_read(&self) -> Vec<(usize, Joint)> {
        let read = |body: usize| {
            let (joint, handles) = self.jointed(body)?;
            let (multibody, id) = self.world.multibody_joints.get(handles.link)?;
            let link = multibody.link(id)?;
            let (axis, index) = axis(joint.kind);
            let (_, value) = coordinates(joint.kind);
            let (stiffness, rest) = link.joint.spring(index);
            let limits = link.joint.data.limits(axis)?;
            let motor = handles.friction.and_then(|motor| self.world.impulse_joints.get(motor)?.data.motor(axis));
            let lead = multibody.couplings().first().map_or(0.0, |coupling| coupling.coeff);
            let acting = Joint {
                range: [limits.min, limits.max],
                start: link.joint().coords()[index],
                damping: multibody.damping()[value],
                friction: motor.map_or(0.0, |motor| motor.max_force),
                stiffness,
                rest,
                pitch_m: lead * std::f64::consts::TAU,
                ..*joint
            };
            Some((body, acting))
        };
        (0..self.free.len()).filter_map(read).collect()
    }

    /// Locks the bodies whose threads have taken nothing up: they do not turn.
    pub(super) fn lock_threads(&mut self) {
        let threads = |body: usize| self.scene.free_body(body).joint.is_some_and(|joint| joint.thread.is_some());
        for screw in (0..self.free.len()).filter(|body| threads(*body)).collect::<Vec<_>>() {
            let ground = self.world.insert_body(RigidBodyBuilder::fixed());
            self.fix(screw, ground);
        }
    }

    /// Joins a body on a screw and another body at their relative pose, in place of what it was joined to.
    fn fix(&mut self, screw: usize, to: RigidBodyHandle) {
        if let Some(index) = self.threads.iter().position(|(known, _)| *known == screw) {
            self.world.remove_impulse_joint(self.threads.remove(index).1);
        }
        let of = |handle: RigidBodyHandle| isometry(self.world.bodies[handle].position());
        let first = self.free[screw].0;
        let joint = FixedJointBuilder::new().local_frame1(pose(&(of(first).inverse() * of(to)))).build();
        self.threads.push((screw, self.world.insert_impulse_joint(first, to, joint)));
    }

    pub(super) fn take_up(&mut self, screw: usize, body: usize) {
        self.fix(screw, self.free[body].0);
    }

    pub(super) fn let_go(&mut self, screw: usize) {
        let ground = self.world.insert_body(RigidBodyBuilder::fixed());
        self.fix(screw, ground);
    }
}
