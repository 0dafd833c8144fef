//! Imported episodes that repeat cases.
//!
//! The episodes of one case are not independent evidence about other cases. The requirements are therefore tested for new
//! episodes of exactly these cases, as for the scenarios of a suite. The rate over new cases is stated beside them: each case is
//! one observation, its success rate, and the interval of their mean makes no assumption about the distribution of these rates
//! ([`robogate_stats::bounded_mean`]).

use std::collections::{BTreeMap, BTreeSet};

use robogate_core::{Domain, ParameterSpace, Value};
use robogate_dictionary::results::{groups_rows, only_identifies};
use robogate_stats::bounded_mean::BoundedMean;
use robogate_stats::clusters::{Clusters, Setting, equal_settings};
use robogate_stats::{Confidence, Interval};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Ending, Population, Trial};

/// The success rate over new cases, from imported episodes that repeat cases. The verdict does not depend on it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NewCases {
    /// Number of cases.
    pub cases: u64,
    /// Mean of the success rates of the cases. `None` without a valid episode.
    pub rate: Option<f64>,
    /// 95 % interval of the success rate over new cases, if these are a random sample of them. It holds for any outcome of
    /// the invalid episodes.
    pub interval_95: [f64; 2],
}

impl NewCases {
    /// `None` unless the episodes repeat at least two cases.
    pub(crate) fn of(population: &Population, trials: &[&Trial]) -> Option<Self> {
        let cases = population.repeated_cases().filter(|cases| *cases > 1)?;
        let (mut rates, mut worst, mut best) = (Vec::new(), Vec::new(), Vec::new());
        for trials in by_case(trials).values() {
            let valid = trials.iter().filter(|trial| trial.ending.is_valid()).count();
            let successes = trials.iter().filter(|trial| trial.ending == Ending::Success).count();
            let share = |successes: usize, of: usize| successes as f64 / of as f64;
            if valid > 0 {
                rates.push(share(successes, valid));
            }
            worst.push(share(successes, trials.len()));
            best.push(share(successes + trials.len() - valid, trials.len()));
        }
        let looks = [worst.len()];
        let interval = |shares: &[f64]| {
            BoundedMean::new(shares, &looks, 1.0).map_or(Interval::UNIT, |mean| mean.interval(Confidence::P95.tail()))
        };
        let rate = (!rates.is_empty()).then(|| rates.iter().sum::<f64>() / rates.len() as f64);
        Some(Self { cases, rate, interval_95: [interval(&worst).low, interval(&best).high] })
    }
}

/// The number of cases of imported episodes, if they repeat cases. Without names of cases, a case is a combination of
/// parameters, one of them continuous: the values of others may be equal by chance. Rounded values may, too, so there are at
/// least two episodes for each such case.
pub(crate) fn repeated(space: &ParameterSpace, trials: &[Trial]) -> Option<u64> {
    // A missing value is absent.
    let continuous = |trial: &Trial| {
        space.parameters().iter().any(|parameter| {
            matches!(parameter.domain, Domain::Continuous { .. })
                && !only_identifies(&parameter.name)
                && trial.requested.get(&parameter.name).is_some()
        })
    };
    let of_each = trials.iter().all(continuous);
    let trials: Vec<&Trial> = trials.iter().collect();
    let cases = by_case(&trials).len();
    let repeats = if are_named(&trials) {
        cases < trials.len()
    } else {
        (of_each && 2 * cases <= trials.len()) || by_settings(&trials).is_some()
    };
    (repeats && cases > 0).then_some(cases as u64)
}

/// The trials of each case.
fn by_case<'a>(trials: &[&'a Trial]) -> BTreeMap<String, Vec<&'a Trial>> {
    let named = are_named(trials);
    let settings = if named { None } else { by_settings(trials) };
    let mut cases: BTreeMap<String, Vec<&'a Trial>> = BTreeMap::new();
    for (at, &trial) in trials.iter().enumerate() {
        let case = match &trial.label.case {
            _ if settings.is_some() => {
                format!("{:?} {:?}", trial.label, settings.as_ref().map(|clusters| clusters.of_row()[at]))
            }
            // Names may be unique within a category only.
            Some(_) if named => format!("{:?}", trial.label),
            _ => {
                let parameters: Vec<_> = trial.requested.iter().filter(|(name, _)| !only_identifies(name)).collect();
                format!("{:?} {parameters:?}", trial.label)
            }
        };
        cases.entry(case).or_default().push(trial);
    }
    cases
}

