//! The arguments that select the environment of a run.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_core::Suite;
use robogate_dictionary::hex;
use robogate_physics::{SuctionLaw, is_folder};
use robogate_tasks::pick_place::Rules;
use sha2::{Digest, Sha256};

use crate::cell::{Cell, CellSettings};
use crate::exit::{Exit, OrExit};
use crate::registry::{self, CELL_TASK, ENGINES, EngineEntry};
use crate::remote::Simulators;
use crate::renderer::RendererName;
use crate::reopening::{Reopening, Trust};
use crate::terminal::foreign;

use super::environment::{EnvironmentSource, RemoteSource};
use crate::environments::BUNDLED;

/// The arguments that select the environment.
#[derive(Debug, Args)]
pub(crate) struct EnvironmentArguments {
    /// Choose the built-in task (see `robogate list`)
    #[arg(long, value_name = "TASK", default_value = CELL_TASK, conflicts_with = "addresses")]
    task: String,
    /// Run in this environment: FAMILY:NAME of a bundled one (see `robogate env list`), gymnasium:ID, or your own as
    /// FILE.py:ATTRIBUTE or MODULE:ATTRIBUTE
    #[arg(long, value_name = "NAME", conflicts_with_all = ["task", "addresses", "engine", "time_step", "robot", "grip_force", "suction", "time_limit", "jam_force", "jam_duration", "orientation_tolerance"])]
    env: Option<String>,
    /// Choose the robot: a built-in one (see `robogate robots`), or the folder of your own [default: franka]
    #[arg(long, value_name = "ROBOT")]
    robot: Option<String>,
    #[arg(long, help = engine_help(), value_name = "ENGINE", conflicts_with = "addresses")]
    engine: Option<String>,
    /// Set the engine's time step, in seconds; default: the engine's own
    #[arg(long, value_name = "SECONDS", conflicts_with = "addresses")]
    time_step: Option<f64>,
    /// Set the normal force of each gripper pad, in newtons; default: the robot's own
    #[arg(long, value_name = "NEWTONS")]
    grip_force: Option<f64>,
    /// Choose how a suction cup holds an object: surface (a joint that never breaks, as in the paper) or vacuum
    /// (limited by pressure and friction); default: surface with the paper preset, vacuum otherwise
    #[arg(long, value_name = "LAW")]
    suction: Option<SuctionLaw>,
    /// Set the time limit of an episode of pick_place, in seconds; a multiple of 0.05 [default: 15]
    #[arg(long, value_name = "SECONDS")]
    time_limit: Option<f64>,
    /// Set the contact force above which the robot presses, in newtons; see the failure mode `jam` [default: 100]
    #[arg(long, value_name = "NEWTONS")]
    jam_force: Option<f64>,
    /// Set the duration of pressing that is a jam, in seconds [default: 0.05]
    #[arg(long, value_name = "SECONDS")]
    jam_duration: Option<f64>,
    /// Require the part to be at rest within this angle of its orientation at the target, in degrees; default: any
    /// orientation
    #[arg(long, value_name = "DEGREES")]
    orientation_tolerance: Option<f64>,
    /// Choose the renderer of the camera images: the embedded ray caster, or MuJoCo's renderer through EGL
    /// (docs/cameras.md)
    #[arg(long, value_name = "RENDERER", default_value = "embedded")]
    renderer: RendererName,
    #[command(flatten)]
    pub(crate) simulators: Simulators,
}

/// The help of `--engine`, with the engines of this build.
fn engine_help() -> String {
    let names: Vec<&str> = ENGINES.iter().map(|engine| engine.name).collect();
    format!("Choose the physics engine: {} [default: {}]", names.join(" or "), names[0])
}

impl EnvironmentArguments {
    /// The environment that the arguments select. `suction` is used for a suction cup if they do not choose a law.
    pub(crate) fn environment(&self, suction: SuctionLaw) -> Result<EnvironmentSource, Exit> {
        if let Some(name) = &self.env {
            return EnvironmentSource::launched(&from_any_folder(name), &self.simulators);
        }
        if self.simulators.python.is_some() && self.simulators.addresses.is_empty() {
            return Err(anyhow!("--python applies to --env only\n  hint: leave it out")).or_usage();
        }
        let pool = self.simulators.connect()?;
        let scores_itself = pool.as_ref().is_some_and(|pool| pool.hello().scores_itself);
        if let (Some(option), true) = (self.rules_given().first(), scores_itself || self.task != CELL_TASK) {
            return Err(anyhow!("{option} applies to pick_place in the built-in cell only\n  hint: leave it out"))
                .or_usage();
        }
        if let Some(pool) = pool.as_ref().filter(|pool| pool.hello().scores_itself) {
            return Ok(EnvironmentSource::Remote(RemoteSource {
                pool: Arc::clone(pool),
                robot: self.robot().to_owned(),
                launched: None,
            }));
        }
        if registry::arm_task(&self.task).is_none() {
            let task = registry::task(&self.task).or_usage()?;
            self.refuse_cell_options(&self.task)?;
            return Ok(EnvironmentSource::SelfContained(task));
        }
        Cell::new(self.settings(), suction, pool).map(|cell| EnvironmentSource::Cell(Box::new(cell))).or_setup()
    }

