//! Puts stress between any policy and any environment.

use std::collections::VecDeque;
use std::sync::Arc;

use super::image::Changes;
use super::words::{in_case, with_typos};
use super::{STRESS_PREFIX, Stress};
use crate::latency::Hold;
use crate::{
    Action, Assignment, Command, Environment, Fault, FaultKind, FeatureSpec, Foresight, Image, Infeasibility, Measures,
    Observation, Policy, Scenario, Seed, Start, Step, Stream, TaskInstance, TaskSpec, Word,
};

/// Puts stress between a policy and an environment.
///
/// The task of the environment gets the declarations of [`Stress::declared_in`]. The environment lists the parameters of stress among
/// the applied ones, and the policy takes its values from there ([`Policy::note_applied`]). A latency belongs inside of it.
pub fn with_stress(
    environment: Box<dyn Environment>,
    policy: Box<dyn Policy>,
    stress: &Stress,
) -> (Box<dyn Environment>, Box<dyn Policy>) {
    let task = stress.declared_in(environment.task());
    let policy = Stressed { policy, stress: stress.clone(), values: Assignment::default(), episode: None };
    (Box::new(StressedEnvironment { environment, task }), Box::new(policy))
}

/// The parameters of the environment itself.
fn without_stress(requested: &Assignment) -> Assignment {
    let others = requested.iter().filter(|(name, _)| !name.starts_with(STRESS_PREFIX));
    others.map(|(name, value)| (name.into(), value.clone())).collect()
}

fn of_environment(scenario: &Scenario) -> Scenario {
    Scenario { requested: without_stress(&scenario.requested), ..scenario.clone() }
}

/// An environment whose scenarios may have parameters of stress.
struct StressedEnvironment {
    environment: Box<dyn Environment>,
    task: Arc<TaskSpec>,
}

/// The knowledge of a task that does not know about stress.
struct StressedForesight(Arc<dyn Foresight>);

impl Foresight for StressedForesight {
    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        self.0.draws(&of_environment(scenario))
    }

    fn feature_specs(&self) -> &[FeatureSpec] {
        self.0.feature_specs()
    }

    fn features(&self, scenario: &Scenario) -> Result<Vec<f64>, Fault> {
        self.0.features(&of_environment(scenario))
    }
}

impl Environment for StressedEnvironment {
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
        Some(Arc::new(StressedForesight(self.environment.foresight()?)))
    }

    fn draws(&self, scenario: &Scenario) -> Result<Measures, Fault> {
        self.environment.draws(&of_environment(scenario))
    }

    fn infeasibility(&self, requested: &Assignment) -> Option<Infeasibility> {
        self.environment.infeasibility(&without_stress(requested))
    }

    fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
        let own = scenario.requested.iter().filter(|(name, _)| name.starts_with(STRESS_PREFIX));
        let own: Vec<_> = own.map(|(name, value)| (name.to_owned(), value.clone())).collect();
        for (name, value) in &own {
            let unknown = || Fault::new(FaultKind::Setup, format!("`{name}` is not a parameter of this run"));
            let spec = self.task.parameter(name).ok_or_else(unknown)?;
            spec.accepts(value).map_err(|why| Fault::new(FaultKind::Setup, why))?;
        }
        let mut start = self.environment.reset(&of_environment(scenario))?;
        own.into_iter().for_each(|(name, value)| start.applied.set(&*name, value));
        Ok(start)
    }

    fn step(&mut self, action: &Action) -> Result<Step, Fault> {
        self.environment.step(action)
    }
}

/// A policy that receives and acts through the stress of the episode.
struct Stressed {
    policy: Box<dyn Policy>,
    stress: Stress,
    /// The applied parameters of the next episode.
    values: Assignment,
    /// `None` if no parameter of this episode has an effect.
    episode: Option<Episode>,
}

