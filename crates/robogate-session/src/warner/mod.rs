//! A warner in the episodes of a run: a detector that stops, slows down or hands over an episode before it fails.

mod again;
mod slow;

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, anyhow, bail};
use robogate_campaign::Worker;
use robogate_core::latency::Execution;
use robogate_core::stress::Stress;
use robogate_core::{
    Action, Better, Ending, Environment, FailureMode, FailureModeSpec, Fault, MeasureSpec, Measures, Observation,
    Policy, Scenario, Severity, Signals, Start, Step, TaskSpec, Word,
};
use robogate_dictionary::{OnWarning, WarnerRecord, hex, read_text};
use robogate_gate::{HANDOVER, WARNED_S, WARNED_STOP};
use robogate_monitor::warn::{Detector, WarnFile, Warner};
use sha2::{Digest, Sha256};

use crate::failure::{Failure, OrFailure};
use crate::notice::note;

pub(crate) use again::WarnedAgain;
pub use again::{UnwarnedEnd, unwarned, warner_effect_of};
use slow::Slowed;

/// The measure that counts how often a person helped.
const ASSISTS: Word = Word::constant("assists");
/// The most control periods of one action at a warning.
const MOST_PERIODS: u32 = 10;

/// A warner as the user chooses it.
#[derive(Debug, Clone, Default)]
pub struct WarnerChoice {
    /// The file of the detector. `None` for no warner.
    pub detector: Option<PathBuf>,
    /// What happens at a warning.
    pub on_warning: Option<OnWarning>,
}

/// Reads what happens at a warning: `record`, `stop`, `slow`, `slow:N` or `handover`.
pub fn on_warning(text: &str) -> Result<OnWarning, String> {
    let periods = |text: &str| text.parse().ok().filter(|n| (2..=MOST_PERIODS).contains(n));
    let known = match text.split_once(':').unwrap_or((text, "")) {
        ("record", "") => Some(OnWarning::Record),
        ("stop", "") => Some(OnWarning::Stop),
        ("slow", "") => Some(OnWarning::Slow(2)),
        ("slow", n) => periods(n).map(OnWarning::Slow),
        ("handover", "") => Some(OnWarning::Handover),
        _ => None,
    };
    known.ok_or_else(|| {
        format!(
            "`{text}` is not known. Expected stop, slow, slow:N with N from 2 to {MOST_PERIODS}, handover or record"
        )
    })
}

/// Reads the file of a detector, and its text.
///
/// # Errors
/// A file that cannot be read, or that is not a detector.
pub fn read_detector(path: &Path) -> Result<(WarnFile, String), Failure> {
    let text = read_text(path).with_context(|| format!("cannot read {}", path.display())).or_request()?;
    Ok((parse(&text, path.display()).or_request()?, text))
}

fn parse(text: &str, name: impl Display) -> anyhow::Result<WarnFile> {
    serde_json::from_str(text)
        .with_context(|| format!("{name}: not a detector\nHint: `robogate warn train DIR --out FILE` writes one"))
}

impl WarnerChoice {
    /// The record of the chosen warner. `None` without one.
    ///
    /// # Errors
    /// A file that is not a detector.
    pub(crate) fn record(&self) -> Result<Option<WarnerRecord>, Failure> {
        let Some(path) = &self.detector else { return Ok(None) };
        let (_, detector) = read_detector(path)?;
        let on_warning = self.on_warning.unwrap_or(OnWarning::Record);
        Ok(Some(WarnerRecord { on_warning, sha256: hex(&Sha256::digest(&detector)), detector }))
    }
}

/// The warner of a run.
#[derive(Debug, Clone)]
pub(crate) struct SimulatedWarner {
    record: WarnerRecord,
    file: Arc<WarnFile>,
    detector: Arc<Detector>,
    /// Whether the next workers act on warnings. Otherwise they record them.
    acts: Arc<AtomicBool>,
}

impl SimulatedWarner {
    /// The warner of a record, for this task and what is between its environment and policy.
    ///
    /// # Errors
    /// A detector of another task, and a reaction that this task or policy does not allow.
    pub(crate) fn new(record: WarnerRecord, given: &Given<'_>) -> Result<Self, Failure> {
        let file = parse(&record.detector, "--warner").or_request()?;
        let detector = file.detector().context("--warner: the detector is damaged").or_request()?;
        if file.features.signals != Signals::of(given.task) {
            return Err(anyhow!(
                "--warner: the detector is for other signals than those of the task {}: another task, robot or control period\nHint: \
                 train one with a run of this task (`robogate run --record-signals`, `robogate warn train`)",
                given.task.name
            ))
            .or_request();
        }
        if let OnWarning::Slow(_) = record.on_warning {
            given.can_slow_down().or_request()?;
        }
        Ok(Self { record, file: Arc::new(file), detector: Arc::new(detector), acts: Arc::new(AtomicBool::new(true)) })
    }

