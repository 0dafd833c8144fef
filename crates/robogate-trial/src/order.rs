//! The order of a study: for each trial its set-up and policy, and the codes. It follows from the secret alone.

use std::collections::BTreeSet;
use std::sync::Arc;

use robogate_core::samplers::Uniform;
use robogate_core::{Domain, Sampler, Stream, Value};

use crate::{Plan, Population, Problem, Secret, Setup};

/// Letters of codes: none is mistaken for another.
const LETTERS: &[u8] = b"ABCDEFGHJKMNPQRSTUVWXYZ23456789";

/// A planned trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Its block, from 0.
    pub block: u64,
    /// The number of its policy.
    pub arm: usize,
    /// Its set-up.
    pub setup: Setup,
}

/// All planned trials, in order.
///
/// # Errors
/// If the space of the plan cannot be sampled.
pub fn order(plan: &Plan, secret: &Secret) -> Result<Vec<Planned>, Problem> {
    let seed = secret.seed();
    let setups = setups(plan, secret)?;
    let mut orders = seed.stream("order");
    let mut trials = Vec::with_capacity(plan.most_trials() as usize);
    for (block, setup) in (0..plan.blocks).zip(setups) {
        let mut arms: Vec<usize> = (0..plan.arms.len()).collect();
        orders.shuffle(&mut arms);
        trials.extend(arms.into_iter().map(|arm| Planned { block, arm, setup: setup.clone() }));
    }
    Ok(trials)
}

/// The codes of trials. No two are equal, and a repeated trial has a new one.
#[derive(Debug)]
pub struct Codes {
    stream: Stream,
    used: BTreeSet<String>,
}

impl Codes {
    /// The codes of a study.
    pub fn new(secret: &Secret) -> Self {
        Self { stream: secret.seed().stream("codes"), used: BTreeSet::new() }
    }
}

impl Iterator for Codes {
    type Item = String;

    fn next(&mut self) -> Option<String> {
        loop {
            let code: String = (0..5).map(|_| char::from(LETTERS[self.stream.below(LETTERS.len())])).collect();
            if self.used.insert(code.clone()) {
                return Some(code);
            }
        }
    }
}

/// The set-up of each block.
fn setups(plan: &Plan, secret: &Secret) -> Result<Vec<Setup>, Problem> {
    let mut stream = secret.seed().stream("set-ups");
    let blocks = plan.blocks as usize;
    Ok(match &plan.population {
        Population::Space(space) => {
            let design = Uniform
                .design(&Arc::new(space.clone()), blocks, stream)
                .map_err(|error| Problem::Plan(error.to_string()))?;
            let point = |i: usize| {
                let values = space.parameters().iter().zip(design.coded(i).unwrap_or_default());
                values
                    .map(|(parameter, coded)| (parameter.name.to_string(), rounded(&parameter.domain, *coded)))
                    .collect()
            };
            (0..blocks).map(point).collect()
        }
        Population::List(all) => (0..blocks).map(|_| all[stream.below(all.len())].clone()).collect(),
        Population::Count(n) => {
            let number = |stream: &mut Stream| stream.below(*n as usize) + 1;
            (0..blocks).map(|_| vec![("setup".to_owned(), number(&mut stream).to_string())]).collect()
        }
    })
}

/// A value with four significant digits, if that is still in its range: an operator cannot set more.
fn rounded(domain: &Domain, coded: f64) -> String {
    match domain.decode(coded) {
        Value::Number(x) => {
            let near = format!("{x:.3e}").parse::<f64>().unwrap_or(x);
            if domain.has_code(near) { near } else { x }.to_string()
        }
        other => other.to_string(),
    }
}
