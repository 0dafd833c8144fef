//! A task from a folder: how it is read, and how it is checked.

use std::io::{self, Read};
use std::path::Path;

use anyhow::{Context, bail};
use robogate_core::{
    Action, Allowed, Command, Environment, Fault, Observation, Outcome, Policy, Scenario, Seed, TaskInstance, TaskSpec,
    Value, check_applied, rollout,
};
use robogate_dictionary::check_columns;
use robogate_tasks::file::{FILE, FileTask, Imported, MOST_FILE_BYTES, Wishes};

use crate::cell::{Cell, default_place, listed, nominal};
use crate::failure::{Failure, OrFailure};

/// Largest file, in bytes. The reader of tasks accepts less.
const MOST_BYTES: u64 = 1 << 20;

/// A commented example of a task: a drawer.
pub const EXAMPLE: &str = include_str!("../../../assets/tasks/drawer/task.toml");

/// Reads the task in a folder.
///
/// # Errors
/// Every problem of its file.
pub fn read(folder: &Path) -> anyhow::Result<FileTask> {
    let path = folder.join(FILE);
    let text = text(&path).with_context(|| {
        format!("cannot read {}\nHint: `robogate tasks init {}` writes an example", path.display(), folder.display())
    })?;
    match FileTask::read_with(&text, &mut |name| beside(folder, name)) {
        Ok(task) => Ok(task),
        Err(problems) => bail!("{}\n{}", path.display(), listed(&problems)),
    }
}

fn text(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    std::fs::File::open(path)?.take(MOST_BYTES).read_to_string(&mut text)?;
    Ok(text)
}

/// The content of a file in the folder of a task. The name has no `..`; a link may lead nowhere else.
fn beside(folder: &Path, name: &str) -> Result<Vec<u8>, String> {
    let read = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => "there is no such file in the folder of the task".to_owned(),
        _ => error.to_string(),
    };
    let path = folder.join(name).canonicalize().map_err(read)?;
    if !path.starts_with(folder.canonicalize().map_err(read)?) {
        return Err(
            "it is a link to a file outside of the folder of the task. Copy the file into the folder".to_owned()
        );
    }
    if !path.metadata().map_err(read)?.is_file() {
        return Err("it is not a file".to_owned());
    }
    let mut content = Vec::new();
    std::fs::File::open(path)
        .map_err(read)?
        .take(MOST_FILE_BYTES as u64 + 1)
        .read_to_end(&mut content)
        .map_err(read)?;
    Ok(content)
}

/// Largest file that an import reads, in bytes.
const MOST_IMPORTED: u64 = 64 << 20;

/// A task from a file that another simulator reads. It names further files, of which only models and meshes are read.
///
/// # Errors
/// Why it cannot be imported.
pub fn import(file: &Path, wishes: &Wishes) -> anyhow::Result<Imported> {
    let name = file.to_str().context("the path of the file is not UTF-8")?;
    let mut read = |name: &str| {
        let end = name.rsplit_once('.').map_or("", |(_, end)| end).to_ascii_lowercase();
        if !["xml", "mjcf", "urdf", "bddl", "stl", "obj"].contains(&end.as_str()) {
            return Err(format!(
                "{name}: a file that ends with `.{end}` is not read. Expected a model, or a mesh (STL, OBJ)"
            ));
        }
        let path = Path::new(name);
        let shown = |error: io::Error| format!("{name}: {error}");
        if !path.metadata().map_err(shown)?.is_file() {
            return Err(format!("{name}: it is not a file"));
        }
        let mut content = Vec::new();
        std::fs::File::open(path).map_err(shown)?.take(MOST_IMPORTED).read_to_end(&mut content).map_err(shown)?;
        Ok(content)
    };
    robogate_tasks::file::import(name, wishes, &mut read).map_err(anyhow::Error::msg)
}

/// What a check of a task found.
#[derive(Debug, Default)]
pub struct Checked {
    /// The problems, as lines.
    pub problems: Vec<String>,
    /// What was measured, as lines.
    pub figures: Vec<String>,
}

/// How many episodes of the expert a check with physics runs.
pub const EXPERT_EPISODES: u64 = 20;

/// A failure within this time is one of the start, in seconds.
const START_S: f64 = 1.0;

/// The encoder errors of these episodes, in radians: each episode has others, as small as those of a calibrated arm.
const ENCODER_BIAS_RAD: f64 = 0.002;

