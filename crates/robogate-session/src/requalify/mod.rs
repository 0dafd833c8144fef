//! Requalification after an upgrade: the scenarios of a run again, before and after it.

mod python;
mod side;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::anyhow;
use robogate_dictionary::{Dictionary, Entry, Place, Provenance, PythonPlace};
use robogate_gate::{Ending, Requalification, Requalifier, Seen};
use serde::Serialize;

use crate::cell;
use crate::environment_choice::{absolute, file_sha256, from_any_folder};
use crate::environments::Interpreter;
use crate::failure::{Failure, FailureKind, OrFailure};
use crate::notice::note;
use crate::origin;
use crate::policy_source::{PolicyChoice, PolicyLocation};
use crate::registry::ENGINES;
use crate::reopening::{Reopening, Trust};
use crate::repetition::repeats;
use crate::source::open_source;
use crate::subject::Subject;

pub use python::{Packages, VersionChange};
use side::Side;

/// Pairs of the first round. Each later one doubles them.
const FIRST_ROUND: usize = 20;
/// Scenarios that run twice to check that they repeat.
const REPEATED: usize = 8;

/// What is upgraded.
#[derive(Debug, Clone)]
pub enum Upgrade {
    /// Packages of the Python environment, as requirements of pip.
    Packages(Vec<String>),
    /// The environment: another version of its file, or another name.
    Environment(String),
    /// The policy.
    Policy(Box<PolicyChoice>),
    /// The robot of the built-in cell: a name or a folder.
    Robot(String),
    /// The engine of the built-in cell.
    Engine(String),
}

/// How a requalification runs.
#[derive(Debug, Clone)]
pub struct Requalifying {
    /// The most pairs.
    pub pairs: usize,
    /// Whether all of them run, also after an answer is certain.
    pub all: bool,
    /// A change of success within this margin is not relevant.
    pub margin: f64,
    /// The probability of a false claim.
    pub error: f64,
    /// Episodes that run at once on each side. `None` for one on each processor.
    pub threads: Option<NonZeroUsize>,
}

/// A requalification with its two sides.
#[derive(Debug, Serialize)]
pub struct Requalified {
    /// The task.
    pub task: String,
    /// The policy before.
    pub policy: String,
    /// SHA-256 (hex) of the rows before.
    pub dataset_sha256: String,
    /// The upgrade, in words.
    pub upgrade: String,
    /// Engine and version on both sides. The second is unknown if it does not start.
    pub engines: [String; 2],
    /// Packages whose versions differ.
    pub packages: Vec<VersionChange>,
    /// Episodes before the upgrade that repeat the recorded ones bit for bit, of those that ran.
    pub repeats_run: [u64; 2],
    /// What the upgrade changes.
    #[serde(flatten)]
    pub result: Requalification,
}

/// A recorded run whose scenarios run again.
pub struct RecordedRun {
    folder: PathBuf,
    provenance: Provenance,
    dataset_sha256: String,
    entries: Vec<Entry>,
    opening: Reopening,
    before: Side,
    /// The Python of the environment, if it runs in one.
    python: Option<Packages>,
}

impl RecordedRun {
    /// Opens a run and starts its environment as it was.
    ///
    /// # Errors
    /// Rows that were not simulated, or an environment that does not start.
    pub fn open(folder: &Path, opening: Reopening, how: &Requalifying) -> Result<Self, Failure> {
        let source = open_source(folder)?;
        let dictionary: &Dictionary = source.dictionary();
        let provenance = dictionary.provenance().clone();
        if provenance.source.is_some() {
            return Err(anyhow!("{}: its rows were imported, so they cannot run again", folder.display())).or_request();
        }
        let mut entries = Vec::new();
        for entry in dictionary.entries().take(how.pairs) {
            entries.push(entry.or_request()?);
        }
        let python = match provenance.world.as_ref().map(|world| &world.place) {
            Some(Place::Python(PythonPlace { environment, .. })) => {
                let own = origin::of(folder, &provenance).and_then(|origin| origin.python);
                let named = opening.simulators.python.clone().or(own);
                Some(Packages::of(Interpreter::choose(named.as_deref(), environment).or_request()?.path())?)
            }
            _ => None,
        };
        let before = Side::new(|probe| Subject::recorded(&provenance, Some(folder), &opening.probed(probe)))?;
        let dataset_sha256 = dictionary.dataset_hash().to_owned();
        Ok(Self { folder: folder.to_owned(), provenance, dataset_sha256, entries, opening, before, python })
    }

