//! A synthetic environment: the outcome of an episode is a fixed function of its parameters and its seed.

use std::collections::BTreeMap;
use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use robogate_campaign::{BatchPool, Completion, Event, Executor, Plan, RunError, ThreadPool, Worker, WorkerFactory};
use robogate_core::{
    Action, ActionSpace, ActionSpec, Command, Contact, Ending, Environment, FailureMode, FailureModeSpec, Fault,
    FaultKind, MeasureSpec, Observation, ObservationSpec, ParameterSpace, Policy, Scenario, Seed, Severity, Start,
    Step, TaskInstance, TaskSpec, Word,
};
use robogate_dictionary::{CellPlace, Engine, Place, Platform, Provenance, Robot, SCHEMA_VERSION, Tool};

pub(crate) fn space() -> ParameterSpace {
    ParameterSpace::from_toml(
        r#"
        name = "synthetic"
        [[parameter]]
        name = "friction"
        kind = "continuous"
        low = 0.05
        high = 1.2
        scale = "log"
        [[parameter]]
        name = "mass_kg"
        kind = "continuous"
        low = 0.05
        high = 2.0
        scale = "log"
        [[parameter]]
        name = "size_m"
        kind = "continuous"
        low = 0.02
        high = 0.12
        [[parameter]]
        name = "obstacles"
        kind = "integer"
        low = 0
        high = 5
        [[parameter]]
        name = "shape"
        kind = "categorical"
        choices = ["box", "cylinder", "sphere"]
        "#,
    )
    .unwrap()
}

pub(crate) fn plan(uniform: u64, boundary: u64) -> Plan {
    let text = format!(
        r#"
        seed = 7
        sampler = "uniform"
        [uniform]
        episodes = {uniform}
        [boundary]
        episodes = {boundary}
        [boundary.emphasis]
        share = 0.30
        where = [{{ parameter = "friction", high = 0.3 }}, {{ parameter = "mass_kg", low = 0.5 }}]
        [[boundary.fallback]]
        parameter = "size_m"
        low = 0.015
        high = 0.05
        [[boundary.restrict]]
        parameter = "obstacles"
        low = 1
        high = 5
        "#
    );
    Plan::from_toml(&text).unwrap()
}

pub(crate) fn provenance() -> Provenance {
    Provenance {
        tool: Tool::robogate(),
        schema_version: SCHEMA_VERSION,
        build: Some(robogate_dictionary::Build { source_sha256: "5e".repeat(32) }),
        engine: Engine { name: "synthetic".to_owned(), version: Some("1".to_owned()), build_sha256: None },
        task: task(),
        robot: Robot { name: "none".to_owned(), sha256: Some("ab".repeat(32)), dimensions: None },
        policy: "waits".to_owned(),
        world: Some(robogate_dictionary::World::new(Place::Cell(CellPlace {
            robot: "none".to_owned(),
            engine: "test".to_owned(),
            time_step_s: 0.002,
            renderer: None,
            physics_servers: false,
        }))),
        space: space(),
        plan: serde_json::Value::Null,
        seed: 0,
        question_sha256: None,
        platform: Some(Platform::here()),
        source: None,
    }
}

const DISTANCE: Word = Word::constant("target_distance_m");

/// The task of the synthetic environment. Its failure mode for a lost part is undeclared on purpose.
pub(crate) fn task() -> Arc<TaskSpec> {
    let mode = |name| FailureModeSpec {
        name: FailureMode::constant(name),
        meaning: String::new(),
        severity: Severity::Major,
        published_as: None,
    };
    Arc::new(TaskSpec {
        name: Word::constant("synthetic"),
        version: 1,
        instruction: "wait".to_owned(),
        control_period_s: PERIOD,
        time_limit_s: 0.5,
        failure_modes: vec![mode("grasp_miss"), mode("collision")],
        measures: vec![MeasureSpec {
            name: DISTANCE,
            unit: "m".to_owned(),
            meaning: String::new(),
            better: robogate_core::Better::Lower,
        }],
        draws: Vec::new(),
        phases: Vec::new(),
        stages: Vec::new(),
        parameters: Vec::new(),
        settings: Vec::new(),
        observation: ObservationSpec::default(),
        action: ActionSpec {
            spaces: vec![ActionSpace::Vector { names: vec!["nothing".to_owned()], low: vec![-1.0], high: vec![1.0] }],
            gripper: None,
        },
        details: serde_json::Value::Null,
    })
}

/// The injected problem of an episode, by index.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Trouble {
    None,
    Panic,
    Invalid,
}

pub(crate) type Troubles = fn(u64) -> Trouble;

/// A factory of synthetic workers.
pub(crate) struct Synthetic {
    pub(crate) trouble: Troubles,
    /// Wall-clock duration of a control period.
    pub(crate) tick: Duration,
    pub(crate) workers: AtomicU64,
    /// The number of workers that can be created.
    pub(crate) most_workers: u64,
}

impl Default for Synthetic {
    fn default() -> Self {
        Self { trouble: |_| Trouble::None, tick: Duration::ZERO, workers: AtomicU64::new(0), most_workers: u64::MAX }
    }
}

impl WorkerFactory for Synthetic {
    fn worker(&self) -> Result<Worker, Fault> {
        if self.workers.fetch_add(1, Ordering::Relaxed) >= self.most_workers {
            return Err(Fault::new(FaultKind::Unavailable, "no more workers"));
        }
        let world = World { task: task(), trouble: self.trouble, tick: self.tick, scenario: None, ticks: 0 };
        Ok(Worker { environment: Box::new(world), policy: Box::new(Waits) })
    }
}

struct World {
    task: Arc<TaskSpec>,
    trouble: Troubles,
    tick: Duration,
    scenario: Option<Scenario>,
    ticks: u32,
}

