//! Inspects a robot for this task.

use std::path::Path;

use robogate_core::{Assignment, FailureMode, Outcome, Scenario, Seed, Value, rollout};
use robogate_physics::{
    self as physics, Engine, GRAVITY, Gripper, MujocoEngine, Problem, Robot, RobotSettings, built_in_robot, is_folder,
};
use serde::Serialize;

use super::scene::target;
use super::{PickPlace, SceneParameters, Scripted};
use crate::{ArmTask, Rig};

/// The part of the trial is at most this fraction of the gripper's opening, and its weight at most this fraction of what the
/// gripper can carry.
const OPENING_SHARE: f64 = 0.75;
/// The same for a jaw that turns towards a fixed one: a wide part meets it far from the tool centre point.
const ONE_JAW_SHARE: f64 = 0.6;
const WEIGHT_SHARE: f64 = 0.5;
/// The part of the trial is at least this multiple of the diameter of a suction cup.
const CUP_SHARE: f64 = 1.25;

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
    /// The trial episode; `None` if the robot has a problem or does not reach the target.
    pub episode: Option<TrialEpisode>,
}

/// An episode of the task with the scripted controller. Everything is nominal, except for a part that is smaller or lighter
/// where the gripper needs it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialEpisode {
    /// Edge of the part, a cube, in metres.
    pub part_m: f64,
    /// Mass of the part, in kilograms.
    pub mass_kg: f64,
    /// The failure mode; `None` for success.
    pub failure: Option<FailureMode>,
    /// Duration in simulated seconds.
    pub time_s: f64,
}

/// Inspects a robot: a built-in one by its name, any other by its folder.
pub fn inspect(robot: &str) -> Inspection {
    let read = if is_folder(robot) { Robot::from_folder(Path::new(robot)) } else { built_in_robot(robot) }.ok();
    // A robot that cannot be read has problems, and reaches nothing.
    let scale = read.as_ref().map_or(1.0, |robot| PickPlace::DEFAULT.workspace_scale(robot));
    let physics::Inspection { mut problems, settings, measured } = physics::inspect(robot, scale, &[target(scale)]);
    let measured = measured.map(|of_robot| {
        let reaches_target = of_robot.reaches == [true];
        let ready = problems.is_empty() && reaches_target && of_robot.grasp.is_some();
        let episode = read.filter(|_| ready).and_then(|read| match trial(read) {
            Ok(episode) => {
                problems.extend(episode.problem(robot));
                Some(episode)
            }
            Err(why) => {
                problems.push(Problem::new(
                    format!("the trial episode cannot run: {why}"),
                    "correct robot.toml: the episode needs everything that a run needs",
                ));
                None
            }
        });
        Measured { robot: of_robot, reaches_target, episode }
    });
    Inspection { problems, settings, measured }
}

/// Runs the trial episode.
fn trial(robot: Robot) -> Result<TrialEpisode, String> {
    let nominal = SceneParameters::nominal();
    let (part_m, carried_n) = match &robot.settings.gripper {
        Gripper::ParallelJaw(jaw) => {
            let share = if jaw.fixed_jaw_m.is_some() { ONE_JAW_SHARE } else { OPENING_SHARE };
            (nominal.size_m.min(share * jaw.opening_m), 2.0 * nominal.friction * jaw.force_n)
        }
        Gripper::Suction(cup) => (nominal.size_m.max(CUP_SHARE * cup.cup_diameter_m), cup.force_n()),
    };
    let mass_kg = nominal.mass_kg.min(WEIGHT_SHARE * carried_n / GRAVITY).min(robot.settings.arm.payload_kg);
    let mut requested = Assignment::default();
    requested.set("size_m", Value::Number(part_m));
    requested.set("mass_kg", Value::Number(mass_kg));
    let engine = MujocoEngine::new(robot.clone(), MujocoEngine::TIME_STEP_S).map_err(|error| error.to_string())?;
    let mut policy = Scripted::new(robot, engine.chain().clone());
    let mut cell = PickPlace::default().environment(Box::new(engine), Rig::default())?;
    let scenario = Scenario { index: 0, seed: Seed::campaign(0).episode(0), requested };
    let episode = rollout(&mut *cell, &mut policy, &scenario);
    let failure = match episode.outcome {
        Outcome::Success => None,
        Outcome::Failure(mode) => Some(mode),
        Outcome::Invalid(fault) => return Err(fault.to_string()),
    };
    Ok(TrialEpisode { part_m, mass_kg, failure, time_s: episode.time_s })
}

impl TrialEpisode {
    /// The problem of a robot that fails in the trial.
    fn problem(&self, robot: &str) -> Option<Problem> {
        let failure = self.failure.as_ref()?;
        let check = if *failure == FailureMode::TIMEOUT {
            "Check arm.velocity_limit_rad_s, acceleration_limit_rad_s2 and gripper.finger_speed_m_s, and give a slow arm more time: --set time_limit_s=30"
        } else {
            "Check gripper.tip_m, palm_m and force_n, the servos of the arm, and arm.home_rad"
        };
        Some(Problem::new(
            format!(
                "the trial episode of pick and place fails with `{}` after {:.1} s. The part is a cube of {:.0} mm and {:.2} kg",
                failure.as_str(),
                self.time_s,
                1e3 * self.part_m,
                self.mass_kg
            ),
            format!(
                "see what happens: robogate run --robot {robot} -n 1 --out RUN, then robogate replay RUN 0. {check}"
            ),
        ))
    }
}
