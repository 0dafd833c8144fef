//! The arguments that select the environment of a run.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow};
use clap::Args;
use robogate_core::{Assignment, SettingSpec, Suite};
use robogate_dictionary::hex;
use robogate_physics::is_folder;
use sha2::{Digest, Sha256};

use crate::cell::{Cell, CellSettings};
use crate::exit::{Exit, OrExit};
use crate::registry::{self, CELL_TASK, ENGINES, EngineEntry};
use crate::remote::Simulators;
use crate::renderer::RendererName;
use crate::reopening::{Reopening, Trust};
use crate::terminal::foreign;

use super::environment::{EnvironmentSource, RemoteSource};
use super::spaces::assignment;
use crate::environments::BUNDLED;

/// The arguments that select the environment.
#[derive(Debug, Args)]
pub(crate) struct EnvironmentArguments {
    /// Choose the built-in task (see `robogate list`)
    #[arg(long, value_name = "TASK", default_value = CELL_TASK, conflicts_with = "addresses")]
    task: String,
    /// Run in this environment: FAMILY:NAME of a bundled one (see `robogate env list`), gymnasium:ID, or your own as
    /// FILE.py:ATTRIBUTE or MODULE:ATTRIBUTE
    #[arg(long, value_name = "NAME", conflicts_with_all = ["task", "addresses", "engine", "time_step", "robot"])]
    env: Option<String>,
    /// Choose the robot: a built-in one (see `robogate robots`), or the folder of your own [default: franka]
    #[arg(long, value_name = "ROBOT")]
    robot: Option<String>,
    #[arg(long, help = engine_help(), value_name = "ENGINE", conflicts_with = "addresses")]
    engine: Option<String>,
    /// Set the engine's time step, in seconds; default: the engine's own
    #[arg(long, value_name = "SECONDS", conflicts_with = "addresses")]
    time_step: Option<f64>,
    /// Set a setting of the task (`robogate list` has them): time_limit_s=20, or with a unit time_limit_s=2min; repeat
    /// for several
    #[arg(long = "set", value_name = "NAME=VALUE")]
    set: Vec<String>,
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
    /// The environment that the arguments select.
    pub(crate) fn environment(&self) -> Result<EnvironmentSource, Exit> {
        let (environment, rest) = self.environment_and_parameters()?;
        self.refuse_parameters(&environment, &rest)?;
        Ok(environment)
    }

    /// The environment that the arguments select, and the values of `--set` that are no settings of its task, for verbs
    /// that make a scenario of them.
    pub(crate) fn environment_and_parameters(&self) -> Result<(EnvironmentSource, Assignment), Exit> {
        if let Some(name) = &self.env {
            return Ok((EnvironmentSource::launched(&from_any_folder(name), &self.simulators)?, self.parameters()?));
        }
        if self.simulators.python.is_some() && self.simulators.addresses.is_empty() {
            return Err(anyhow!("--python applies to --env only\n  hint: leave it out")).or_usage();
        }
        let pool = self.simulators.connect()?;
        if let Some(pool) = pool.as_ref().filter(|pool| pool.hello().scores_itself) {
            let remote = RemoteSource { pool: Arc::clone(pool), robot: self.robot().to_owned(), launched: None };
            return Ok((EnvironmentSource::Remote(remote), self.parameters()?));
        }
        let Some(arm) = registry::arm_task(&self.task) else {
            let task = registry::task(&self.task).or_usage()?;
            self.refuse_cell_options(&self.task)?;
            let (chosen, rest) = self.settings_among(&task.settings()).or_usage()?;
            let task = task.with(&chosen).map_err(|why| anyhow!("--set: {why}")).or_usage()?;
            return Ok((EnvironmentSource::SelfContained(task), rest));
        };
        let (chosen, rest) = self.settings_among(&arm.settings()).or_usage()?;
        let cell = Cell::new(self.settings(), chosen, pool).or_setup()?;
        Ok((EnvironmentSource::Cell(Box::new(cell)), rest))
    }

    /// The values of `--set` as parameters of a scenario.
    pub(crate) fn parameters(&self) -> Result<Assignment, Exit> {
        assignment(&self.set).or_usage()
    }

    /// The values of `--set` that belong to these settings, and the others.
    fn settings_among(&self, specs: &[SettingSpec]) -> anyhow::Result<(Assignment, Assignment)> {
        let (mut chosen, mut rest) = (Assignment::default(), Vec::new());
        for pair in &self.set {
            let named = pair.split_once('=');
            match named.and_then(|(name, text)| Some((specs.iter().find(|spec| &*spec.name == name.trim())?, text))) {
                Some((spec, text)) => chosen.set(&*spec.name, spec.read(text).map_err(|why| anyhow!("--set: {why}"))?),
                None => rest.push(pair.clone()),
            }
        }
        Ok((chosen, assignment(&rest)?))
    }

    /// Rejects values of `--set` that are no settings of the task.
    fn refuse_parameters(&self, environment: &EnvironmentSource, rest: &Assignment) -> Result<(), Exit> {
        let Some((name, _)) = rest.iter().next() else { return Ok(()) };
        let task = environment.task().or_broken()?;
        let known: Vec<&str> = task.settings.iter().map(|spec| &*spec.name).collect();
        let name = foreign(name);
        Err(match (environment, known.is_empty()) {
            _ if task.parameter(&name).is_some() => anyhow!(
                "--set {name}: `{name}` is a parameter of {}, which varies between episodes\n  hint: set its range in a \
                 space: --space FILE",
                task.name
            ),
            (EnvironmentSource::Remote(_), false) => anyhow!(
                "--set {name}: the settings of {} are those of its server\n  hint: give them to the server: robogate \
                 serve --set {name}=VALUE",
                task.name
            ),
            (_, true) => anyhow!("--set {name}: {} has no settings\n  hint: leave it out", task.name),
            (_, false) => {
                anyhow!("--set {name}: {} has no such setting. Expected one of: {}", task.name, known.join(", "))
            }
        })
        .or_usage()
    }

    /// The environment that the arguments select for a suite: if they select none, that of the suite.
    pub(crate) fn environment_of(&self, suite: Option<&Suite>) -> Result<EnvironmentSource, Exit> {
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
                let environment = EnvironmentSource::launched(name, &self.simulators)?;
                self.refuse_parameters(&environment, &self.parameters()?)?;
                Ok(environment)
            }
            _ => self.environment(),
        }
    }

    /// The built-in task for an arm that the arguments select, for verbs that need its robot.
    pub(crate) fn cell(&self) -> Result<Cell, Exit> {
        Self::as_cell(self.environment()?)
    }

    /// As [`Self::cell`], with the values of `--set` that are no settings of its task.
    pub(crate) fn cell_and_parameters(&self) -> Result<(Cell, Assignment), Exit> {
        let (environment, rest) = self.environment_and_parameters()?;
        Ok((Self::as_cell(environment)?, rest))
    }

    fn as_cell(environment: EnvironmentSource) -> Result<Cell, Exit> {
        match environment {
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
            renderer: self.renderer.record(),
            simulator: None,
        }
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
