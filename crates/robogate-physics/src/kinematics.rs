//! Forward and inverse kinematics of a serial arm.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Isometry3, Matrix6, Matrix6xX, Translation3, Unit, UnitQuaternion, Vector3, Vector6};
use robogate_core::Seed;

use crate::Gripper;

/// Number of random postures from which [`Chain::reach`] searches for a posture nearer to the rest posture.
const STARTS: usize = 16;

/// Weight of the first and the last joint in the distance between postures; the others have 1.
const OUTER_WEIGHT: f64 = 0.1;

/// A descent from a random posture ends after this many steps without reducing the error by a tenth.
const STALLED_STEPS: usize = 12;

/// Number of joints with which a tool can have any pose.
const FREE_JOINTS: usize = 6;

/// Tolerance of the tool's orientation for an arm with fewer joints, in radians, and the weight of an orientation error (rad)
/// against a position error (m). Such an arm cannot remove every small tilt, and its position is exact in spite of it.
const FEW_JOINTS: (f64, f64) = (1e-4, 0.03);

/// A joint of a chain: a hinge about its axis.
#[derive(Debug, Clone, PartialEq)]
pub struct ChainJoint {
    /// The joint's frame in the frame of the joint before it, at joint position 0.
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

/// The error for a pose without joint positions.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("({:.3}, {:.3}, {:.3}) m is out of reach: the nearest pose found is {position_error_m:.4} m and {angle_error_rad:.4} rad off", .position[0], .position[1], .position[2])]
pub struct Unreachable {
    /// The requested position, in metres.
    pub position: [f64; 3],
    /// Remaining position error, in metres.
    pub position_error_m: f64,
    /// Remaining orientation error, in radians.
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

    /// The chain to the middle of a part of this width (m) that the gripper holds. A jaw that does not move holds a part beside the
    /// tool centre point; two moving fingers and a cup hold it there.
    #[must_use]
    pub fn holding(&self, gripper: &Gripper, width_m: f64) -> Self {
        let beside = gripper.jaw().map_or(0.0, |jaw| jaw.beside_m(width_m));
        Self { tcp: self.tcp * Translation3::new(0.0, beside, 0.0), ..self.clone() }
    }

    fn last_frame(&self, positions: &[f64]) -> Isometry3<f64> {
        self.joints.iter().zip(positions).fold(Isometry3::identity(), |frame, (joint, q)| {
            frame * joint.placement * UnitQuaternion::from_axis_angle(&joint.axis, *q)
        })
    }

    /// Pose of the tool centre point and its geometric Jacobian (6 x n: linear rows above angular ones, base frame).
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

    /// Joint positions that put the tool centre point at `goal` to within 1e-6 m and rad, in the posture nearest to
    /// `rest`, within the joints' ranges and without unnecessary full rotations.
    ///
    /// An arm of six joints reaches a pose in up to sixteen postures: elbow up or down, shoulder left or right, wrist
    /// flipped; more if a joint can rotate more than once. The posture of `rest`, in which the arm waits, is preferred.
    /// The descent from `rest` mostly stays in it. If that descent does not converge, or ends with a joint more than 90
    /// degrees away, further descents search for a nearer posture: from `rest` rotated to face the goal, and from a few
    /// fixed random postures. The first joint, which faces the goal, and the last, which rotates the tool, have a small
    /// weight because they do not change the posture. A redundant arm takes the result of its first descent, which is
    /// pulled towards `rest`.
    ///
    /// # Errors
    /// If no descent converges.
    pub fn reach(&self, goal: &Isometry3<f64>, rest: &[f64]) -> Result<Vec<f64>, Unreachable> {
        let first = self.inverse(goal, rest, rest).map(|q| self.unwound(q, rest));
        let redundant = self.joints.len() > 6;
        if let Ok(q) = &first
            && (redundant || inner(q).iter().zip(inner(rest)).all(|(q, rest)| (q - rest).abs() < FRAC_PI_2))
        {
            return first;
        }
        let mut stream = Seed::campaign(0).stream("inverse-kinematics");
        let scattered = (0..STARTS).map(|_| {
            let near = |(joint, rest): (&ChainJoint, &f64)| {
                let [low, high] = joint.range;
                stream.between(low.max(rest - PI).min(high), high.min(rest + PI).max(low))
            };
            self.joints.iter().zip(rest).map(near).collect()
        });
        let others = std::iter::once(self.facing(goal, rest))
            .chain(scattered)
            .filter_map(|start: Vec<f64>| self.descend(goal, &start, rest, STALLED_STEPS).ok())
            .map(|q| self.unwound(q, rest));
        let squares = |q: &[f64], rest: &[f64]| q.iter().zip(rest).map(|(q, rest)| (q - rest).powi(2)).sum::<f64>();
        let turned = |q: &[f64]| squares(inner(q), inner(rest)) + OUTER_WEIGHT * squares(q, rest);
        // Among equally near postures the first one wins, which makes the result deterministic.
        let nearest = first.iter().cloned().chain(others).min_by(|a, b| turned(a).total_cmp(&turned(b)));
        nearest.map_or(first, Ok)
    }