/// The stress of one episode.
struct Episode {
    changes: Changes,
    state_noise: f64,
    state_bias: f64,
    action_step: f64,
    dropped_frames: f64,
    /// Delays in control periods.
    delayed_frames: usize,
    delayed_state: usize,
    delayed_action: usize,
    /// The camera whose images are black.
    dropped_camera: Option<String>,
    /// Whether images of each control period are needed, because some arrive late or not at all.
    needs_images: bool,
    /// For the places of occlusions.
    places: Stream,
    noise: Stream,
    drops: Stream,
    /// Where the occlusion of each camera is.
    place: Vec<(String, [f64; 2])>,
    /// The offset of each number of the state.
    bias: Vec<Vec<f64>>,
    states: VecDeque<Vec<(Word, Vec<f64>)>>,
    images: VecDeque<Vec<Image>>,
    delivered: Vec<Image>,
    commands: VecDeque<Action>,
    hold: Hold,
}

impl Episode {
    /// The stress of these values. `None` without effect.
    fn new(values: &Assignment, task: &TaskSpec, uses_images: bool, seed: Seed) -> Option<Self> {
        let number = |name: &str, nominal: f64| values.number(&format!("{STRESS_PREFIX}{name}")).unwrap_or(nominal);
        let count = |name: &str| number(name, 0.0) as usize;
        let changes = Changes {
            noise: number("noise", 0.0),
            blur_px: number("blur_px", 0.0),
            brightness: number("brightness", 0.0),
            contrast: number("contrast", 1.0),
            warmth: number("warmth", 0.0),
            jpeg_loss: number("jpeg_loss", 0.0),
            occlusion: number("occlusion", 0.0),
            crop: number("crop", 0.0),
            rotation_deg: number("rotation_deg", 0.0),
        };
        let dropped_camera = count("dropped_camera").checked_sub(1);
        let dropped_camera = dropped_camera.and_then(|at| Some(task.observation.cameras.get(at)?.name.to_string()));
        let (dropped_frames, delayed_frames) = (number("dropped_frames", 0.0), count("delayed_frames"));
        let stream = |purpose: &str| seed.stream(&format!("stress {purpose}"));
        let episode = Self {
            state_noise: number("state_noise", 0.0),
            state_bias: number("state_bias", 0.0),
            action_step: number("action_step", 0.0),
            dropped_frames,
            delayed_frames,
            delayed_state: count("delayed_state"),
            delayed_action: count("delayed_action"),
            dropped_camera,
            needs_images: uses_images && (dropped_frames > 0.0 || delayed_frames > 0),
            places: stream("places"),
            noise: stream("noise"),
            drops: stream("drops"),
            place: Vec::new(),
            bias: Vec::new(),
            states: VecDeque::new(),
            images: VecDeque::new(),
            delivered: Vec::new(),
            commands: VecDeque::new(),
            hold: Hold::of(task),
            changes,
        };
        episode.has_effect().then_some(episode)
    }

    fn has_effect(&self) -> bool {
        let numbers = [self.state_noise, self.state_bias, self.action_step, self.dropped_frames];
        let delays = [self.delayed_frames, self.delayed_state, self.delayed_action];
        self.changes != Changes::default()
            || self.dropped_camera.is_some()
            || numbers.iter().any(|number| *number > 0.0)
            || delays.iter().any(|delay| *delay > 0)
    }

    /// What the policy receives of this observation.
    fn seen(&mut self, observation: &Observation) -> Observation {
        let vectors = self.state(observation);
        let images = if observation.images.is_empty() { Vec::new() } else { self.pictures(&observation.images) };
        Observation { time_s: observation.time_s, vectors, images }
    }

    fn state(&mut self, observation: &Observation) -> Vec<(Word, Vec<f64>)> {
        self.states.push_back(observation.vectors.clone());
        if self.states.len() > self.delayed_state + 1 {
            self.states.pop_front();
        }
        let mut vectors = self.states.front().cloned().unwrap_or_default();
        if self.state_bias > 0.0 && self.bias.is_empty() {
            let (stream, deviation) = (&mut self.noise, self.state_bias);
            let offsets = |(_, values): &(Word, Vec<f64>)| values.iter().map(|_| deviation * stream.normal()).collect();
            self.bias = vectors.iter().map(offsets).collect();
        }
        for (index, (_, values)) in vectors.iter_mut().enumerate() {
            for (at, value) in values.iter_mut().enumerate() {
                let offset = self.bias.get(index).and_then(|offsets| offsets.get(at));
                let noise = if self.state_noise > 0.0 { self.state_noise * self.noise.normal() } else { 0.0 };
                *value += offset.unwrap_or(&0.0) + noise;
            }
        }
        vectors
    }

