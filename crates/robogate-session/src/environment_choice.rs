//! The environment as the user chooses it.

use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, anyhow, bail};
use robogate_core::{Assignment, SettingSpec, Suite};
use robogate_dictionary::{CellPlace, RendererRecord, hex};
use robogate_physics::{built_in_robots, is_folder};
use sha2::{Digest, Sha256};

use crate::cell::{Cell, default_place};
use crate::environments::BUNDLED;
use crate::failure::{Failure, OrFailure};
#[cfg(feature = "mujoco")]
use crate::menagerie;
use crate::policy_source::PolicyChoice;
use crate::registry::{self, CELL_TASK, ENGINES, EngineEntry};
use crate::remote::Simulators;
use crate::reopening::{Reopening, Trust};
use crate::subject::{EnvironmentSource, RemoteSource, assignment};
use crate::text::foreign;

/// The environment as the user chooses it.
#[derive(Debug, Clone)]
pub struct EnvironmentChoice {
    /// The built-in task.
    pub task: String,
    /// An environment that this process starts: `FAMILY:NAME` of a bundled one, `gymnasium:ID`, or the user's own as
    /// `FILE.py:ATTRIBUTE` or `MODULE:ATTRIBUTE`. It replaces the built-in task.
    pub env: Option<String>,
    /// The robot: the name of a built-in one, `menagerie:NAME`, or a folder. `None` for the Franka.
    pub robot: Option<String>,
    /// The physics engine. `None` for the default of this build.
    pub engine: Option<String>,
    /// The engine's time step, in seconds. `None` for the engine's own.
    pub time_step_s: Option<f64>,
    /// Settings of the task as `NAME=VALUE`.
    pub set: Vec<String>,
    /// The renderer of the camera images. `None` for the embedded one.
    pub renderer: Option<RendererRecord>,
    /// Simulators in other processes.
    pub simulators: Simulators,
}

impl Default for EnvironmentChoice {
    /// Pick and place with the Franka.
    fn default() -> Self {
        Self {
            task: CELL_TASK.to_owned(),
            env: None,
            robot: None,
            engine: None,
            time_step_s: None,
            set: Vec::new(),
            renderer: None,
            simulators: Simulators::default(),
        }
    }
}

impl EnvironmentChoice {
    /// The chosen environment.
    pub fn environment(&self) -> Result<EnvironmentSource, Failure> {
        let (environment, rest) = self.environment_and_parameters()?;
        self.refuse_parameters(&environment, &rest)?;
        Ok(environment)
    }

    /// The chosen environment, and the values of `--set` that are not settings of its task, for verbs that put them into a
    /// scenario.
    pub fn environment_and_parameters(&self) -> Result<(EnvironmentSource, Assignment), Failure> {
        if let Some(name) = &self.env {
            return Ok((EnvironmentSource::launched(&from_any_folder(name), &self.simulators)?, self.parameters()?));
        }
        #[cfg(feature = "mujoco")]
        if let Some(robot) = self.robot.as_deref().filter(|robot| robot.starts_with(menagerie::PREFIX)) {
            let mut found = self.clone();
            found.robot = Some(menagerie::resolved(robot, found.simulators.python.take().as_deref())?);
            return found.environment_and_parameters();
        }
        if self.simulators.python.is_some() && self.simulators.addresses.is_empty() {
            return Err(anyhow!("--python applies to --env only\nHint: leave it out")).or_request();
        }
        let pool = self.simulators.connect()?;
        if let Some(pool) = pool.as_ref().filter(|pool| pool.hello().scores_itself) {
            let served = &pool.hello().task.name;
            if self.task != CELL_TASK && *served != *self.task {
                return Err(anyhow!(
                    "--task {} cannot be used with --simulator: the server has its own task, {served}\nHint: leave out --task, \
                     or start a server that computes physics only",
                    self.task
                ))
                .or_request();
            }
            // The scripted controller has the robot that the server declares, unless the user names a folder of it.
            let declared = pool.hello().robot.as_ref().map(|robot| robot.name.clone());
            let declared = declared.filter(|name| built_in_robots().any(|known| known == name));
            let robot = self.robot.clone().or(declared).unwrap_or_else(|| self.robot().to_owned());
            let remote = RemoteSource { pool: Arc::clone(pool), robot, launched: None };
            return Ok((EnvironmentSource::Remote(remote), self.parameters()?));
        }
        let Some(arm) = registry::arm_task(&self.task).or_request()? else {
            let task = registry::task(&self.task).or_request()?;
            self.refuse_cell_options(&self.task)?;
            if pool.is_some() {
                let task = &self.task;
                return Err(anyhow!(
                    "--simulator cannot be used with {task}, which has its own engine\nHint: leave it out"
                ))
                .or_request();
            }
            let (chosen, rest) = self.settings_among(&task.settings()).or_request()?;
            let task = task.with(&chosen).map_err(|why| anyhow!("--set: {why}")).or_request()?;
            return Ok((EnvironmentSource::BuiltIn(Box::new(task)), rest));
        };
        let (chosen, rest) = self.settings_among(&arm.settings()).or_request()?;
        let cell = Cell::new(&*arm, self.place(), chosen, pool).or_setup()?;
        Ok((EnvironmentSource::BuiltIn(Box::new(cell)), rest))
    }

