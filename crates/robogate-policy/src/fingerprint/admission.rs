//! Compares a deployed policy with a fingerprint.

use serde_json::Value as Json;

use super::changes::changes;
use super::relation::{DIFFERS, relations};
use super::{Asked, FEW, Fingerprint, difference};
use crate::chunk::Chunk;
use crate::error::PolicyError;
use crate::query::Query;

/// Rearrangements of a permutation test, and its level.
const PERMUTATIONS: u64 = 1999;
const LEVEL: f64 = 0.001;

/// The result of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Admission {
    /// Requests that were compared.
    pub requests: usize,
    /// The largest difference of an answer, in spreads of its number. `None` for a policy with random answers.
    pub largest: Option<f64>,
    /// The largest difference that is admitted.
    pub tolerance: f64,
    /// For random answers: the p-value of the hypothesis that both policies have the same distribution of answers.
    pub p_value: Option<f64>,
    /// The differences, in words. Empty if the policy is admitted.
    pub differences: Vec<String>,
}

impl Admission {
    /// Whether the deployed policy answers as the judged one.
    pub fn is_admitted(&self) -> bool {
        self.differences.is_empty()
    }
}

/// Ask a deployed policy the requests of a fingerprint, and explain what differs.
///
/// # Errors
/// If the policy does not answer. Then it is not admitted.
pub fn admit(judged: &Fingerprint, policy: &mut dyn Asked) -> Result<Admission, PolicyError> {
    let mut differences = declared_differences(&judged.declared, policy.declared());
    let (requests, tolerance) = (judged.probes.len(), judged.tolerance());
    if judged.is_random() {
        let answers = judged.probes.iter().map(|probe| {
            let ask = |_| policy.ask(&probe.query);
            (0..probe.answers.len()).map(ask).collect::<Result<Vec<_>, _>>()
        });
        let answers = answers.collect::<Result<Vec<_>, _>>()?;
        if let Some(words) = not_finite(answers.iter().map(Vec::as_slice)) {
            differences.push(words);
            return Ok(Admission { requests, largest: None, tolerance, p_value: None, differences });
        }
        let p_value = same_distribution(judged, &answers);
        if p_value < LEVEL {
            differences.push(format!("the answers have another distribution (p = {p_value:.4})"));
        }
        return Ok(Admission { requests, largest: None, tolerance, p_value: Some(p_value), differences });
    }
    let answers: Vec<Chunk> =
        judged.probes.iter().map(|probe| policy.ask(&probe.query)).collect::<Result<Vec<_>, _>>()?;
    if let Some(words) = not_finite(answers.iter().map(std::slice::from_ref)) {
        differences.push(words);
        return Ok(Admission { requests, largest: None, tolerance, p_value: None, differences });
    }
    let spreads = judged.spreads();
    let worst = |answers: &[Chunk]| {
        let each =
            judged.probes.iter().zip(answers).map(|(probe, answer)| difference(&probe.answers[0], answer, &spreads));
        each.fold(0.0, f64::max)
    };
    let largest = worst(&answers);
    if largest > tolerance {
        // If the sizes of answers differ, that is the cause, and no other one is looked for.
        let sized = largest.is_finite() && policy.takes_changed_requests();
        let causes = if sized { causes(judged, policy, largest)? } else { Vec::new() };
        let mut ignored = Vec::new();
        for input in judged.used.iter().filter(|_| sized) {
            if !judged.is_used(input, policy)? {
                ignored.push(format!("`{input}` has no effect on the answers"));
            }
        }
        if ignored.len() > 1 && ignored.len() == judged.used.len() {
            ignored = vec!["the answers do not depend on the request".to_owned()];
        }
        let explained: Vec<String> = causes.into_iter().chain(ignored).collect();
        let relations = relations(judged, &answers);
        // Both may be the cause: a change of the sign of the inputs of an odd function is one of its outputs.
        let also = explained.is_empty() || relations.iter().all(|words| !words.ends_with(DIFFERS));
        differences.extend(explained);
        differences.extend(relations.into_iter().filter(|_| also));
        if differences.is_empty() {
            differences.push("the answers differ, and no known change explains it: other weights?".to_owned());
        }
    }
    Ok(Admission { requests, largest: Some(largest), tolerance, p_value: None, differences })
}

/// What is wrong if some answers contain NaN or infinity: such an answer equals no other one, and no change explains it.
fn not_finite<'a>(requests: impl Iterator<Item = &'a [Chunk]>) -> Option<String> {
    let broken = |chunk: &Chunk| chunk.rows().iter().any(|row| row.iter().any(|number| !number.is_finite()));
    let (mut wrong, mut all) = (0, 0);
    for answers in requests {
        all += 1;
        wrong += usize::from(answers.iter().any(broken));
    }
    (wrong > 0).then(|| format!("the answers to {wrong} of {all} requests contain numbers that are not finite"))
}