    /// The environment that the arguments select for a suite: if they select none, that of the suite.
    pub(crate) fn environment_of(&self, suite: Option<&Suite>, suction: SuctionLaw) -> Result<EnvironmentSource, Exit> {
        match suite.and_then(Suite::environment) {
            Some(name) if self.env.is_none() && self.simulators.addresses.is_empty() => {
                self.refuse_cell_options(name)?;
                // Another user may have written the suite. Bundled environments are part of RoboGate.
                if !is_bundled(name) {
                    return Err(anyhow!(
                        "the suite is for the environment {0}, whose code a file cannot start\n  hint: add --env {0} if you trust it",
                        foreign(name)
                    ))
                    .or_usage();
                }
                EnvironmentSource::launched(name, &self.simulators)
            }
            _ => self.environment(suction),
        }
    }

    /// The built-in task for an arm that the arguments select, for verbs that need its robot.
    pub(crate) fn cell(&self) -> Result<Cell, Exit> {
        match self.environment(SuctionLaw::Vacuum)? {
            EnvironmentSource::Cell(cell) => Ok(*cell),
            EnvironmentSource::SelfContained(_) | EnvironmentSource::Remote(_) => {
                let arms: Vec<&str> = registry::ARM_TASKS.iter().map(|task| task.name()).collect();
                Err(anyhow!(
                    "this command needs a built-in task for an arm: {}\n  hint: leave out --env and --simulator",
                    arms.join(", ")
                ))
                .or_usage()
            }
        }
    }

    /// The arguments as those of a recorded run.
    pub(crate) fn reopening(&self, trust: Trust) -> Reopening {
        Reopening::of(self.env.clone(), self.robot.clone(), trust, &self.simulators)
    }

    fn robot(&self) -> &str {
        self.robot.as_deref().unwrap_or("franka")
    }

    /// Rejects options of the built-in cell for an environment that brings its own robot and physics.
    fn refuse_cell_options(&self, environment: &str) -> Result<(), Exit> {
        let given = [
            ("--robot", self.robot.is_some()),
            ("--engine", self.engine.is_some()),
            ("--time-step", self.time_step.is_some()),
            ("--grip-force", self.grip_force.is_some()),
            ("--suction", self.suction.is_some()),
            ("--renderer", self.renderer.record().is_some()),
        ];
        match given.into_iter().find(|(_, given)| *given) {
            Some((option, _)) => Err(anyhow!(
                "{option} cannot be used with {environment}, which has no robots and engines to choose\n  hint: leave it out"
            ))
            .or_usage(),
            None => Ok(()),
        }
    }

    fn settings(&self) -> CellSettings {
        let name = self.engine.as_deref().unwrap_or(ENGINES[0].name);
        let engine = ENGINES.iter().find(|engine| engine.name == name);
        CellSettings {
            task: self.task.clone(),
            robot: absolute(self.robot()),
            engine: name.to_owned(),
            time_step_s: self.time_step.unwrap_or(engine.map_or(0.0, |engine: &EngineEntry| engine.time_step_s)),
            grip_force_n: self.grip_force,
            suction: self.suction,
            renderer: self.renderer.record(),
            rules: self.rules(),
            simulator: None,
        }
    }

    fn rules(&self) -> Rules {
        let default = Rules::default();
        Rules {
            time_limit_s: self.time_limit.unwrap_or(default.time_limit_s),
            jam_force_n: self.jam_force.unwrap_or(default.jam_force_n),
            jam_duration_s: self.jam_duration.unwrap_or(default.jam_duration_s),
            orientation_tolerance_rad: self.orientation_tolerance.map(f64::to_radians),
            ..default
        }
    }

    /// The options that set a rule of the built-in cell.
    fn rules_given(&self) -> Vec<&'static str> {
        let given = [
            ("--time-limit", self.time_limit),
            ("--jam-force", self.jam_force),
            ("--jam-duration", self.jam_duration),
            ("--orientation-tolerance", self.orientation_tolerance),
        ];
        given.into_iter().filter_map(|(name, value)| value.map(|_| name)).collect()
    }
}

/// Whether a name is that of a bundled environment. It contains no path and no module.
fn is_bundled(name: &str) -> bool {
    let plain = |text: &str| !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || "_-./".contains(c));
    name.split_once(':').is_some_and(|(family, own)| BUNDLED.contains(&family) && plain(own))
}

/// Replaces a robot's folder by its absolute path, so that a run can be resumed from any folder. A name stays as it is.
pub(super) fn absolute(robot: &str) -> String {
    let path = Path::new(robot);
    let full = if is_folder(robot) { path.canonicalize().ok() } else { None };
    full.map_or_else(|| robot.to_owned(), |path| path.to_string_lossy().into_owned())
}

/// Makes the file in the name of an environment absolute, so that a run can be resumed from any folder.
pub(crate) fn from_any_folder(name: &str) -> String {
    let Some((file, attribute)) = file_and_attribute(name) else { return name.to_owned() };
    match Path::new(file).canonicalize() {
        Ok(full) => format!("{}{attribute}", full.display()),
        Err(_) => name.to_owned(),
    }
}

/// The file in the name of an environment, FILE.py:ATTRIBUTE, and the rest of the name.
fn file_and_attribute(name: &str) -> Option<(&str, &str)> {
    let (file, attribute) = name.split_at(name.find(".py")? + 3);
    (attribute.is_empty() || attribute.starts_with(':')).then_some((file, attribute))
}

/// The SHA-256 of the file in the name of an environment. `None` if the name contains no file.
pub(super) fn file_sha256(name: &str) -> anyhow::Result<Option<String>> {
    let Some((file, _)) = file_and_attribute(name) else { return Ok(None) };
    let bytes = std::fs::read(file).with_context(|| format!("cannot read {file}"))?;
    Ok(Some(hex(&Sha256::digest(bytes))))
}