/// Groups of equal settings, within the noise of reading them back and with integers only, if these are more than chance.
fn by_settings(trials: &[&Trial]) -> Option<Clusters> {
    let names: BTreeSet<&str> = trials.iter().flat_map(|trial| trial.requested.iter()).map(|(name, _)| name).collect();
    let mut columns: Vec<(bool, Vec<f64>)> = Vec::new();
    for name in names.into_iter().filter(|name| !only_identifies(name) && !groups_rows(name)) {
        let mut words: BTreeMap<&str, usize> = BTreeMap::new();
        let mut levels = false;
        // A missing value identifies nothing.
        let values: Option<Vec<f64>> = trials
            .iter()
            .map(|trial| match trial.requested.get(name)? {
                Value::Number(value) => Some(*value),
                Value::Integer(value) => Some(*value as f64),
                Value::Category(word) => {
                    levels = true;
                    let next = words.len();
                    Some(*words.entry(word).or_insert(next) as f64)
                }
            })
            .collect();
        columns.push((levels, values?));
    }
    let settings = columns.iter().map(|(levels, values)| match levels {
        true => Setting::Levels(values),
        false => Setting::Numbers(values),
    });
    equal_settings(&settings.collect::<Vec<_>>())
}

/// Whether the source names the case of each episode.
fn are_named(trials: &[&Trial]) -> bool {
    trials.iter().all(|trial| trial.label.case.is_some())
}

#[cfg(test)]
mod tests {
    use robogate_core::{Assignment, Measures, Value};
    use robogate_dictionary::Label;
    use robogate_dictionary::results::SOURCE_SEED;

    use super::*;

    fn trial(index: u64, case: Option<&str>, friction: f64, seed: i64) -> Trial {
        let mut requested = Assignment::default();
        requested.set("friction", Value::Number(friction));
        requested.set(SOURCE_SEED, Value::Integer(seed));
        Trial {
            index,
            seed: 1,
            label: Label { case: case.map(str::to_owned), ..Label::default() },
            requested,
            ending: Ending::Success,
            time_s: None,
            measures: Measures::default(),
            trajectory: None,
            unseen: Vec::new(),
            groups: Vec::new(),
            forces: Vec::new(),
        }
    }

    fn space(kind: &str) -> ParameterSpace {
        ParameterSpace::from_toml(&format!("name = \"s\"\n[[parameter]]\nname = \"friction\"\n{kind}\n")).unwrap()
    }

    #[test]
    fn names_or_continuous_values_identify_cases() {
        let continuous = space("kind = \"continuous\"\nlow = 0.0\nhigh = 10.0");
        let levels = space("kind = \"integer\"\nlow = 0\nhigh = 10");
        let settings: Vec<Trial> = (0..12_u8).map(|i| trial(i.into(), None, f64::from(i % 4), i.into())).collect();
        assert_eq!(repeated(&continuous, &settings), Some(4));
        assert_eq!(repeated(&levels, &settings), None);
        let once: Vec<Trial> = (0..4_u8).map(|i| trial(i.into(), None, f64::from(i), 0)).collect();
        assert_eq!(repeated(&continuous, &once), None);
        let named: Vec<Trial> =
            (0..12_u8).map(|i| trial(i.into(), Some(["lift", "push"][usize::from(i % 2)]), f64::from(i), 0)).collect();
        assert_eq!(repeated(&levels, &named), Some(2));
        assert_eq!(repeated(&continuous, &[]), None);
        // Two rounded values that are equal by chance, and a missing value.
        let mut few: Vec<Trial> = (0..8_u8).map(|i| trial(i.into(), None, f64::from(i % 7), i.into())).collect();
        assert_eq!(repeated(&continuous, &few), None);
        few.extend((8..20_u8).map(|i| trial(i.into(), None, f64::from(i % 7), i.into())));
        assert_eq!(repeated(&continuous, &few), Some(7));
        few[3].requested = Assignment::default();
        assert_eq!(repeated(&continuous, &few), None);
        // Integers of a wide range, and read-back noise.
        let wide = space("kind = \"integer\"\nlow = 0\nhigh = 1000");
        let integer = |i: u64| {
            let mut trial = trial(i, None, 0.0, 0);
            trial.requested.set("friction", Value::Integer([3, 17, 512, 89, 702, 430][i as usize % 6]));
            trial
        };
        assert_eq!(repeated(&wide, &(0..120).map(integer).collect::<Vec<_>>()), Some(6));
        let noisy = |i: u64| trial(i, None, [0.13, 3.9, 7.71, 5.2][i as usize % 4] + 1e-5 * (i * 37 % 101) as f64, 0);
        assert_eq!(repeated(&continuous, &(0..80).map(noisy).collect::<Vec<_>>()), Some(4));
    }
}
