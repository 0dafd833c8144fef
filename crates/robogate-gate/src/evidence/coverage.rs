//! Which part of the operating ranges the valid episodes cover.

use robogate_core::{Domain, Outcome, Parameter, Spread, Suite};
use robogate_stats::format::number;

use super::Judged;
use crate::operating_domain::suite_of;
use crate::{GateError, Population, operating_ranges};

/// A range counts as covered if an episode came this close to each end, as a share of the range.
const NEAR: f64 = 0.02;
/// A sample that leaves a larger part of a range empty has this probability.
const BY_CHANCE: f64 = 1e-3;

/// A parameter of the operating ranges, and what the valid episodes cover of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Covered {
    /// The parameter.
    pub parameter: String,
    /// Its range, or its choices.
    pub range: String,
    /// What is not covered, as the end of a sentence. `None` if the episodes cover the range.
    pub missing: Option<String>,
}

/// The parameters of the space of the rows, with what the valid episodes cover.
///
/// # Errors
/// If a row cannot be read.
pub(super) fn of(judged: &Judged<'_>) -> Result<Vec<Covered>, GateError> {
    let parameters = operating_ranges(judged.provenance());
    let mut seen: Vec<Vec<f64>> = vec![Vec::new(); parameters.len()];
    for entry in judged.dictionary.entries() {
        let entry = entry?;
        if matches!(entry.episode.outcome, Outcome::Invalid(_)) || entry.is_chosen() {
            continue;
        }
        for (parameter, seen) in parameters.iter().zip(&mut seen) {
            let value = entry.episode.scenario.requested.get(&parameter.name);
            seen.extend(value.and_then(|value| parameter.domain.encode(value)));
        }
    }
    let sample = match &judged.evaluation.population {
        Population::Drawn { .. } | Population::Suite { fresh: true, .. } => true,
        Population::Suite { .. } | Population::Imported { .. } => false,
    };
    let suite = suite_of(judged.provenance());
    let is_drawn = |name: &str| {
        let cases = suite.iter().flat_map(Suite::cases).flat_map(|case| &case.parameters);
        cases.filter(|(of, _)| **of == *name).any(|(_, spread)| matches!(spread, Spread::Drawn(_)))
    };
    let of = |(parameter, seen): (&Parameter, &Vec<f64>)| covered(parameter, seen, sample || is_drawn(&parameter.name));
    Ok(parameters.iter().zip(&seen).map(of).collect())
}

fn covered(parameter: &Parameter, seen: &[f64], sampled: bool) -> Covered {
    let range = match &parameter.domain {
        Domain::Continuous { low, high, .. } if low == high => number(*low),
        Domain::Continuous { low, high, .. } => format!("{} to {}", number(*low), number(*high)),
        Domain::Integer { low, high } if low == high => low.to_string(),
        Domain::Integer { low, high } => format!("{low} to {high}"),
        Domain::Categorical { choices } => choices.join(", "),
    };
    let missing = match &parameter.domain {
        _ if seen.is_empty() => Some("no valid episode has a value".to_owned()),
        Domain::Categorical { choices } => {
            let without =
                choices.iter().enumerate().filter(|(at, _)| !seen.iter().any(|x| (x - *at as f64).abs() < 0.5));
            let without: Vec<&str> = without.map(|(_, choice)| &**choice).collect();
            (!without.is_empty()).then(|| format!("no valid episode with {}", without.join(", ")))
        }
        domain => gap(domain, seen, sampled),
    };
    Covered { parameter: parameter.name.to_string(), range, missing }
}

/// The part of a range of numbers that the episodes leave empty at an end.
fn gap(domain: &Domain, seen: &[f64], sampled: bool) -> Option<String> {
    // In a uniform sample, no point lies in a share g at one end with the probability (1 - g)^n.
    let allowed = if sampled { 1.0 - BY_CHANCE.powf(1.0 / seen.len() as f64) } else { NEAR };
    let (least, most) = seen.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
    let (low, high) = match domain {
        Domain::Continuous { low, high, .. } if low < high => (domain.to_unit(least), domain.to_unit(most)),
        Domain::Integer { low, high } if low < high => {
            let width = (high - low) as f64;
            ((least - *low as f64) / width, (most - *low as f64) / width)
        }
        _ => return None,
    };
    let of_integer = |share: f64| matches!(domain, Domain::Integer { .. }) && share * seen.len() as f64 <= 1.0;
    let beyond = |gap: f64| gap > allowed && !of_integer(gap);
    (beyond(low) || beyond(1.0 - high))
        .then(|| format!("valid episodes reach only from {} to {}", number(least), number(most)))
}
