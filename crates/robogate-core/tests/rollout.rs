//! Tests of the rollout loop, with an environment whose state is one number.

mod line;

use std::sync::Arc;

use robogate_core::{
    Action, Assignment, Better, Command, Episode, FailureMode, Fault, FaultKind, GAVE_UP, MeasureSpec, Measures,
    Observation, Outcome, Policy, Request, Rollout, Seed, TaskInstance, TaskSpec, Value, Word, rollout, rollout_with,
};

use line::{COLLISION, Line, Walker, scenario, task};

fn run(mut line: Line) -> Episode {
    rollout(&mut line, &mut Walker::default(), &scenario(0))
}

fn invalid(episode: &Episode) -> &Fault {
    let Outcome::Invalid(fault) = &episode.outcome else { panic!("{:?}", episode.outcome) };
    fault
}

#[test]
fn time_limit_is_exact() {
    // 0.1 added ten times, or 30 / 0.02, is not exact in binary; the number of ticks is.
    for (limit_s, period_s, ticks) in
        [(1.0, 0.1, 10), (30.0, 0.02, 1_500), (0.3, 0.1, 3), (0.7, 0.1, 7), (5.0, 1.0 / 30.0, 150)]
    {
        let episode = run(Line { task: task(period_s, limit_s), ..Line::default() });
        assert_eq!(episode.outcome, Outcome::Failure(FailureMode::TIMEOUT));
        assert_eq!(episode.ticks, ticks, "{limit_s} / {period_s}");
        assert!((episode.time_s - limit_s).abs() < 1e-9);
    }
}

#[test]
fn impossible_time_limit_is_invalid() {
    for (limit_s, period_s) in [(1.0, 0.0), (f64::NAN, 0.1), (f64::INFINITY, 0.1), (0.0, 0.1), (1.0, -0.1), (1e12, 0.1)]
    {
        let episode = run(Line { task: task(period_s, limit_s), ..Line::default() });
        assert_eq!(invalid(&episode).kind, FaultKind::Setup, "{limit_s} / {period_s}");
        assert_eq!(episode.ticks, 0);
    }
}

#[test]
fn ending_in_last_tick_counts() {
    let episode = run(Line { endings: vec![(10, None)], ..Line::default() });
    assert_eq!((episode.outcome, episode.ticks), (Outcome::Success, 10));
    let episode = run(Line { endings: vec![(11, None)], ..Line::default() });
    assert_eq!((episode.outcome, episode.ticks), (Outcome::Failure(FailureMode::TIMEOUT), 10));
}

#[test]
fn first_ending_wins() {
    let endings = vec![(4, Some(COLLISION)), (5, None)];
    let mut line = Line { endings, ..Line::default() };
    let mut walker = Walker::default();
    let episode = rollout(&mut line, &mut walker, &scenario(0));
    assert_eq!(episode.outcome, Outcome::Failure(COLLISION));
    assert_eq!((episode.ticks, line.steps, walker.acts), (4, 4, 4));
    assert!((episode.time_s - 0.35).abs() < 1e-12, "the time of the event, not the end of the period");
    assert_eq!(episode.contact.unwrap().other_body, "table");
    assert_eq!(episode.phase, Some(Word::constant("stride")));
}

#[test]
fn environment_decides_success() {
    let episode = run(Line { endings: vec![(2, None)], ..Line::default() });
    assert_eq!(episode.outcome, Outcome::Success);
    assert_eq!(episode.contact, None);
    assert_eq!(episode.phase, Some(Word::constant("start")));
}

#[test]
fn policy_fault_is_invalid() {
    let mut walker = Walker { faults_at: Some(3), ..Walker::default() };
    let episode = rollout(&mut Line::default(), &mut walker, &scenario(0));
    assert_eq!(invalid(&episode), &Fault::new(FaultKind::BadAction, "expected 7 joints, got 6"));
    assert_eq!(episode.ticks, 2, "earlier steps are kept");
    assert!(episode.measures.get("position").is_some());
    let mut walker = Walker { faults_on_reset: true, ..Walker::default() };
    let episode = rollout(&mut Line::default(), &mut walker, &scenario(0));
    assert_eq!(invalid(&episode).kind, FaultKind::Unavailable);
    assert_eq!(episode.ticks, 0);
    assert_eq!(episode.applied, scenario(0).requested, "the reset had succeeded");
}

#[test]
fn environment_fault_is_invalid() {
    let episode = run(Line { breaks_at: Some(6), ..Line::default() });
    assert_eq!(invalid(&episode).kind, FaultKind::Diverged);
    assert_eq!(episode.ticks, 5);
    let episode = run(Line { refuses: true, ..Line::default() });
    assert_eq!(invalid(&episode).kind, FaultKind::Setup);
    assert!(episode.applied.is_empty());
    assert_eq!(episode.measures, Measures::default(), "a missing measure is not zero");
}

