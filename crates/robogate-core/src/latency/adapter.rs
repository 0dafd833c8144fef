//! Puts latency between any policy and any environment.

use std::borrow::Cow;
use std::sync::Arc;

use super::draws::stream;
use super::queue::Queue;
use super::{Execution, LATENCY_PARAMETER, Latency, latency_parameter};
use crate::{
    Action, ActionSpace, ActionSpec, Assignment, Command, Environment, Fault, FaultKind, FeatureSpec, Foresight,
    Infeasibility, Measures, Observation, Policy, PredictedStep, Prediction, Scenario, Seed, Start, Step, Stream,
    TaskInstance, TaskSpec, Value,
};

/// Puts latency between a policy and an environment.
///
/// The task of the environment gets the declarations of [`with_declarations`]. Episodes with a sampled latency record its
/// hidden draws ([`Latency::draws`]), and the knowledge of the task about them has these draws too.
///
/// The two share no state: the environment lists [`LATENCY_PARAMETER`] among the applied parameters, and the policy takes
/// its latency from there ([`Policy::note_applied`]).
pub fn with_latency(
    environment: Box<dyn Environment>,
    policy: Box<dyn Policy>,
    execution: Execution,
) -> (Box<dyn Environment>, Box<dyn Policy>) {
    let environment: Box<dyn Environment> = if matches!(execution.latency, Latency::Fixed { .. }) {
        environment
    } else {
        let latency = execution.latency.clone();
        let task = with_declarations(environment.task(), &latency);
        Box::new(LatencyEnvironment { environment, task, latency })
    };
    (environment, Box::new(Delayed::new(policy, execution)))
}

/// The task with the declarations of a latency: the parameter [`LATENCY_PARAMETER`] for [`Latency::Parameter`], or the
/// draws of a sampled latency ([`Latency::draw_specs`]). A name that the task declares already is not declared again.
pub fn with_declarations(task: &Arc<TaskSpec>, latency: &Latency) -> Arc<TaskSpec> {
    let mut task = (**task).clone();
    if *latency == Latency::Parameter && task.parameter(LATENCY_PARAMETER).is_none() {
        task.parameters.push(latency_parameter());
    }
    for draw in latency.draw_specs() {
        if task.draws.iter().all(|declared| declared.name != draw.name) {
            task.draws.push(draw);
        }
    }
    Arc::new(task)
}

/// An environment whose policy has a latency that is sampled, or that the parameter [`LATENCY_PARAMETER`] sets.
struct LatencyEnvironment {
    environment: Box<dyn Environment>,
    task: Arc<TaskSpec>,
    latency: Latency,
}

/// The knowledge of a task about episodes with a latency, which the task itself does not know.
struct LatencyForesight {
    of_task: Arc<dyn Foresight>,
    latency: Latency,
    /// The features of the task, then those of the latency.
    features: Vec<FeatureSpec>,
}

impl LatencyForesight {
    fn new(of_task: Arc<dyn Foresight>, latency: Latency) -> Self {
        let features = [of_task.feature_specs(), latency.feature_specs()].concat();
        Self { of_task, latency, features }
    }
}

impl Foresight for LatencyForesight {
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        let of_task = self.of_task.draws(&without_parameter(&self.latency, scenario))?;
        Ok(with_draws(of_task, &self.latency, scenario.seed))
    }

    fn feature_specs(&self) -> &[FeatureSpec] {
        &self.features
    }

    fn features(&self, scenario: &Scenario) -> Result<Vec<f64>, Fault> {
        let mut features = self.of_task.features(&without_parameter(&self.latency, scenario))?;
        features.extend(self.latency.features(scenario.seed));
        Ok(features)
    }
}

/// These draws and those of the latency in the episode with this seed.
fn with_draws(mut draws: Measures, latency: &Latency, seed: Seed) -> Measures {
    for (name, value) in latency.draws(seed).iter() {
        // A draw that the environment declares keeps its meaning.
        if draws.get(name.as_str()).is_none() {
            draws.set(name, Some(value));
        }
    }
    draws
}

