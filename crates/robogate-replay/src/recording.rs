//! Records an episode.

use robogate_core::{Command, Environment, Episode, Policy, Scenario, Tick, Trajectory, Word, rollout_with, vectors};

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
    let task = environment.task().clone();
    environment.record_trajectory(Some(FRAME_PERIOD_S));
    let mut tick_s = Vec::new();
    let mut log = Log::default();
    let mut phases: Vec<Mark> = Vec::new();
    let mut events: Vec<Mark> = Vec::new();
    let mut phase = None;
    let episode = rollout_with(environment, policy, scenario, &mut |tick| {
        observe(&tick);
        let begin_s = tick.observation.time_s;
        if tick.action.phase != phase {
            phase = tick.action.phase;
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
    });
    let trajectory = environment.take_trajectory();
    environment.record_trajectory(None);
    let mut signals = log.signals;
    signals.retain(Signal::is_known);
    signals.truncate(MAX_SIGNALS);
    if let Some(trajectory) = &trajectory {
        signals.insert(signals.len().min(2), Signal::contact_force(trajectory));
    }
    Recording { episode, trajectory, tick_s, signals, phases, events }
}

/// The name of an observed vector in a chart.
fn label(name: Word) -> &'static str {
    if name == vectors::GRIPPER_OPENING { "gripper opening" } else { name.as_str() }
}

fn unit(specs: &[robogate_core::VectorSpec], name: Word) -> &str {
    specs.iter().find(|spec| spec.name == name).map_or("", |spec| &spec.unit)
}

/// Signals at the end of each control period.
#[derive(Default)]
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
