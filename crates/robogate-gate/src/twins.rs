//! The control arm: each episode compared with its nominal twin, which has the same seed and no perturbation.
//!
//! A failure rate under perturbation does not say what the perturbation does: some scenarios fail without it too. The
//! difference of a pair does. Pairs are grouped by the family of the perturbation: the group of a suite, or the parameters
//! that differ between the two episodes. Where the campaign perturbs several declared families at once, a further arm has episodes
//! with one family each, and these are compared with the same twins. [`robogate_stats::families`] has the test and its adjustment for several families.

use std::collections::{BTreeMap, BTreeSet};

use robogate_core::{TaskSpec, Value};
use robogate_dictionary::results::only_identifies;
use robogate_stats::compare::Pairs;
use robogate_stats::families::{FamilyPairs, SharedTwin, paired_effects};
use robogate_stats::format::{count, counted, list, percent, percent_range};
use robogate_stats::{Confidence, Trials, wilson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::record::{recorded_numbers, recorded_seeds};
use crate::{Ending, GateError, Population, Record, Sampling, Trial};

/// Looks of a run whose number of episodes was chosen in an unknown way. Up to 10,000 pairs, with a look after each of them,
/// the error is then at most 5 %.
const UNKNOWN_LOOKS: u64 = 1_000;
/// Words without a value in imported files.
const NO_VALUE: [&str; 6] = ["", "nan", "null", "none", "na", "n/a"];
/// The family of pairs in which the parameters of several declared families differ.
const TOGETHER: &str = "all perturbations together";
/// Maximum number of parameters in the name of a family.
const NAMED_PARAMETERS: usize = 3;

/// What a perturbation does to the success rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Effect {
    /// It lowers the rate: the interval of the difference is below 0.
    Harmful,
    /// It raises the rate: the interval is above 0.
    Beneficial,
    /// The interval contains 0.
    NotSignificant,
}

impl Effect {
    /// The effect in words.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Harmful => "harmful",
            Self::Beneficial => "beneficial",
            Self::NotSignificant => "not significant",
        }
    }
}

/// One family of perturbations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Family {
    /// The group of the suite, the value of the column that names the perturbation, or the perturbed parameters.
    pub family: String,
    /// Pairs of valid episodes.
    pub pairs: u64,
    /// Nominal twins of these pairs, if several pairs share a twin. Each then counts once in the difference and its interval.
    /// Absent if each pair has its own twin.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub shared_twins: u64,
    /// Pairs with an invalid episode. The interval covers all their possible outcomes.
    pub invalid: u64,
    /// Pairs in which both succeed.
    pub both: u64,
    /// Pairs that fail only with the perturbation.
    pub new_failures: u64,
    /// Pairs that fail only without the perturbation.
    pub recovered: u64,
    /// Pairs that fail with and without the perturbation.
    pub already_failing: u64,
    /// Success rate with the perturbation minus the rate without it, as a mean over twins if pairs share them. `None` without a
    /// valid pair.
    pub difference: Option<f64>,
    /// Its interval. The intervals of all families hold together at 95 %.
    pub interval_95: [f64; 2],
    /// p-value of "no effect", adjusted for all families and, in a run that stopped early, for all looks.
    pub adjusted_p: f64,
    /// The effect.
    pub effect: Effect,
}