const PERIOD: f64 = 0.05;

impl World {
    fn observation(&self) -> Observation {
        let time_s = f64::from(self.ticks) * PERIOD;
        Observation { time_s, vectors: Vec::new(), images: Vec::new() }
    }
}

/// The outcome: friction that holds the mass gives success, small objects are missed, obstacles are touched.
fn ending(scenario: &Scenario) -> Option<Option<FailureMode>> {
    let of = |name: &str| scenario.requested.number(name).unwrap();
    let mut chance = scenario.seed.stream("outcome");
    if chance.uniform() < 0.02 * of("obstacles") {
        return Some(Some(FailureMode::constant("collision")));
    }
    if chance.uniform() < 0.02 / of("size_m") * 0.2 {
        return Some(Some(FailureMode::constant("grasp_miss")));
    }
    let grip = (of("friction") / of("mass_kg")).ln();
    if chance.uniform() < 1.0 / (1.0 + (2.0 * (grip + 0.5)).exp()) {
        return Some(Some(FailureMode::constant("grip_loss")));
    }
    // One of fifty episodes runs until the time limit.
    (chance.uniform() > 0.02).then_some(None)
}

impl Environment for World {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.scenario = Some(scenario.clone());
        self.ticks = 0;
        if let Trouble::Invalid = (self.trouble)(scenario.index) {
            return Err(Fault::new(FaultKind::Setup, format!("episode {} cannot be set up", scenario.index)));
        }
        Ok(Start {
            instance: TaskInstance::default(),
            observation: self.observation(),
            applied: scenario.requested.clone(),
        })
    }

    fn step(&mut self, _: &Action) -> Result<Step, Fault> {
        if !self.tick.is_zero() {
            std::thread::sleep(self.tick);
        }
        let scenario = self.scenario.as_ref().unwrap();
        self.ticks += 1;
        if let (Trouble::Panic, 2) = ((self.trouble)(scenario.index), self.ticks) {
            panic!("simulator crash in episode {}", scenario.index);
        }
        let mut state = scenario.seed.stream("state");
        let due = 2 + (state.bits() % 5) as u32;
        let ending = ending(scenario).filter(|_| self.ticks == due).map(|failure| Ending {
            failure,
            time_s: f64::from(self.ticks) * PERIOD - 0.01,
            contact: failure.map(|_| Contact {
                robot_body: "hand".to_owned(),
                other_body: "table".to_owned(),
                force_n: state.between(0.0, 30.0),
            }),
        });
        let measures = [(DISTANCE, Some(state.uniform()))].into_iter().collect();
        let state_hash = state.bits().wrapping_add(u64::from(self.ticks));
        Ok(Step { observation: self.observation(), measures, ending, events: Vec::new(), state_hash })
    }
}

struct Waits;

impl Policy for Waits {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        Ok(())
    }

    fn act(&mut self, _: &Observation) -> Result<Action, Fault> {
        Ok(Action { command: Command::Vector(vec![0.0]), gripper: None, phase: Some(Word::constant("wait")) })
    }
}

/// Runs with `threads` threads. `watch` sees the events and may set the stop flag.
pub(crate) fn with_pool<T>(
    factory: &dyn WorkerFactory,
    threads: usize,
    watch: &mut dyn FnMut(&Event, &AtomicBool),
    go: impl FnOnce(&dyn Executor, &mut dyn FnMut(&Event)) -> T,
) -> T {
    let stop = AtomicBool::new(false);
    let pool = ThreadPool { factory, threads: NonZeroUsize::new(threads).unwrap(), stop: &stop };
    go(&pool, &mut |event| watch(event, &stop))
}

/// Runs with `threads` threads, each with `slots` episodes in progress.
pub(crate) fn with_batches<T>(
    factory: &dyn WorkerFactory,
    [threads, slots]: [usize; 2],
    watch: &mut dyn FnMut(&Event, &AtomicBool),
    go: impl FnOnce(&dyn Executor, &mut dyn FnMut(&Event)) -> T,
) -> T {
    let stop = AtomicBool::new(false);
    let [threads, slots] = [threads, slots].map(|n| NonZeroUsize::new(n).unwrap());
    let pool = BatchPool { factory, threads, slots, stop: &stop };
    go(&pool, &mut |event| watch(event, &stop))
}

pub(crate) fn start(
    dir: &Path,
    plan: &Plan,
    factory: &dyn WorkerFactory,
    threads: usize,
) -> Result<Completion, RunError> {
    with_pool(factory, threads, &mut |_, _| {}, |pool, events| {
        robogate_campaign::start(dir, plan, provenance(), pool, events)
    })
}

pub(crate) fn resume(dir: &Path, factory: &dyn WorkerFactory, threads: usize) -> Result<Completion, RunError> {
    with_pool(factory, threads, &mut |_, _| {}, |pool, events| {
        robogate_campaign::resume(dir, &provenance(), pool, events)
    })
}

/// Stops after `episodes` episodes of this process.
pub(crate) fn stop_after(episodes: u64) -> impl FnMut(&Event, &AtomicBool) {
    let mut seen = 0;
    move |event, stop| {
        seen += u64::from(matches!(event, Event::Episode { .. }));
        if seen >= episodes {
            stop.store(true, Ordering::Relaxed);
        }
    }
}

pub(crate) fn summary(completion: &Completion) -> &robogate_campaign::Summary {
    match completion {
        Completion::Finished { summary, .. } => summary,
        Completion::Interrupted { .. } => panic!("{completion:?}"),
    }
}

/// Every file of a folder with its bytes.
pub(crate) fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    fs::read_dir(dir)
        .unwrap()
        .map(|entry| {
            let entry = entry.unwrap();
            (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap())
        })
        .collect()
}
