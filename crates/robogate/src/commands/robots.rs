//! `robogate robots`: lists and checks robots.

use clap::{Args, Subcommand};
use robogate_physics::{Gripper, RobotSettings, built_in_robot, built_in_robots};
use serde_json::json;

use crate::exit::{DONE, Exit, OrExit};
use crate::terminal::{bold, line};

/// List the built-in robots, or check one of your own.
#[derive(Debug, Args)]
pub(crate) struct Robots {
    #[command(subcommand)]
    what: Option<What>,
    /// Print the list as one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Check a robot: report every problem, and what it can reach and hold
    Check(Check),
}

/// Loads the robot, measures it, holds it still and moves it a little. Exit code 2 if there is a problem.
#[derive(Debug, Args)]
struct Check {
    /// Folder of the robot (robot.toml and its model), or the name of a built-in one
    #[arg(value_name = "ROBOT")]
    robot: String,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Robots {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            Some(What::Check(check)) => check.execute(),
            None => self.list(),
        }
    }

    fn list(&self) -> Result<u8, Exit> {
        let robots = built_in_robots().map(built_in_robot).collect::<Result<Vec<_>, _>>().or_broken()?;
        if self.json {
            let robots: Vec<_> = robots.iter().map(|robot| &robot.settings).map(facts).collect();
            line(json!({"version": 1, "robots": robots}));
            return Ok(DONE);
        }
        line(bold(format_args!("{:<8} {:>6}  {:<26} {:>8} {:>9}", "robot", "joints", "gripper", "reach", "payload")));
        for RobotSettings { name, arm, gripper, .. } in robots.iter().map(|robot| &robot.settings) {
            line(format_args!(
                "{name:<8} {:>6}  {:<26} {:>6.2} m {:>6.1} kg",
                arm.joints.len(),
                in_words(gripper),
                arm.reach_m,
                arm.payload_kg
            ));
        }
        line("\nUse your own robot as a folder (docs/robots.md) and check it: robogate robots check FOLDER");
        Ok(DONE)
    }
}

pub(crate) fn in_words(gripper: &Gripper) -> String {
    match gripper {
        Gripper::ParallelJaw(jaw) => format!("parallel jaw, {:.0} mm", 1e3 * jaw.opening_m),
        Gripper::Suction(cup) => format!("suction cup, {:.0} mm", 1e3 * cup.cup_diameter_m),
    }
}

pub(crate) fn facts(settings: &RobotSettings) -> serde_json::Value {
    let RobotSettings { name, arm, gripper, .. } = settings;
    json!({
        "name": name,
        "joints": arm.joints.len(),
        "gripper": gripper,
        "reach_m": arm.reach_m,
        "payload_kg": arm.payload_kg,
    })
}

impl Check {
    #[cfg(feature = "mujoco")]
    fn execute(&self) -> Result<u8, Exit> {
        Ok(crate::inspection::show(&self.robot, self.json))
    }

    #[cfg(not(feature = "mujoco"))]
    fn execute(&self) -> Result<u8, Exit> {
        let why = format!(
            "this build has no MuJoCo, which the check needs\nhint: build with --features mujoco, or run a few episodes: robogate run --robot {} -n 10",
            self.robot
        );
        Err(anyhow::anyhow!(why)).or_usage()
    }
}
