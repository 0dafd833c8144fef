//! The loop between simulator and policy, with a world of one number.

use robogate_core::{
    Action, ArmCommand, Assignment, Contact, Ending, Episode, FailureMode, Fault, FaultKind, GripperCommand, Measures,
    Observation, Outcome, Phase, Policy, Pose, Scenario, Seed, Simulator, Start, Step, TaskSpec, Value, rollout,
    rollout_with,
};

/// A number that grows by what the policy asks for.
struct Line {
    /// What happens in the step of this number, from 1.
    endings: Vec<(u32, Option<FailureMode>)>,
    breaks_at: Option<u32>,
    refuses: bool,
    /// Changes what was asked for before it is read back.
    alter: fn(&mut Assignment),
    period_s: f64,
    limit_s: f64,
    position: f64,
    steps: u32,
}

impl Default for Line {
    fn default() -> Self {
        Self {
            endings: Vec::new(),
            breaks_at: None,
            refuses: false,
            alter: |_| {},
            period_s: 0.1,
            limit_s: 1.0,
            position: 0.0,
            steps: 0,
        }
    }
}

impl Line {
    fn observation(&self) -> Observation {
        Observation {
            time_s: f64::from(self.steps) * self.period_s,
            joint_positions: vec![self.position],
            joint_velocities: vec![0.0],
            gripper_opening_m: None,
            tool_pose: Pose::IDENTITY,
            images: Vec::new(),
        }
    }
}

impl Simulator for Line {
    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        if self.refuses {
            return Err(Fault::new(FaultKind::Setup, "object starts in contact"));
        }
        self.steps = 0;
        self.position = scenario.requested.number("start").unwrap_or(0.0);
        let mut applied = scenario.requested.clone();
        (self.alter)(&mut applied);
        let nowhere = Pose::upright([0.0; 3], 0.0);
        let task = TaskSpec {
            instruction: "go".to_owned(),
            control_period_s: self.period_s,
            time_limit_s: self.limit_s,
            shape: "box".to_owned(),
            object_extent_m: [0.05; 3],
            object_pose: nowhere,
            target_pose: nowhere,
            tolerance_m: 0.05,
            approach_speed_m_s: None,
        };
        Ok(Start { task, observation: self.observation(), applied })
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.steps += 1;
        if self.breaks_at == Some(self.steps) {
            return Err(Fault::new(FaultKind::Diverged, "position is NaN"));
        }
        let ArmCommand::JointPositions(target) = &action.arm else {
            return Err(Fault::new(FaultKind::BadAction, "one position was due"));
        };
        self.position = target[0];
        let ending = self.endings.iter().find(|(at, _)| *at == self.steps).map(|(_, failure)| Ending {
            failure: *failure,
            // Within the period, as a real simulator would say it.
            time_s: (f64::from(self.steps) - 0.5) * self.period_s,
            contact: failure.is_some().then(|| Contact {
                robot_body: "hand".to_owned(),
                other_body: "table".to_owned(),
                force_n: 12.0,
            }),
        });
        Ok(Step {
            observation: self.observation(),
            measures: Measures { slip_m: Some(self.position), ..Measures::default() },
            ending,
            events: Vec::new(),
            state_hash: self.position.to_bits(),
        })
    }
}

/// Walks by random strides.
#[derive(Default)]
struct Walker {
    stream: Option<robogate_core::Stream>,
    acts: u32,
    faults_at: Option<u32>,
    faults_on_reset: bool,
}

impl Policy for Walker {
    fn reset(&mut self, _: &TaskSpec, seed: Seed) -> Result<(), Fault> {
        if self.faults_on_reset {
            return Err(Fault::new(FaultKind::Unavailable, "no answer in 5 s"));
        }
        self.stream = Some(seed.stream("walk"));
        self.acts = 0;
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        self.acts += 1;
        if self.faults_at == Some(self.acts) {
            return Err(Fault::new(FaultKind::BadAction, "7 joints wanted, 6 given"));
        }
        let stride = self.stream.as_mut().map_or(0.0, robogate_core::Stream::uniform);
        Ok(Action {
            arm: ArmCommand::JointPositions(vec![observation.joint_positions[0] + stride]),
            gripper: GripperCommand::Open,
            phase: Some(if self.acts < 3 { Phase::ApproachAbove } else { Phase::Descend }),
        })
    }
}

fn scenario(index: u64) -> Scenario {
    let requested = [("start".into(), Value::Number(0.25)), ("shape".into(), Value::Category("box".into()))];
    Scenario { index, seed: Seed::campaign(1).episode(index), requested: requested.into_iter().collect() }
}

