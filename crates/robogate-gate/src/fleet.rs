//! Fleets: which share of the units of a robot meets the requirements, and what do the others have in common?
//!
//! A unit is one robot with its own constant deviations: encoder biases, grip force, friction of the pads, pose of the
//! camera, delay. Units are independent draws from a declared distribution. Each is judged by the gate on its own episodes,
//! so a unit may stay undecided, and a verdict is wrong with a probability of at most α. The interval of the share accounts
//! for the finite number of units, for wrong verdicts and for undecided units ([`robogate_stats::unit_share`]).
//!
//! Units are ordered by verdict, and by success rate among equal verdicts. A parameter is named as a difference between better
//! and worse units only after a permutation test over all parameters together ([`robogate_stats::max_statistic`]).

use std::cmp::Ordering;
use std::collections::BTreeMap;

use robogate_core::{Assignment, Domain, Parameter, ParameterSpace, Value};
use robogate_dictionary::TaskIdentity;
use robogate_stats::format::number;
use robogate_stats::max_statistic::correlated_quantities;
use robogate_stats::unit_share::{UnitVerdicts, unit_share};
use robogate_stats::{Confidence, Trials, clopper_pearson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Evaluation, Mode, Population, Requirements, Status, Verdict};

/// Number of permutations of the test.
const PERMUTATIONS: usize = 9_999;
/// The seed of the permutations.
const SEED: u64 = 0xF1EE_7001;
/// The probability with which any parameter is named although none has an effect.
const LEVEL: f64 = 0.05;

/// The result of one unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FleetUnit {
    /// The number of the unit, from 1.
    pub unit: u64,
    /// The campaign seed of its episodes.
    pub seed: u64,
    /// Its constant parameters.
    pub parameters: BTreeMap<String, Value>,
    /// The verdict of the gate on this unit.
    pub verdict: Verdict,
    /// The reason for the verdict, in one sentence.
    pub because: String,
    /// Number of judged episodes.
    pub episodes: u64,
    /// Number of valid episodes.
    pub valid: u64,
    /// Number of successes.
    pub successes: u64,
    /// Exact (Clopper-Pearson) 95 % interval of the success rate. It assumes a fixed number of episodes.
    pub success_95: [f64; 2],
    /// Requirements that are shown to be violated.
    pub violated: Vec<String>,
    /// Requirements that are neither met nor violated.
    pub undecided: Vec<String>,
    /// SHA-256 (hex) of its rows.
    pub dataset_sha256: String,
}

impl FleetUnit {
    /// The result of a unit from the evaluation of its episodes.
    pub fn of(unit: u64, seed: u64, parameters: &Assignment, evaluation: &Evaluation) -> Self {
        let valid = evaluation.groups.iter().map(|group| group.valid).sum();
        let successes = evaluation.groups.iter().map(|group| group.successes).sum();
        let interval = clopper_pearson(Trials::new(successes, valid).unwrap_or(Trials::NONE), Confidence::P95);
        let with = |status: &[Status]| {
            let results = evaluation.results.iter().filter(|result| status.contains(&result.status));
            results.map(|result| result.id.clone()).collect()
        };
        Self {
            unit,
            seed,
            parameters: parameters.iter().map(|(name, value)| (name.to_owned(), value.clone())).collect(),
            verdict: evaluation.verdict,
            because: evaluation.because.clone(),
            episodes: evaluation.counts.episodes,
            valid,
            successes,
            success_95: [interval.low, interval.high],
            violated: with(&[Status::Violated]),
            undecided: with(&[Status::Undecided, Status::NoEvidence]),
            dataset_sha256: evaluation.dataset_sha256.clone(),
        }
    }
}

/// The share of units that meet the requirements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UnitShare {
    /// Units that are judged to meet the requirements.
    pub meets: u64,
    /// Units that are judged to violate them.
    pub violates: u64,
    /// Units without a decision.
    pub undecided: u64,
    /// 95 % interval of the share in the population of units.
    pub interval_95: [f64; 2],
    /// The largest probability of a wrong verdict that the interval accounts for. `None` if verdicts have no stated error,
    /// because the requirements are compared as points. The interval then applies to the verdicts.
    pub error: Option<f64>,
    /// The estimand, in one sentence.
    pub estimand: String,
}

/// How a parameter enters the test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DriverForm {
    /// Its value.
    Value,
    /// Its distance from the middle of its distribution, in either direction.
    Deviation,
    /// Whether it is one word.
    Word,
}

