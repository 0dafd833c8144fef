//! A synthetic world: how an episode goes is a fixed function of its parameters and its seed.

use std::collections::BTreeMap;
use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use robogate_campaign::{Completion, Crew, Event, Plan, RunError, Station, Workshop};
use robogate_core::{
    Action, ArmCommand, Contact, Ending, FailureMode, Fault, FaultKind, GripperCommand, Measures, Observation,
    ParameterSpace, Phase, Policy, Pose, Scenario, Seed, Simulator, Start, Step, TaskSpec,
};
use robogate_dictionary::{Engine, Platform, Provenance, Robot, SCHEMA_VERSION, Tool};

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
        engine: Engine { name: "synthetic".to_owned(), version: Some("1".to_owned()), build_sha256: None },
        robot: Robot { name: "none".to_owned(), sha256: Some("ab".repeat(32)), dimensions: None },
        policy: "waits".to_owned(),
        world: serde_json::json!({ "time_step_s": 0.002 }),
        space: space(),
        plan: serde_json::Value::Null,
        seed: 0,
        platform: Some(Platform::here()),
        source: None,
    }
}

/// What goes wrong in an episode, by its index.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Trouble {
    None,
    Panic,
    Invalid,
}

pub(crate) type Troubles = fn(u64) -> Trouble;

/// Makes synthetic stations.
pub(crate) struct Synthetic {
    pub(crate) trouble: Troubles,
    /// How long a control tick takes in the real world.
    pub(crate) tick: Duration,
    pub(crate) stations: AtomicU64,
    /// How many stations can be made.
    pub(crate) most_stations: u64,
}

impl Default for Synthetic {
    fn default() -> Self {
        Self { trouble: |_| Trouble::None, tick: Duration::ZERO, stations: AtomicU64::new(0), most_stations: u64::MAX }
    }
}

impl Workshop for Synthetic {
    fn station(&self) -> Result<Station, Fault> {
        if self.stations.fetch_add(1, Ordering::Relaxed) >= self.most_stations {
            return Err(Fault::new(FaultKind::Unavailable, "no more stations"));
        }
        let world = World { trouble: self.trouble, tick: self.tick, scenario: None, ticks: 0 };
        Ok(Station { simulator: Box::new(world), policy: Box::new(Waits) })
    }
}

struct World {
    trouble: Troubles,
    tick: Duration,
    scenario: Option<Scenario>,
    ticks: u32,
}

const PERIOD: f64 = 0.05;

impl World {
    fn observation(&self) -> Observation {
        let time_s = f64::from(self.ticks) * PERIOD;
        Observation {
            time_s,
            joint_positions: vec![0.0],
            joint_velocities: vec![0.0],
            gripper_opening_m: None,
            tool_pose: robogate_core::Pose::IDENTITY,
            images: Vec::new(),
        }
    }
}

/// Success is likely where friction holds the mass; small things are missed; obstacles are touched.
fn ending(scenario: &Scenario) -> Option<Option<FailureMode>> {
    let of = |name: &str| scenario.requested.number(name).unwrap();
    let mut chance = scenario.seed.stream("outcome");
    if chance.uniform() < 0.02 * of("obstacles") {
        return Some(Some(FailureMode::Collision));
    }
    if chance.uniform() < 0.02 / of("size_m") * 0.2 {
        return Some(Some(FailureMode::GraspMiss));
    }
    let grip = (of("friction") / of("mass_kg")).ln();
    if chance.uniform() < 1.0 / (1.0 + (2.0 * (grip + 0.5)).exp()) {
        return Some(Some(FailureMode::GripLoss));
    }
    // One in fifty goes on until the time limit.
    (chance.uniform() > 0.02).then_some(None)
}

impl Simulator for World {
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.scenario = Some(scenario.clone());
        self.ticks = 0;
        if let Trouble::Invalid = (self.trouble)(scenario.index) {
            return Err(Fault::new(FaultKind::Setup, format!("episode {} cannot be set up", scenario.index)));
        }
        let pose = Pose::upright([0.5, 0.0, 0.0], 0.0);
        let task = TaskSpec {
            instruction: "wait".to_owned(),
            control_period_s: PERIOD,
            time_limit_s: 0.5,
            shape: "box".to_owned(),
            object_extent_m: [0.05; 3],
            object_pose: pose,
            target_pose: pose,
            tolerance_m: 0.03,
            approach_speed_m_s: None,
        };
        Ok(Start { task, observation: self.observation(), applied: scenario.requested.clone() })
    }

    fn step(&mut self, _: &Action) -> Result<Step, Fault> {
        if !self.tick.is_zero() {
            std::thread::sleep(self.tick);
        }
        let scenario = self.scenario.as_ref().unwrap();
        self.ticks += 1;
        if let (Trouble::Panic, 2) = ((self.trouble)(scenario.index), self.ticks) {
            panic!("the world of episode {} ends", scenario.index);
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
        let measures = Measures { target_distance_m: Some(state.uniform()), ..Measures::default() };
        let state_hash = state.bits().wrapping_add(u64::from(self.ticks));
        Ok(Step { observation: self.observation(), measures, ending, events: Vec::new(), state_hash })
    }
}

struct Waits;

impl Policy for Waits {
    fn reset(&mut self, _: &TaskSpec, _: Seed) -> Result<(), Fault> {
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        Ok(Action {
            arm: ArmCommand::JointPositions(observation.joint_positions.clone()),
            gripper: GripperCommand::Open,
            phase: Some(Phase::Grasp),
        })
    }
}

/// Runs with so many threads; `watch` sees the events and may set the flag.
pub(crate) fn with_crew<T>(
    workshop: &dyn Workshop,
    threads: usize,
    watch: &mut dyn FnMut(&Event, &AtomicBool),
    go: impl FnOnce(&Crew<'_>, &mut dyn FnMut(&Event)) -> T,
) -> T {
    let stop = AtomicBool::new(false);
    let crew = Crew { workshop, threads: NonZeroUsize::new(threads).unwrap(), stop: &stop };
    go(&crew, &mut |event| watch(event, &stop))
}

pub(crate) fn start(dir: &Path, plan: &Plan, workshop: &dyn Workshop, threads: usize) -> Result<Completion, RunError> {
    with_crew(workshop, threads, &mut |_, _| {}, |crew, events| {
        robogate_campaign::start(dir, plan, provenance(), crew, events)
    })
}

pub(crate) fn resume(dir: &Path, workshop: &dyn Workshop, threads: usize) -> Result<Completion, RunError> {
    with_crew(workshop, threads, &mut |_, _| {}, |crew, events| {
        robogate_campaign::resume(dir, &provenance(), crew, events)
    })
}

/// Stops after so many episodes of this process.
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

/// Every file of a folder and its bytes.
pub(crate) fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    fs::read_dir(dir)
        .unwrap()
        .map(|entry| {
            let entry = entry.unwrap();
            (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap())
        })
        .collect()
}
