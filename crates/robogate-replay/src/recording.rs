//! Records an episode.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::Arc;

use robogate_core::{
    BatchEnvironment, BatchPolicy, Command, Environment, Episode, Policy, Scenario, TaskSpec, Tick, Trajectory, Word,
    Workload, rollout_many, rollout_with, vectors,
};

use crate::signals::{Clock, Signal};

/// Time between two frames of a trajectory, in seconds.
pub const FRAME_PERIOD_S: f64 = 1.0 / 30.0;

/// The largest number of signals of an episode.
const MAX_SIGNALS: usize = 12;

/// A recorded episode.
#[derive(Debug, Clone)]
pub struct Recording {
    /// The record of the episode.
    pub episode: Episode,
    /// The motion of all bodies. `None` if the environment has no geometry.
    pub trajectory: Option<Trajectory>,
    /// Simulated time at the end of each control period, in seconds.
    pub tick_s: Vec<f64>,
    /// Signals over time.
    pub signals: Vec<Signal>,
    /// The phases of the policy, each with its start.
    pub phases: Vec<Mark>,
    /// The events of the episode.
    pub events: Vec<Mark>,
}

/// A named point in time.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// Simulated time in seconds.
    pub time_s: f64,
    /// The name of the phase, or the description of the event.
    pub what: String,
}

/// Runs one episode and records it.
pub fn record(environment: &mut dyn Environment, policy: &mut dyn Policy, scenario: &Scenario) -> Recording {
    record_with(environment, policy, scenario, &mut |_| {})
}

/// Runs one episode and records it, with an observer that is called after every control period.
pub fn record_with(
    environment: &mut dyn Environment,
    policy: &mut dyn Policy,
    scenario: &Scenario,
    observe: &mut dyn FnMut(&Tick<'_>),
) -> Recording {
    let mut recorder = Recorder::new(Arc::clone(environment.task()));
    environment.record_trajectory(Some(FRAME_PERIOD_S));
    let episode = rollout_with(environment, policy, scenario, &mut |tick| {
        observe(&tick);
        recorder.observe(&tick);
    });
    let trajectory = environment.take_trajectory();
    environment.record_trajectory(None);
    recorder.finish(episode, trajectory)
}

/// Runs these episodes in a batch and records them. The recordings are those of [`record`], in the order of the scenarios.
pub fn record_all(
    environment: &mut dyn BatchEnvironment,
    policy: &mut dyn BatchPolicy,
    scenarios: &[Scenario],
) -> Vec<Recording> {
    environment.record_trajectory(Some(FRAME_PERIOD_S));
    let task = Arc::clone(environment.task());
    let mut recordings = Recordings { task, scenarios, next: 0, slots: BTreeMap::new(), finished: BTreeMap::new() };
    rollout_many(environment, policy, &mut recordings);
    environment.record_trajectory(None);
    recordings.finished.into_values().collect()
}

/// The recordings of a batch.
struct Recordings<'a> {
    task: Arc<TaskSpec>,
    scenarios: &'a [Scenario],
    next: usize,
    /// The recorder of the episode in each slot, with the place of its scenario.
    slots: BTreeMap<usize, (usize, Recorder)>,
    /// Finished recordings by the place of their scenario.
    finished: BTreeMap<usize, Recording>,
}

impl Workload for Recordings<'_> {
    fn next(&mut self, slot: usize) -> Option<Scenario> {
        let scenario = self.scenarios.get(self.next)?.clone();
        self.slots.insert(slot, (self.next, Recorder::new(Arc::clone(&self.task))));
        self.next += 1;
        Some(scenario)
    }

    fn observe(&mut self, slot: usize, tick: Tick<'_>) {
        if let Some((_, recorder)) = self.slots.get_mut(&slot) {
            recorder.observe(&tick);
        }
    }

    fn finished(&mut self, slot: usize, episode: Episode, environment: &mut dyn BatchEnvironment) -> ControlFlow<()> {
        if let Some((at, recorder)) = self.slots.remove(&slot) {
            self.finished.insert(at, recorder.finish(episode, environment.take_trajectory(slot)));
        }
        ControlFlow::Continue(())
    }
}