/// A unit parameter and its relation to the verdicts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UnitDriver {
    /// The parameter.
    pub parameter: String,
    /// How it enters the test.
    pub form: DriverForm,
    /// The word, if the form is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub word: Option<String>,
    /// Rank correlation with the order of the units, in [-1, 1]. Positive: larger values are those of worse units.
    pub correlation: f64,
    /// p-value of "the verdicts do not depend on any unit parameter", adjusted for all parameters and forms.
    pub p_adjusted: f64,
    /// Whether it is named: the adjusted p-value is at most 0.05.
    pub significant: bool,
    /// Median over the units that meet the requirements. `None` for a word.
    pub median_meets: Option<f64>,
    /// Median over the units that violate them. `None` for a word.
    pub median_violates: Option<f64>,
}

/// The evaluation of a fleet as one versioned document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Fleet {
    /// Version of the format.
    pub format: u32,
    /// The task.
    pub task: TaskIdentity,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// The scenarios on which each unit is judged.
    pub scenarios: Population,
    /// The requirements.
    pub requirements: Requirements,
    /// The distribution of the unit parameters.
    pub unit_space: ParameterSpace,
    /// The seed of the fleet.
    pub seed: u64,
    /// The share of units that meet the requirements.
    pub share: UnitShare,
    /// The smallest share that is required. `None` if no share is required.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub required_share: Option<f64>,
    /// Whether the interval of the share is above or below the required share. `None` if no share is required.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
    /// The unit parameters, the most strongly correlated first. Empty if they cannot be tested.
    pub drivers: Vec<UnitDriver>,
    /// The reason why the parameters cannot be tested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_tested: Option<String>,
    /// The units, in order.
    pub units: Vec<FleetUnit>,
}

/// The units along the range of one parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct UnitPlaces {
    /// The parameter.
    pub parameter: String,
    /// Its range, or its choices.
    pub range: String,
    /// The verdict of each unit and its place in the range, from 0 to 1.
    pub places: Vec<(Verdict, f64)>,
}

/// What a fleet is evaluated on, in addition to its units.
#[derive(Debug)]
pub struct FleetSubject {
    /// The task.
    pub task: TaskIdentity,
    /// The robot.
    pub robot: String,
    /// The policy.
    pub policy: String,
    /// The scenarios on which each unit is judged.
    pub scenarios: Population,
    /// The requirements.
    pub requirements: Requirements,
    /// The distribution of the unit parameters.
    pub unit_space: ParameterSpace,
    /// The seed of the fleet.
    pub seed: u64,
    /// The smallest share that is required.
    pub required_share: Option<f64>,
}

impl Fleet {
    /// The version of the format.
    pub const FORMAT: u32 = 1;

    /// Evaluates judged units.
    pub fn of(subject: FleetSubject, units: Vec<FleetUnit>) -> Self {
        let share = share(&subject.requirements, &units);
        let verdict = subject.required_share.map(|required| {
            let [low, high] = share.interval_95;
            match (low >= required, high < required) {
                (true, _) => Verdict::Pass,
                (_, true) => Verdict::Fail,
                _ => Verdict::Inconclusive,
            }
        });
        let (drivers, not_tested) = match drivers(&subject.unit_space, &units) {
            Ok(drivers) => (drivers, None),
            Err(because) => (Vec::new(), Some(because.to_owned())),
        };
        let FleetSubject { task, robot, policy, scenarios, requirements, unit_space, seed, required_share } = subject;
        Self {
            format: Self::FORMAT,
            task,
            robot,
            policy,
            scenarios,
            requirements,
            unit_space,
            seed,
            share,
            required_share,
            verdict,
            drivers,
            not_tested,
            units,
        }
    }

    /// The place of each unit in the range of each parameter.
    pub fn places(&self) -> Vec<UnitPlaces> {
        let of = |parameter: &Parameter| {
            let place = |unit: &FleetUnit| {
                let coded = parameter.domain.encode(unit.parameters.get(&*parameter.name)?)?;
                Some((unit.verdict, parameter.domain.to_unit(coded))).filter(|(_, place)| place.is_finite())
            };
            let range = match &parameter.domain {
                Domain::Continuous { low, high, .. } => format!("{} to {}", number(*low), number(*high)),
                Domain::Integer { low, high } => format!("{low} to {high}"),
                Domain::Categorical { choices } => choices.join(", "),
            };
            UnitPlaces {
                parameter: parameter.name.to_string(),
                range,
                places: self.units.iter().filter_map(place).collect(),
            }
        };
        self.unit_space.parameters().iter().map(of).collect()
    }