    fn pictures(&mut self, images: &[Image]) -> Vec<Image> {
        self.images.push_back(images.to_vec());
        if self.images.len() > self.delayed_frames + 1 {
            self.images.pop_front();
        }
        let mut seen = self.images.front().cloned().unwrap_or_default();
        for image in &mut seen {
            let before = self.delivered.iter().find(|before| before.camera == image.camera);
            let dropped = self.dropped_frames > 0.0 && self.drops.uniform() < self.dropped_frames;
            if let (true, Some(before)) = (dropped, before) {
                image.clone_from(before);
                continue;
            }
            if self.place.iter().all(|(camera, _)| *camera != image.camera) {
                self.place.push((image.camera.clone(), [self.places.uniform(), self.places.uniform()]));
            }
            let place = self.place.iter().find(|(camera, _)| *camera == image.camera);
            let place = place.map_or([0.5; 2], |(_, place)| *place);
            if self.dropped_camera.as_ref() == Some(&image.camera) {
                image.rgb.fill(0);
            } else {
                self.changes.apply(image, place, &mut self.noise);
            }
        }
        if self.dropped_frames > 0.0 {
            self.delivered.clone_from(&seen);
        }
        seen
    }

    /// What the robot executes in this control period.
    fn executed(&mut self, mut action: Action, observation: &Observation) -> Action {
        if self.action_step > 0.0 {
            round(&mut action.command, self.action_step, self.hold.bounds());
        }
        if self.delayed_action == 0 {
            return action;
        }
        self.commands.push_back(action);
        if self.commands.len() <= self.delayed_action {
            return self.hold.action(observation);
        }
        self.commands.pop_front().unwrap_or_else(|| self.hold.action(observation))
    }
}

/// Rounds a command. A number of a vector stays within its bounds.
fn round(command: &mut Command, step: f64, (low, high): (&[f64], &[f64])) {
    let nearest = |value: &mut f64| *value = (*value / step).round() * step;
    match command {
        Command::JointPosition(numbers) => numbers.iter_mut().for_each(nearest),
        Command::Vector(numbers) => {
            for (value, (low, high)) in numbers.iter_mut().zip(low.iter().zip(high)) {
                nearest(value);
                *value = value.max(*low).min(*high);
            }
        }
        Command::ToolDelta { translation_m, rotation_rad } => {
            translation_m.iter_mut().chain(rotation_rad).for_each(nearest);
        }
    }
}