fn run(mut line: Line) -> Episode {
    rollout(&mut line, &mut Walker::default(), &scenario(0))
}

fn invalid(episode: &Episode) -> &Fault {
    let Outcome::Invalid(fault) = &episode.outcome else { panic!("{:?}", episode.outcome) };
    fault
}

#[test]
fn a_task_that_never_ends_is_a_timeout_after_exactly_limit_over_period_ticks() {
    // 0.1 added ten times, or 30 / 0.02, is not exact in binary; the number of ticks is.
    for (limit_s, period_s, ticks) in
        [(1.0, 0.1, 10), (30.0, 0.02, 1_500), (0.3, 0.1, 3), (0.7, 0.1, 7), (5.0, 1.0 / 30.0, 150)]
    {
        let episode = run(Line { limit_s, period_s, ..Line::default() });
        assert_eq!(episode.outcome, Outcome::Failure(FailureMode::Timeout));
        assert_eq!(episode.ticks, ticks, "{limit_s} / {period_s}");
        assert!((episode.time_s - limit_s).abs() < 1e-9);
    }
}

#[test]
fn a_task_without_a_number_of_ticks_is_invalid_and_not_a_timeout() {
    for (limit_s, period_s) in [(1.0, 0.0), (f64::NAN, 0.1), (f64::INFINITY, 0.1), (0.0, 0.1), (1.0, -0.1), (1e12, 0.1)]
    {
        let episode = run(Line { limit_s, period_s, ..Line::default() });
        assert_eq!(invalid(&episode).kind, FaultKind::Setup, "{limit_s} / {period_s}");
        assert_eq!(episode.ticks, 0);
    }
}

#[test]
fn an_ending_in_the_last_tick_is_no_timeout() {
    let episode = run(Line { endings: vec![(10, None)], ..Line::default() });
    assert_eq!((episode.outcome, episode.ticks), (Outcome::Success, 10));
    let episode = run(Line { endings: vec![(11, None)], ..Line::default() });
    assert_eq!((episode.outcome, episode.ticks), (Outcome::Failure(FailureMode::Timeout), 10));
}

#[test]
fn the_first_ending_wins_and_nothing_runs_after_it() {
    let endings = vec![(4, Some(FailureMode::Collision)), (5, None)];
    let mut line = Line { endings, ..Line::default() };
    let mut walker = Walker::default();
    let episode = rollout(&mut line, &mut walker, &scenario(0));
    assert_eq!(episode.outcome, Outcome::Failure(FailureMode::Collision));
    assert_eq!((episode.ticks, line.steps, walker.acts), (4, 4, 4));
    assert!((episode.time_s - 0.35).abs() < 1e-12, "when it happened, not when the period was over");
    assert_eq!(episode.contact.unwrap().other_body, "table");
    assert_eq!(episode.phase, Some(Phase::Descend));
}

#[test]
fn success_is_what_the_simulator_says_and_not_the_policy() {
    let episode = run(Line { endings: vec![(2, None)], ..Line::default() });
    assert_eq!(episode.outcome, Outcome::Success);
    assert_eq!(episode.contact, None);
    assert_eq!(episode.phase, Some(Phase::ApproachAbove));
}

#[test]
fn a_fault_of_the_policy_is_invalid_and_never_a_failure() {
    let mut walker = Walker { faults_at: Some(3), ..Walker::default() };
    let episode = rollout(&mut Line::default(), &mut walker, &scenario(0));
    assert_eq!(invalid(&episode), &Fault::new(FaultKind::BadAction, "7 joints wanted, 6 given"));
    assert_eq!(episode.ticks, 2, "what ran before is kept");
    assert!(episode.measures.slip_m.is_some());
    let mut walker = Walker { faults_on_reset: true, ..Walker::default() };
    let episode = rollout(&mut Line::default(), &mut walker, &scenario(0));
    assert_eq!(invalid(&episode).kind, FaultKind::Unavailable);
    assert_eq!(episode.ticks, 0);
    assert_eq!(episode.applied, scenario(0).requested, "the simulator had got so far");
}

#[test]
fn a_fault_of_the_simulator_is_invalid_and_never_a_failure() {
    let episode = run(Line { breaks_at: Some(6), ..Line::default() });
    assert_eq!(invalid(&episode).kind, FaultKind::Diverged);
    assert_eq!(episode.ticks, 5);
    let episode = run(Line { refuses: true, ..Line::default() });
    assert_eq!(invalid(&episode).kind, FaultKind::Setup);
    assert!(episode.applied.is_empty());
    assert_eq!(episode.measures, Measures::default(), "nothing measured is nothing, not zero");
}

