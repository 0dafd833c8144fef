//! The time that stress in transit adds to an image of 256 x 256 pixels, beside the time to copy one.
#![expect(clippy::unwrap_used, clippy::print_stdout, clippy::disallowed_methods, reason = "a benchmark prints times")]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use robogate_core::stress::{STRESS, Stress, StressGroup, with_stress};
use robogate_core::{
    Action, ActionSpace, ActionSpec, Assignment, CameraSpec, Command, Environment, Fault, Image, Measures, Observation,
    ObservationSpec, Policy, Scenario, Seed, Start, Step, TaskInstance, TaskSpec, Value, Word, rollout,
};

const SIDE: usize = 256;
const TICKS: u32 = 200;

struct World(Arc<TaskSpec>, Image);

impl Environment for World {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.0
    }

    fn draws(&self, _: &Scenario) -> Result<Measures, Fault> {
        Ok(Measures::default())
    }

    fn reset(&mut self, _: &Scenario) -> Result<Start, Fault> {
        let (observation, applied) = (Observation::default(), Assignment::default());
        Ok(Start { observation, applied, instance: TaskInstance::default() })
    }

    fn step(&mut self, _: &Action) -> Result<Step, Fault> {
        let (observation, measures) = (Observation::default(), Measures::default());
        Ok(Step { observation, measures, ending: None, events: Vec::new(), state_hash: 0 })
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        Ok(vec![self.1.clone()])
    }
}

struct Seeing;

impl Policy for Seeing {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        Ok(())
    }

    fn wants_images(&self) -> bool {
        true
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        black_box(&observation.images);
        Ok(Action { command: Command::Vector(vec![0.0]), gripper: None, phase: None })
    }
}

fn task() -> TaskSpec {
    let camera = CameraSpec { name: "front".to_owned(), width: SIDE, height: SIDE };
    let vector = ActionSpace::Vector { names: vec!["x".to_owned()], low: vec![-1.0], high: vec![1.0] };
    TaskSpec {
        name: Word::constant("bench"),
        version: 1,
        instruction: String::new(),
        control_period_s: 0.05,
        time_limit_s: 0.05 * f64::from(TICKS),
        failure_modes: Vec::new(),
        draws: Vec::new(),
        measures: Vec::new(),
        phases: Vec::new(),
        stages: Vec::new(),
        parameters: Vec::new(),
        settings: Vec::new(),
        observation: ObservationSpec { cameras: vec![camera], ..ObservationSpec::default() },
        action: ActionSpec { spaces: vec![vector], gripper: None },
        details: serde_json::Value::Null,
    }
}

/// Milliseconds for each control period with these values.
fn time_ms(requested: Assignment) -> f64 {
    let rgb = (0..3 * SIDE * SIDE).map(|i| (i * 31 % 251) as u8).collect();
    let image = Image { camera: "front".to_owned(), width: SIDE, height: SIDE, rgb };
    let stress = Stress { parameters: STRESS.iter().map(|row| row.name.to_owned()).collect(), wordings: Vec::new() };
    let (mut world, mut policy) = with_stress(Box::new(World(Arc::new(task()), image)), Box::new(Seeing), &stress);
    let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested };
    let runs = (0..3).map(|_| {
        let began = Instant::now();
        let episode = rollout(&mut *world, &mut *policy, &scenario);
        assert_eq!(episode.ticks, TICKS, "{episode:?}");
        1e3 * began.elapsed().as_secs_f64() / f64::from(TICKS)
    });
    runs.fold(f64::INFINITY, f64::min)
}

fn main() {
    let plain = time_ms(Assignment::default());
    println!("an image and its copy: {plain:.3} ms");
    for row in STRESS.iter().filter(|row| row.group == StressGroup::Images) {
        let spec =
            Stress { parameters: vec![row.name.to_owned()], wordings: Vec::new() }.declared_in(&Arc::new(task()));
        let nominal = spec.parameter(row.name).unwrap().nominal.clone().unwrap();
        let strong = match nominal {
            Value::Integer(_) => Value::Integer(1),
            _ => Value::Number(if row.name.ends_with("jpeg_loss") { 50.0 } else { 0.3 }),
        };
        let added = time_ms([(row.name.into(), strong)].into_iter().collect()) - plain;
        println!("{}: {added:.3} ms more, {:.1} times the copy", row.name, added / plain);
    }
}