#[test]
fn fault_beats_ending() {
    let episode = run(Line { breaks_at: Some(4), endings: vec![(4, None)], ..Line::default() });
    assert_eq!(invalid(&episode).kind, FaultKind::Diverged);
}

#[test]
fn unapplied_parameter_is_invalid() {
    type Alteration = fn(&mut Assignment);
    let alterations: [(Alteration, &str); 4] = [
        (|a| a.set("start", Value::Number(0.250_001)), "requested start = 0.25, but the environment applied 0.250001"),
        (
            |a| a.set("start", Value::Category("0.25".into())),
            "requested start = 0.25, but the environment applied 0.25",
        ),
        (
            |a| a.set("shape", Value::Category("sphere".into())),
            "requested shape = box, but the environment applied sphere",
        ),
        (|a| *a = Assignment::default(), "requested start = 0.25, but the environment applied nothing"),
    ];
    for (alter, detail) in alterations {
        let mut walker = Walker::default();
        let episode = rollout(&mut Line { alter, ..Line::default() }, &mut walker, &scenario(0));
        assert_eq!(invalid(&episode), &Fault::new(FaultKind::NotApplied, detail));
        assert_eq!((episode.ticks, walker.acts), (0, 0), "no step runs after a failed check");
    }
}

#[test]
fn non_finite_parameter_is_unapplied() {
    type Alteration = fn(&mut Assignment);
    let alterations: [Alteration; 2] =
        [|a| a.set("start", Value::Number(f64::NAN)), |a| a.set("start", Value::Number(f64::INFINITY))];
    for alter in alterations {
        assert_eq!(invalid(&run(Line { alter, ..Line::default() })).kind, FaultKind::NotApplied);
    }
}

#[test]
fn single_precision_is_applied() {
    let mut request = scenario(0);
    request.requested.set("mass_kg", Value::Number(0.1));
    request.requested.set("offset_x_m", Value::Number(0.003));
    let alter = |a: &mut Assignment| {
        a.set("mass_kg", Value::Number(f64::from(0.1_f32)));
        // The value is computed from the object's position.
        a.set("offset_x_m", Value::Number(f64::from(0.503_f32) - 0.5));
        a.set("gravity", Value::Number(9.81));
    };
    let mut line = Line { alter, endings: vec![(1, None)], ..Line::default() };
    let episode = rollout(&mut line, &mut Walker::default(), &request);
    assert_eq!(episode.outcome, Outcome::Success);
    assert_eq!(episode.applied.number("gravity"), Some(9.81));
}

#[test]
fn same_inputs_same_trajectory() {
    let mut used = Line::default();
    let mut walker = Walker::default();
    let first = rollout(&mut used, &mut walker, &scenario(7));
    rollout(&mut used, &mut walker, &scenario(8));
    // Repeated after another episode, in the same environment and in a new one.
    assert_eq!(rollout(&mut used, &mut walker, &scenario(7)), first);
    let fresh = rollout(&mut Line::default(), &mut Walker::default(), &scenario(7));
    assert_eq!(fresh, first);
    let other = rollout(&mut Line::default(), &mut Walker::default(), &scenario(8));
    assert_ne!(other.trajectory_hash, first.trajectory_hash);
}

#[test]
fn hash_depends_on_length() {
    let hash = |limit_s| run(Line { task: task(0.1, limit_s), ..Line::default() }).trajectory_hash;
    assert_ne!(hash(0.5), hash(0.6));
    assert_ne!(hash(0.1), hash(0.2));
}

#[test]
fn observer_changes_nothing() {
    let mut seen = Vec::new();
    let line = || Line { endings: vec![(4, None)], ..Line::default() };
    let episode = rollout_with(&mut line(), &mut Walker::default(), &scenario(3), &mut |tick| {
        let target = tick.step.observation.vector("position").unwrap();
        assert_eq!(tick.action.command, Command::Vector(target.to_vec()));
        assert!(tick.observation.time_s < tick.step.observation.time_s);
        assert_eq!(target[0].to_bits(), tick.step.state_hash);
        seen.push(tick.step.observation.time_s);
    });
    assert_eq!(seen.len(), 4);
    assert!(seen.is_sorted());
    assert_eq!(episode, rollout(&mut line(), &mut Walker::default(), &scenario(3)));
}

