//! The policies of the controls of a gate: an expert that acts through a profile, and random actions of a model.

use robogate_core::{
    Action, Assignment, Fault, FaultKind, Observation, Policy, Seed, Stream, TaskInstance, TaskSpec, Word, vectors,
};

use super::decoder::Decoder;
use super::encoder::{Encoder, read_pose, state_numbers};
use super::profile::{Arm, Profile, Side};
use super::suits;

/// The positive control: an expert that sees what the model would see, and whose actions take the path of the model's.
///
/// The expert reads the pose of the tool from the numbers of the profile's states, with the published conventions of the
/// model. Its actions are encoded with these conventions, and then decoded, scaled and executed as the profile says.
pub struct ThroughProfile {
    expert: Box<dyn Policy>,
    profile: Profile,
    reference: Profile,
    encoder: Encoder,
    decoder: Decoder,
    phase: Option<Word>,
}

impl std::fmt::Debug for ThroughProfile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ThroughProfile").field("profile", &self.profile.name).finish_non_exhaustive()
    }
}

impl ThroughProfile {
    /// An expert that acts through `profile`. `reference` has the published conventions of the model.
    pub fn new(expert: Box<dyn Policy>, profile: &Profile, reference: &Profile) -> Self {
        Self {
            expert,
            encoder: Encoder::new(reference),
            decoder: Decoder::new(profile),
            profile: profile.clone(),
            reference: reference.clone(),
            phase: None,
        }
    }

    /// The observation with the pose that the model reads in its state.
    fn seen(&self, observation: &Observation) -> Result<Observation, Fault> {
        let mut seen = Observation { images: Vec::new(), ..observation.clone() };
        let numbers = state_numbers(&self.profile, observation)?;
        let pose = read_pose(&self.reference, &numbers, observation.joint_positions().len());
        if let Some(pose) = pose
            && let Some((_, vector)) = seen.vectors.iter_mut().find(|(name, _)| *name == vectors::TOOL_POSE)
        {
            *vector = pose.to_array().to_vec();
        }
        Ok(seen)
    }
}

impl Policy for ThroughProfile {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        self.expert.check(task)
    }

    fn note_applied(&mut self, applied: &Assignment) {
        self.expert.note_applied(applied);
    }

    fn reset(&mut self, task: &TaskSpec, instance: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.encoder.begin(task)?;
        self.decoder.begin(task)?;
        self.expert.reset(task, instance, seed)
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        if self.decoder.is_empty() {
            let action = self.expert.act(&self.seen(observation)?)?;
            self.phase = action.phase;
            let mut raw = self.encoder.encode(&action, observation)?;
            // Sizes differ if the profile contradicts the published conventions.
            raw.resize(self.decoder.form.size, 0.0);
            self.decoder.put(raw);
        }
        Ok(Action { phase: self.phase, ..self.decoder.next(observation)? })
    }
}

/// The negative control: random numbers in the action space of a model, executed as the profile says.
#[derive(Debug)]
pub struct RandomModel {
    profile: Profile,
    decoder: Decoder,
    stream: Stream,
    bounds: Vec<(f64, f64)>,
}

/// Range of a random motion for a model that sends metres and radians: 0.02 m, or 0.05 rad.
const METRES: f64 = 0.02;
/// Range of a random change of a joint, in radians.
const RADIANS: f64 = 0.05;

impl RandomModel {
    /// Random actions for this profile.
    pub fn new(profile: &Profile) -> Self {
        let stream = Seed::campaign(0).stream("random model");
        Self { decoder: Decoder::new(profile), profile: profile.clone(), stream, bounds: Vec::new() }
    }

    fn draw(&mut self, observation: &Observation) -> Vec<f64> {
        let form = &self.profile.action;
        let stream = &mut self.stream;
        let mut draw = |limit: f64| stream.between(-limit, limit);
        if form.arm == Arm::Vector {
            return self.bounds.iter().map(|(low, high)| 0.5 * (low + high) + draw(0.5 * (high - low))).collect();
        }
        let arms = form.used().saturating_sub(1);
        let limit = |number: usize| match (form.clip, form.arm) {
            (Some(clip), _) => clip,
            (None, Arm::JointDeltas) => RADIANS / form.rotation_scale_rad.abs(),
            (None, _) if number < 3 => METRES / form.position_scale_m.abs(),
            (None, _) => RADIANS / form.rotation_scale_rad.abs(),
        };
        let mut raw: Vec<f64> = match form.arm {
            Arm::JointPositions => {
                let unit = self.profile.tool.joint_unit_rad.unwrap_or(1.0);
                observation.joint_positions().iter().map(|q| (q + draw(RADIANS)) / unit).collect()
            }
            _ => (0..arms).map(|number| draw(limit(number))).collect(),
        };
        raw.resize(arms, 0.0);
        let threshold = form.gripper_threshold.unwrap_or_default();
        let open = draw(1.0) > 0.0;
        let above = open == (form.gripper_open == Some(Side::Above));
        raw.push(if above { threshold + 0.5 } else { threshold - 0.5 });
        raw.resize(form.size, 0.0);
        raw
    }
}

impl Policy for RandomModel {
    fn check(&self, task: &TaskSpec) -> Result<(), String> {
        suits::check_task(&self.profile, task)
    }

    fn reset(&mut self, task: &TaskSpec, _: &TaskInstance, seed: Seed) -> Result<(), Fault> {
        self.decoder.begin(task)?;
        self.stream = seed.stream("random model");
        let bounds = task.action.vector().map(|(low, high)| low.iter().copied().zip(high.iter().copied()).collect());
        self.bounds = bounds.unwrap_or_default();
        if self.profile.action.arm == Arm::Vector && self.bounds.is_empty() {
            return Err(Fault::new(FaultKind::Setup, "the task takes no vectors"));
        }
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Action, Fault> {
        if self.decoder.is_empty() {
            let raw = self.draw(observation);
            self.decoder.put(raw);
        }
        Ok(self.decoder.next(observation)?)
    }
}
