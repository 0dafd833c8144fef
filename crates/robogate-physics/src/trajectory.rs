//! Rest-to-rest joint trajectories within the joints' limits.

use nalgebra::{Isometry3, Translation3};

use crate::{Arm, Chain, Unreachable};

/// Heights of the tool above the table on transit paths, in metres: the carried object passes over the highest obstacle. An arm that
/// does not reach so high takes the first lower one that it reaches.
pub const TRANSIT_HEIGHTS_M: [f64; 7] = [0.25, 0.2, 0.16, 0.13, 0.1, 0.08, 0.06];

/// Fraction of a joint's speed and acceleration limits that a plan uses.
const LIMIT_SHARE: f64 = 0.7;

/// Peak speed and acceleration of the minimum-jerk profile over unit distance and time (Flash and Hogan 1985:
/// s = 10 u^3 - 15 u^4 + 6 u^5).
const PEAK_SPEED: f64 = 1.875;
const PEAK_ACCELERATION: f64 = 5.773_502_691_896_258;

/// Longest accepted duration of a straight path, in seconds. A longer one counts as unreachable.
const SLOWEST_S: f64 = 60.0;

fn min_jerk(u: f64) -> f64 {
    u * u * u * (10.0 + u * (-15.0 + u * 6.0))
}

/// Duration in seconds of a minimum-jerk motion over `distance` within these limits.
fn duration(distance: f64, speed: f64, acceleration: f64) -> f64 {
    (PEAK_SPEED * distance / speed).max((PEAK_ACCELERATION * distance / acceleration).sqrt())
}

/// Duration of the slowest joint's motion from `from` to `to`, in seconds.
fn joint_duration(from: &[f64], to: &[f64], arm: &Arm) -> f64 {
    (0..from.len())
        .map(|i| {
            let distance = (to[i] - from[i]).abs();
            duration(
                distance,
                LIMIT_SHARE * arm.velocity_limit_rad_s[i],
                LIMIT_SHARE * arm.acceleration_limit_rad_s2[i],
            )
        })
        .fold(0.0, f64::max)
}

/// A straight path in joint space: joint positions (rad) at every control tick, the last one at `to`. `period` is the
/// control period in seconds.
pub fn joint_path(from: &[f64], to: &[f64], arm: &Arm, period: f64) -> Vec<Vec<f64>> {
    let ticks = (joint_duration(from, to, arm) / period).ceil().max(1.0) as usize;
    (1..=ticks)
        .map(|k| {
            let s = min_jerk(k as f64 / ticks as f64);
            from.iter().zip(to).map(|(a, b)| a + s * (b - a)).collect()
        })
        .collect()
}

/// Limits on the tool's motion.
#[derive(Debug, Clone, Copy)]
pub struct ToolLimit {
    /// Speed, in m/s.
    pub speed: f64,
    /// Acceleration, in m/s^2.
    pub acceleration: f64,
}

/// A straight path of the tool centre point from its pose at `from` (rad) to `to`, rotating evenly on the path: joint
/// positions (rad) at every control tick. A redundant arm keeps near `rest`.
///
/// # Errors
/// If a pose on the path is out of reach, or a joint would have to jump.
pub fn straight_path(
    chain: &Chain,
    from: &[f64],
    to: &Isometry3<f64>,
    rest: &[f64],
    arm: &Arm,
    limit: ToolLimit,
    period: f64,
) -> Result<Vec<Vec<f64>>, Unreachable> {
    let start = chain.tcp_at(from);
    let distance = (to.translation.vector - start.translation.vector).norm();
    let pose = |s: f64| {
        let at = start.translation.vector.lerp(&to.translation.vector, s);
        Isometry3::from_parts(Translation3::from(at), start.rotation.slerp(&to.rotation, s))
    };
    curved_path(chain, from, &pose, distance, rest, arm, limit, period)
}

