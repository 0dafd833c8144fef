//! `robogate robots`: which robots there are, and what is wrong with one.

use clap::{Args, Subcommand};
use robogate_sim::{Gripper, Inspection, Measured, RobotSettings, built_in_robot, built_in_robots, inspect};
use serde_json::json;

use crate::exit::{DONE, Exit, OrExit, USAGE};
use crate::terminal::{bold, line, percent};

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
    /// Say all that is wrong with a robot, and what it can do
    Check(Check),
}

/// Loads the robot, measures it, holds it still and moves it a little. Exit code 2 where something is wrong.
#[derive(Debug, Args)]
struct Check {
    /// The folder of your robot (robot.toml and its model), or a built-in robot's name
    #[arg(value_name = "ROBOT")]
    robot: String,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Robots {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            Some(What::Check(check)) => Ok(check.execute()),
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
        line("\nA robot of your own is a folder: docs/robots.md. Try it: robogate robots check FOLDER");
        Ok(DONE)
    }
}

fn in_words(gripper: &Gripper) -> String {
    match gripper {
        Gripper::ParallelJaw(jaw) => format!("parallel jaw, {:.0} mm", 1e3 * jaw.opening_m),
        Gripper::Suction(cup) => format!("suction cup, {:.0} mm", 1e3 * cup.cup_diameter_m),
    }
}

fn facts(settings: &RobotSettings) -> serde_json::Value {
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
    fn execute(&self) -> u8 {
        let inspection = inspect(&self.robot);
        let Inspection { problems, settings, measured } = &inspection;
        if self.json {
            line(json!({
                "version": 1,
                "robot": settings.as_ref().map(facts),
                "problems": problems,
                "measured": measured,
            }));
        } else {
            let name = settings.as_ref().map_or(self.robot.as_str(), |settings| &settings.name);
            match problems.len() {
                0 => line(format_args!("{} {name} can be used", bold("ok"))),
                1 => line(format_args!("{} 1 thing is wrong with {name}", bold("FAILS"))),
                n => line(format_args!("{} {n} things are wrong with {name}", bold("FAILS"))),
            }
            for (i, problem) in problems.iter().enumerate() {
                line(format_args!("\n{}. {}\n   hint: {}", i + 1, problem.what, problem.hint));
            }
            if let (Some(settings), Some(measured)) = (settings, measured) {
                line("");
                summary(settings, measured);
            }
        }
        if problems.is_empty() { DONE } else { USAGE }
    }
}

fn summary(settings: &RobotSettings, measured: &Measured) {
    let RobotSettings { arm, gripper, .. } = settings;
    let total: f64 = measured.masses_kg.iter().map(|(_, mass)| mass).sum();
    let masses: Vec<String> = measured.masses_kg.iter().map(|(body, mass)| format!("{body} {mass:.3}")).collect();
    line(format_args!("joints     {}: {}", arm.joints.len(), arm.joints.join(", ")));
    line(format_args!("gripper    {}", in_words(gripper)));
    line(format_args!("masses     {total:.3} kg that move: {}", masses.join(", ")));
    line(format_args!(
        "reach      {:.3} m stated; from the first joint's axis the flange came {:.3} m, the tool {:.3} m",
        arm.reach_m, measured.flange_reach_m, measured.tool_reach_m
    ));
    line(format_args!(
        "workspace  {} of the places over the table within reach of a tool that points down; the target {}",
        percent(measured.workspace_share),
        if measured.reaches_target { "too" } else { "not" }
    ));
    if !measured.reaches_target {
        line("           where it does not reach the target no episode of the task can succeed");
    }
    match measured.tracking_error_rad {
        Some(error) => line(format_args!("servos     hold and follow within {:.2} mrad", 1e3 * error)),
        None => line("servos     not tried: see above"),
    }
}
