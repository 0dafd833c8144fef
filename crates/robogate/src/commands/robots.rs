//! `robogate list robots`: checks and drafts robots.

#[cfg(feature = "mujoco")]
use std::path::Path;
use std::path::PathBuf;

#[cfg(feature = "mujoco")]
use anyhow::{Context, anyhow};
use clap::{Args, Subcommand};
#[cfg(feature = "mujoco")]
use robogate_dictionary::files;
#[cfg(feature = "mujoco")]
use robogate_physics::is_folder;
use robogate_physics::{Gripper, RobotSettings, built_in_robot, built_in_robots};
#[cfg(feature = "mujoco")]
use robogate_session::{in_child, menagerie_robot};
use serde_json::json;

use crate::exit::{DONE, Exit, OrExit};
#[cfg(feature = "mujoco")]
use crate::terminal::note;
use crate::terminal::{bold, line};

/// Check a robot, or draft one of your own from its model.
#[derive(Debug, Args)]
pub(crate) struct Robots {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Check a robot: report every problem, its reach, its grasp of a part, and a trial episode
    Check(Check),
    /// Draft robot.toml for a model, and mark what is guessed
    Init(Init),
}

/// Loads the robot, measures it, holds it still, moves it a little, lifts a test part and runs an episode of pick and place.
/// Exit code 2 if there is a problem.
#[derive(Debug, Args)]
struct Check {
    /// Folder of the robot (robot.toml and its model), the name of a built-in one, or menagerie:NAME
    #[arg(value_name = "ROBOT")]
    robot: String,
    /// Use this Python, which has the package mujoco-menagerie [default: python3]
    #[arg(long, value_name = "PYTHON")]
    python: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Writes robot.toml beside the model: joints, limits, gains, home posture, frames and gripper, as far as the model states
/// them. A comment lists what is guessed.
#[derive(Debug, Args)]
struct Init {
    /// Model of one arm with its gripper: MJCF or URDF
    model: PathBuf,
    /// Set the robot's name; default: the name of the model's folder
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Replace an existing robot.toml
    #[arg(long)]
    force: bool,
}

impl Robots {
    pub(crate) fn execute(&self) -> Result<u8, Exit> {
        match &self.what {
            What::Check(check) => check.execute(),
            What::Init(init) => init.execute(),
        }
    }
}

/// Prints the built-in robots.
pub(crate) fn list(json: bool) -> Result<u8, Exit> {
    let robots = built_in_robots().map(built_in_robot).collect::<Result<Vec<_>, _>>().or_broken()?;
    if json {
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
    line("\nUse your own robot as a folder (docs/guides/robots.md) and check it: robogate robots check FOLDER");
    line("Use a robot of MuJoCo Menagerie, whose package is mujoco-menagerie on PyPI, as menagerie:NAME");
    Ok(DONE)
}

pub(crate) fn in_words(gripper: &Gripper) -> String {
    match gripper {
        Gripper::ParallelJaw(jaw) => {
            let kind = if jaw.fixed_jaw_m.is_some() { "one moving jaw" } else { "parallel jaw" };
            format!("{kind}, {:.0} mm", 1e3 * jaw.opening_m)
        }
        Gripper::Suction(cup) => {
            let spring = cup.bellows.map_or_else(String::new, |bellows| {
                format!(", spring {:.1} N/mm over {:.0} mm", 1e-3 * bellows.stiffness_n_m, 1e3 * bellows.stroke_m)
            });
            format!("suction cup, {:.0} mm{spring}", 1e3 * cup.cup_diameter_m)
        }
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
        let robot = menagerie_robot(&self.robot, self.python.as_deref())?;
        if is_folder(&robot)
            && let Some(code) = in_child(Path::new(&robot))?
        {
            return Ok(code);
        }
        Ok(crate::inspection::show(&robot, self.json))
    }

    #[cfg(not(feature = "mujoco"))]
    fn execute(&self) -> Result<u8, Exit> {
        let why = format!(
            "this build has no MuJoCo, which the check needs\nHint: build with --features mujoco, or run a few episodes: robogate run --robot {} -n 10",
            self.robot
        );
        Err(anyhow::anyhow!(why)).or_usage()
    }
}

impl Init {
    #[cfg(feature = "mujoco")]
    fn execute(&self) -> Result<u8, Exit> {
        if let Some(code) = in_child(&self.model)? {
            return Ok(code);
        }
        let folder = self.model.canonicalize().ok().and_then(|model| model.parent().map(Path::to_owned));
        let folder = folder.with_context(|| format!("{}: no such file", self.model.display())).or_usage()?;
        let file = folder.join("robot.toml");
        if file.exists() && !self.force {
            return Err(anyhow!("{} exists\nHint: replace it with --force", file.display())).or_usage();
        }
        let own = || folder.file_name().map(|name| name.to_string_lossy().into_owned());
        let name = self.name.clone().or_else(own).unwrap_or_else(|| "robot".to_owned());
        let draft = match robogate_physics::draft(&self.model, &name) {
            Ok(draft) => draft,
            Err(problems) => {
                let lines: Vec<String> =
                    problems.iter().map(|problem| format!("{}\nHint: {}", problem.what, problem.hint)).collect();
                return Err(anyhow!("{}: {}", self.model.display(), lines.join("\n"))).or_usage();
            }
        };
        files::write(&file, &draft.text).with_context(|| format!("cannot write {}", file.display())).or_broken()?;
        line(format_args!("{}", bold(file.display())));
        line("Guessed, because the model does not state it:");
        draft.guesses.iter().for_each(|guess| line(format_args!("  - {guess}")));
        note(format_args!("next: robogate robots check {}", folder.display()));
        Ok(DONE)
    }

    #[cfg(not(feature = "mujoco"))]
    fn execute(&self) -> Result<u8, Exit> {
        let Self { model, name, force } = self;
        let why = format!("{}: this build has no MuJoCo, which reads the model ({name:?}, {force})", model.display());
        Err(anyhow::anyhow!(why)).or_usage()
    }
}