/// As [`straight_path`], through the poses that `pose` gives for the shares 0 to 1 of a way of `length` metres.
///
/// # Errors
/// As [`straight_path`].
#[expect(clippy::too_many_arguments, reason = "a straight path with its poses and its length")]
pub fn curved_path(
    chain: &Chain,
    from: &[f64],
    pose: &dyn Fn(f64) -> Isometry3<f64>,
    length: f64,
    rest: &[f64],
    arm: &Arm,
    limit: ToolLimit,
    period: f64,
) -> Result<Vec<Vec<f64>>, Unreachable> {
    // A joint that jumps between postures exceeds its limits for any duration.
    let unreachable = || {
        let position = pose(1.0).translation.vector.into();
        Unreachable { position, position_error_m: 0.0, angle_error_rad: 0.0 }
    };
    let mut seconds = duration(length, limit.speed, limit.acceleration);
    loop {
        if !seconds.is_finite() || seconds > SLOWEST_S {
            return Err(unreachable());
        }
        let ticks = (seconds / period).ceil().max(1.0) as usize;
        let mut path: Vec<Vec<f64>> = Vec::with_capacity(ticks);
        for k in 1..=ticks {
            let goal = pose(min_jerk(k as f64 / ticks as f64));
            let near = path.last().map_or(from, Vec::as_slice);
            path.push(chain.inverse(&goal, near, rest)?);
        }
        // If a joint exceeds its limits in this posture, the whole path takes longer.
        let slower = overload(from, &path, arm, period);
        if slower <= 1.0 {
            return Ok(path);
        }
        seconds *= slower.max(1.05);
    }
}

/// A path of the tool centre point through the poses that `poses` gives for control ticks 1 to `ticks`, from `from` (rad): joint
/// positions (rad) at every control tick.
///
/// # Errors
/// If a pose is out of reach, or a joint would have to be too fast.
pub fn timed_path(
    chain: &Chain,
    from: &[f64],
    ticks: usize,
    poses: &dyn Fn(usize) -> Isometry3<f64>,
    arm: &Arm,
    period: f64,
) -> Result<Vec<Vec<f64>>, Unreachable> {
    let mut path: Vec<Vec<f64>> = Vec::new();
    for k in 1..=ticks {
        let (goal, near) = (poses(k), path.last().map_or(from, Vec::as_slice));
        let joints = chain.inverse(&goal, near, &arm.home_rad)?;
        let fast = |i: usize| (joints[i] - near[i]).abs() > arm.velocity_limit_rad_s[i] * period;
        if (0..joints.len()).any(fast) {
            let position = goal.translation.vector.into();
            return Err(Unreachable { position, position_error_m: 0.0, angle_error_rad: 0.0 });
        }
        path.push(joints);
    }
    Ok(path)
}

/// The share of the way after the share `time` of the duration of a minimum-jerk motion.
pub fn smooth(time: f64) -> f64 {
    min_jerk(time.clamp(0.0, 1.0))
}

/// Duration in seconds of a minimum-jerk motion over `distance` metres within a limit.
pub fn smooth_duration(distance: f64, limit: ToolLimit) -> f64 {
    duration(distance, limit.speed, limit.acceleration)
}

/// Factor by which the path must be stretched in time to respect every joint's limits. Below 1 it already does.
fn overload(from: &[f64], path: &[Vec<f64>], arm: &Arm, period: f64) -> f64 {
    let mut worst: f64 = 0.0;
    for i in 0..from.len() {
        let mut before = (from[i], 0.0);
        for q in path.iter().map(|point| point[i]).chain(path.last().map(|point| point[i])) {
            let speed = (q - before.0) / period;
            let acceleration = (speed - before.1) / period;
            worst = worst
                .max(speed.abs() / arm.velocity_limit_rad_s[i])
                .max((acceleration.abs() / arm.acceleration_limit_rad_s2[i]).sqrt());
            before = (q, speed);
        }
    }
    worst
}