impl Environment for LatencyEnvironment {
    fn adapted(&self) -> Option<&dyn Environment> {
        Some(&*self.environment)
    }

    fn adapted_mut(&mut self) -> Option<&mut dyn Environment> {
        Some(&mut *self.environment)
    }

    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        let of_task = self.environment.foresight()?;
        Some(Arc::new(LatencyForesight::new(of_task, self.latency.clone())))
    }

    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        let of_task = self.environment.draws(&without_parameter(&self.latency, scenario))?;
        Ok(with_draws(of_task, &self.latency, scenario.seed))
    }

    fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        if self.latency == Latency::Parameter {
            self.environment.infeasibility(&without_latency(requested))
        } else {
            self.environment.infeasibility(requested)
        }
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        let set = if self.latency == Latency::Parameter { scenario.requested.number(LATENCY_PARAMETER) } else { None };
        let Some(wanted) = set else {
            return self.environment.reset(scenario);
        };
        if let Err(why) = latency_parameter().accepts(&Value::Number(wanted)) {
            return Err(Fault::new(FaultKind::Setup, why));
        }
        let mut start = self.environment.reset(&without_parameter(&self.latency, scenario))?;
        start.applied.set(LATENCY_PARAMETER, Value::Number(wanted));
        Ok(start)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.environment.step(action)
    }
}

/// The scenario of the environment itself, which does not have the parameter of a latency.
fn without_parameter<'a>(latency: &Latency, scenario: &'a Scenario) -> Cow<'a, Scenario> {
    if *latency == Latency::Parameter {
        Cow::Owned(Scenario { requested: without_latency(&scenario.requested), ..scenario.clone() })
    } else {
        Cow::Borrowed(scenario)
    }
}

/// The parameters of the environment itself.
fn without_latency(requested: &Assignment) -> Assignment {
    let others = requested.iter().filter(|(name, _)| *name != LATENCY_PARAMETER);
    others.map(|(name, value)| (name.into(), value.clone())).collect()
}

/// A policy whose actions arrive after a delay.
struct Delayed<P: ?Sized> {
    policy: Box<P>,
    latency: Latency,
    /// The applied [`LATENCY_PARAMETER`] of the next episode, in seconds. `None` if it was not noted.
    noted_s: Option<f64>,
    /// The applied [`LATENCY_PARAMETER`] of this episode, in seconds.
    applied_s: f64,
    stream: Stream,
    queue: Queue,
    /// The request in progress: the control period of its reply, and the reply.
    pending: Option<(u64, Prediction)>,
    /// The index of the present control period.
    tick: u64,
    period_s: f64,
    hold: Hold,
    /// Control periods that a step takes, and those that are left of the present one.
    periods: u32,
    left: u32,
}

impl<P: Policy + ?Sized> Delayed<P> {
    fn new(policy: Box<P>, Execution { latency, mode }: Execution) -> Self {
        Self {
            policy,
            latency,
            noted_s: None,
            applied_s: 0.0,
            stream: stream(Seed::campaign(0)),
            queue: Queue::new(mode),
            pending: None,
            tick: 0,
            period_s: 1.0,
            hold: Hold::default(),
            periods: 1,
            left: 0,
        }
    }

    /// Requests the next actions.
    fn request(&mut self, observation: &Observation) -> Result<(), Fault> {
        let prediction = self.policy.predict(observation)?;
        self.queue.requested();
        let latency_s = self.latency.sample(&mut self.stream, self.applied_s);
        // The tolerance keeps a latency of one period at one period.
        let delay = (latency_s / self.period_s - 1e-9).ceil().max(0.0) as u64;
        self.pending = Some((self.tick + delay, prediction));
        self.arrive();
        Ok(())
    }