/// Checks the task in a folder with a robot: its nominal scenario, its start, and one episode of its expert. With `physics`, also
/// every parameter at both ends of its range, 20 episodes of the expert, and a policy that does nothing.
///
/// # Errors
/// A folder that is not a task, or a robot that cannot be set up.
pub fn check(folder: &Path, robot: &str, physics: bool) -> Result<Checked, Failure> {
    let task = read(folder).or_request()?;
    let cell = Cell::new(&task, default_place(robot), robogate_core::Assignment::default(), None).or_setup()?;
    let mut checked = Checked::default();
    let chain = cell.kinematics().or_broken()?;
    checked.problems.extend(task.lint(cell.robot(), &chain).iter().map(ToString::to_string));
    let mut environment = cell.environment().or_broken()?;
    checked.problems.extend(check_columns(environment.task()).err().map(|error| error.to_string()));
    idle(&mut checked, &mut *environment, physics, task.moves());
    let episodes = if physics { EXPERT_EPISODES } else { 1 };
    checked.figures.extend(task.figures().iter().cloned());
    let settings: Vec<String> = task.own_settings().map(|(name, value)| format!("{name}={value}")).collect();
    if !settings.is_empty() {
        checked.figures.push(format!("settings for --set, with their defaults: {}", settings.join(", ")));
    }
    if task.has_expert() {
        expert(&mut checked, &cell, &mut *environment, (episodes, task.stages()))?;
    } else {
        checked.figures.push("no [expert]: whether the task can be solved is not checked".to_owned());
    }
    if physics {
        parameters(&mut checked, &mut *environment);
    }
    Ok(checked)
}

/// The start must not decide the episode, and a policy that does nothing must not succeed. Where fixtures move, it may fail later.
fn idle(checked: &mut Checked, environment: &mut dyn Environment, to_the_end: bool, moves: bool) {
    let scenario = nominal();
    let episode = rollout(environment, &mut Idle { posture: Vec::new(), gives_up: !to_the_end }, &scenario);
    match episode.outcome {
        Outcome::Success => checked.problems.push(format!(
            "a policy that does nothing succeeds after {:.2} s\nHint: let [success] require a change",
            episode.time_s
        )),
        Outcome::Failure(mode)
            if mode != robogate_core::FailureMode::TIMEOUT && !(moves && episode.time_s > START_S) =>
        {
            checked.problems.push(format!(
                "a policy that does nothing ends with `{mode}` after {:.2} s\nHint: the start must not be a failure",
                episode.time_s
            ))
        }
        Outcome::Invalid(fault) => checked.problems.push(format!("the nominal scenario cannot be set up: {fault}")),
        Outcome::Failure(_) => {}
    }
}

fn expert(
    checked: &mut Checked,
    cell: &Cell,
    environment: &mut dyn Environment,
    (episodes, declared): (u64, usize),
) -> Result<(), Failure> {
    let mut expert = cell.controller().or_broken()?;
    let (mut solved, mut first) = (0, None);
    let mut stages: f64 = f64::INFINITY;
    for index in 0..episodes {
        let mut scenario = Scenario { index, seed: Seed::campaign(0).episode(index), ..nominal() };
        if episodes > 1 {
            scenario.requested.set("encoder_bias_rad", Value::Number(ENCODER_BIAS_RAD));
        }
        let episode = rollout(environment, &mut *expert, &scenario);
        if episode.outcome == Outcome::Success {
            solved += 1;
            stages = stages.min(episode.measures.get("stages").unwrap_or(f64::INFINITY));
        } else {
            first.get_or_insert((episode.outcome.as_str(), episode.time_s));
        }
    }
    checked.figures.push(format!("expert: {solved} of {episodes} nominal episodes succeed"));
    if let Some((outcome, time_s)) = first
        && solved * 20 < episodes * 19
    {
        let hint = "Hint: watch it with `robogate run --task DIR --nominal -n 1 --out first` and `robogate view first`";
        checked.problems.push(format!("the expert fails at nominal: {outcome} after {time_s:.2} s\n{hint}"));
    }
    if solved > 0 && stages < declared as f64 {
        checked.problems.push(format!(
            "the expert succeeds, but reaches only {stages} of {declared} stages in their order\nHint: order [[stage]] as they \
             happen"
        ));
    }
    Ok(())
}

/// Sets every parameter to both ends of its range and reads it back.
fn parameters(checked: &mut Checked, environment: &mut dyn Environment) {
    let task = std::sync::Arc::clone(environment.task());
    for parameter in &task.parameters {
        let Allowed::Continuous { low, high } = parameter.allowed else { continue };
        for value in [low, high] {
            let mut scenario = nominal();
            scenario.requested.set(&*parameter.name, Value::Number(value));
            let applied = environment.reset(&scenario).and_then(|start| {
                check_applied(&scenario.requested, &start.applied)?;
                Ok(())
            });
            if let Err(fault) = applied {
                checked.problems.push(format!("parameter `{}` = {value}: {fault}", parameter.name));
            }
        }
    }
}

/// A policy that keeps its first posture.
struct Idle {
    posture: Vec<f64>,
    /// Whether the episode may end as soon as nothing moves.
    gives_up: bool,
}

impl Policy for Idle {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        self.posture.clear();
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        if self.posture.is_empty() {
            self.posture = observation.joint_positions().to_vec();
        }
        Ok(Action { command: Command::JointPosition(self.posture.clone()), gripper: Some(Action::OPEN), phase: None })
    }

    fn gave_up(&self) -> bool {
        self.gives_up
    }
}