/// Records an episode while it runs: the observer of any rollout.
#[derive(Debug)]
pub struct Recorder {
    task: Arc<TaskSpec>,
    tick_s: Vec<f64>,
    log: Log,
    phase: Option<Word>,
    phases: Vec<Mark>,
    events: Vec<Mark>,
}

impl Recorder {
    /// Begins the recording of an episode of this task.
    #[must_use]
    pub fn new(task: Arc<TaskSpec>) -> Self {
        let (tick_s, log, phases, events) = (Vec::new(), Log::default(), Vec::new(), Vec::new());
        Self { task, tick_s, log, phase: None, phases, events }
    }

    /// Adds a control period.
    pub fn observe(&mut self, tick: &Tick<'_>) {
        let Self { task, tick_s, log, phase, phases, events } = self;
        let begin_s = tick.observation.time_s;
        if tick.action.phase != *phase {
            *phase = tick.action.phase;
            phases.extend(phase.map(|phase| Mark { time_s: begin_s, what: phase.as_str().to_owned() }));
        }
        let time_s = tick.step.observation.time_s;
        events.extend(tick.step.events.iter().map(|what| Mark { time_s, what: what.clone() }));
        tick_s.push(time_s);
        if let Some(command) = tick.action.gripper {
            log.note("gripper command", "", Some(command));
        }
        if let Command::Vector(values) = &tick.action.command {
            let names = task.action.spaces.iter().find_map(|space| match space {
                robogate_core::ActionSpace::Vector { names, .. } => Some(names),
                _ => None,
            });
            for (i, value) in values.iter().enumerate() {
                let name = names.and_then(|names| names.get(i)).map_or("command", String::as_str);
                log.note(name, "", Some(*value));
            }
        }
        for (name, values) in &tick.step.observation.vectors {
            if let [value] = values.as_slice() {
                log.note(label(*name), unit(&task.observation.vectors, *name), Some(*value));
            }
        }
        for measure in &task.measures {
            log.note(measure.name.as_str(), &measure.unit, tick.step.measures.get(measure.name.as_str()));
        }
        log.end_tick(tick_s.len());
    }

    /// Ends the recording with the record of the episode and the motion of all bodies.
    #[must_use]
    pub fn finish(self, episode: Episode, trajectory: Option<Trajectory>) -> Recording {
        let Self { tick_s, log, phases, events, .. } = self;
        let mut signals = log.signals;
        signals.retain(Signal::is_known);
        signals.truncate(MAX_SIGNALS);
        if let Some(trajectory) = &trajectory {
            signals.insert(signals.len().min(2), Signal::contact_force(trajectory));
        }
        Recording { episode, trajectory, tick_s, signals, phases, events }
    }
}

/// The name of an observed vector in a chart.
fn label(name: Word) -> &'static str {
    if name == vectors::GRIPPER_OPENING { "gripper opening" } else { name.as_str() }
}

fn unit(specs: &[robogate_core::VectorSpec], name: Word) -> &str {
    specs.iter().find(|spec| spec.name == name).map_or("", |spec| &spec.unit)
}

/// Signals at the end of each control period.
#[derive(Debug, Default)]
struct Log {
    signals: Vec<Signal>,
    ticks: usize,
}

impl Log {
    fn note(&mut self, name: &str, unit: &str, value: Option<f64>) {
        let at = self.signals.iter().position(|signal| signal.name == name).unwrap_or_else(|| {
            let values = vec![None; self.ticks];
            self.signals.push(Signal { name: name.to_owned(), unit: unit.to_owned(), clock: Clock::Ticks, values });
            self.signals.len() - 1
        });
        let signal = &mut self.signals[at];
        if signal.values.len() == self.ticks {
            signal.values.push(value.filter(|value| value.is_finite()));
        }
    }

    /// Ends a control period: a signal without a value in it gets none.
    fn end_tick(&mut self, ticks: usize) {
        self.ticks = ticks;
        self.signals.iter_mut().for_each(|signal| signal.values.resize(ticks, None));
    }
}