    /// Adds the actions of the request in progress to the queue, if its reply has arrived.
    fn arrive(&mut self) {
        if let Some((_, prediction)) = self.pending.take_if(|(due, _)| *due <= self.tick) {
            self.periods = prediction.periods.max(1);
            self.queue.merge(prediction);
        }
    }

    /// Whether a request starts in this control period.
    fn is_due(&self) -> bool {
        self.left == 0 && self.pending.is_none() && self.queue.is_due()
    }

    /// The command of this control period. `None` if there is no action to execute.
    fn command(&mut self, observation: &Observation) -> Result<Option<Action>, Fault> {
        if self.left > 0 {
            self.left -= 1;
            return self.policy.perform(None, observation).map(Some);
        }
        Ok(match self.queue.pop() {
            Some(PredictedStep::Action(action)) => Some(action),
            Some(PredictedStep::Numbers(numbers)) => {
                self.left = self.periods - 1;
                Some(self.policy.perform(Some(&numbers), observation)?)
            }
            None => None,
        })
    }
}

impl<P: Policy + ?Sized> Policy for Delayed<P> {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.policy.check(task)
    }

    fn note_applied(&mut self, applied: &Assignment) {
        self.noted_s = Some(applied.number(LATENCY_PARAMETER).unwrap_or(0.0));
        self.policy.note_applied(applied);
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.applied_s = match (self.noted_s.take(), &self.latency) {
            (Some(noted_s), _) => noted_s,
            (None, Latency::Parameter) => {
                let detail =
                    "the policy was not told its latency: an adapter around it does not pass on the applied parameters";
                return Err(Fault::new(FaultKind::Setup, detail));
            }
            (None, _) => 0.0,
        };
        self.queue.clear();
        self.pending = None;
        self.tick = 0;
        self.period_s = task.control_period_s;
        self.stream = stream(seed);
        self.hold = Hold::of(task);
        self.left = 0;
        self.policy.reset(task, instance, seed)
    }

    fn wants_images(&self) -> bool {
        self.policy.observes_images() || (self.is_due() && self.policy.wants_images())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        self.policy.observe(observation)?;
        if self.is_due() {
            self.request(observation)?;
        }
        let action = match self.command(observation)? {
            Some(action) => {
                self.hold.last = Some(action.clone());
                action
            }
            None => self.hold.action(observation),
        };
        self.tick += 1;
        self.arrive();
        Ok(action)
    }
}

/// Commands that hold the robot's position.
#[derive(Debug, Default)]
pub(crate) struct Hold {
    last: Option<Action>,
    spec: ActionSpec,
}

impl Hold {
    /// Before the first command for this task.
    pub(crate) fn of(task: &TaskSpec) -> Self {
        Self { last: None, spec: task.action.clone() }
    }

    /// The command while the robot waits.
    ///
    /// A tool stays at its last commanded pose, joints at their last commanded positions, or at the measured ones before
    /// the first action. In a vector, a number whose bounds are symmetric about 0 is a velocity, a change or an effort,
    /// and becomes 0. Any other number is a position and keeps its last value. The gripper keeps its last command, and is
    /// open before the first one.
    pub(crate) fn action(&self, observation: &Observation) -> Action {
        let command = match &self.last {
            Some(Action { command: Command::JointPosition(joints), .. }) => Command::JointPosition(joints.clone()),
            Some(Action { command: Command::Vector(numbers), .. }) => Command::Vector(self.vector(Some(numbers))),
            Some(Action { command: Command::ToolDelta { .. }, .. }) => STILL,
            None => match self.spec.spaces.first() {
                Some(ActionSpace::JointPosition { .. }) => {
                    Command::JointPosition(observation.joint_positions().to_vec())
                }
                Some(ActionSpace::Vector { .. }) => Command::Vector(self.vector(None)),
                Some(ActionSpace::ToolDelta { .. }) | None => STILL,
            },
        };
        let gripper = self.last.as_ref().map_or(self.spec.gripper.map(|_| Action::OPEN), |action| action.gripper);
        Action { command, gripper, phase: self.last.as_ref().and_then(|action| action.phase) }
    }