/// Episodes compared with their nominal twins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Twins {
    /// Version of the format.
    pub format: u32,
    /// SHA-256 (hex) of the rows with perturbations.
    pub dataset_sha256: String,
    /// SHA-256 (hex) of the rows of the control arm.
    pub nominal_sha256: String,
    /// Pairs that differ in a parameter.
    pub pairs: u64,
    /// Pairs without a difference: the scenario itself is nominal. They are in no family.
    pub unperturbed: u64,
    /// Episodes without a partner, of both arms.
    pub unpaired: u64,
    /// How often the run could have been stopped. 1 for a fixed number of pairs.
    pub looks: u64,
    /// Parameters without a nominal value, which the twins share with their partners.
    pub kept: Vec<String>,
    /// Valid pairs, over all families.
    pub valid: u64,
    /// Successes with the perturbations, in valid pairs.
    pub perturbed_successes: u64,
    /// Successes without the perturbations, in valid pairs.
    pub nominal_successes: u64,
    /// Nominal twins of the valid pairs, if several pairs share a twin. Absent if each pair has its own twin.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub shared_twins: u64,
    /// Successes of these twins, each counted once.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub shared_twin_successes: u64,
    /// Wilson's 95 % interval of the success rate without the perturbations, in which each twin counts once. [0, 1] without a
    /// valid pair.
    pub nominal_interval_95: [f64; 2],
    /// Failures with the perturbations that occur without them too.
    pub already_failing: u64,
    /// Episodes with the perturbations of one declared family each, whose effects are among `families`. Absent if there are none.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub one_family: u64,
    /// The families, in the order of their first episode.
    pub families: Vec<Family>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(n: &u64) -> bool {
    *n == 0
}

/// A pair: the perturbed episode, its twin, and the family.
struct Pair<'a> {
    perturbed: &'a Trial,
    nominal: &'a Trial,
    /// `None` if the two scenarios do not differ.
    family: Option<String>,
}

/// The value of `category`, `group` or a parameter.
fn value_of(trial: &Trial, column: &str) -> Option<String> {
    match column {
        "category" => trial.label.category.clone(),
        "group" => trial.label.group.clone(),
        name => trial.requested.get(name).map(Value::to_string),
    }
}

/// Whether a trial has this value of a column.
fn is_of(trial: &Trial, column: &str, wanted: &str) -> bool {
    // An import reads these words as a missing value.
    let missing = NO_VALUE.iter().any(|word| word.eq_ignore_ascii_case(wanted));
    value_of(trial, column).map_or(missing, |value| value == wanted)
}

impl Twins {
    /// The version of the format.
    pub const FORMAT: u32 = 1;

    /// Pairs the episodes of a run with those of its control arm. Episodes of campaigns are paired by seed and index,
    /// imported ones by case and seed, or by case and number. `sampling` is how the number of episodes was chosen; the record
    /// can override it.
    ///
    /// # Errors
    /// If episodes cannot be identified, or if a pair has two different seeds or scenarios.
    pub fn of(record: &Record, nominal: &Record, sampling: Sampling) -> Result<Self, GateError> {
        Self::with_families(record, nominal, None, sampling)
    }

    /// The same with `one_family`, the episodes with the perturbations of one declared family each. They have the seeds and
    /// indices of the others, and are compared with the same twins.
    ///
    /// # Errors
    /// As above, or if such an episode has perturbations of another family.
    pub fn with_families(
        record: &Record,
        nominal: &Record,
        one_family: Option<&Record>,
        sampling: Sampling,
    ) -> Result<Self, GateError> {
        let (mut unpaired, mut of_focused) = (0, 0);
        let (mut pairs, mut alone) = (Vec::new(), Vec::new());
        if record.imported || nominal.imported {
            let one_case = [record, nominal].iter().all(|of| of.trials.iter().all(|trial| trial.label.case.is_none()));
            let (these, twins) = (identities(record, one_case)?, identities(nominal, one_case)?);
            let mut by_identity = BTreeMap::new();
            for (identity, trial) in &twins {
                if let Some(first) = by_identity.insert(identity, *trial) {
                    return Err(GateError::Copies { first: first.index, second: trial.index });
                }
            }
            for (identity, trial) in &these {
                match by_identity.get(identity) {
                    Some(twin) => {
                        pairs.push(Pair { perturbed: trial, nominal: twin, family: imported_family(trial, twin) });
                    }
                    None => unpaired += 1,
                }
            }
        } else {
            let twins: BTreeMap<u64, &Trial> = nominal.trials.iter().map(|trial| (trial.index, trial)).collect();
            let suite = matches!(record.population, Population::Suite { .. });
            // A suite of one group does not say what is perturbed.
            let groups = record.trials.iter().any(|trial| group(trial) != record.trials.first().and_then(group));
            for trial in &record.trials {
                let Some(twin) = twins.get(&trial.index) else {
                    unpaired += 1;
                    continue;
                };
                same_origin(trial, twin, suite)?;
                pairs.push(Pair { perturbed: trial, nominal: twin, family: family(trial, twin, groups) });
            }
            // Twins of episodes that a model chose. They represent no population, and are not compared.
            let episodes = record.trials.len() as u64 + record.focused;
            let judged: BTreeSet<u64> = record.trials.iter().map(|trial| trial.index).collect();
            for trial in one_family.iter().flat_map(|of| &of.trials) {
                let Some(twin) = twins.get(&trial.index) else {
                    unpaired += 1;
                    continue;
                };
                same_origin(trial, twin, false)?;
                alone.push(Pair {
                    perturbed: trial,
                    nominal: twin,
                    family: declared_family(&record.task, trial, twin)?,
                });
            }
            if !alone.is_empty() {
                for pair in &mut pairs {
                    pair.family = pair.family.take().map(|_| TOGETHER.to_owned());
                }
            }
            of_focused = twins.keys().filter(|index| **index < episodes && !judged.contains(*index)).count();
        }
        let used: BTreeSet<u64> = pairs.iter().map(|pair| pair.nominal.index).collect();
        unpaired += (nominal.trials.len() as u64).saturating_sub((used.len() + of_focused) as u64);
        let looks = looks(record, sampling);
        Ok(Self::from_pairs(record, nominal, &pairs, &alone, unpaired, looks))
    }

