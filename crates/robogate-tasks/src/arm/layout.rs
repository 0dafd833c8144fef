//! Places of parts and their deviations.

use robogate_core::{Scenario, Stream};
use robogate_physics::Robot;

/// An arm with less reach than this, in metres, works on a layout that is smaller by [`SHORT_SCALE`].
const SHORT_REACH_M: f64 = 0.6;
const SHORT_SCALE: f64 = 0.7;

/// Places (x, y, in metres) within this robot's reach.
pub(crate) fn within_reach<const N: usize>(robot: &Robot, places: [[f64; 2]; N]) -> [[f64; 2]; N] {
    let scale = if robot.settings.arm.reach_m < SHORT_REACH_M { SHORT_SCALE } else { 1.0 };
    places.map(|place| place.map(|x| scale * x))
}

/// The bias of each encoder, drawn uniformly between minus and plus `bound` (rad).
pub(crate) fn encoder_bias(scenario: &Scenario, robot: &Robot, bound: f64) -> Vec<f64> {
    let mut stream = scenario.seed.stream("encoder-bias");
    robot.settings.arm.joints.iter().map(|_| stream.between(-bound, bound)).collect()
}

/// A uniform draw from the unit disc.
pub(crate) fn disc_point(stream: &mut Stream) -> [f64; 2] {
    let fraction = stream.uniform().sqrt();
    let (sin, cos) = stream.between(0.0, std::f64::consts::TAU).sin_cos();
    [fraction * cos, fraction * sin]
}
