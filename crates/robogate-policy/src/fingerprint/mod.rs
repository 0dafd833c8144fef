//! Behavioural fingerprints: what a policy answers to requests of the episodes by which it was judged.
//!
//! A fingerprint has requests as the dialect of the profile sends them, so a deployed server can be asked the same without a
//! simulator. Each answer is that of a new episode of the policy: a memory of the policy has no effect.

mod admission;
mod alike;
mod camera;
mod changes;
mod file;
mod recorder;
mod relation;
#[cfg(test)]
mod tests;

pub use admission::{Admission, admit};
pub use alike::Likeness;
pub use camera::{CameraCheck, CellImage, compare_camera};
pub use recorder::Recorder;

use serde_json::Value as Json;

use crate::chunk::Chunk;
use crate::error::PolicyError;
use crate::external::ExternalPolicy;
use crate::profile::Profile;
use crate::query::Query;

/// Most requests of a fingerprint.
pub const MOST_PROBES: usize = 64;
/// Answers to each request of a policy whose answers are repeatable, and of a random one.
const ANSWERS: [usize; 2] = [2, 16];
/// Requests of a random policy.
const RANDOM_PROBES: usize = 16;
/// Requests that are enough to see whether a change has an effect.
const FEW: usize = 4;
/// The largest difference of two answers to one request of a repeatable policy, in spreads of the number.
const REPEATABLE: f64 = 0.01;
/// The smallest tolerance, in spreads. Single precision on other processors differs by less, half precision by more.
const TOLERANCE: f64 = 2e-4;
/// The largest difference between two repeats, as a multiple, that is still tolerated.
const REPEATS: f64 = 5.0;

/// A policy that can be asked single requests.
pub trait Asked {
    /// The answer to a request in a new episode of the policy.
    fn ask(&mut self, query: &Query) -> Result<Chunk, PolicyError>;

    /// What the policy reports about itself.
    fn declared(&self) -> &Json;

    /// Whether it answers other requests than the recorded ones. Otherwise no cause is looked for by changing requests.
    fn takes_changed_requests(&self) -> bool {
        true
    }
}

impl Asked for ExternalPolicy {
    fn ask(&mut self, query: &Query) -> Result<Chunk, PolicyError> {
        Self::ask(self, query)
    }

    fn declared(&self) -> &Json {
        Self::declared(self)
    }
}

/// A request, and the answers to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Probe {
    /// The request.
    pub query: Query,
    /// The answers, each in a new episode of the policy.
    pub answers: Vec<Chunk>,
}

/// What a policy answers to some requests.
#[derive(Debug, Clone, PartialEq)]
pub struct Fingerprint {
    /// The profile of the policy.
    pub profile: Profile,
    /// What the policy reported about itself.
    pub declared: Json,
    /// The control period of the task, in seconds.
    pub control_period_s: f64,
    /// The inputs that have an effect on the answers: images, states, `instruction`.
    pub used: Vec<String>,
    /// The requests with their answers.
    pub probes: Vec<Probe>,
}

impl Fingerprint {
    /// Ask a policy these requests, twice and in both orders; a policy with random answers more often. Then find the inputs that have
    /// an effect.
    pub fn measure(
        queries: Vec<Query>,
        policy: &mut dyn Asked,
        profile: &Profile,
        control_period_s: f64,
    ) -> Result<Self, PolicyError> {
        let mut fingerprint = Self::answers(queries, policy, profile, control_period_s)?;
        if let Some(first) =
            fingerprint.probes.first().filter(|_| !fingerprint.is_random() && policy.takes_changed_requests())
        {
            let inputs = changes::inputs(&first.query);
            for input in inputs {
                if fingerprint.is_used(&input, policy)? {
                    fingerprint.used.push(input);
                }
            }
        }
        Ok(fingerprint)
    }

