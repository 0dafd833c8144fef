//! An environment whose state is one number, and a policy for it.
#![allow(dead_code, reason = "each test binary uses only some items")]

use std::sync::Arc;

use robogate_core::{
    Action, ActionSpace, ActionSpec, Assignment, Command, Contact, Ending, Environment, FailureMode, Fault, FaultKind,
    Observation, ObservationSpec, Policy, Scenario, Seed, Start, Step, TaskInstance, TaskSpec, Value, VectorSpec, Word,
};

pub(crate) const POSITION: Word = Word::constant("position");
pub(crate) const COLLISION: FailureMode = FailureMode::constant("collision");

/// A task on a line: reach its end.
pub(crate) fn task(period_s: f64, limit_s: f64) -> Arc<TaskSpec> {
    Arc::new(TaskSpec {
        name: Word::constant("line"),
        version: 1,
        instruction: "go".to_owned(),
        control_period_s: period_s,
        time_limit_s: limit_s,
        failure_modes: Vec::new(),
        measures: Vec::new(),
        draws: Vec::new(),
        phases: Vec::new(),
        stages: Vec::new(),
        parameters: Vec::new(),
        settings: Vec::new(),
        observation: ObservationSpec {
            vectors: vec![VectorSpec { name: POSITION, length: 1, unit: "m".to_owned() }],
            cameras: Vec::new(),
        },
        action: ActionSpec {
            spaces: vec![ActionSpace::Vector { names: vec!["position".to_owned()], low: vec![-1e4], high: vec![1e4] }],
            gripper: None,
        },
        details: serde_json::Value::Null,
    })
}

/// An environment whose state is one number that the policy sets.
pub(crate) struct Line {
    pub(crate) task: Arc<TaskSpec>,
    /// Endings by step number, from 1.
    pub(crate) endings: Vec<(u32, Option<FailureMode>)>,
    pub(crate) breaks_at: Option<u32>,
    /// The step after which the ending at the time limit is certain.
    pub(crate) certain_at: Option<u32>,
    pub(crate) refuses: bool,
    /// Alters the requested parameters before they are read back.
    pub(crate) alter: fn(&mut Assignment),
    pub(crate) position: f64,
    pub(crate) steps: u32,
}

impl Default for Line {
    fn default() -> Self {
        Self {
            endings: Vec::new(),
            breaks_at: None,
            certain_at: None,
            refuses: false,
            alter: |_| {},
            task: task(0.1, 1.0),
            position: 0.0,
            steps: 0,
        }
    }
}

impl Line {
    fn observation(&self) -> Observation {
        Observation {
            time_s: f64::from(self.steps) * self.task.control_period_s,
            vectors: vec![(POSITION, vec![self.position])],
            images: Vec::new(),
        }
    }
}

impl Environment for Line {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        if self.refuses {
            return Err(Fault::new(FaultKind::Setup, "object starts in contact"));
        }
        self.steps = 0;
        self.position = scenario.requested.number("start").unwrap_or(0.0);
        let mut applied = scenario.requested.clone();
        (self.alter)(&mut applied);
        let instance = TaskInstance::default();
        Ok(Start { instance, observation: self.observation(), applied })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.steps += 1;
        if self.breaks_at == Some(self.steps) {
            return Err(Fault::new(FaultKind::Diverged, "position is NaN"));
        }
        let Command::Vector(target) = &action.command else {
            return Err(Fault::new(FaultKind::BadAction, "expected one position"));
        };
        self.position = target[0];
        let ending = self.endings.iter().find(|(at, _)| *at == self.steps).map(|(_, failure)| Ending {
            failure: *failure,
            // Within the period, as a real simulator would report it.
            time_s: (f64::from(self.steps) - 0.5) * self.task.control_period_s,
            contact: failure.is_some().then(|| Contact {
                robot_body: "hand".to_owned(),
                other_body: "table".to_owned(),
                force_n: 12.0,
            }),
        });
        Ok(Step {
            observation: self.observation(),
            measures: [(POSITION, Some(self.position))].into_iter().collect(),
            ending,
            events: Vec::new(),
            state_hash: self.position.to_bits(),
        })
    }

    fn foregone_ending(&self) -> Option<Ending> {
        let certain = self.certain_at.is_some_and(|at| self.steps >= at);
        certain.then(|| Ending { failure: Some(COLLISION), time_s: self.task.time_limit_s, contact: None })
    }
}

/// A policy that moves by random steps.
#[derive(Default)]
pub(crate) struct Walker {
    pub(crate) stream: Option<robogate_core::Stream>,
    pub(crate) acts: u32,
    pub(crate) faults_at: Option<u32>,
    pub(crate) faults_on_reset: bool,
}

impl Policy for Walker {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        task.action.vector().map(drop).ok_or_else(|| "no vector".to_owned())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        if self.faults_on_reset {
            return Err(Fault::new(FaultKind::Unavailable, "no answer within 5 s"));
        }
        self.stream = Some(seed.stream("walk"));
        self.acts = 0;
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        self.acts += 1;
        if self.faults_at == Some(self.acts) {
            return Err(Fault::new(FaultKind::BadAction, "expected 7 joints, got 6"));
        }
        let stride = self.stream.as_mut().map_or(0.0, robogate_core::Stream::uniform);
        Ok(Action {
            command: Command::Vector(vec![observation.vector("position").unwrap_or_default()[0] + stride]),
            gripper: None,
            phase: Some(if self.acts < 3 { Word::constant("start") } else { Word::constant("stride") }),
        })
    }
}

pub(crate) fn scenario(index: u64) -> Scenario {
    let requested = [("start".into(), Value::Number(0.25)), ("shape".into(), Value::Category("box".into()))];
    Scenario { index, seed: Seed::campaign(1).episode(index), requested: requested.into_iter().collect() }
}
