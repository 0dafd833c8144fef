use std::sync::Mutex;

use robogate_core::{
    ActionSpace, ActionSpec, Assignment, Command, Episode, ObservationSpec, Outcome, Seed, TaskInstance, VectorSpec,
    rollout,
};
use robogate_monitor::warn::{Features, Model, Moments};

use super::*;

const POSITION: Word = Word::constant("position");

fn task() -> TaskSpec {
    let names = vec!["x".to_owned()];
    let vector = ActionSpace::Vector { names, low: vec![-1.0], high: vec![1.0] };
    TaskSpec {
        name: Word::constant("push"),
        version: 1,
        instruction: String::new(),
        control_period_s: 0.1,
        time_limit_s: 2.0,
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
        action: ActionSpec { spaces: vec![vector], gripper: None },
        details: serde_json::Value::Null,
    }
}

/// Moves by the command, and succeeds at 1 m. Notes its commands.
struct Line(Arc<TaskSpec>, f64, u32, Arc<Mutex<Vec<f64>>>);

impl Line {
    fn observation(&self) -> Observation {
        let time_s = 0.1 * f64::from(self.2);
        Observation { time_s, vectors: vec![(POSITION, vec![self.1])], images: Vec::new() }
    }
}

impl Environment for Line {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.0
    }

    fn draws(&self, _: &Scenario) -> Result<Measures, Fault> {
        Ok(Measures::default())
    }

    fn reset(&mut self, _: &Scenario) -> Result<Start, Fault> {
        (self.1, self.2) = (0.0, 0);
        self.3.lock().unwrap().clear();
        let (instance, applied) = (TaskInstance::default(), Assignment::default());
        Ok(Start { instance, observation: self.observation(), applied })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        let Command::Vector(numbers) = &action.command else { panic!("{action:?}") };
        self.1 += numbers[0];
        self.2 += 1;
        self.3.lock().unwrap().push(numbers[0]);
        let ending = (self.1 > 0.99).then(|| Ending { failure: None, time_s: 0.1 * f64::from(self.2), contact: None });
        let (observation, state_hash) = (self.observation(), u64::from(self.2));
        Ok(Step { observation, measures: Measures::default(), ending, events: Vec::new(), state_hash })
    }
}

/// Moves by 0.1 m, and notes the times that it sees.
struct Pusher(Arc<Mutex<Vec<f64>>>);

impl Policy for Pusher {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        self.0.lock().unwrap().clear();
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        self.0.lock().unwrap().push(observation.time_s);
        Ok(Action { command: Command::Vector(vec![0.1]), gripper: None, phase: None })
    }
}

/// Warns where the position is above 0.45 m: the distance to a mean of zero with a deviation of one.
fn warner(on_warning: OnWarning) -> SimulatedWarner {
    let features = Features { signals: Signals::of(&task()), parameters: Vec::new() };
    let distance = robogate_monitor::warn::Distance {
        columns: vec![0],
        scale: vec![[0.0, 1.0]],
        moments: Moments { bin_s: 100.0, cells: vec![vec![Some(0)]] },
        means: vec![vec![0.0]],
        factors: vec![vec![1.0]],
        band: vec![[0.0, 1.0]],
    };
    let text = serde_json::json!({
        "warn_format": WarnFile::FORMAT,
        "conditions": { "task": "", "engine": "", "robot": "", "policy": "", "population": "" },
        "features": features,
        "distance": distance,
        "calibration": { "threshold": 0.45, "successes": 59, "rank": 59, "promised": 0.05 },
        "baselines": { "clock": 0.0 },
    });
    let record = WarnerRecord { on_warning, sha256: String::new(), detector: text.to_string() };
    let made = SimulatedWarner::new(record, &Given { task: &task(), execution: None, stress: None, inside: false });
    let made = made.unwrap();
    assert!(matches!(made.detector.model, Model::Distance(_)));
    made
}

fn run(warner: &SimulatedWarner) -> (Episode, Vec<f64>, Vec<f64>) {
    let (commands, times) = (Arc::new(Mutex::new(Vec::new())), Arc::new(Mutex::new(Vec::new())));
    let line = Line(Arc::new(task()), 0.0, 0, Arc::clone(&commands));
    let worker = warner.between(Box::new(line), Box::new(Pusher(Arc::clone(&times)))).unwrap();
    let Worker { mut environment, mut policy } = worker;
    let scenario = Scenario { index: 0, seed: Seed::campaign(1).episode(0), requested: Assignment::default() };
    let first = rollout(&mut *environment, &mut *policy, &scenario);
    assert_eq!(first, rollout(&mut *environment, &mut *policy, &scenario), "the second episode starts over");
    let read = |of: &Arc<Mutex<Vec<f64>>>| of.lock().unwrap().clone();
    (first, read(&commands), read(&times))
}

#[test]
fn stop_ends_the_episode_before_the_action() {
    let (episode, commands, _) = run(&warner(OnWarning::Stop));
    assert_eq!((episode.outcome, commands.len()), (Outcome::Failure(WARNED_STOP), 5));
    assert!((episode.time_s - 0.5).abs() < 1e-9);
    assert_eq!(episode.measures.get("warned_s"), Some(episode.time_s));
}

#[test]
fn handover_is_an_assist() {
    let (episode, ..) = run(&warner(OnWarning::Handover));
    assert_eq!((episode.outcome, episode.measures.get("assists")), (Outcome::Failure(HANDOVER), Some(1.0)));
}

#[test]
fn recorded_warning_changes_nothing() {
    let (episode, commands, _) = run(&warner(OnWarning::Record));
    assert_eq!((episode.outcome, commands.len()), (Outcome::Success, 10));
    assert!(episode.measures.get("warned_s").is_some());
    // A worker that does not act is the same.
    let stops = warner(OnWarning::Stop);
    stops.acts().store(false, Ordering::Relaxed);
    assert_eq!(run(&stops).0.outcome, Outcome::Success);
}

#[test]
fn slow_motion_takes_more_periods() {
    let (episode, commands, times) = run(&warner(OnWarning::Slow(2)));
    // The warned action is executed as it is: 6 fast ones, and 4 others in two periods each.
    assert_eq!((episode.outcome, commands.len(), times.len()), (Outcome::Success, 14, 10), "{commands:?}");
    assert!(commands[6..].iter().all(|x| (x - 0.05).abs() < 1e-12), "{commands:?}");
    assert!(times.windows(2).all(|two| (two[1] - two[0] - 0.1).abs() < 1e-9), "the clock of the policy: {times:?}");
}

#[test]
fn forces_and_delays_cannot_be_slowed_down() {
    let torque = ActionSpace::Vector { names: vec!["Torque_1".to_owned()], low: vec![-1.0], high: vec![1.0] };
    let force = TaskSpec { action: ActionSpec { spaces: vec![torque], gripper: None }, ..task() };
    let given = |task, inside| Given { task, execution: None, stress: None, inside };
    for (given, why) in [(given(&force, false), "Torque_1"), (given(&task(), true), "runs the policy itself")] {
        let text = given.can_slow_down().unwrap_err().to_string();
        assert!(text.contains(why) && text.contains("Hint: "), "{text}");
    }
    assert_eq!(on_warning("slow:3"), Ok(OnWarning::Slow(3)));
    assert!(["slow:1", "slow:11", "halt", "stop:2"].iter().all(|text| on_warning(text).is_err()));
}