    /// The bounds of the numbers of a vector. Empty for another command.
    pub(crate) fn bounds(&self) -> (&[f64], &[f64]) {
        self.spec.vector().unwrap_or_default()
    }

    fn vector(&self, last: Option<&Vec<f64>>) -> Vec<f64> {
        let (low, high) = self.spec.vector().unwrap_or_default();
        let held = |(i, (low, high)): (usize, (&f64, &f64))| match last.and_then(|last| last.get(i)) {
            Some(last) if (low + high).abs() > 1e-9 * (high - low) => *last,
            _ => 0.0_f64.clamp(*low, *high),
        };
        low.iter().zip(high).enumerate().map(held).collect()
    }
}

/// No motion of the tool.
const STILL: Command = Command::ToolDelta { translation_m: [0.0; 3], rotation_rad: [0.0; 3] };

#[cfg(test)]
pub(crate) mod tests {
    use super::super::ExecutionMode;
    use super::super::draws::REQUESTS;
    use super::*;
    use crate::{
        Better, DrawSpec, Episode, ObservationSpec, SingleEnvironments, SinglePolicies, Word, rollout, rollout_all,
        rollout_with,
    };

    /// Predicts four steps with the number of the request.
    struct Counting {
        requests: f64,
        periods: u32,
        present: f64,
    }

    impl Policy for Counting {
        fn check(&self, _: &TaskSpec) -> Result<(), String> {
            Ok(())
        }

        fn reset(&mut self, _: &TaskSpec, _: &TaskInstance, _: Seed) -> Result<(), Fault> {
            self.requests = 0.0;
            Ok(())
        }

        fn act(&mut self, _: &Observation) -> Result<Action, Fault> {
            panic!("the adapter asks for chunks")
        }

        fn predict(&mut self, _: &Observation) -> Result<Prediction, Fault> {
            self.requests += 1.0;
            let steps = vec![PredictedStep::Numbers(vec![self.requests]); 4];
            Ok(Prediction { steps, execute: 2, periods: self.periods })
        }

        fn perform(&mut self, step: Option<&[f64]>, _: &Observation) -> Result<Action, Fault> {
            self.present = step.map_or(self.present, |numbers| numbers[0]);
            Ok(Action { command: Command::Vector(vec![self.present]), gripper: None, phase: None })
        }
    }

    /// A task whose command is one number.
    pub(crate) fn task() -> TaskSpec {
        let vector = ActionSpace::Vector { names: vec!["x".to_owned()], low: vec![-99.0], high: vec![99.0] };
        TaskSpec {
            name: Word::constant("test"),
            version: 1,
            instruction: String::new(),
            control_period_s: 0.05,
            time_limit_s: 1.0,
            failure_modes: Vec::new(),
            draws: Vec::new(),
            measures: Vec::new(),
            phases: Vec::new(),
            stages: Vec::new(),
            parameters: Vec::new(),
            settings: Vec::new(),
            observation: ObservationSpec::default(),
            action: ActionSpec { spaces: vec![vector], gripper: None },
            details: serde_json::Value::Null,
        }
    }

    /// The first numbers of the commands in `n` control periods.
    fn commands(latency: Latency, mode: ExecutionMode, periods: u32, n: usize) -> Vec<f64> {
        let policy = Box::new(Counting { requests: 0.0, periods, present: 0.0 });
        let mut policy = Delayed::new(policy, Execution { latency, mode });
        policy.reset(&task(), &TaskInstance::default(), Seed::campaign(1).episode(0)).unwrap();
        let act = |_| match policy.act(&Observation::default()).unwrap().command {
            Command::Vector(numbers) => numbers[0],
            other => panic!("{other:?}"),
        };
        (0..n).map(act).collect()
    }

