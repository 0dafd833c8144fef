//! A tool that is pushed about while the expert acts.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use robogate_core::{Seed, Stream};

/// The push forgets itself within this time, in seconds.
const MEMORY_S: f64 = 0.4;
/// Share of the way to a new push that one control tick goes.
const FOLLOW: f64 = 0.25;
/// Below this height of the tool above the table there is no push, in metres: it would spoil the grasp.
const FREE_BELOW_M: f64 = 0.07;
/// From there to this much higher it grows to its full size, in metres.
const GROWS_OVER_M: f64 = 0.08;

/// Displaces the tool from where the expert sends it, smoothly and at random (Laskey et al. 2017, DART): an
/// Ornstein-Uhlenbeck process in each direction, followed with a lag.
///
/// An expert that never errs shows no way back from an error.
#[derive(Debug, Clone)]
pub struct Push {
    sigma_m: f64,
    stream: Stream,
    goal: Vector3<f64>,
    now: Vector3<f64>,
}

impl Push {
    /// Pushes of this standard deviation in each direction, in metres; 0 is none.
    pub fn new(sigma_m: f64, seed: Seed) -> Self {
        Self { sigma_m, stream: seed.stream("push"), goal: Vector3::zeros(), now: Vector3::zeros() }
    }

    /// The displacement (m, base frame) of the next control tick, of `period_s`, for a tool that is sent to `height_m`.
    pub fn next(&mut self, period_s: f64, height_m: f64) -> Vector3<f64> {
        let keep = (-period_s / MEMORY_S).exp();
        let fresh = self.sigma_m * (1.0 - keep * keep).sqrt();
        self.goal = self.goal.map(|x| keep * x + fresh * normal(&mut self.stream));
        self.now += (self.goal - self.now) * FOLLOW;
        self.now * ((height_m - FREE_BELOW_M) / GROWS_OVER_M).clamp(0.0, 1.0)
    }
}

/// A standard normal number (Box and Muller).
fn normal(stream: &mut Stream) -> f64 {
    let radius = (-2.0 * (1.0 - stream.uniform()).ln()).sqrt();
    radius * (TAU * stream.uniform()).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_the_table_nothing_is_pushed_and_high_above_it_the_tool_strays() {
        let mut push = Push::new(0.02, Seed::campaign(1).episode(2));
        assert!((0..200).all(|_| push.next(0.05, 0.05) == Vector3::zeros()));
        let strayed: Vec<f64> = (0..4000).map(|_| push.next(0.05, 0.3).x).collect();
        let mean = strayed.iter().sum::<f64>() / 4000.0;
        let deviation = (strayed.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 4000.0).sqrt();
        // What lags behind a process that changes is smaller than it.
        assert!(mean.abs() < 0.005 && (0.010..0.020).contains(&deviation), "{mean} {deviation}");
    }

    #[test]
    fn the_same_seed_pushes_the_same_way() {
        let pushes = |episode| {
            let mut push = Push::new(0.01, Seed::campaign(5).episode(episode));
            (0..20).map(|_| push.next(0.05, 0.2)).collect::<Vec<_>>()
        };
        assert_eq!(pushes(1), pushes(1));
        assert_ne!(pushes(1), pushes(2));
    }
}
