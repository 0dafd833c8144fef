//! Inspects a robot for this task.

use std::path::Path;

use robogate_physics::{self as physics, Problem, Robot, RobotSettings, built_in_robot, is_folder};
use serde::Serialize;

use super::Rules;
use super::scene::target;

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
    /// Whether the tool reaches the target of its workspace pointing down.
    pub reaches_target: bool,
}

/// Inspects a robot: a built-in one by its name, any other by its folder.
pub fn inspect(robot: &str) -> Inspection {
    let folder = is_folder(robot);
    let read = if folder { Robot::from_folder(Path::new(robot)) } else { built_in_robot(robot) };
    // A robot that cannot be read has problems, and reaches nothing.
    let scale = read.map_or(1.0, |robot| Rules::default().workspace_scale(&robot));
    let physics::Inspection { problems, settings, measured } = physics::inspect(robot, &[target(scale)]);
    let measured = measured.map(|robot| Measured { reaches_target: robot.reaches == [true], robot });
    Inspection { problems, settings, measured }
}