impl Policy for Stressed {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.policy.check(task)
    }

    fn note_applied(&mut self, applied: &Assignment) {
        self.values = applied.clone();
        self.policy.note_applied(applied);
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        let number = |name: &str| self.values.number(&format!("{STRESS_PREFIX}{name}")).unwrap_or(0.0);
        let wording = (number("wording") as usize).checked_sub(1);
        let text = wording.and_then(|at| self.stress.wordings.get(at)).unwrap_or(&instance.instruction);
        let mut instance = instance.clone();
        instance.instruction =
            in_case(&with_typos(text, number("typos"), &mut seed.stream("stress words")), number("letter_case") as i64);
        self.policy.reset(task, &instance, seed)?;
        let uses_images = self.policy.wants_images() || self.policy.observes_images();
        self.episode = Episode::new(&self.values, task, uses_images, seed);
        Ok(())
    }

    fn wants_images(&self) -> bool {
        self.policy.wants_images() || self.episode.as_ref().is_some_and(|episode| episode.needs_images)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        let Some(episode) = &mut self.episode else { return self.policy.act(observation) };
        let mut seen = episode.seen(observation);
        if !self.policy.wants_images() {
            // A policy gets images only when it asks for them.
            seen.images.clear();
        }
        let action = self.policy.act(&seen)?;
        Ok(episode.executed(action, observation))
    }

    fn gave_up(&self) -> bool {
        self.episode.is_none() && self.policy.gave_up()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::latency::number_task;
    use crate::{CameraSpec, Ending, Episode, ObservationSpec, Value, rollout};

    /// What a policy has received.
    #[derive(Default)]
    struct Log {
        instruction: String,
        states: Vec<f64>,
        images: Vec<u8>,
    }

    /// Acts with the number of the call, and notes what it receives.
    struct Noting(Arc<Mutex<Log>>, f64);

    impl Policy for Noting {
        fn check(&self, _: &TaskSpec) -> Result<(), String> {
            Ok(())
        }

        fn reset(&mut self, _: &TaskSpec, instance: &TaskInstance, _: Seed) -> Result<(), Fault> {
            *self.0.lock().unwrap() = Log { instruction: instance.instruction.clone(), ..Log::default() };
            self.1 = 0.0;
            Ok(())
        }

        fn wants_images(&self) -> bool {
            true
        }

        fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
            let mut log = self.0.lock().unwrap();
            log.states.push(observation.vectors[0].1[0]);
            log.images.push(observation.images[0].rgb[0]);
            self.1 += 1.0;
            Ok(Action { command: Command::Vector(vec![self.1]), gripper: None, phase: None })
        }
    }

    /// A world whose state and image are the number of the control period, and which notes its commands.
    struct Counting {
        task: Arc<TaskSpec>,
        tick: u32,
        commands: Arc<Mutex<Vec<f64>>>,
    }

    impl Counting {
        fn observation(&self) -> Observation {
            let vectors = vec![(Word::constant("tick"), vec![f64::from(self.tick)])];
            Observation { time_s: 0.1 * f64::from(self.tick), vectors, images: Vec::new() }
        }
    }

    impl Environment for Counting {
        fn task(&self) -> &Arc<TaskSpec> {
            &self.task
        }

        fn draws(&self, _: &Scenario) -> Result<Measures, Fault> {
            Ok(Measures::default())
        }

        fn reset(&mut self, scenario: &Scenario) -> Result<Start, Fault> {
            assert!(scenario.requested.iter().next().is_none(), "the environment does not know stress");
            self.tick = 0;
            self.commands.lock().unwrap().clear();
            let instance = TaskInstance { instruction: "push it".to_owned(), ..TaskInstance::default() };
            Ok(Start { observation: self.observation(), applied: Assignment::default(), instance })
        }

        fn step(&mut self, action: &Action) -> Result<Step, Fault> {
            let Command::Vector(numbers) = &action.command else { panic!("{action:?}") };
            self.commands.lock().unwrap().push(numbers[0]);
            self.tick += 1;
            let ending = (self.tick == 12).then_some(Ending { failure: None, time_s: 1.2, contact: None });
            Ok(Step {
                observation: self.observation(),
                measures: Measures::default(),
                ending,
                events: Vec::new(),
                state_hash: u64::from(self.tick),
            })
        }

        fn render(&mut self) -> Result<Vec<Image>, Fault> {
            Ok(vec![Image { camera: "front".to_owned(), width: 1, height: 1, rgb: vec![self.tick as u8; 3] }])
        }
    }

    fn with_camera() -> ObservationSpec {
        let camera = CameraSpec { name: "front".to_owned(), width: 1, height: 1 };
        ObservationSpec { cameras: vec![camera], ..ObservationSpec::default() }
    }

    fn run(values: &[(&str, Value)]) -> (Episode, Log, Vec<f64>) {
        let (log, commands) = (Arc::new(Mutex::new(Log::default())), Arc::new(Mutex::new(Vec::new())));
        let task = Arc::new(TaskSpec { time_limit_s: 2.0, observation: with_camera(), ..number_task() });
        let world = Counting { task, tick: 0, commands: Arc::clone(&commands) };
        let all = super::super::STRESS.iter().map(|row| row.name.to_owned()).collect();
        let stress = Stress { parameters: all, wordings: vec!["shove it away".to_owned()] };
        let policy = Noting(Arc::clone(&log), 0.0);
        let (mut world, mut policy) = with_stress(Box::new(world), Box::new(policy), &stress);
        let requested = values.iter().map(|(name, value)| (format!("{STRESS_PREFIX}{name}").into(), value.clone()));
        let scenario = Scenario { index: 3, seed: Seed::campaign(5).episode(3), requested: requested.collect() };
        let episode = rollout(&mut *world, &mut *policy, &scenario);
        drop((world, policy));
        let commands = commands.lock().unwrap().clone();
        (episode, Arc::into_inner(log).unwrap().into_inner().unwrap(), commands)
    }

    #[test]
    fn nominal_stress_changes_nothing() {
        let (episode, log, commands) = run(&[("noise", Value::Number(0.0))]);
        assert_eq!(episode.applied.number("transit_noise"), Some(0.0));
        assert_eq!(log.instruction, "push it");
        assert_eq!(log.states[..4], [0.0, 1.0, 2.0, 3.0]);
        assert_eq!((log.images[..4].to_vec(), commands[..3].to_vec()), (vec![0, 1, 2, 3], vec![1.0, 2.0, 3.0]));
    }

    #[test]
    fn late_images_states_and_commands_arrive_late() {
        let (_, log, commands) = run(&[
            ("delayed_frames", Value::Integer(2)),
            ("delayed_state", Value::Integer(3)),
            ("delayed_action", Value::Integer(1)),
        ]);
        assert_eq!(log.images[..6], [0, 0, 0, 1, 2, 3]);
        assert_eq!(log.states[..6], [0.0, 0.0, 0.0, 0.0, 1.0, 2.0]);
        assert_eq!(commands[1..4], [1.0, 2.0, 3.0]);
    }

    #[test]
    fn dropped_frames_repeat_the_last_one() {
        let (_, log, _) = run(&[("dropped_frames", Value::Number(0.6))]);
        let repeats = log.images.windows(2).filter(|pair| pair[0] == pair[1]).count();
        assert!((3..=10).contains(&repeats), "{:?}", log.images);
        assert!(log.images.is_sorted());
    }

    #[test]
    fn words_and_state_follow_the_seed() {
        let values =
            [("wording", Value::Integer(1)), ("letter_case", Value::Integer(2)), ("state_bias", Value::Number(0.1))];
        let (first, log, _) = run(&values);
        assert_eq!(log.instruction, "SHOVE IT AWAY");
        let offset = log.states[0];
        assert!(offset.abs() > 0.0 && log.states.iter().enumerate().all(|(k, x)| (x - k as f64 - offset).abs() < 1e-9));
        assert_eq!(first, run(&values).0);
    }

    #[test]
    fn rounded_commands_stay_within_their_bounds() {
        let mut command = Command::Vector(vec![1.0, -1.0, 0.4]);
        round(&mut command, 0.06, (&[-1.0; 3], &[1.0; 3]));
        let Command::Vector(numbers) = &command else { panic!("{command:?}") };
        assert_eq!(numbers[..2], [1.0, -1.0]);
        assert!((numbers[2] - 0.42).abs() < 1e-12);
    }

    #[test]
    fn parameters_without_effect_are_not_declared() {
        let all: Vec<String> = super::super::STRESS.iter().map(|row| row.name.to_owned()).collect();
        let stress = Stress { parameters: all, wordings: vec!["a".to_owned(), "b".to_owned()] };
        let task = stress.declared_in(&Arc::new(number_task()));
        assert!(task.parameter("transit_noise").is_none(), "the task has no cameras");
        let wording = task.parameter("transit_wording").unwrap();
        assert!(wording.accepts(&Value::Integer(2)).is_ok() && wording.accepts(&Value::Integer(3)).is_err());
        assert!(stress.without_effect(&task).contains(&"transit_dropped_camera"));
    }

    #[test]
    fn values_beyond_the_range_are_faults() {
        let (episode, ..) = run(&[("noise", Value::Number(1e9))]);
        assert!(matches!(episode.outcome, crate::Outcome::Invalid(_)), "{episode:?}");
    }
}