#[test]
fn a_fault_in_the_step_that_would_have_ended_it_is_a_fault() {
    let episode = run(Line { breaks_at: Some(4), endings: vec![(4, None)], ..Line::default() });
    assert_eq!(invalid(&episode).kind, FaultKind::Diverged);
}

#[test]
fn a_parameter_that_was_not_applied_makes_the_episode_invalid() {
    type Alteration = fn(&mut Assignment);
    let alterations: [(Alteration, &str); 4] = [
        (|a| a.set("start", Value::Number(0.250_001)), "asked for start = 0.25, the simulator has 0.250001"),
        (|a| a.set("start", Value::Category("0.25".into())), "asked for start = 0.25, the simulator has 0.25"),
        (|a| a.set("shape", Value::Category("sphere".into())), "asked for shape = box, the simulator has sphere"),
        (|a| *a = Assignment::default(), "asked for start = 0.25, the simulator has nothing"),
    ];
    for (alter, detail) in alterations {
        let mut walker = Walker::default();
        let episode = rollout(&mut Line { alter, ..Line::default() }, &mut walker, &scenario(0));
        assert_eq!(invalid(&episode), &Fault::new(FaultKind::NotApplied, detail));
        assert_eq!((episode.ticks, walker.acts), (0, 0), "nothing is run in a world that was not asked for");
    }
}

#[test]
fn a_number_that_is_not_finite_counts_as_not_applied() {
    type Alteration = fn(&mut Assignment);
    let alterations: [Alteration; 2] =
        [|a| a.set("start", Value::Number(f64::NAN)), |a| a.set("start", Value::Number(f64::INFINITY))];
    for alter in alterations {
        assert_eq!(invalid(&run(Line { alter, ..Line::default() })).kind, FaultKind::NotApplied);
    }
}

#[test]
fn single_precision_and_further_parameters_count_as_applied() {
    let mut request = scenario(0);
    request.requested.set("mass_kg", Value::Number(0.1));
    request.requested.set("offset_x_m", Value::Number(0.003));
    let alter = |a: &mut Assignment| {
        a.set("mass_kg", Value::Number(f64::from(0.1_f32)));
        // Read out of where the object stands.
        a.set("offset_x_m", Value::Number(f64::from(0.503_f32) - 0.5));
        a.set("gravity", Value::Number(9.81));
    };
    let mut line = Line { alter, endings: vec![(1, None)], ..Line::default() };
    let episode = rollout(&mut line, &mut Walker::default(), &request);
    assert_eq!(episode.outcome, Outcome::Success);
    assert_eq!(episode.applied.number("gravity"), Some(9.81));
}

#[test]
fn the_same_inputs_give_the_same_trajectory_and_another_seed_another() {
    let mut used = Line::default();
    let mut walker = Walker::default();
    let first = rollout(&mut used, &mut walker, &scenario(7));
    rollout(&mut used, &mut walker, &scenario(8));
    // Again after another episode, in the same world, and in a new one.
    assert_eq!(rollout(&mut used, &mut walker, &scenario(7)), first);
    let fresh = rollout(&mut Line::default(), &mut Walker::default(), &scenario(7));
    assert_eq!(fresh, first);
    let other = rollout(&mut Line::default(), &mut Walker::default(), &scenario(8));
    assert_ne!(other.trajectory_hash, first.trajectory_hash);
}

#[test]
fn the_trajectory_hash_depends_on_order_and_length() {
    let hash = |limit_s| run(Line { limit_s, ..Line::default() }).trajectory_hash;
    assert_ne!(hash(0.5), hash(0.6));
    assert_ne!(hash(0.1), hash(0.2));
}

#[test]
fn an_onlooker_sees_each_tick_in_order_and_changes_nothing() {
    let mut seen = Vec::new();
    let line = || Line { endings: vec![(4, None)], ..Line::default() };
    let episode = rollout_with(&mut line(), &mut Walker::default(), &scenario(3), &mut |tick| {
        let target = tick.step.observation.joint_positions.clone();
        assert_eq!(tick.action.arm, ArmCommand::JointPositions(target));
        assert!(tick.observation.time_s < tick.step.observation.time_s);
        assert_eq!(tick.step.observation.joint_positions[0].to_bits(), tick.step.state_hash);
        seen.push(tick.step.observation.time_s);
    });
    assert_eq!(seen.len(), 4);
    assert!(seen.is_sorted());
    assert_eq!(episode, rollout(&mut line(), &mut Walker::default(), &scenario(3)));
}