    /// Serialises the evaluation. Equal fleets give equal bytes.
    pub fn to_json(&self) -> String {
        // Every number is finite, so serialisation cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

fn share(requirements: &Requirements, units: &[FleetUnit]) -> UnitShare {
    let count = |verdict| units.iter().filter(|unit| unit.verdict == verdict).count() as u64;
    let (meets, violates) = (count(Verdict::Pass), count(Verdict::Fail));
    let verdicts = UnitVerdicts { meets, violates, undecided: units.len() as u64 - meets - violates };
    let error = (requirements.mode == Mode::Confidence).then(|| requirements.alpha());
    let interval = unit_share(verdicts, error.unwrap_or(0.0), Confidence::P95);
    let estimand = match error {
        Some(error) => format!(
            "The share of all units of this distribution that truly meet the requirements on these scenarios. The interval \
             accounts for the number of units, for wrong verdicts (at most {} % of the units on either side of the limits), \
             and for undecided units, which may be either.",
            100.0 * error
        ),
        None => "The share of all units of this distribution whose observed figures are within the limits on this number of \
                 episodes. A point comparison has no stated error, so nothing is said about the true figures of a unit."
            .to_owned(),
    };
    UnitShare {
        meets,
        violates,
        undecided: verdicts.undecided,
        interval_95: [interval.low, interval.high],
        error,
        estimand,
    }
}

/// One quantity of the test.
struct Quantity {
    parameter: String,
    form: DriverForm,
    word: Option<String>,
    values: Vec<f64>,
}

/// The place of each unit in the order from the best to the worst: by verdict, then by success rate. Equal units share a place.
/// Each place depends on the episodes of the units alone, so units without an effect of any parameter are exchangeable.
fn places_from_best(units: &[FleetUnit]) -> Vec<f64> {
    let verdict = |unit: &FleetUnit| match unit.verdict {
        Verdict::Pass => 0,
        Verdict::Inconclusive | Verdict::Invalid => 1,
        Verdict::Fail => 2,
    };
    // Rates are compared as fractions, without rounding.
    let rate = |a: &FleetUnit, b: &FleetUnit| {
        let [a_to_b, b_to_a] = [(a, b), (b, a)].map(|(of, other)| u128::from(of.successes) * u128::from(other.valid));
        b_to_a.cmp(&a_to_b)
    };
    let worse = |a: &FleetUnit, b: &FleetUnit| verdict(a).cmp(&verdict(b)).then_with(|| rate(a, b));
    let better_than = |unit: &FleetUnit| units.iter().filter(|other| worse(unit, other) == Ordering::Greater).count();
    units.iter().map(|unit| better_than(unit) as f64).collect()
}

/// Tests which unit parameters are correlated with the order of the units, or returns the reason why this is impossible.
fn drivers(space: &ParameterSpace, units: &[FleetUnit]) -> Result<Vec<UnitDriver>, &'static str> {
    let places = places_from_best(units);
    if places.iter().all(|place| *place <= 0.0) {
        return Err("all units have the same verdict and success rate");
    }
    let quantities = quantities(space, units);
    let values: Vec<Vec<f64>> = quantities.iter().map(|quantity| quantity.values.clone()).collect();
    let tests = correlated_quantities(&values, &places, PERMUTATIONS, SEED)
        .ok_or("a unit has no value for one of the parameters")?;
    let median = |values: &[f64], verdict| {
        let mut chosen: Vec<f64> =
            values.iter().zip(units).filter(|(_, unit)| unit.verdict == verdict).map(|(value, _)| *value).collect();
        chosen.sort_by(f64::total_cmp);
        let (low, high) = (chosen.get((chosen.len().max(1) - 1) / 2)?, chosen.get(chosen.len() / 2)?);
        Some(0.5 * (low + high))
    };
    let mut drivers: Vec<UnitDriver> = quantities
        .into_iter()
        .zip(tests)
        .map(|(quantity, test)| {
            let number =
                |verdict| (quantity.form != DriverForm::Word).then(|| median(&quantity.values, verdict)).flatten();
            UnitDriver {
                correlation: test.correlation,
                p_adjusted: test.p_adjusted,
                significant: test.p_adjusted <= LEVEL,
                median_meets: number(Verdict::Pass),
                median_violates: number(Verdict::Fail),
                parameter: quantity.parameter,
                form: quantity.form,
                word: quantity.word,
            }
        })
        .collect();
    drivers.sort_by(|a, b| b.correlation.abs().total_cmp(&a.correlation.abs()));
    Ok(drivers)
}

fn quantities(space: &ParameterSpace, units: &[FleetUnit]) -> Vec<Quantity> {
    let mut quantities = Vec::new();
    for parameter in space.parameters() {
        let value = |unit: &FleetUnit| unit.parameters.get(&*parameter.name).cloned();
        let mut add = |form, word: Option<&str>, values: Vec<f64>| {
            let (parameter, word) = (parameter.name.to_string(), word.map(str::to_owned));
            quantities.push(Quantity { parameter, form, word, values });
        };
        if let Domain::Categorical { choices } = &parameter.domain {
            for choice in choices {
                let is = |unit: &FleetUnit| f64::from(u8::from(value(unit) == Some(Value::Category(choice.clone()))));
                add(DriverForm::Word, Some(&**choice), units.iter().map(is).collect());
            }
            continue;
        }
        let coded =
            |unit: &FleetUnit| value(unit).and_then(|value| parameter.domain.encode(&value)).unwrap_or(f64::NAN);
        let values: Vec<f64> = units.iter().map(coded).collect();
        // The distance is measured in the scale of the distribution, from 0 in the middle to 1 at both ends.
        let deviation = |x: &f64| 2.0 * (parameter.domain.to_unit(*x) - 0.5).abs();
        let deviations = values.iter().map(deviation).collect();
        add(DriverForm::Value, None, values);
        add(DriverForm::Deviation, None, deviations);
    }
    quantities
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(number: u64, bias: f64, verdict: Verdict) -> FleetUnit {
        let parameters = [("bias".to_owned(), Value::Number(bias)), ("force".to_owned(), Value::Number(1.0))];
        FleetUnit {
            unit: number,
            seed: number,
            parameters: parameters.into_iter().collect(),
            verdict,
            because: String::new(),
            episodes: 10,
            valid: 10,
            successes: 9,
            success_95: [0.5, 1.0],
            violated: Vec::new(),
            undecided: Vec::new(),
            dataset_sha256: String::new(),
        }
    }

    fn space() -> ParameterSpace {
        let parameter = |name: &str, low: f64, high: f64| {
            format!("[[parameter]]\nname = \"{name}\"\nkind = \"continuous\"\nlow = {low}\nhigh = {high}\n")
        };
        let text = format!("name = \"units\"\n{}{}", parameter("bias", -1.0, 1.0), parameter("force", 0.5, 1.5));
        ParameterSpace::from_toml(&text).unwrap()
    }

    #[test]
    fn deviation_in_either_direction_is_found() {
        let bias = |i: u64| (i as f64 - 9.5) / 10.0;
        let verdict = |i| if bias(i).abs() > 0.6 { Verdict::Fail } else { Verdict::Pass };
        let units: Vec<FleetUnit> = (0..20).map(|i| unit(i + 1, bias(i), verdict(i))).collect();
        let drivers = drivers(&space(), &units).unwrap();
        assert_eq!((drivers[0].parameter.as_str(), drivers[0].form), ("bias", DriverForm::Deviation));
        assert!(drivers[0].significant && drivers[0].median_violates > drivers[0].median_meets, "{drivers:?}");
        assert_eq!(drivers.iter().filter(|driver| driver.significant).count(), 1);
    }

    #[test]
    fn units_with_equal_verdicts_differ_by_their_success() {
        let bias = |i: u64| (i as f64 - 9.5) / 10.0;
        let units: Vec<FleetUnit> = (0..20)
            .map(|i| FleetUnit { valid: 100 + i, successes: 99 - i, ..unit(i + 1, bias(i), Verdict::Pass) })
            .collect();
        assert_eq!(places_from_best(&units), (0..20).map(f64::from).collect::<Vec<_>>());
        let drivers = drivers(&space(), &units).unwrap();
        assert_eq!((drivers[0].parameter.as_str(), drivers[0].form), ("bias", DriverForm::Value));
        assert!(drivers[0].significant && drivers[0].correlation > 0.99 && drivers[0].median_violates.is_none());
    }

    #[test]
    fn verdict_counts_before_success() {
        let of = |successes, valid, verdict| FleetUnit { successes, valid, ..unit(1, 0.0, verdict) };
        let units = [
            of(8, 10, Verdict::Pass),
            of(9, 10, Verdict::Inconclusive),
            of(90, 100, Verdict::Inconclusive),
            of(0, 0, Verdict::Fail),
            of(10, 10, Verdict::Pass),
        ];
        assert_eq!(places_from_best(&units), [1.0, 2.0, 2.0, 4.0, 0.0]);
    }

    #[test]
    fn nothing_is_named_among_equal_units() {
        let units = vec![unit(1, 0.1, Verdict::Pass), unit(2, 0.2, Verdict::Pass)];
        assert_eq!(drivers(&space(), &units), Err("all units have the same verdict and success rate"));
    }
}
