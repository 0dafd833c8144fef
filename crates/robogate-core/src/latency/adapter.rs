//! Puts latency between any policy and any environment.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;

use super::queue::Queue;
use super::{Execution, LATENCY_PARAMETER, Latency, latency_parameter};
use crate::{
    Action, ActionSpace, ActionSpec, Assignment, Command, Environment, Fault, FaultKind, FeatureSpec, Foresight, Image,
    Infeasibility, Measures, Observation, Policy, PredictedStep, Prediction, Scenario, Seed, Start, Step, Stream,
    TaskInstance, TaskSpec, Trajectory, Value,
};

/// The latency of the scenario, in seconds. The environment's adapter sets it, and the policy's adapter applies it.
type Shared = Rc<Cell<f64>>;

/// Puts latency between a policy and an environment.
///
/// The task of the environment gets the parameter [`LATENCY_PARAMETER`], if the latency is [`Latency::Parameter`] and the
/// task has no parameter of this name.
pub fn with_latency(
    environment: Box<dyn Environment>,
    policy: Box<dyn Policy>,
    execution: Execution,
) -> (Box<dyn Environment>, Box<dyn Policy>) {
    let shared = Shared::default();
    let environment: Box<dyn Environment> = if execution.latency == Latency::Parameter {
        let task = with_parameter(environment.task());
        Box::new(LatencyEnvironment { environment, task, shared: Rc::clone(&shared) })
    } else {
        environment
    };
    (environment, Box::new(Delayed::new(policy, execution, shared)))
}

/// The task with the declaration of the latency.
pub fn with_parameter(task: &Arc<TaskSpec>) -> Arc<TaskSpec> {
    let mut task = (**task).clone();
    if task.parameter(LATENCY_PARAMETER).is_none() {
        task.parameters.push(latency_parameter());
    }
    Arc::new(task)
}

/// An environment whose scenarios have the parameter [`LATENCY_PARAMETER`].
struct LatencyEnvironment {
    environment: Box<dyn Environment>,
    task: Arc<TaskSpec>,
    shared: Shared,
}

/// The knowledge of a task that has no latency.
struct WithoutLatency(Arc<dyn Foresight>);

impl WithoutLatency {
    fn known(scenario: &Scenario) -> Scenario {
        Scenario { requested: without_latency(&scenario.requested), ..scenario.clone() }
    }
}

impl Foresight for WithoutLatency {
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        self.0.draws(&Self::known(scenario))
    }

    fn feature_specs(&self) -> &[FeatureSpec] {
        self.0.feature_specs()
    }

    fn features(&self, scenario: &Scenario) -> Result<Vec<f64>, Fault> {
        self.0.features(&Self::known(scenario))
    }
}

impl Environment for LatencyEnvironment {
    fn task(&self) -> &Arc<TaskSpec> {
        &self.task
    }

    fn foresight(&self) -> Option<Arc<dyn Foresight>> {
        self.environment.foresight().map(|foresight| Arc::new(WithoutLatency(foresight)) as Arc<dyn Foresight>)
    }

    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        let requested = without_latency(&scenario.requested);
        self.environment.draws(&Scenario { requested, ..scenario.clone() })
    }

    fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.environment.infeasibility(&without_latency(requested))
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        self.shared.set(0.0);
        let Some(wanted) = scenario.requested.number(LATENCY_PARAMETER) else {
            return self.environment.reset(scenario);
        };
        if let Err(why) = latency_parameter().accepts(&Value::Number(wanted)) {
            return Err(Fault::new(FaultKind::Setup, why));
        }
        let requested = without_latency(&scenario.requested);
        let mut start = self.environment.reset(&Scenario { requested, ..scenario.clone() })?;
        self.shared.set(wanted);
        start.applied.set(LATENCY_PARAMETER, Value::Number(self.shared.get()));
        Ok(start)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.environment.step(action)
    }

    fn render(&mut self) -> Result<Vec<Image>, Fault> {
        self.environment.render()
    }

    fn render_only(&mut self, cameras: &[&str]) -> Result<Vec<Image>, Fault> {
        self.environment.render_only(cameras)
    }

    fn record_trajectory(&mut self, period_s: Option<f64>) {
        self.environment.record_trajectory(period_s);
    }

    fn take_trajectory(&mut self) -> Option<Trajectory> {
        self.environment.take_trajectory()
    }
}

/// The parameters of the environment itself.
fn without_latency(requested: &Assignment) -> Assignment {
    let others = requested.iter().filter(|(name, _)| *name != LATENCY_PARAMETER);
    others.map(|(name, value)| (name.into(), value.clone())).collect()
}

/// A policy whose actions arrive after a delay.
struct Delayed {
    policy: Box<dyn Policy>,
    latency: Latency,
    shared: Shared,
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

impl Delayed {
    fn new(policy: Box<dyn Policy>, Execution { latency, mode }: Execution, shared: Shared) -> Self {
        Self {
            policy,
            latency,
            shared,
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
        let latency_s = self.latency.sample(&mut self.stream, self.shared.get());
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

impl Policy for Delayed {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.policy.check(task)
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.queue.clear();
        self.pending = None;
        self.tick = 0;
        self.period_s = task.control_period_s;
        self.stream = stream(seed);
        self.hold = Hold { last: None, spec: task.action.clone() };
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

/// The random stream of the latencies of an episode.
fn stream(seed: Seed) -> Stream {
    seed.stream("inference-latency")
}

/// Commands that hold the robot's position.
#[derive(Debug, Default)]
struct Hold {
    last: Option<Action>,
    spec: ActionSpec,
}

impl Hold {
    /// The command while the robot waits.
    ///
    /// A tool stays at its last commanded pose, joints at their last commanded positions, or at the measured ones before
    /// the first action. In a vector, a number whose bounds are symmetric about 0 is a velocity, a change or an effort,
    /// and becomes 0. Any other number is a position and keeps its last value. The gripper keeps its last command, and is
    /// open before the first one.
    fn action(&self, observation: &Observation) -> Action {
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
mod tests {
    use super::super::ExecutionMode;
    use super::*;
    use crate::{ObservationSpec, Word};

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

    fn task() -> TaskSpec {
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
            parameters: Vec::new(),
            observation: ObservationSpec::default(),
            action: ActionSpec { spaces: vec![vector], gripper: None },
            details: serde_json::Value::Null,
        }
    }

    /// The first numbers of the commands in `n` control periods.
    fn commands(latency: Latency, mode: ExecutionMode, periods: u32, n: usize) -> Vec<f64> {
        let policy = Box::new(Counting { requests: 0.0, periods, present: 0.0 });
        let mut policy = Delayed::new(policy, Execution { latency, mode }, Shared::default());
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
}