    /// What the run records.
    pub(crate) fn record(&self) -> &WarnerRecord {
        &self.record
    }

    /// Whether the next workers act on warnings.
    pub(crate) fn acts(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.acts)
    }

    /// Notes in what the run differs from the calibration of the promise.
    pub(crate) fn note_differences(&self, found: [(&'static str, String); 5]) {
        let [task, engine, robot, policy, population] = found.map(|(_, text)| text);
        let here = robogate_monitor::warn::Conditions { task, engine, robot, policy, population };
        for difference in self.file.conditions.differences(&here) {
            note(format_args!("--warner: the promise of the detector is for other conditions: {difference}"));
        }
    }

    /// The task with what a warning adds: when it came, and how it ended the episode.
    ///
    /// # Errors
    /// A task that has such a measure or failure mode already.
    pub(crate) fn declared_in(&self, task: &Arc<TaskSpec>) -> anyhow::Result<Arc<TaskSpec>> {
        if task.measure(WARNED_S.as_str()).is_some() {
            bail!("--warner: the task {} has a measure `{WARNED_S}` already", task.name);
        }
        let mode = ended_by(self.record.on_warning);
        if let Some(mode) = mode.filter(|mode| task.modes().any(|known| known == *mode)) {
            bail!("--on-warning: the task {} has a failure mode `{mode}` already", task.name);
        }
        let mut task = (**task).clone();
        task.measures.push(MeasureSpec {
            name: WARNED_S,
            unit: "s".to_owned(),
            meaning: "Time of the first warning of a failure.".to_owned(),
            better: Better::Neither,
        });
        task.failure_modes.extend(mode.map(|name| FailureModeSpec {
            name,
            meaning: match self.record.on_warning {
                OnWarning::Handover => "A warning ended the episode, and a person took over.".to_owned(),
                _ => "A warning stopped the episode before it ended by itself.".to_owned(),
            },
            severity: Severity::Minor,
            published_as: None,
        }));
        if self.record.on_warning == OnWarning::Handover && task.measure(ASSISTS.as_str()).is_none() {
            task.measures.push(MeasureSpec {
                name: ASSISTS,
                unit: String::new(),
                meaning: "How often a person helped.".to_owned(),
                better: Better::Lower,
            });
        }
        Ok(Arc::new(task))
    }

    /// Puts the warner between this environment and this policy.
    pub(crate) fn between(&self, environment: Box<dyn Environment>, policy: Box<dyn Policy>) -> Result<Worker, Fault> {
        let task = self
            .declared_in(environment.task())
            .map_err(|why| Fault::new(robogate_core::FaultKind::Setup, why.to_string()))?;
        let on_warning = if self.acts.load(Ordering::Relaxed) { self.record.on_warning } else { OnWarning::Record };
        let slows = Arc::new(AtomicBool::new(false));
        let policy: Box<dyn Policy> = match on_warning {
            OnWarning::Slow(periods) => Box::new(Slowed::new(policy, periods, Arc::clone(&slows))),
            _ => policy,
        };
        let warner = Warner::new(Arc::clone(&self.detector), self.file.calibration.threshold);
        let row = vec![f32::NAN; self.file.features.signals.width()];
        let warned = Warned {
            environment,
            task,
            file: Arc::clone(&self.file),
            on_warning,
            warner,
            row,
            observation: Observation::default(),
            measures: Measures::default(),
            state_hash: 0,
            warned_s: None,
            slows,
        };
        Ok(Worker { environment: Box::new(warned), policy })
    }
}

/// The failure mode of an episode that a warning ends. `None` if it goes on.
fn ended_by(on_warning: OnWarning) -> Option<FailureMode> {
    match on_warning {
        OnWarning::Stop => Some(WARNED_STOP),
        OnWarning::Handover => Some(HANDOVER),
        OnWarning::Record | OnWarning::Slow(_) => None,
    }
}

/// What a warner is put into.
pub(crate) struct Given<'a> {
    pub(crate) task: &'a TaskSpec,
    pub(crate) execution: Option<&'a Execution>,
    pub(crate) stress: Option<&'a Stress>,
    /// Whether the environment runs the policy itself.
    pub(crate) inside: bool,
}