    /// The packages of its Python environment.
    pub fn packages(&self) -> Option<&Packages> {
        self.python.as_ref()
    }

    /// The subject after an upgrade, with its changed packages. The inner error is that of an environment which does not start.
    fn upgraded(&self, upgrade: &Upgrade) -> Result<(Result<Side, Failure>, Vec<VersionChange>), Failure> {
        let (folder, mut provenance) = (Some(&*self.folder), self.provenance.clone());
        // What the record names may start, as it did for the side before. Another record has no origin that says so.
        let mut opening = Reopening { upgraded: true, trust: Trust::YES, ..self.opening.clone() };
        opening.simulators.python =
            self.python.as_ref().map(|first| first.path().to_owned()).or(opening.simulators.python);
        let mut packages = Vec::new();
        if let Upgrade::Packages(requirements) = upgrade {
            let Some(first) = &self.python else {
                return Err(anyhow!(
                    "--env-with: the run was not made in a Python environment, but in the built-in cell\nHint: use --engine, --robot or \
                     --policy"
                ))
                .or_request();
            };
            let second = first.with(requirements)?;
            packages = first.changes(&Packages::of(&second)?);
            opening.simulators.python = Some(second);
        }
        match (upgrade, provenance.world.as_mut().map(|world| &mut world.place)) {
            (Upgrade::Robot(name), Some(Place::Cell(place))) => {
                #[cfg(feature = "mujoco")]
                let name = if name.starts_with(crate::menagerie::PREFIX) {
                    &crate::menagerie::resolved(name, opening.simulators.python.take().as_deref())?
                } else {
                    name
                };
                place.robot = absolute(name);
                opening.robot = robogate_physics::is_folder(name).then(|| name.clone());
                provenance.robot.sha256 = None;
                // Values of the other robot's gripper, such as the grip force of fingers for a cup.
                let robot = cell::robot(name).or_request()?;
                let task = cell::recorded_task(&provenance.task).or_request()?;
                let applies = |name: &str| task.has_effect(name, &robot.settings.gripper);
                Arc::make_mut(&mut provenance.task).settings.retain(|setting| applies(&setting.name));
            }
            (Upgrade::Engine(name), Some(Place::Cell(place))) => {
                let Some(engine) = ENGINES.iter().find(|engine| engine.name == name) else {
                    let known: Vec<&str> = ENGINES.iter().map(|engine| engine.name).collect();
                    return Err(anyhow!("--engine {name}: no such engine. Expected one of: {}", known.join(", ")))
                        .or_request();
                };
                (place.engine, place.time_step_s) = (engine.name.to_owned(), engine.time_step_s);
            }
            (Upgrade::Environment(name), Some(Place::Python(place))) => {
                let environment = from_any_folder(name);
                let sha256 = file_sha256(&environment).or_request()?;
                let (files, packages) = Default::default();
                *place = PythonPlace { environment, sha256, files, packages };
                opening.env = Some(name.clone());
            }
            (Upgrade::Environment(name), _) => {
                return Err(anyhow!(
                    "--env {name}: the run was not made in an environment that RoboGate starts\nHint: use --engine, --robot or --policy"
                ))
                .or_request();
            }
            (Upgrade::Robot(_) | Upgrade::Engine(_), _) => {
                return Err(anyhow!(
                    "--robot and --engine apply to the built-in cell, but the run was made in another environment\nHint: use \
                     --env, --env-with or --policy"
                ))
                .or_request();
            }
            _ => {}
        }
        if let Upgrade::Policy(choice) = upgrade {
            opening.simulators.loads = choice.loaded()?;
            let location = PolicyLocation { at: None, access: opening.access.clone() };
            let policy = choice.source_at(&location)?;
            let side = Side::new(|probe| {
                Subject::recorded_environment(&provenance, folder, &opening.probed(probe))?.with_policy(policy)
            });
            return side.map(|side| (Ok(side), packages));
        }
        let side = Side::new(|probe| Subject::recorded(&provenance, folder, &opening.probed(probe)));
        match side {
            // The requested version exists, but the environment does not start with it.
            Err(failure) if failure.kind != FailureKind::Evidence && !matches!(upgrade, Upgrade::Robot(_)) => {
                Ok((Err(failure), packages))
            }
            side => side.map(|side| (Ok(side), packages)),
        }
    }