    /// Like [`Self::measure`], without the inputs that have an effect.
    pub fn answers(
        queries: Vec<Query>,
        policy: &mut dyn Asked,
        profile: &Profile,
        control_period_s: f64,
    ) -> Result<Self, PolicyError> {
        let mut probes: Vec<Probe> =
            queries.into_iter().map(|query| Probe { query, answers: Vec::with_capacity(ANSWERS[0]) }).collect();
        let mut ask = |probe: &mut Probe| {
            probe.answers.push(policy.ask(&probe.query)?);
            Ok(())
        };
        probes.iter_mut().try_for_each(&mut ask)?;
        probes.iter_mut().rev().try_for_each(&mut ask)?;
        let (declared, used) = (Json::Null, Vec::new());
        let mut fingerprint = Self { profile: profile.clone(), declared, control_period_s, used, probes };
        if fingerprint.is_random() {
            fingerprint.probes.truncate(RANDOM_PROBES);
            for _ in ANSWERS[0]..ANSWERS[1] {
                fingerprint.probes.iter_mut().try_for_each(&mut ask)?;
            }
        }
        fingerprint.declared = policy.declared().clone();
        Ok(fingerprint)
    }

    /// Whether an input has an effect on the answers of a policy to some of the requests.
    fn is_used(&self, input: &str, policy: &mut dyn Asked) -> Result<bool, PolicyError> {
        let spreads = self.spreads();
        for probe in self.probes.iter().take(FEW) {
            let [with, without] = [&probe.query, &changes::without(&probe.query, input)].map(|query| policy.ask(query));
            if difference(&with?, &without?, &spreads) > self.tolerance() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The standard deviation of each number of an action over all first answers. A number that hardly varies has a hundredth of its
    /// largest magnitude.
    fn spreads(&self) -> Vec<f64> {
        let rows = || self.probes.iter().filter_map(|probe| probe.answers.first()).flat_map(Chunk::rows);
        let size = rows().map(Vec::len).min().unwrap_or(0);
        let n = rows().count().max(1) as f64;
        (0..size)
            .map(|at| {
                let mean = rows().map(|row| row[at]).sum::<f64>() / n;
                let variance = rows().map(|row| (row[at] - mean).powi(2)).sum::<f64>() / n;
                let largest = rows().map(|row| row[at].abs()).fold(0.0, f64::max);
                variance.sqrt().max(0.01 * largest).max(1e-9)
            })
            .collect()
    }

    /// The largest difference between two answers to the same request, in spreads. Infinite if they have different sizes.
    fn repeat_error(&self) -> f64 {
        let spreads = self.spreads();
        let of = |probe: &Probe| match probe.answers.as_slice() {
            [first, second, ..] => difference(first, second, &spreads),
            _ => 0.0,
        };
        self.probes.iter().map(of).fold(0.0, f64::max)
    }

    /// Whether the answers to one request differ by more than rounding.
    pub fn is_random(&self) -> bool {
        self.repeat_error() > REPEATABLE
    }

    /// The largest difference that is admitted, in spreads.
    pub fn tolerance(&self) -> f64 {
        (REPEATS * self.repeat_error()).max(TOLERANCE)
    }
}

/// The largest difference of two answers, in spreads. Infinite if they have different sizes.
fn difference(a: &Chunk, b: &Chunk, spreads: &[f64]) -> f64 {
    let same = |(a, b): (&Vec<f64>, &Vec<f64>)| a.len() == b.len() && a.len() == spreads.len();
    if a.rows().len() != b.rows().len() || !a.rows().iter().zip(b.rows()).all(same) {
        return f64::INFINITY;
    }
    let rows = a.rows().iter().zip(b.rows());
    let numbers = rows.flat_map(|(a, b)| a.iter().zip(b).zip(spreads));
    // A number that is not finite is a difference.
    let apart = |((a, b), spread): ((&f64, &f64), &f64)| Some((a - b).abs() / spread).filter(|x| !x.is_nan());
    numbers.map(|pair| apart(pair).unwrap_or(f64::INFINITY)).fold(0.0, f64::max)
}