    /// The record without the rows of the control arm, which the verdict does not count: those with this value of `column`
    /// ([`Twins::within`]).
    #[must_use]
    pub fn without_nominal(mut record: Record, column: &str, nominal: &str) -> Record {
        record.trials.retain(|trial| !is_of(trial, column, nominal));
        record.divided_again()
    }

    /// Pairs the episodes of one imported file. `column` is `category`, `group` or a parameter; rows with the value
    /// `nominal` are the control arm, and the other values are the families.
    ///
    /// # Errors
    /// If no row has that value, or if episodes cannot be identified.
    pub fn within(record: &Record, column: &str, nominal: &str, sampling: Sampling) -> Result<Self, GateError> {
        let is_nominal = |trial: &Trial| is_of(trial, column, nominal);
        if !record.trials.iter().any(is_nominal) {
            return Err(GateError::NoNominalRows { column: column.to_owned(), value: nominal.to_owned() });
        }
        let one_case = record.trials.iter().all(|trial| trial.label.case.is_none());
        let seeds =
            recorded_seeds(&record.trials).ok_or_else(|| GateError::NoIdentity { policy: record.policy.clone() })?;
        let mut twins: BTreeMap<(&str, i64), &Trial> = BTreeMap::new();
        let (mut pairs, mut unpaired) = (Vec::new(), 0);
        let identity = |trial: &'_ Trial| match &trial.label.case {
            _ if one_case => Ok(String::new()),
            Some(case) => Ok(case.clone()),
            None => Err(GateError::NoIdentity { policy: record.policy.clone() }),
        };
        let cases: Vec<String> = record.trials.iter().map(identity).collect::<Result<_, _>>()?;
        for ((trial, seed), case) in record.trials.iter().zip(&seeds).zip(&cases) {
            if is_nominal(trial)
                && let Some(first) = twins.insert((case, *seed), trial)
            {
                return Err(GateError::Copies { first: first.index, second: trial.index });
            }
        }
        let mut used = BTreeSet::new();
        for ((trial, seed), case) in record.trials.iter().zip(&seeds).zip(&cases) {
            if is_nominal(trial) {
                continue;
            }
            match twins.get(&(case.as_str(), *seed)) {
                Some(twin) => {
                    used.insert(twin.index);
                    let family = Some(value_of(trial, column).unwrap_or_else(|| "not stated".to_owned()));
                    pairs.push(Pair { perturbed: trial, nominal: twin, family });
                }
                None => unpaired += 1,
            }
        }
        unpaired += (twins.len() - used.len()) as u64;
        Ok(Self::from_pairs(record, record, &pairs, &[], unpaired, looks(record, sampling)))
    }

    /// The same with the parameters that have no nominal value.
    #[must_use]
    pub fn keeping(self, kept: Vec<String>) -> Self {
        Self { kept, ..self }
    }

    /// `pairs` are the episodes of the campaign and their twins, `alone` those with the perturbations of one family.
    fn from_pairs(
        record: &Record,
        nominal: &Record,
        pairs: &[Pair<'_>],
        alone: &[Pair<'_>],
        unpaired: u64,
        looks: u64,
    ) -> Self {
        let (mut names, mut counts) = counted_by_family(pairs);
        let all = counts.iter().fold(Pairs::default(), |sum, of| Pairs {
            both: sum.both + of.valid.both,
            first_only: sum.first_only + of.valid.first_only,
            second_only: sum.second_only + of.valid.second_only,
            neither: sum.neither + of.valid.neither,
        });
        let (more_names, more_counts) = counted_by_family(alone);
        names.extend(more_names);
        counts.extend(more_counts);
        let effects = paired_effects(&counts, Confidence::P95, looks);
        let families: Vec<Family> = names
            .iter()
            .zip(&counts)
            .zip(effects)
            .map(|((name, of), effect)| Family {
                family: (*name).to_owned(),
                pairs: of.valid.n(),
                shared_twins: of.shared_twins(),
                invalid: of.invalid,
                both: of.valid.both,
                new_failures: of.valid.second_only,
                recovered: of.valid.first_only,
                already_failing: of.valid.neither,
                difference: effect.difference,
                interval_95: [effect.interval.low, effect.interval.high],
                adjusted_p: effect.adjusted_p,
                effect: match (effect.is_harmful(), effect.is_beneficial()) {
                    (true, _) => Effect::Harmful,
                    (_, true) => Effect::Beneficial,
                    _ => Effect::NotSignificant,
                },
            })
            .collect();
        let without = all.both + all.second_only;
        let twins = distinct_twins(pairs);
        let interval = wilson(twins, Confidence::P95);
        let shared = if twins.n() < all.n() { twins } else { Trials::NONE };
        let perturbed = pairs.iter().filter(|pair| pair.family.is_some()).count() as u64;
        Self {
            format: Self::FORMAT,
            dataset_sha256: record.dataset_sha256.clone(),
            nominal_sha256: nominal.dataset_sha256.clone(),
            pairs: perturbed,
            unperturbed: pairs.len() as u64 - perturbed,
            unpaired,
            looks,
            kept: Vec::new(),
            valid: all.n(),
            perturbed_successes: all.both + all.first_only,
            nominal_successes: without,
            shared_twins: shared.n(),
            shared_twin_successes: shared.successes(),
            nominal_interval_95: [interval.low, interval.high],
            already_failing: all.neither,
            one_family: alone.len() as u64,
            families,
        }
    }

    /// Serialises the result. Equal results give equal bytes.
    pub fn to_json(&self) -> String {
        // Every number is finite, so serialisation cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// The result in sentences: what fails without the perturbations, and which families are harmful.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if self.valid == 0 {
            lines.push("No perturbed episode has a valid nominal twin, so no effect can be estimated.".to_owned());
            return lines;
        }
        let share = |successes: u64, of: u64| percent(successes as f64 / of as f64);
        let (with, interval) = (share(self.perturbed_successes, self.valid), percent_range(self.nominal_interval_95));
        lines.push(if self.shared_twins > 0 {
            format!(
                "In {} with {}, success is {with} with the perturbations. Without them, {} of the twins succeed (95 % interval \
                 {interval}).",
                counted(self.valid, "pair"),
                counted(self.shared_twins, "distinct nominal twin"),
                share(self.shared_twin_successes, self.shared_twins),
            )
        } else {
            format!(
                "In {}, success is {with} with the perturbations and {} without them (95 % interval {interval}).",
                counted(self.valid, "pair"),
                share(self.nominal_successes, self.valid),
            )
        });
        if self.families.iter().any(|family| family.shared_twins > 0) {
            lines.push(
                "Several pairs of a family share a twin. The difference is then the mean over the twins, and each twin counts \
                 once in the interval."
                    .to_owned(),
            );
        }
        let failures = self.valid - self.perturbed_successes;
        if failures > 0 {
            lines.push(format!(
                "{} of {} also fail without the perturbation, with the same seed.",
                count(self.already_failing),
                counted(failures, "failure")
            ));
        }
        let of = |wanted: Effect| -> Vec<String> {
            self.families.iter().filter(|of| of.effect == wanted).map(|of| of.family.clone()).collect()
        };
        match of(Effect::Harmful).as_slice() {
            [] => lines.push("No perturbation is shown to lower the success rate.".to_owned()),
            some => lines.push(format!("Shown to lower the success rate: {}.", list(some))),
        }
        if let some @ [_, ..] = of(Effect::Beneficial).as_slice() {
            lines.push(format!("Shown to raise the success rate: {}.", list(some)));
        }
        if self.one_family > 0 {
            lines.push(format!(
                "{} perturb one declared family only; their rows state the effect of that family alone.",
                counted(self.one_family, "further episode")
            ));
        }
        if self.unperturbed > 0 {
            lines.push(format!("{} of nominal scenarios are not counted.", counted(self.unperturbed, "episode")));
        }
        if self.unpaired > 0 {
            lines.push(format!("{} have no partner.", counted(self.unpaired, "episode")));
        }
        if !self.kept.is_empty() {
            lines.push(format!(
                "The task declares no nominal value for {}: the twins keep the value.",
                list(&self.kept)
            ));
        }
        lines
    }
}