#[test]
fn undeclared_ending_is_a_failure() {
    let jam = FailureMode::from_foreign("jammed");
    let episode = run(Line { endings: vec![(3, Some(jam))], ..Line::default() });
    assert_eq!(episode.outcome, Outcome::Failure(jam));
    assert!(!task(0.1, 1.0).declares(jam));
}

/// A policy that always returns the same action.
struct Constant(Action);

impl Policy for Constant {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        Ok(())
    }

    fn act(&mut self, _: &Observation) -> Result<Action, Fault> {
        Ok(self.0.clone())
    }
}

#[test]
fn action_outside_spec_is_fault() {
    let commands = [
        Command::Vector(vec![]),
        Command::Vector(vec![f64::NAN]),
        Command::Vector(vec![2e4]),
        Command::JointPosition(vec![0.0]),
    ];
    for command in commands {
        let action = Action { command: command.clone(), gripper: None, phase: None };
        let episode = rollout(&mut Line::default(), &mut Constant(action), &scenario(0));
        assert_eq!(invalid(&episode).kind, FaultKind::BadAction, "{command:?}");
        assert_eq!(episode.ticks, 0);
    }
}

/// A policy that returns the same action and gives up at its third one.
struct GivesUp(Action, u32);

impl Policy for GivesUp {
    fn check(&self, _: &TaskSpec) -> Result<(), String> {
        Ok(())
    }

    fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
        self.1 = 0;
        Ok(())
    }

    fn act(&mut self, _: &Observation) -> Result<Action, Fault> {
        self.1 += 1;
        Ok(self.0.clone())
    }

    fn gave_up(&self) -> bool {
        self.1 >= 3
    }
}

#[test]
fn certain_ending_needs_a_policy_that_gave_up() {
    let action = || Action { command: Command::Vector(vec![1.0]), gripper: None, phase: None };
    let mut declares = (*task(0.1, 1.0)).clone();
    declares.measures.push(MeasureSpec {
        name: GAVE_UP,
        unit: "s".to_owned(),
        meaning: String::new(),
        better: Better::Neither,
    });
    let task = Arc::new(declares);
    // The policy gives up at 0.2 s. The rest is certain after step 2, 5, or never.
    for (certain_at, ticks) in [(Some(2), 3), (Some(5), 5), (None, 10)] {
        let mut line = Line { certain_at, task: Arc::clone(&task), ..Line::default() };
        let episode = rollout(&mut line, &mut GivesUp(action(), 0), &scenario(0));
        assert_eq!(episode.ticks, ticks, "{certain_at:?}");
        assert!((episode.measures.get("gave_up_s").unwrap() - 0.2).abs() < 1e-9);
        assert!((episode.time_s - 1.0).abs() < 1e-9, "the time of the ending");
        let mode = if certain_at.is_some() { COLLISION } else { FailureMode::TIMEOUT };
        assert_eq!(episode.outcome, Outcome::Failure(mode));
        // A policy that may still act runs to the time limit.
        let mut line = Line { certain_at, task: Arc::clone(&task), ..Line::default() };
        let episode = rollout(&mut line, &mut Constant(action()), &scenario(0));
        assert_eq!((episode.ticks, episode.measures.get("gave_up_s")), (10, None));
    }
    // An ending in the same step takes precedence.
    let mut line = Line { certain_at: Some(1), endings: vec![(3, None)], ..Line::default() };
    let episode = rollout(&mut line, &mut GivesUp(action(), 0), &scenario(0));
    assert_eq!(episode.outcome, Outcome::Success);
    assert_eq!(episode.measures.get("gave_up_s"), None, "the task does not declare the measure");
}

#[test]
fn unrequested_replies_are_invalid() {
    let mut early = Rollout::begin(task(0.1, 1.0), scenario(0));
    assert_eq!(early.request(), Some(Request::Reset(&scenario(0))));
    early.acted(Ok(Action { command: Command::Vector(vec![0.0]), gripper: None, phase: None }));
    assert_eq!(early.request(), None);
    let fault = Fault::new(FaultKind::Setup, "the episode was given an action that it did not request");
    assert_eq!(invalid(&early.finish()), &fault);
    // A late reply does not change an episode that has ended.
    let mut late = Rollout::begin(task(0.1, 1.0), scenario(0));
    let fault = Fault::new(FaultKind::Unavailable, "no answer within 5 s");
    late.started(Err(fault.clone()));
    late.drawn(Ok(Measures::default()));
    assert_eq!(invalid(&late.finish()), &fault);
}

#[test]
fn unfinished_episode_is_invalid() {
    let episode = Rollout::begin(task(0.1, 1.0), scenario(0)).finish();
    assert_eq!((invalid(&episode).kind, episode.ticks), (FaultKind::Unavailable, 0));
}
