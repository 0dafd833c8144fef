//! Inspects a robot for this task.

use robogate_physics::{self as physics, Problem, RobotSettings};
use serde::Serialize;

use super::scene::TARGET;

/// The result of an inspection.
#[derive(Debug, Clone, PartialEq)]
pub struct Inspection {
    /// All problems; empty if the robot can be used.
    pub problems: Vec<Problem>,
    /// The settings, if they could be read.
    pub settings: Option<RobotSettings>,
    /// The measurements, if the robot could be loaded.
    pub measured: Option<Measured>,
}

/// Measurements of a robot that loads.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// Measurements that do not depend on the task.
    #[serde(flatten)]
    pub robot: physics::Measured,
    /// Whether the tool reaches the target pointing down.
    pub reaches_target: bool,
}

/// Inspects a robot: a built-in one by its name, any other by its folder.
pub fn inspect(robot: &str) -> Inspection {
    let physics::Inspection { problems, settings, measured } = physics::inspect(robot, &[TARGET]);
    let measured = measured.map(|robot| Measured { reaches_target: robot.reaches == [true], robot });
    Inspection { problems, settings, measured }
}
