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

use mujoco_rs::prelude::*;
use nalgebra::DMatrix;

use super::PREFIX;
use crate::RobotSettings;

/// A joint is strongly damped if h D is more than this multiple of the inertia that its servo moves. For the built-in robots
/// it is at most 5 times.
const STRONG: f64 = 20.0;

/// Changes strongly damped joints of the arm, in the order of `arm.joints`, and returns which ones they are. `model` is the
/// compiled `spec`.
pub(crate) fn couple(spec: &mut MjSpec, model: &MjModel, settings: &RobotSettings, time_step: f64) -> Vec<bool> {
    let arm = &settings.arm;
    let joints: Vec<usize> =
        arm.joints.iter().filter_map(|name| model.name_to_id(MjtObjBase::mjOBJ_JOINT, name)).collect();
    let dofs: Vec<usize> = joints.iter().map(|joint| model.jnt_dofadr()[*joint] as usize).collect();
    let mut data = MjData::new(Box::new(model.clone()));
    for (joint, home) in joints.iter().zip(&arm.home_rad) {
        data.qpos_mut()[model.jnt_qposadr()[*joint] as usize] = *home;
    }
    data.forward();
    let Some(inertias) = moved_inertias(&data, &dofs) else { return vec![false; arm.joints.len()] };
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
            if let Some(actuator) = spec.actuator_mut(&format!("{PREFIX}{name}")) {
                actuator.biasprm_mut()[2] = 0.0;
            }
        }
    }
    strong
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
