//! Servos that damp a joint far more than its inertia allows in a time step.
//!
//! The integrator treats the damping of a servo implicitly: with the mass matrix M, the damping D and the time step h, the
//! acceleration a follows from (M + h D) a = force. The contact solver, however, uses M alone. If h D is much larger than M, it
//! expects an arm that gives way, which the integrator then hardly moves. The friction on a held part can point along its
//! motion, and the part slips out of the fingers. Models without the inertia of the motors (armature) have such joints.
//!
//! For these joints h D is added to the armature, and the damping force is computed from the speed at the start of the step. That
//! is the same equation of motion, and the contact solver uses it too. Other joints, among them those of all built-in robots,
//! keep the implicit damping.
//!
//! Fingers are light, so their stiffness K counts as well: h D + h^2 K is added to the inertia, and the servo pulls with
//! K (target - q - h v) - D v. This is implicit Euler for spring and damper, which is stable for any mass and any time step.
//! Joints that an equality couples to a drive have such a servo too (`FingerMotion::forces`).

use mujoco_rs::prelude::*;
use nalgebra::DMatrix;

use super::PREFIX;
use super::sweep::DriveAt;
use crate::{FingerMotion, RobotSettings};

/// A joint of the arm is strongly damped if h D is more than this multiple of the inertia that its servo moves. For the built-in
/// robots it is at most 5 times.
const STRONG: f64 = 20.0;
/// A finger is strongly damped if h D + h^2 K is more than this multiple of its inertia: at 7 times, fingers of 29 g chatter.
/// For the built-in Panda it is 0.5 times.
const STRONG_FINGER: f64 = 1.0;

/// Which joints and drives are strongly damped.
pub(crate) struct Strong {
    /// In the order of `arm.joints`.
    pub(crate) arm: Vec<bool>,
    /// In the order of `gripper.finger_joints` or `[[gripper.drive]]`.
    pub(crate) fingers: Vec<bool>,
}

/// Changes strongly damped joints of the arm, in the order of `arm.joints`, and strongly damped fingers, and returns which ones
/// they are. `model` is the compiled `spec`.
pub(crate) fn couple(
    spec: &mut MjSpec,
    model: &MjModel,
    settings: &RobotSettings,
    motion: Option<&FingerMotion>,
    time_step: f64,
) -> Strong {
    let arm = &settings.arm;
    let joints: Vec<usize> =
        arm.joints.iter().filter_map(|name| model.name_to_id(MjtObjBase::mjOBJ_JOINT, name)).collect();
    let dofs: Vec<usize> = joints.iter().map(|joint| model.jnt_dofadr()[*joint] as usize).collect();
    let mut data = MjData::new(Box::new(model.clone()));
    for (joint, home) in joints.iter().zip(&arm.home_rad) {
        data.qpos_mut()[model.jnt_qposadr()[*joint] as usize] = *home;
    }
    data.forward();
    let fingers = couple_fingers(spec, model, settings, motion, time_step);
    let Some(inertias) = moved_inertias(&data, &dofs) else {
        return Strong { arm: vec![false; arm.joints.len()], fingers };
    };
    let mut strong = Vec::with_capacity(arm.joints.len());
    // An array that is too short is reported as a problem of the settings.
    let damping = arm.damping_nms_rad.iter().copied().chain(std::iter::repeat(0.0));
    for (i, (name, damping)) in arm.joints.iter().zip(damping).enumerate() {
        let added = time_step * damping;
        strong.push(inertias.get(i).is_some_and(|inertia| added > STRONG * inertia));
        if strong[i] {
            if let Some(joint) = spec.joint_mut(name) {
                joint.set_armature(model.dof_armature()[dofs[i]] + added);
            }
            drop_damping(spec, name);
        }
    }
    Strong { arm: strong, fingers }
}

/// Changes strongly damped fingers, and returns which ones they are.
fn couple_fingers(
    spec: &mut MjSpec,
    model: &MjModel,
    settings: &RobotSettings,
    motion: Option<&FingerMotion>,
    time_step: f64,
) -> Vec<bool> {
    let Some(jaw) = settings.gripper.jaw() else { return Vec::new() };
    let slides = jaw.slides().iter().map(|name| (name, 1.0));
    // A drive with the slope s = d(opening)/d(position) and the share w has w s^2 / 2 of a finger's stiffness and damping. Shares of both
    // signs exceed 1 in sum: then this multiple is an upper bound of the stiffness that couples the drives (Cauchy and Schwarz).
    let drives = motion.into_iter().flat_map(|motion| {
        let sizes = motion.states.iter().map(|state| state.shares.iter().map(|share| share.abs()).sum::<f64>());
        let size = sizes.fold(1.0, f64::max);
        let bound = if size > 1.0 + 1e-6 { size + 1.0 } else { 1.0 };
        let share = move |i: usize| 0.5 * bound * motion.largest_share(i) * motion.steepest(i).powi(2);
        motion.driven(jaw).enumerate().map(move |(i, name)| (name, share(i)))
    });
    let followed = motion.is_some_and(|motion| !motion.followers.is_empty());
    slides
        .chain(drives)
        .map(|(name, share)| {
            let Some(at) = DriveAt::find(model, name) else { return false };
            let passive = at.passive_damping(model);
            let added = time_step * share * (jaw.damping_ns_m + time_step * jaw.stiffness_n_m);
            let strong = followed || added + time_step * passive > STRONG_FINGER * at.inertia(model);
            if strong {
                if let Some(joint) = spec.joint_mut(name) {
                    joint.set_armature(joint.armature() + added);
                } else if let Some(tendon) = spec.tendon_mut(name) {
                    tendon.set_armature(tendon.armature() + added);
                }
                drop_damping(spec, name);
            }
            strong
        })
        .collect()
}

/// Removes the implicit damping of a servo.
fn drop_damping(spec: &mut MjSpec, moves: &str) {
    if let Some(actuator) = spec.actuator_mut(&format!("{PREFIX}{moves}")) {
        actuator.biasprm_mut()[2] = 0.0;
    }
}

/// The inertia that each of these joints moves while the others move freely, in kg m^2: one over the diagonal of the inverse
/// mass matrix. `dofs` are the joints' addresses in qvel. `None` if the mass matrix is singular.
fn moved_inertias(data: &MjData<Box<MjModel>>, dofs: &[usize]) -> Option<Vec<f64>> {
    let n = data.qvel().len();
    let mut full = vec![0.0; n * n];
    data.full_m(&mut full).ok()?;
    let inverse = DMatrix::from_fn(dofs.len(), dofs.len(), |i, j| full[dofs[i] * n + dofs[j]]).try_inverse()?;
    Some((0..dofs.len()).map(|i| 1.0 / inverse[(i, i)]).collect())
}
