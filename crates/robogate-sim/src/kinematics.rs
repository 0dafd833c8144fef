//! Forward and inverse kinematics of a serial arm.

use nalgebra::{Isometry3, Matrix6, Matrix6xX, Unit, UnitQuaternion, Vector3, Vector6};

/// One joint of a chain: a hinge about its own axis.
#[derive(Debug, Clone, PartialEq)]
pub struct ChainJoint {
    /// The joint's frame in the one before, at joint position 0.
    pub placement: Isometry3<f64>,
    /// The hinge's axis in its own frame.
    pub axis: Unit<Vector3<f64>>,
    /// Smallest and largest position, in radians.
    pub range: [f64; 2],
}

/// A serial arm from its base to its tool centre point.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// The joints, base to tip.
    pub joints: Vec<ChainJoint>,
    /// The flange in the last joint's frame.
    pub flange: Isometry3<f64>,
    /// The tool centre point in the last joint's frame.
    pub tcp: Isometry3<f64>,
}

/// No joint positions were found that reach a pose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("({:.3}, {:.3}, {:.3}) m is out of reach: {position_error_m:.4} m and {angle_error_rad:.4} rad are left", .position[0], .position[1], .position[2])]
pub struct Unreachable {
    /// The position asked for, in metres.
    pub position: [f64; 3],
    /// What is left of the way, in metres.
    pub position_error_m: f64,
    /// What is left of the turn, in radians.
    pub angle_error_rad: f64,
}

impl Chain {
    /// Pose of the tool centre point at these joint positions (rad).
    pub fn tcp_at(&self, positions: &[f64]) -> Isometry3<f64> {
        self.last_frame(positions) * self.tcp
    }

    /// Pose of the flange at these joint positions (rad).
    pub fn flange_at(&self, positions: &[f64]) -> Isometry3<f64> {
        self.last_frame(positions) * self.flange
    }

    fn last_frame(&self, positions: &[f64]) -> Isometry3<f64> {
        self.joints.iter().zip(positions).fold(Isometry3::identity(), |frame, (joint, q)| {
            frame * joint.placement * UnitQuaternion::from_axis_angle(&joint.axis, *q)
        })
    }

    /// Tool centre point and its geometric Jacobian (6 x n: linear above angular, base frame).
    fn jacobian(&self, positions: &[f64]) -> (Isometry3<f64>, Matrix6xX<f64>) {
        let mut frame = Isometry3::identity();
        let mut hinges = Vec::with_capacity(self.joints.len());
        for (joint, q) in self.joints.iter().zip(positions) {
            frame *= joint.placement;
            hinges.push((frame.translation.vector, frame.rotation * joint.axis.into_inner()));
            frame *= UnitQuaternion::from_axis_angle(&joint.axis, *q);
        }
        let tcp = frame * self.tcp;
        let mut jacobian = Matrix6xX::zeros(hinges.len());
        for (mut column, (at, axis)) in jacobian.column_iter_mut().zip(hinges) {
            column.fixed_rows_mut::<3>(0).copy_from(&axis.cross(&(tcp.translation.vector - at)));
            column.fixed_rows_mut::<3>(3).copy_from(&axis);
        }
        (tcp, jacobian)
    }

    /// Joint positions that put the tool centre point at `goal`, found from `start`, to 1e-6 m and
    /// rad; among the many of a redundant arm one near `rest`.
    ///
    /// Damped least squares (Wampler 1986) with the rest posture pulled in the null space (Liegeois
    /// 1977); steps are cut at the joint limits.
    pub fn inverse(&self, goal: &Isometry3<f64>, start: &[f64], rest: &[f64]) -> Result<Vec<f64>, Unreachable> {
        const TOLERANCE: f64 = 1e-6;
        const ITERATIONS: usize = 200;
        let mut q = start.to_vec();
        let mut error = Vector6::zeros();
        for _ in 0..ITERATIONS {
            let (tcp, jacobian) = self.jacobian(&q);
            error.fixed_rows_mut::<3>(0).copy_from(&(goal.translation.vector - tcp.translation.vector));
            error.fixed_rows_mut::<3>(3).copy_from(&(goal.rotation * tcp.rotation.inverse()).scaled_axis());
            if error.fixed_rows::<3>(0).norm() < TOLERANCE && error.fixed_rows::<3>(3).norm() < TOLERANCE {
                return Ok(q);
            }
            // Damping shrinks with the error: far off it keeps steps sane at singular poses, close by
            // it would only slow convergence.
            let damping = 1e-8 + 1e-2 * error.norm_squared().min(0.1);
            let normal = &jacobian * jacobian.transpose() + Matrix6::identity() * damping;
            let Some(factor) = normal.cholesky() else { break };
            let pull: Vec<f64> = q.iter().zip(rest).map(|(q, r)| 0.1 * (r - q) * error.norm().min(1.0)).collect();
            let pull = nalgebra::DVector::from_vec(pull);
            let step = jacobian.transpose() * factor.solve(&(error - &jacobian * &pull)) + pull;
            // A step of more than 0.3 rad leaves the region in which the Jacobian is worth anything.
            let scale = (0.3 / step.amax()).min(1.0);
            for ((q, step), joint) in q.iter_mut().zip(step.iter()).zip(&self.joints) {
                *q = (*q + scale * step).clamp(joint.range[0], joint.range[1]);
            }
        }
        Err(Unreachable {
            position: goal.translation.vector.into(),
            position_error_m: error.fixed_rows::<3>(0).norm(),
            angle_error_rad: error.fixed_rows::<3>(3).norm(),
        })
    }
}