    #[test]
    fn hold_waits_for_each_reply() {
        let fixed = |seconds| Latency::Fixed { seconds };
        assert_eq!(commands(fixed(0.0), ExecutionMode::Hold, 1, 5), [1.0, 1.0, 2.0, 2.0, 3.0]);
        // 80 ms are two control periods of 50 ms.
        assert_eq!(commands(fixed(0.08), ExecutionMode::Hold, 1, 8), [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 2.0, 2.0]);
        assert_eq!(commands(fixed(0.05), ExecutionMode::Hold, 1, 4), [0.0, 1.0, 1.0, 0.0]);
    }

    #[test]
    fn overlap_never_waits_after_the_first_reply() {
        let found = commands(Latency::Fixed { seconds: 0.08 }, ExecutionMode::Overlap, 1, 9);
        assert_eq!(found[..2], [0.0, 0.0]);
        assert!(found[2..].iter().all(|n| *n > 0.0), "{found:?}");
    }

    #[test]
    fn slow_policies_act_for_several_periods() {
        // A policy of 10 Hz in a world of 20 Hz: each step takes two control periods.
        assert_eq!(
            commands(Latency::Fixed { seconds: 0.0 }, ExecutionMode::Hold, 2, 6),
            [1.0, 1.0, 1.0, 1.0, 2.0, 2.0]
        );
    }

    #[test]
    fn delays_repeat_with_the_seed() {
        let latency = Latency::Gamma { mean_s: 0.1, sd_s: 0.1 };
        let run = || commands(latency.clone(), ExecutionMode::Hold, 1, 100);
        assert_eq!(run(), run());
        assert!(run().contains(&0.0));
    }

    /// A world with a draw and a feature of its own, which only the time limit ends.
    struct World(Arc<TaskSpec>);

    const OWN: Word = Word::constant("own");

    impl World {
        fn new(period_s: f64) -> Box<Self> {
            let mut task = task();
            task.control_period_s = period_s;
            task.time_limit_s = 4000.0 * period_s;
            task.draws.push(DrawSpec { name: OWN, unit: String::new(), meaning: String::new() });
            Box::new(Self(Arc::new(task)))
        }
    }

    impl Environment for World {
        fn task(&self) -> &Arc<TaskSpec> {
            &self.0
        }

        fn foresight(&self) -> Option<Arc<dyn Foresight>> {
            Some(Arc::new(Known))
        }

        fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
            let (instance, observation) = (TaskInstance::default(), Observation::default());
            Ok(Start { instance, observation, applied: scenario.requested.clone() })
        }