    /// The same choice, whose processes load the policy of this choice if it is one that they load.
    ///
    /// # Errors
    /// A policy that does not exist.
    pub fn with_policy(mut self, policy: &PolicyChoice) -> Result<Self, Failure> {
        self.simulators.loads = policy.loaded()?;
        Ok(self)
    }

    /// The values of `--set` as parameters of a scenario.
    pub fn parameters(&self) -> Result<Assignment, Failure> {
        assignment(&self.set).or_request()
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

    /// Rejects values of `--set` that are not settings of the task.
    fn refuse_parameters(&self, environment: &EnvironmentSource, rest: &Assignment) -> Result<(), Failure> {
        let Some((name, _)) = rest.iter().next() else { return Ok(()) };
        let task = environment.task().or_broken()?;
        let known: Vec<&str> = task.settings.iter().map(|spec| &*spec.name).collect();
        let name = foreign(name);
        Err(match (environment, known.is_empty()) {
            _ if task.parameter(&name).is_some() => anyhow!(
                "--set {name}: `{name}` is a parameter of {}, which varies between episodes\nHint: set its range in a \
                 space: --space FILE",
                task.name
            ),
            (EnvironmentSource::Remote(_), false) => anyhow!(
                "--set {name}: the settings of {} are those of its server\nHint: give them to the server: robogate \
                 serve --set {name}=VALUE",
                task.name
            ),
            (_, true) => anyhow!("--set {name}: {} has no settings\nHint: leave it out", task.name),
            (_, false) => {
                anyhow!("--set {name}: {} has no such setting. Expected one of: {}", task.name, known.join(", "))
            }
        })
        .or_request()
    }

    /// The chosen environment for a suite: without a choice, that of the suite.
    pub fn environment_of(&self, suite: Option<&Suite>) -> Result<EnvironmentSource, Failure> {
        match suite.and_then(Suite::environment) {
            Some(name) if self.env.is_none() && self.simulators.addresses.is_empty() => {
                self.refuse_cell_options(name)?;
                // Another user may have written the suite. Bundled environments are part of RoboGate.
                if !is_bundled(name) {
                    return Err(anyhow!(
                        "the suite is for the environment {0}, whose code a file cannot start\nHint: add --env {0} if you trust it",
                        foreign(name)
                    ))
                    .or_request();
                }
                let environment = EnvironmentSource::launched(name, &self.simulators)?;
                self.refuse_parameters(&environment, &self.parameters()?)?;
                Ok(environment)
            }
            _ => self.environment(),
        }
    }

    /// The chosen built-in task for an arm, for verbs that need its robot.
    pub fn cell(&self) -> Result<Cell, Failure> {
        Self::as_cell(self.environment()?)
    }

    /// As [`Self::cell`], with the values of `--set` that are not settings of its task.
    pub fn cell_and_parameters(&self) -> Result<(Cell, Assignment), Failure> {
        let (environment, rest) = self.environment_and_parameters()?;
        Ok((Self::as_cell(environment)?, rest))
    }

    fn as_cell(environment: EnvironmentSource) -> Result<Cell, Failure> {
        let cell = match environment {
            EnvironmentSource::BuiltIn(built_in) => built_in.into_cell(),
            EnvironmentSource::Remote(_) => None,
        };
        match cell {
            Some(cell) => Ok(cell),
            None => {
                let arms: Vec<&str> = registry::ARM_TASKS.iter().map(|task| task.name()).collect();
                Err(anyhow!(
                    "this command needs a built-in task for an arm: {}\nHint: leave out --env and --simulator",
                    arms.join(", ")
                ))
                .or_request()
            }
        }
    }

    /// The choice as that of a recorded run.
    pub fn reopening(&self, trust: Trust) -> Reopening {
        Reopening::of(self.env.clone(), self.robot.clone(), trust, &self.simulators)
    }

    fn robot(&self) -> &str {
        self.robot.as_deref().unwrap_or("franka")
    }

    /// Rejects options of the built-in cell for an environment that brings its own robot and physics.
    fn refuse_cell_options(&self, environment: &str) -> Result<(), Failure> {
        let given = [
            ("--robot", self.robot.is_some()),
            ("--engine", self.engine.is_some()),
            ("--time-step", self.time_step_s.is_some()),
            ("--renderer", self.renderer.clone().is_some()),
        ];
        match given.into_iter().find(|(_, given)| *given) {
            Some((option, _)) => Err(anyhow!(
                "{option} cannot be used with {environment}, which has no robots and engines to choose\nHint: leave it out"
            ))
            .or_request(),
            None => Ok(()),
        }
    }

    fn place(&self) -> CellPlace {
        let name = self.engine.as_deref().unwrap_or(ENGINES[0].name);
        let engine = ENGINES.iter().find(|engine| engine.name == name);
        CellPlace {
            engine: name.to_owned(),
            time_step_s: self.time_step_s.unwrap_or(engine.map_or(0.0, |engine: &EngineEntry| engine.time_step_s)),
            renderer: self.renderer.clone(),
            ..default_place(&absolute(self.robot()))
        }
    }
}

/// Whether a name is that of a bundled environment. It contains no path and no module.
fn is_bundled(name: &str) -> bool {
    let plain = |text: &str| !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || "_-./".contains(c));
    name.split_once(':').is_some_and(|(family, own)| BUNDLED.contains(&family) && plain(own))
}

/// Replaces a robot's folder by its absolute path, so that a run can be resumed from any folder. A name stays as it is.
pub(crate) fn absolute(robot: &str) -> String {
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
pub(crate) fn file_and_attribute(name: &str) -> Option<(&str, &str)> {
    let (file, attribute) = name.split_at(name.find(".py")? + 3);
    (attribute.is_empty() || attribute.starts_with(':')).then_some((file, attribute))
}

/// The SHA-256 of the file in the name of an environment. `None` if the name contains no file.
pub(crate) fn file_sha256(name: &str) -> anyhow::Result<Option<String>> {
    let Some((file, _)) = file_and_attribute(name) else { return Ok(None) };
    let bytes = match std::fs::read(file) {
        Err(why) if why.kind() == ErrorKind::NotFound => {
            bail!("{}: no such file\nHint: check the path of the environment", foreign(file))
        }
        read => read.with_context(|| format!("cannot read {}", foreign(file)))?,
    };
    Ok(Some(hex(&Sha256::digest(bytes))))
}
