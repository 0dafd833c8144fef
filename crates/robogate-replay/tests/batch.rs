//! Tests that recordings of a batch are those of single episodes.

use std::sync::Arc;

use robogate_core::{
    Action, ActionSpace, ActionSpec, Assignment, Command, Ending, Environment, Fault, Frame, Measures, Observation,
    ObservationSpec, Policy, Scenario, Seed, SingleEnvironments, SinglePolicies, Start, Step, TaskInstance, TaskSpec,
    Trajectory, VectorSpec, Word,
};
use robogate_replay::{Recording, record, record_all};

const POSITION: Word = Word::constant("position");

/// A world whose episodes have between 1 and 5 steps.
struct World {
    task: Arc<TaskSpec>,
    steps: u64,
    end: u64,
    frames: Option<Vec<Frame>>,
}

impl World {
    fn boxed() -> Box<dyn Environment> {
        let space = ActionSpace::Vector { names: vec!["speed".to_owned()], low: vec![-1.0], high: vec![1.0] };
        let task = TaskSpec {
            name: Word::constant("world"),
            version: 1,
            instruction: String::new(),
            control_period_s: 0.1,
            time_limit_s: 1.0,
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
            action: ActionSpec { spaces: vec![space], gripper: None },
            details: serde_json::Value::Null,
        };
        Box::new(Self { task: Arc::new(task), steps: 0, end: 0, frames: None })
    }

    fn observation(&mut self) -> Observation {
        let time_s = 0.1 * self.steps as f64;
        if let Some(frames) = &mut self.frames {
            frames.push(Frame { time_s, poses: Vec::new(), contacts: Vec::new() });
        }
        Observation { time_s, vectors: vec![(POSITION, vec![time_s * self.end as f64])], images: Vec::new() }
    }
}

impl Environment for World {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.steps = 0;
        self.end = 1 + scenario.index % 5;
        self.frames.iter_mut().for_each(Vec::clear);
        let (instance, applied) = (TaskInstance::default(), Assignment::default());
        Ok(Start { instance, observation: self.observation(), applied })
    }

    fn step(&mut self, _: &Action) -> Result<Step, Fault> {
        self.steps += 1;
        let observation = self.observation();
        let ending = (self.steps == self.end).then_some(Ending { failure: None, time_s: 0.1, contact: None });
        let events = vec![format!("step {} of {}", self.steps, self.end)];
        Ok(Step { observation, measures: Measures::default(), ending, events, state_hash: self.steps })
    }

    fn record_trajectory(&mut self, period_s: Option<f64>) {
        self.frames = period_s.map(|_| Vec::new());
    }

    fn take_trajectory(&mut self) -> Option<Trajectory> {
        self.frames.as_mut().map(|frames| Trajectory { frames: std::mem::take(frames), ..Trajectory::default() })
    }
}

/// A policy with a memory: the number of its action.
#[derive(Default)]
struct Counting(f64);

impl Policy for Counting {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        self.0 = 0.0;
        Ok(())
    }

    fn act(&mut self, _: &Observation) -> Result<Action, Fault> {
        self.0 += 0.1;
        Ok(Action { command: Command::Vector(vec![self.0]), gripper: None, phase: Some(Word::constant("go")) })
    }
}

#[test]
fn recordings_of_a_batch_equal_single_ones() {
    let scenario = |index| Scenario { index, seed: Seed::campaign(1).episode(index), requested: Assignment::default() };
    let scenarios: Vec<Scenario> = (0..23).map(scenario).collect();
    let single: Vec<Recording> =
        scenarios.iter().map(|scenario| record(&mut *World::boxed(), &mut Counting::default(), scenario)).collect();
    let mut worlds = SingleEnvironments::new((0..4).map(|_| World::boxed()).collect()).unwrap();
    let policies = (0..4).map(|_| Box::new(Counting::default()) as Box<dyn Policy>).collect();
    let batch = record_all(&mut worlds, &mut SinglePolicies::new(policies), &scenarios);
    assert_eq!(format!("{batch:?}"), format!("{single:?}"));
    assert_eq!(batch[7].trajectory.as_ref().unwrap().frames.len(), 4);
    assert!(batch[7].signals.iter().any(|signal| signal.name == "contact force"));
}
