//! Joint paths in time: rest to rest, within the joints' limits.

use nalgebra::{Isometry3, Translation3};

use crate::{Arm, Chain, Unreachable};

/// Share of a joint's speed and acceleration limits that a plan uses.
const LIMIT_SHARE: f64 = 0.7;

/// Peak speed and acceleration of the minimum-jerk profile over unit way and time (Flash and Hogan
/// 1985: s = 10 u^3 - 15 u^4 + 6 u^5).
const PEAK_SPEED: f64 = 1.875;
const PEAK_ACCELERATION: f64 = 5.773_502_691_896_258;

/// A straight way that would take longer is none, in seconds.
const SLOWEST_S: f64 = 60.0;

fn min_jerk(u: f64) -> f64 {
    u * u * u * (10.0 + u * (-15.0 + u * 6.0))
}

/// Seconds for a way at most this fast and this accelerated.
fn duration(way: f64, speed: f64, acceleration: f64) -> f64 {
    (PEAK_SPEED * way / speed).max((PEAK_ACCELERATION * way / acceleration).sqrt())
}

/// The slowest joint's time from `from` to `to`, in seconds.
fn joint_duration(from: &[f64], to: &[f64], arm: &Arm) -> f64 {
    (0..from.len())
        .map(|i| {
            let way = (to[i] - from[i]).abs();
            duration(way, LIMIT_SHARE * arm.velocity_limit_rad_s[i], LIMIT_SHARE * arm.acceleration_limit_rad_s2[i])
        })
        .fold(0.0, f64::max)
}

/// Joint positions at every control tick of a straight way in joint space, the last one at `to`.
pub(crate) fn joint_path(from: &[f64], to: &[f64], arm: &Arm, period: f64) -> Vec<Vec<f64>> {
    let ticks = (joint_duration(from, to, arm) / period).ceil().max(1.0) as usize;
    (1..=ticks)
        .map(|k| {
            let s = min_jerk(k as f64 / ticks as f64);
            from.iter().zip(to).map(|(a, b)| a + s * (b - a)).collect()
        })
        .collect()
}

/// A limit on the tool's motion.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ToolLimit {
    /// In m/s.
    pub(crate) speed: f64,
    /// In m/s^2.
    pub(crate) acceleration: f64,
}

/// Joint positions at every control tick of a straight way of the tool centre point from where
/// `from` puts it to `to`, turning evenly on the way.
pub(crate) fn straight_path(
    chain: &Chain,
    from: &[f64],
    to: &Isometry3<f64>,
    rest: &[f64],
    arm: &Arm,
    limit: ToolLimit,
    period: f64,
) -> Result<Vec<Vec<f64>>, Unreachable> {
    let start = chain.tcp_at(from);
    let way = (to.translation.vector - start.translation.vector).norm();
    let mut seconds = duration(way, limit.speed, limit.acceleration);
    loop {
        let ticks = (seconds / period).ceil().max(1.0) as usize;
        let mut path: Vec<Vec<f64>> = Vec::with_capacity(ticks);
        for k in 1..=ticks {
            let s = min_jerk(k as f64 / ticks as f64);
            let at = start.translation.vector.lerp(&to.translation.vector, s);
            let goal = Isometry3::from_parts(Translation3::from(at), start.rotation.slerp(&to.rotation, s));
            let near = path.last().map_or(from, Vec::as_slice);
            path.push(chain.inverse(&goal, near, rest)?);
        }
        // Where the arm's posture makes a joint turn faster than it may, the whole way takes longer.
        let slower = overload(from, &path, arm, period);
        if slower <= 1.0 {
            return Ok(path);
        }
        seconds *= slower.max(1.05);
        if seconds > SLOWEST_S {
            // A joint that jumps between postures is no faster for any time given to it.
            let at = to.translation.vector.into();
            return Err(Unreachable { position: at, position_error_m: 0.0, angle_error_rad: 0.0 });
        }
    }
}

/// By which factor the path must be stretched in time to keep every joint's limits (below 1: keeps them).
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