/// The families of these pairs in the order of their first pair, and the outcomes of each.
fn counted_by_family<'a>(pairs: &'a [Pair<'_>]) -> (Vec<&'a str>, Vec<FamilyPairs>) {
    let mut names: Vec<&str> = Vec::new();
    let mut counts: Vec<FamilyPairs> = Vec::new();
    let mut twins: Vec<BTreeMap<u64, SharedTwin>> = Vec::new();
    for pair in pairs {
        let Some(family) = &pair.family else { continue };
        let at = names.iter().position(|name| name == family).unwrap_or_else(|| {
            names.push(family);
            counts.push(FamilyPairs::default());
            twins.push(BTreeMap::new());
            names.len() - 1
        });
        let succeeded = |trial: &Trial| trial.ending.is_valid().then_some(trial.ending == Ending::Success);
        let (perturbed, nominal) = (succeeded(pair.perturbed), succeeded(pair.nominal));
        twins[at].entry(pair.nominal.index).or_insert_with(|| SharedTwin::new(nominal)).add(perturbed);
        let of = &mut counts[at];
        match (perturbed, nominal) {
            (Some(true), Some(true)) => of.valid.both += 1,
            (Some(true), Some(false)) => of.valid.first_only += 1,
            (Some(false), Some(true)) => of.valid.second_only += 1,
            (Some(false), Some(false)) => of.valid.neither += 1,
            _ => of.invalid += 1,
        }
    }
    for (of, twins) in counts.iter_mut().zip(twins) {
        if twins.values().any(|twin| twin.episodes() > 1) {
            of.shared = twins.into_values().collect();
        }
    }
    (names, counts)
}

