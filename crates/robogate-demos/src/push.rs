//! Random displacement of the tool during a demonstration.

use nalgebra::Vector3;
use robogate_core::{Seed, Stream};

/// Correlation time of the push, in seconds.
const MEMORY_S: f64 = 0.4;
/// Fraction of the distance to a new push that is covered in one control period.
const FOLLOW: f64 = 0.25;
/// Height of the tool above the table below which there is no push, in metres. A push there would spoil the grasp.
const FREE_BELOW_M: f64 = 0.07;
/// Height range above [`FREE_BELOW_M`] over which the push increases to its full size, in metres.
const GROWS_OVER_M: f64 = 0.08;

/// Displaces the tool from the expert's target, smoothly and at random (Laskey et al. 2017, DART). It is an
/// Ornstein-Uhlenbeck process in each direction, followed with a lag.
///
/// Without pushes, the demonstrations of a perfect expert contain no recovery from errors.
#[derive(Debug, Clone)]
pub struct Push {
    sigma_m: f64,
    stream: Stream,
    goal: Vector3<f64>,
    now: Vector3<f64>,
}

impl Push {
    /// Creates pushes with this standard deviation in each direction, in metres. 0 disables them.
    pub fn new(sigma_m: f64, seed: Seed) -> Self {
        Self { sigma_m, stream: seed.stream("push"), goal: Vector3::zeros(), now: Vector3::zeros() }
    }

    /// The displacement (m, base frame) for the next control period of `period_s`, with the tool target at `height_m`.
    pub fn next(&mut self, period_s: f64, height_m: f64) -> Vector3<f64> {
        let keep = (-period_s / MEMORY_S).exp();
        let fresh = self.sigma_m * (1.0 - keep * keep).sqrt();
        self.goal = self.goal.map(|x| keep * x + fresh * self.stream.normal());
        self.now += (self.goal - self.now) * FOLLOW;
        self.now * ((height_m - FREE_BELOW_M) / GROWS_OVER_M).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn push_acts_only_above_the_table() {
        let mut push = Push::new(0.02, Seed::campaign(1).episode(2));
        assert!((0..200).all(|_| push.next(0.05, 0.05) == Vector3::zeros()));
        let strayed: Vec<f64> = (0..4000).map(|_| push.next(0.05, 0.3).x).collect();
        let mean = strayed.iter().sum::<f64>() / 4000.0;
        let deviation = (strayed.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 4000.0).sqrt();
        // The lag makes the result smaller than the process itself.
        assert!(mean.abs() < 0.005 && (0.010..0.020).contains(&deviation), "{mean} {deviation}");
    }

    #[test]
    fn same_seed_gives_same_push() {
        let pushes = |episode| {
            let mut push = Push::new(0.01, Seed::campaign(5).episode(episode));
            (0..20).map(|_| push.next(0.05, 0.2)).collect::<Vec<_>>()
        };
        assert_eq!(pushes(1), pushes(1));
        assert_ne!(pushes(1), pushes(2));
    }
}