        fn step(&mut self, action: &Action) -> Result<Step, Fault> {
            let Command::Vector(numbers) = &action.command else { panic!("{action:?}") };
            Ok(Step {
                observation: Observation::default(),
                measures: Measures::default(),
                ending: None,
                events: Vec::new(),
                state_hash: numbers[0].to_bits(),
            })
        }
    }

    struct Known;

    impl Foresight for Known {
        fn draws(&self, _: &Scenario) -> Result<Measures, Fault> {
            Ok([(OWN, Some(1.0))].into_iter().collect())
        }

        fn feature_specs(&self) -> &[FeatureSpec] {
            &[FeatureSpec { name: "room_m", unit: "m", meaning: "Free space.", better: Better::Higher }]
        }

        fn features(&self, _: &Scenario) -> Result<Vec<f64>, Fault> {
            Ok(vec![0.5])
        }
    }

    fn scenario(index: u64) -> Scenario {
        Scenario { index, seed: Seed::campaign(7).episode(index), requested: Assignment::default() }
    }

    fn delayed(latency: &Latency, period_s: f64) -> (Box<dyn Environment>, Box<dyn Policy>) {
        let execution = Execution { latency: latency.clone(), mode: ExecutionMode::Hold };
        with_latency(World::new(period_s), counting(), execution)
    }

    /// An episode, and the control periods that the robot waited for the reply to each request.
    fn waits(latency: &Latency, period_s: f64) -> (Episode, Vec<u32>) {
        let (mut world, mut policy) = delayed(latency, period_s);
        let (mut waits, mut present) = (Vec::new(), 0);
        let episode = rollout_with(&mut *world, &mut *policy, &scenario(3), &mut |tick| {
            let Command::Vector(numbers) = &tick.action.command else { panic!("{:?}", tick.action) };
            // A command is the number of its request, and 0 while the robot waits.
            if numbers[0] <= 0.0 {
                present += 1;
            } else if numbers[0] > waits.len() as f64 {
                waits.push(std::mem::take(&mut present));
            }
        });
        (episode, waits)
    }

    fn counting() -> Box<Counting> {
        Box::new(Counting { requests: 0.0, periods: 1, present: 0.0 })
    }

    #[test]
    fn parameter_sets_the_latency() {
        let mut latency = scenario(3);
        let commands = |scenario: &Scenario| {
            let (mut world, mut policy) = delayed(&Latency::Parameter, 0.05);
            let mut commands = Vec::new();
            let episode = rollout_with(&mut *world, &mut *policy, scenario, &mut |tick| {
                let Command::Vector(numbers) = &tick.action.command else { panic!("{:?}", tick.action) };
                commands.push(numbers[0]);
            });
            (episode, commands)
        };
        assert_eq!(commands(&latency).1[..4], [1.0, 1.0, 2.0, 2.0]);
        latency.requested.set(LATENCY_PARAMETER, Value::Number(0.08));
        let (episode, commands) = commands(&latency);
        assert_eq!(episode.applied.number(LATENCY_PARAMETER), Some(0.08));
        assert_eq!(commands[..5], [0.0, 0.0, 1.0, 1.0, 0.0]);
    }

    #[test]
    fn unknown_latency_is_a_fault() {
        let execution = Execution { latency: Latency::Parameter, mode: ExecutionMode::Hold };
        let mut policy = Delayed::new(counting(), execution);
        let mut reset = |applied: Option<f64>| {
            if let Some(latency_s) = applied {
                policy.note_applied(&[(LATENCY_PARAMETER.into(), Value::Number(latency_s))].into_iter().collect());
            }
            policy.reset(&task(), &TaskInstance::default(), Seed::campaign(1)).map(|()| policy.applied_s)
        };
        assert_eq!(reset(Some(0.1)), Ok(0.1));
        // The latency of an earlier episode says nothing about the next one.
        assert_eq!(reset(None).unwrap_err().kind, FaultKind::Setup);
    }

    #[test]
    fn adapters_move_between_threads() {
        fn is_send<T: Send>(_: &T) {}
        is_send(&Delayed::new(counting(), Execution { latency: Latency::Parameter, mode: ExecutionMode::Hold }));
    }

    #[test]
    fn batch_with_latency_equals_single_episodes() {
        let scenarios: Vec<Scenario> = (0..9)
            .map(|index| {
                let requested = [(LATENCY_PARAMETER.into(), Value::Number(0.01 * index as f64))].into_iter().collect();
                Scenario { requested, ..scenario(index) }
            })
            .collect();
        for mode in [ExecutionMode::Hold, ExecutionMode::Queue, ExecutionMode::Overlap] {
            for latency in [Latency::Parameter, Latency::Gamma { mean_s: 0.1, sd_s: 0.1 }] {
                let pair = || {
                    let execution = Execution { latency: latency.clone(), mode };
                    with_latency(World::new(0.05), counting(), execution)
                };
                let one = |scenario: &Scenario| {
                    let (mut world, mut policy) = pair();
                    rollout(&mut *world, &mut *policy, scenario)
                };
                let expected: Vec<Episode> = scenarios.iter().map(one).collect();
                let (worlds, policies) = (0..4).map(|_| pair()).unzip();
                let mut worlds = SingleEnvironments::new(worlds).unwrap();
                let found = rollout_all(&mut worlds, &mut SinglePolicies::new(policies), &scenarios);
                assert_eq!(found, expected, "{mode:?} {latency:?}");
                // The commands are part of the hash, and depend on the latency.
                assert!(expected.iter().any(|episode| episode.trajectory_hash != expected[0].trajectory_hash));
            }
        }
    }

    #[test]
    fn draws_are_the_applied_latencies() {
        // Samples of whole control periods show the latencies exactly. Others are rounded up.
        for (latency, period_s, tolerance_s) in [
            (Latency::Measured { samples_s: vec![0.1, 0.2, 0.3] }, 1e-3, 1e-9),
            (Latency::Uniform { low_s: 0.01, high_s: 0.03 }, 1e-4, 1e-4),
            (Latency::Normal { mean_s: 0.02, sd_s: 0.005 }, 1e-4, 1e-4),
            (Latency::Gamma { mean_s: 0.02, sd_s: 0.005 }, 1e-4, 1e-4),
        ] {
            let (episode, waits) = waits(&latency, period_s);
            assert!(waits.len() > REQUESTS && waits.iter().any(|wait| *wait != waits[0]), "{latency:?}: {waits:?}");
            let applied: Vec<f64> = waits[..REQUESTS].iter().map(|wait| f64::from(*wait) * period_s).collect();
            let mean = applied.iter().sum::<f64>() / REQUESTS as f64;
            let longest = applied.iter().copied().fold(0.0, f64::max);
            for (name, applied) in [
                ("inference_latency_first_s", applied[0]),
                ("inference_latency_mean_s", mean),
                ("inference_latency_longest_s", longest),
            ] {
                let draw = episode.draws.get(name).unwrap();
                assert!((-1e-9..=tolerance_s).contains(&(applied - draw)), "{latency:?}: {name} {draw}, {applied}");
            }
        }
    }

    #[test]
    fn draws_follow_from_the_seed() {
        let latency = Latency::Gamma { mean_s: 0.1, sd_s: 0.1 };
        let (world, _) = delayed(&latency, 0.05);
        let foresight = world.foresight().unwrap();
        let draws = world.draws(&scenario(3)).unwrap();
        assert_eq!(foresight.draws(&scenario(3)).unwrap(), draws);
        assert_ne!(foresight.draws(&scenario(4)).unwrap(), draws);
        // The draws and features of the task come first and stay.
        let declared: Vec<Word> = world.task().draws.iter().map(|draw| draw.name).collect();
        assert_eq!(declared, draws.iter().map(|(name, _)| name).collect::<Vec<_>>());
        assert_eq!((declared[0], draws.get("own")), (OWN, Some(1.0)));
        let names: Vec<&str> = foresight.feature_specs().iter().map(|spec| spec.name).collect();
        assert_eq!(names, ["room_m", "inference_latency_mean_s", "inference_latency_longest_s"]);
        let of_latency = [1, 2].map(|at: usize| draws.get(names[at]).unwrap());
        assert_eq!(foresight.features(&scenario(3)).unwrap(), [0.5, of_latency[0], of_latency[1]]);
        assert_eq!(with_declarations(world.task(), &latency), *world.task());
    }

    #[test]
    fn only_sampled_latencies_are_draws() {
        for latency in [Latency::Fixed { seconds: 0.08 }, Latency::Parameter] {
            let (world, _) = delayed(&latency, 0.05);
            let foresight = world.foresight().unwrap();
            assert_eq!(world.draws(&scenario(3)).unwrap(), [(OWN, Some(1.0))].into_iter().collect(), "{latency:?}");
            assert_eq!((world.task().draws.len(), foresight.feature_specs().len()), (1, 1), "{latency:?}");
            assert_eq!(foresight.features(&scenario(3)).unwrap(), [0.5], "{latency:?}");
        }
    }
}