/// The twins of valid pairs and their successes. A twin of several pairs counts once.
fn distinct_twins(pairs: &[Pair<'_>]) -> Trials {
    let valid =
        |pair: &&Pair<'_>| pair.family.is_some() && pair.perturbed.ending.is_valid() && pair.nominal.ending.is_valid();
    let twins: BTreeMap<u64, bool> =
        pairs.iter().filter(valid).map(|pair| (pair.nominal.index, pair.nominal.ending == Ending::Success)).collect();
    Trials::count(twins.into_values())
}

/// How often the run could have been stopped.
fn looks(record: &Record, sampling: Sampling) -> u64 {
    match (record.sampling(sampling), &record.population, record.planned) {
        (Sampling::Fixed, ..) => 1,
        (Sampling::Sequential, Population::Suite { cases, .. }, Some(planned)) => (planned / (*cases).max(1)).max(1),
        (Sampling::Sequential, ..) => UNKNOWN_LOOKS,
    }
}

/// Case and seed of an imported episode, or case and number.
type Identity = (String, i64);

/// The identity of each imported episode.
fn identities(record: &Record, one_case: bool) -> Result<Vec<(Identity, &Trial)>, GateError> {
    let refuse = || GateError::NoIdentity { policy: record.policy.clone() };
    let numbers = recorded_seeds(&record.trials).or_else(|| recorded_numbers(&record.trials)).ok_or_else(refuse)?;
    let case = |trial: &Trial| match &trial.label.case {
        _ if one_case => Ok(String::new()),
        Some(case) => Ok(case.clone()),
        None => Err(refuse()),
    };
    record.trials.iter().zip(numbers).map(|(trial, number)| Ok(((case(trial)?, number), trial))).collect()
}

/// Rejects a pair of different episodes.
fn same_origin(trial: &Trial, twin: &Trial, suite: bool) -> Result<(), GateError> {
    let what = if trial.seed != twin.seed {
        format!("the seeds are {} and {}", trial.seed, twin.seed)
    } else if suite && trial.label != twin.label {
        "the scenarios differ".to_owned()
    } else {
        return Ok(());
    };
    Err(GateError::NotPaired { index: trial.index, what })
}

/// The parameters that differ between the episodes of a pair.
fn perturbed(trial: &Trial, twin: &Trial) -> Vec<String> {
    let differs = |(name, value): &(&str, &Value)| {
        !only_identifies(name) && twin.requested.get(name).is_some_and(|nominal| !same(nominal, value))
    };
    trial.requested.iter().filter(differs).map(|(name, _)| name.to_owned()).collect()
}

/// The declared family of a pair that perturbs only one. `None` if nothing differs.
fn declared_family(task: &TaskSpec, trial: &Trial, twin: &Trial) -> Result<Option<String>, GateError> {
    let family = |name: &String| task.parameter(name).and_then(|spec| spec.family);
    let perturbed = perturbed(trial, twin);
    let Some(first) = perturbed.first() else { return Ok(None) };
    match family(first).filter(|declared| perturbed.iter().all(|name| family(name) == Some(*declared))) {
        Some(declared) => Ok(Some(declared.as_str().to_owned())),
        None => {
            let what = format!("{} are not of one declared family", list(&perturbed));
            Err(GateError::NotPaired { index: trial.index, what })
        }
    }
}

/// The family of a pair: the group of the suite, or the parameters that differ. `None` if nothing differs.
fn family(trial: &Trial, twin: &Trial, by_group: bool) -> Option<String> {
    let perturbed = perturbed(trial, twin);
    if perturbed.is_empty() {
        return None;
    }
    Some(group(trial).filter(|_| by_group).unwrap_or_else(|| match perturbed.len() {
        ..=NAMED_PARAMETERS => list(&perturbed),
        more => format!("{more} parameters together"),
    }))
}

/// The family of an imported pair: its own label, or the parameters that differ.
fn imported_family(trial: &Trial, twin: &Trial) -> Option<String> {
    let own = |of: &Trial| (of.label.category.clone(), of.label.group.clone());
    let labelled = if own(trial) == own(twin) { None } else { group(trial) };
    labelled.or_else(|| family(trial, twin, false)).or_else(|| Some("all perturbations".to_owned()))
}

fn group(trial: &Trial) -> Option<String> {
    match (&trial.label.category, &trial.label.group) {
        (Some(category), Some(group)) if category != group => Some(format!("{category}/{group}")),
        (_, Some(name)) | (Some(name), None) => Some(name.clone()),
        (None, None) => None,
    }
}

/// Whether two values are equal. An integer equals the same number.
fn same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Category(a), Value::Category(b)) => a == b,
        (Value::Category(_), _) | (_, Value::Category(_)) => false,
        (a, b) => (number(a) - number(b)).abs() <= 0.0,
    }
}

fn number(value: &Value) -> f64 {
    match value {
        Value::Integer(n) => *n as f64,
        Value::Number(x) => *x,
        Value::Category(_) => f64::NAN,
    }
}