impl Given<'_> {
    /// Rejects a motion that cannot be slowed down.
    fn can_slow_down(&self) -> anyhow::Result<()> {
        let hint = "Hint: use --on-warning stop or handover";
        if self.inside {
            bail!(
                "--on-warning slow: the environment runs the policy itself, so its actions cannot be slowed down\n{hint}"
            );
        }
        let delayed = self.stress.iter().flat_map(|stress| &stress.parameters).any(|name| name.contains("delayed"));
        if self.execution.is_some() || delayed {
            bail!(
                "--on-warning slow: with a latency or delays, these would be slowed down too\n{hint}, or leave them out"
            );
        }
        slow::check(&self.task.action).map_err(|why| anyhow!("--on-warning slow: {why}\n{hint}"))
    }
}

/// A hash of an observation, by which episodes that a warning ends at once differ.
fn hash_of(observation: &Observation) -> u64 {
    let numbers = observation.vectors.iter().flat_map(|(_, values)| values);
    // FNV-1a over the numbers.
    numbers.fold(0xcbf2_9ce4_8422_2325, |hash, x| (hash ^ x.to_bits()).wrapping_mul(0x0000_0100_0000_01b3))
}

/// An environment beside whose policy a detector runs.
struct Warned {
    environment: Box<dyn Environment>,
    task: Arc<TaskSpec>,
    file: Arc<WarnFile>,
    on_warning: OnWarning,
    warner: Warner<Arc<Detector>>,
    row: Vec<f32>,
    /// The last observation, measures and state.
    observation: Observation,
    measures: Measures,
    state_hash: u64,
    warned_s: Option<f64>,
    /// Whether the policy acts slowly from now on.
    slows: Arc<AtomicBool>,
}

impl Warned {
    /// The measures of an episode with what the warner adds.
    fn noted(&self, mut measures: Measures, handed_over: bool) -> Measures {
        measures.set(WARNED_S, self.warned_s);
        if self.on_warning == OnWarning::Handover {
            let assists = measures.get(ASSISTS.as_str()).unwrap_or(0.0);
            measures.set(ASSISTS, Some(assists + f64::from(u8::from(handed_over))));
        }
        measures
    }

    /// The end of an episode at a warning. The action is not executed.
    fn ended(&self, failure: FailureMode) -> Step {
        Step {
            observation: self.observation.clone(),
            measures: self.noted(self.measures.clone(), true),
            ending: Some(Ending { failure: Some(failure), time_s: self.observation.time_s, contact: None }),
            events: vec![format!("warning: {failure}")],
            state_hash: self.state_hash,
        }
    }
}

impl Environment for Warned {
    fn adapted(&self) -> Option<&dyn Environment> {
        Some(&*self.environment)
    }

    fn adapted_mut(&mut self) -> Option<&mut dyn Environment> {
        Some(&mut *self.environment)
    }

    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.slows.store(false, Ordering::Relaxed);
        let start = self.environment.reset(scenario)?;
        let known: Vec<f64> = self.file.known.iter().map(|of| of.number_in(&scenario.requested)).collect();
        self.warner.start(&known);
        self.observation = start.observation.clone();
        (self.measures, self.warned_s) = (Measures::default(), None);
        self.state_hash = hash_of(&start.observation);
        Ok(start)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.file.features.signals.write(&self.observation, action, &mut self.row);
        self.warner.observe(self.observation.time_s as f32, &self.row);
        let begins = self.warned_s.is_none() && self.warner.warned_s().is_some();
        if begins {
            self.warned_s = Some(self.observation.time_s);
            if let Some(failure) = ended_by(self.on_warning) {
                return Ok(self.ended(failure));
            }
            self.slows.store(matches!(self.on_warning, OnWarning::Slow(_)), Ordering::Relaxed);
        }
        let mut step = self.environment.step(action)?;
        self.measures.clone_from(&step.measures);
        self.observation.clone_from(&step.observation);
        self.state_hash = step.state_hash;
        step.measures = self.noted(step.measures, false);
        if begins {
            step.events.push("warning".to_owned());
        }
        Ok(step)
    }
}

#[cfg(test)]
mod tests;