    /// Runs the scenarios before and after an upgrade in rounds, until an answer is certain or all have run. `after` is called after
    /// each round.
    ///
    /// # Errors
    /// An upgrade that cannot be made, or infrastructure.
    pub fn requalify(
        &mut self,
        upgrade: &Upgrade,
        how: &Requalifying,
        after: &mut dyn FnMut(&Requalification),
    ) -> Result<Requalified, Failure> {
        let planned = self.entries.len() as u64;
        let (side, packages) = self.upgraded(upgrade)?;
        let describe = |subject: &Subject| -> Result<String, Failure> {
            let engine = subject.provenance(self.provenance.space.clone())?.engine;
            Ok([Some(engine.name), engine.version].into_iter().flatten().collect::<Vec<_>>().join(" "))
        };
        let engines = [
            describe(&self.before.subject)?,
            side.as_ref().map_or(Ok("-".to_owned()), |side| describe(&side.subject))?,
        ];
        let mut repeats_run = [0, 0];
        let result = match side {
            Err(failure) => Requalification::does_not_start(format!("{:#}", failure.error), planned),
            Ok(mut side) => {
                let scenarios = self.entries.iter().map(planned_episode).collect();
                let task = self.before.subject.task();
                let mut judge = Requalifier::new(scenarios, task.modes().count(), how.margin, how.error);
                let first: Vec<_> =
                    self.entries.iter().take(REPEATED).map(|entry| entry.episode.scenario.clone()).collect();
                for (subject, when) in [(&self.before.subject, "before"), (&side.subject, "after")] {
                    if let Some(found) = repeats(subject, &first)?.filter(|found| found.other_start > 0) {
                        judge.is_unpaired(format!(
                            "{when} the upgrade, {} of {} episodes of the same seed start differently when they run again",
                            found.other_start, found.episodes
                        ));
                    }
                }
                let mut done = 0;
                loop {
                    let end = (2 * done).max(FIRST_ROUND).min(self.entries.len());
                    let due = self.entries.get(done..end).unwrap_or_default();
                    let before = self.before.run(due, how.threads)?;
                    let after_it = side.run(due, how.threads)?;
                    for (entry, seen) in due.iter().zip(&before) {
                        repeats_run[0] += u64::from(seen.hash == entry.episode.trajectory_hash && seen.hash != 0);
                        repeats_run[1] += 1;
                    }
                    judge.round(before.into_iter().zip(after_it).map(<[Seen; 2]>::from).collect());
                    done = end;
                    let result = judge.conclude();
                    after(&result);
                    if done >= self.entries.len() || (result.is_certain() && !how.all) {
                        break result;
                    }
                }
            }
        };
        if repeats_run[0] < repeats_run[1] {
            note(format_args!(
                "note: {} of {} episodes before the upgrade repeat those of the run bit for bit",
                repeats_run[0], repeats_run[1]
            ));
        }
        Ok(Requalified {
            task: self.provenance.task.name.to_string(),
            policy: self.provenance.policy.clone(),
            dataset_sha256: self.dataset_sha256.clone(),
            upgrade: upgrade.to_string(),
            engines,
            packages,
            repeats_run,
            result,
        })
    }
}

impl std::fmt::Display for Upgrade {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Packages(requirements) => f.write_str(&requirements.join(" ")),
            Self::Environment(name) => write!(f, "environment {name}"),
            Self::Policy(choice) => write!(f, "policy {}", choice.policy.as_deref().unwrap_or("scripted")),
            Self::Robot(robot) => write!(f, "robot {robot}"),
            Self::Engine(engine) => write!(f, "engine {engine}"),
        }
    }
}

/// A scenario that may run.
fn planned_episode(entry: &Entry) -> Seen {
    Seen {
        index: entry.index(),
        requested: entry.episode.scenario.requested.clone(),
        case: entry.label.case.clone(),
        ending: Ending::Failure(None),
        ticks: 0,
        hash: 0,
        start: Vec::new(),
        trace: None,
    }
}