    /// The posture `rest`, rotated about the first joint until the tool centre point points towards the goal.
    fn facing(&self, goal: &Isometry3<f64>, rest: &[f64]) -> Vec<f64> {
        let mut q = rest.to_vec();
        let Some(joint) = self.joints.first() else { return q };
        let across = |point: Isometry3<f64>| {
            let local = joint.placement.inverse_transform_point(&point.translation.vector.into()).coords;
            local - joint.axis.into_inner() * local.dot(&joint.axis)
        };
        let (from, to) = (across(self.tcp_at(rest)), across(*goal));
        let angle = from.cross(&to).dot(&joint.axis).atan2(from.dot(&to));
        q[0] = (q[0] + angle).clamp(joint.range[0], joint.range[1]);
        q
    }

    /// The same posture with as few full rotations of each joint from `rest` as its range allows.
    fn unwound(&self, mut q: Vec<f64>, rest: &[f64]) -> Vec<f64> {
        for ((q, rest), joint) in q.iter_mut().zip(rest).zip(&self.joints) {
            let [low, high] = joint.range;
            let turns = ((rest - *q) / TAU).round();
            // No more full rotations than the joint's range allows.
            let turns = turns.clamp(((low - *q) / TAU).ceil().min(0.0), ((high - *q) / TAU).floor().max(0.0));
            if turns.abs() > 0.5 {
                *q += turns * TAU;
            }
        }
        q
    }

    /// Joint positions that put the tool centre point at `goal` to within 1e-6 m and rad, by a descent from `start`. A
    /// redundant arm ends near `rest`.
    ///
    /// Damped least squares (Wampler 1986) with a pull towards the rest posture in the null space (Liegeois 1977). Steps
    /// are clamped to the joint limits.
    ///
    /// # Errors
    /// If the descent does not converge.
    pub fn inverse(&self, goal: &Isometry3<f64>, start: &[f64], rest: &[f64]) -> Result<Vec<f64>, Unreachable> {
        self.descend(goal, start, rest, usize::MAX)
    }

    /// [`Chain::inverse`] that ends after `stalled_steps` steps without reducing the error by a tenth.
    fn descend(
        &self,
        goal: &Isometry3<f64>,
        start: &[f64],
        rest: &[f64],
        stalled_steps: usize,
    ) -> Result<Vec<f64>, Unreachable> {
        const TOLERANCE: f64 = 1e-6;
        const ITERATIONS: usize = 200;
        let (angle_tolerance, weight) = if self.joints.len() < FREE_JOINTS { FEW_JOINTS } else { (TOLERANCE, 1.0) };
        let mut q = start.to_vec();
        let mut error = Vector6::zeros();
        let (mut best, mut best_at) = (f64::INFINITY, 0);
        for iteration in 0..ITERATIONS {
            let (tcp, mut jacobian) = self.jacobian(&q);
            error.fixed_rows_mut::<3>(0).copy_from(&(goal.translation.vector - tcp.translation.vector));
            error.fixed_rows_mut::<3>(3).copy_from(&(goal.rotation * tcp.rotation.inverse()).scaled_axis());
            if error.fixed_rows::<3>(0).norm() < TOLERANCE && error.fixed_rows::<3>(3).norm() < angle_tolerance {
                return Ok(q);
            }
            if weight < 1.0 {
                error.fixed_rows_mut::<3>(3).scale_mut(weight);
                jacobian.fixed_rows_mut::<3>(3).scale_mut(weight);
            }
            if error.norm() < 0.9 * best {
                (best, best_at) = (error.norm(), iteration);
            } else if iteration - best_at > stalled_steps {
                break;
            }
            // Damping shrinks with the error: far from the goal it bounds steps near singular poses, near the goal it would
            // only slow convergence.
            let damping = 1e-8 + 1e-2 * error.norm_squared().min(0.1);
            let normal = &jacobian * jacobian.transpose() + Matrix6::identity() * damping;
            let Some(factor) = normal.cholesky() else { break };
            let pull: Vec<f64> = q.iter().zip(rest).map(|(q, r)| 0.1 * (r - q) * error.norm().min(1.0)).collect();
            let pull = nalgebra::DVector::from_vec(pull);
            let step = jacobian.transpose() * factor.solve(&(error - &jacobian * &pull)) + pull;
            // Beyond a step of 0.3 rad the linearisation is invalid.
            let scale = (0.3 / step.amax()).min(1.0);
            for ((q, step), joint) in q.iter_mut().zip(step.iter()).zip(&self.joints) {
                *q = (*q + scale * step).clamp(joint.range[0], joint.range[1]);
            }
        }
        Err(Unreachable {
            position: goal.translation.vector.into(),
            position_error_m: error.fixed_rows::<3>(0).norm(),
            angle_error_rad: error.fixed_rows::<3>(3).norm() / weight,
        })
    }
}

/// All joints but the first and the last.
fn inner(joints: &[f64]) -> &[f64] {
    joints.get(1..joints.len() - 1).unwrap_or_default()
}