/// The changes of the request after which the deployed policy answers as the judged one.
fn causes(judged: &Fingerprint, policy: &mut dyn Asked, largest: f64) -> Result<Vec<String>, PolicyError> {
    let spreads = judged.spreads();
    let Some(first) = judged.probes.first() else { return Ok(Vec::new()) };
    let enough = judged.tolerance().max(0.002).min(0.2 * largest);
    let mut found: Vec<(f64, String)> = Vec::new();
    for change in changes(&first.query) {
        let mut worst: f64 = 0.0;
        let probes = judged.probes.iter().filter_map(|probe| Some((change.of(&probe.query)?, &probe.answers[0])));
        let probes: Vec<(Query, &Chunk)> = probes.take(2 * FEW).collect();
        if probes.is_empty() {
            continue;
        }
        for (query, answer) in probes {
            worst = worst.max(difference(answer, &policy.ask(&query)?, &spreads));
            if worst > enough {
                break;
            }
        }
        if worst <= enough {
            found.push((worst, change.cause));
        }
    }
    // The best one, with others that explain the answers as well.
    let best = found.iter().map(|(error, _)| *error).fold(f64::INFINITY, f64::min);
    Ok(found.into_iter().filter(|(error, _)| *error <= best.max(judged.tolerance())).map(|(_, cause)| cause).collect())
}

/// The p-value of a permutation test: distance between the mean answers, over all requests. Both policies answered each request
/// equally often.
fn same_distribution(judged: &Fingerprint, deployed: &[Vec<Chunk>]) -> f64 {
    let flat = |chunk: &Chunk| chunk.rows().concat();
    let sets: Vec<[Vec<Vec<f64>>; 2]> = judged
        .probes
        .iter()
        .zip(deployed)
        .map(|(probe, answers)| [&probe.answers, answers].map(|answers| answers.iter().map(flat).collect()))
        .collect();
    let uneven = |sets: &[Vec<Vec<f64>>; 2]| sets.iter().flatten().any(|one| one.len() != sets[0][0].len());
    if sets.iter().any(uneven) {
        return 0.0;
    }
    let pooled: Vec<Vec<&Vec<f64>>> = sets.iter().map(|sets| sets.iter().flatten().collect()).collect();
    // The sum of squared differences of means, each number in units of its pooled variance.
    let scales: Vec<Vec<f64>> = pooled.iter().map(|all| variances(all)).collect();
    let statistic = |labels: &dyn Fn(usize) -> Vec<bool>| -> f64 {
        let of = |(at, all): (usize, &Vec<&Vec<f64>>)| distance(all, &labels(at), &scales[at]);
        pooled.iter().enumerate().map(of).sum()
    };
    let first = |at: usize| (0..pooled[at].len()).map(|i| i < pooled[at].len() / 2).collect();
    let observed = statistic(&first);
    let mut as_large = 1;
    for number in 0..PERMUTATIONS {
        let shuffled = |at: usize| {
            let mut labels: Vec<bool> = first(at);
            let mut stream = robogate_core::Seed::campaign(number).episode(at as u64).stream("admission");
            for i in (1..labels.len()).rev() {
                labels.swap(i, stream.below(i + 1));
            }
            labels
        };
        as_large += u64::from(statistic(&shuffled) >= observed);
    }
    as_large as f64 / (PERMUTATIONS + 1) as f64
}

fn variances(all: &[&Vec<f64>]) -> Vec<f64> {
    let n = all.len() as f64;
    (0..all[0].len())
        .map(|at| {
            let mean = all.iter().map(|one| one[at]).sum::<f64>() / n;
            all.iter().map(|one| (one[at] - mean).powi(2)).sum::<f64>() / n
        })
        .collect()
}

fn distance(all: &[&Vec<f64>], labels: &[bool], scales: &[f64]) -> f64 {
    let numbers = scales.iter().enumerate().filter(|(_, scale)| **scale > 1e-18);
    let each = numbers.map(|(at, scale)| {
        let sum = |side: bool| {
            all.iter().zip(labels).filter(|(_, label)| **label == side).map(|(one, _)| one[at]).sum::<f64>()
        };
        let half = all.len() as f64 / 2.0;
        ((sum(true) - sum(false)) / half).powi(2) / scale
    });
    each.sum()
}

/// What two policies report differently about themselves.
fn declared_differences(judged: &Json, deployed: &Json) -> Vec<String> {
    let empty = serde_json::Map::new();
    let [a, b] = [judged, deployed].map(|value| value.as_object().unwrap_or(&empty));
    // The bytes of a file may differ although the network is the same: an export with another tool.
    let keys = a.keys().chain(b.keys().filter(|key| !a.contains_key(*key))).filter(|key| *key != "sha256");
    let words = |value: Option<&Json>| {
        value.map_or_else(|| "nothing".to_owned(), |value| value.to_string().chars().take(80).collect())
    };
    keys.filter(|key| a.get(*key) != b.get(*key))
        .map(|key| format!("the policy reports {key} = {} in place of {}", words(b.get(key)), words(a.get(key))))
        .collect()
}
