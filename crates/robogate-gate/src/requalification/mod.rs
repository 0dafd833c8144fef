//! What an upgrade changes: the same scenarios before and after it, pair by pair.
//!
//! An upgrade that changes nothing but the last bits makes each pair exchangeable: the two episodes differ by chance, and for every
//! property either of them is as likely to have more of it. The signs of a property over the pairs in which it differs are then fair
//! coins, whatever their number, and the evidence against that ([`robogate_stats::anytime`]) holds after any round. A claim needs
//! evidence of at least 1/α divided by the weight of its property: one quarter of the error for success, the rest in equal
//! parts for all other properties, whose number is fixed by the first pair. So the probability of any false claim, over all
//! properties and rounds, is at most α. Pairs that repeat an earlier one bit for bit are not counted.
//!
//! Initial states are compared exactly: they involve no policy.

mod explanation;
mod properties;
mod starts;
mod trace;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use robogate_core::Assignment;
use robogate_stats::anytime::{ln_evidence_above, ln_evidence_below};
use robogate_stats::bounded_mean::BoundedMean;
use robogate_stats::format::{counted, number, percent, points, points_range};
use robogate_stats::interval::Trials;
use serde::Serialize;

use crate::Ending;

pub use explanation::{Divergence, Explanation, SignalChange};
pub use starts::Starts;
pub use trace::{Part, Trace};

use properties::{Family, Property, Signed};

/// A net change of a property in a smaller share of the pairs is not relevant.
const RELEVANT: f64 = 0.1;
/// The share of the error that the test of success has.
const OF_SUCCESS: f64 = 0.25;
/// Properties that are listed in an answer.
const LISTED: usize = 6;

/// An episode on one side of an upgrade.
#[derive(Debug, Clone)]
pub struct Seen {
    /// Its index in the run.
    pub index: u64,
    /// Its parameters.
    pub requested: Assignment,
    /// Its case in a suite.
    pub case: Option<String>,
    /// How it ended.
    pub ending: Ending,
    /// Control periods that ran.
    pub ticks: u32,
    /// Hash of its states. 0 if unknown.
    pub hash: u64,
    /// The first observation.
    pub start: Vec<f64>,
    /// Its physics, where they can be seen.
    pub trace: Option<Arc<Trace>>,
}

/// What a property is about, in the order in which a requalification answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// What a success consists of: contacts, moving parts, duration, drift.
    Meaning,
    /// How episodes end.
    Success,
    /// Whether an episode runs at all.
    Runs,
    /// The work and the accuracy of the solver.
    Solver,
}

/// An answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// Success is equal, but its meaning changed.
    MeaningChanged,
    /// Initial states changed.
    StartsChanged,
    /// Success changed.
    SuccessChanged,
    /// Episodes cannot run any more.
    CannotRun,
    /// The episodes are not pairs.
    NotPaired,
    /// The solver has larger residuals, more iterations or more warnings.
    SolverWorse,
    /// None of these, and the change of success that remains possible is within the margin.
    NoRelevantChange,
    /// None of these, but a change of success beyond the margin remains possible.
    Inconclusive,
}

/// One thing that an upgrade changed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// The kind.
    pub answer: Answer,
    /// What changed, as a sentence.
    pub sentence: String,
    /// The details, as sentences.
    pub details: Vec<String>,
}

/// A property before and after.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PropertyChange {
    /// What it is about.
    pub group: Group,
    /// Its name.
    pub name: String,
    /// Pairs in which it is known.
    pub pairs: u64,
    /// Its mean before and after. For a yes or no, the share of episodes.
    pub mean: [f64; 2],
    /// Pairs with less of it after the upgrade, and with more.
    pub less: u64,
    /// Pairs with more of it after the upgrade.
    pub more: u64,
    /// The p-value of "as many pairs have more of it as less", corrected for all properties and rounds.
    pub p_adjusted: f64,
    /// Whether the change is certain and relevant.
    pub changed: bool,
}

/// Success before and after, over the pairs that ran on both sides.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct SuccessChange {
    /// Pairs.
    pub pairs: u64,
    /// Successes before and after.
    pub successes: [u64; 2],
    /// Pairs that succeeded only before, and only after.
    pub only: [u64; 2],
    /// Success rate after minus before.
    pub difference: f64,
    /// 95 % interval of the difference, valid after any round.
    pub interval_95: [f64; 2],
}

/// What an upgrade changes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Requalification {
    /// The first of the changes, or that none was found.
    pub answer: Answer,
    /// The answer as a sentence.
    pub headline: String,
    /// All changes, in the order of the answers.
    pub changes: Vec<Change>,
    /// Pairs that ran, and that were planned.
    pub pairs: [u64; 2],
    /// Pairs that do not repeat an earlier one bit for bit.
    pub distinct: u64,
    /// Pairs that are equal bit for bit.
    pub identical: u64,
    /// Number of properties that were tested.
    pub properties_tested: u64,
    /// Whether the change of success that remains possible is within the margin.
    pub within_margin: bool,
    /// The largest net change of any other property that remains possible, for all of them together with 95 %.
    pub bound: f64,
    /// Success before and after.
    pub success: SuccessChange,
    /// The properties that differ in some pair.
    pub properties: Vec<PropertyChange>,
    /// The initial states.
    pub starts: Starts,
    /// Where and how episodes differ.
    pub explanation: Explanation,
}

/// Collects pairs of episodes, round by round.
#[derive(Debug)]
pub struct Requalifier {
    planned: u64,
    margin: f64,
    error: f64,
    family: Option<Family>,
    scenarios: Vec<Seen>,
    modes: usize,
    pairs: Vec<[Seen; 2]>,
    /// Numbers of distinct pairs after each round.
    looks: Vec<usize>,
    /// The largest evidence of each property so far, as its logarithm.
    evidence: BTreeMap<Property, f64>,
    /// Why the episodes of a side do not follow from their scenarios.
    unpaired: Option<String>,
}

impl Requalifier {
    /// Before the first pair. `scenarios` are those that may run, with their parameters and cases. A task declares so many failure
    /// `modes`. A change of success within the `margin` is not relevant. `error` is the probability of a false claim.
    pub fn new(scenarios: Vec<Seen>, modes: usize, margin: f64, error: f64) -> Self {
        Self {
            planned: scenarios.len() as u64,
            margin,
            error,
            family: None,
            scenarios,
            modes,
            pairs: Vec::new(),
            looks: Vec::new(),
            evidence: BTreeMap::new(),
            unpaired: None,
        }
    }

    /// Notes why the same scenario is not the same episode on one side.
    pub fn is_unpaired(&mut self, why: String) {
        self.unpaired.get_or_insert(why);
    }

    /// Adds the pairs of a round, before and after the upgrade.
    pub fn round(&mut self, pairs: Vec<[Seen; 2]>) {
        self.pairs.extend(pairs);
        let family = self.family.get_or_insert_with(|| {
            let first = self.pairs.iter().find(|pair| pair.iter().all(|seen| seen.trace.is_some()));
            let traces =
                first.map_or([None, None], |[before, after]| [before.trace.as_deref(), after.trace.as_deref()]);
            Family::of(&self.scenarios, self.modes, traces)
        });
        let distinct = distinct(&self.pairs);
        if self.looks.last().is_none_or(|last| *last < distinct.len()) {
            self.looks.push(distinct.len());
        }
        let mut counts: BTreeMap<Property, [u64; 2]> = BTreeMap::new();
        for [before, after] in &distinct {
            for (property, signed) in family.signs(before, after) {
                let [less, more] = counts.entry(property).or_default();
                *less += u64::from(signed.sign < 0);
                *more += u64::from(signed.sign > 0);
            }
        }
        for (property, [less, more]) in counts {
            let trials = Trials::new(more, less + more).unwrap_or(Trials::NONE);
            let sides = [ln_evidence_above(trials, 0.5), ln_evidence_below(trials, 0.5)];
            let both = (0.5 * sides.map(f64::exp).iter().sum::<f64>()).ln();
            let largest = self.evidence.entry(property).or_insert(0.0);
            *largest = largest.max(both);
        }
    }

    /// The share of the error of a property.
    fn weight(&self, property: &Property) -> f64 {
        let others = self.family.as_ref().map_or(1, |family| family.size).max(2) - 1;
        if *property == success() { OF_SUCCESS } else { (1.0 - OF_SUCCESS) / others as f64 }
    }

    /// What the pairs so far show.
    pub fn conclude(&self) -> Requalification {
        let distinct = distinct(&self.pairs);
        let family = self.family.clone().unwrap_or_else(|| Family::of(&self.scenarios, self.modes, [None, None]));
        let signs: Vec<BTreeMap<Property, Signed>> =
            distinct.iter().map(|[before, after]| family.signs(before, after)).collect();
        let properties = self.properties(&signs);
        let valid: Vec<(&Seen, &Seen)> =
            self.pairs.iter().map(|[one, two]| (one, two)).filter(|(one, two)| both_valid(one, two)).collect();
        let starts = Starts::of(&valid);
        let success = self.success(&signs);
        let mut changes = self.changes(&properties, &starts, &success);
        changes.sort_by_key(|change| change.answer);
        let identical = self.pairs.iter().filter(|[one, two]| is_same(one, two)).count() as u64;
        let tail = (1.0 - OF_SUCCESS) * self.error / (2.0 * (family.size.max(2) - 1) as f64);
        // One that never differs is among them.
        let mut seen: BTreeSet<Vec<Option<i8>>> = BTreeSet::from([vec![Some(0); signs.len()]]);
        let others = signs.iter().flat_map(BTreeMap::keys).filter(|property| **property != self::success());
        for property in others.collect::<BTreeSet<&Property>>() {
            let sign = |pair: &BTreeMap<Property, Signed>| Some(pair.get(property).map_or(0, |of| of.sign));
            seen.insert(signs.iter().map(sign).collect());
        }
        let intervals = seen.iter().map(|signs| self.net(signs, tail));
        let bound = intervals.fold(0.0, |most: f64, [low, high]| most.max(-low).max(high));
        let [low, high] = success.interval_95;
        let within = success.pairs > 0 && low >= -self.margin && high <= self.margin;
        let answer = match changes.first() {
            Some(change) => change.answer,
            None if within => Answer::NoRelevantChange,
            None => Answer::Inconclusive,
        };
        let properties_tested = family.size as u64;
        let headline = match (changes.first(), answer) {
            (Some(change), _) => change.sentence.clone(),
            // Success is within its margin, but there are too few pairs for all others.
            (None, Answer::NoRelevantChange) if bound > RELEVANT => format!(
                "No relevant change of success: it differs by {} to {} points. Of {} other properties none is shown to change, but with \
                 {} a change in up to {} of the episodes, net, is not excluded (95 %).",
                points(low),
                points(high),
                properties_tested - 1,
                counted(success.pairs, "pair"),
                percent(bound)
            ),
            (None, Answer::NoRelevantChange) => format!(
                "No relevant change: success differs by {} to {} points, and any of {} other properties changes in at most {} of the \
                 episodes, net (95 %).",
                points(low),
                points(high),
                properties_tested - 1,
                percent(bound)
            ),
            (None, _) if success.pairs == 0 => "Inconclusive: no pair of episodes ran.".to_owned(),
            (None, _) => format!(
                "Inconclusive: no change was found in {}, but success may differ by {} points (95 %), and the margin is {} points.",
                counted(success.pairs, "pair"),
                points_range([low, high]),
                number(100.0 * self.margin)
            ),
        };
        Requalification {
            answer,
            headline,
            changes,
            pairs: [self.pairs.len() as u64, self.planned],
            distinct: distinct.len() as u64,
            identical,
            properties_tested,
            within_margin: within,
            bound: bound.min(1.0),
            success,
            properties,
            starts,
            explanation: Explanation::of(&valid),
        }
    }

    fn properties(&self, signs: &[BTreeMap<Property, Signed>]) -> Vec<PropertyChange> {
        let names: BTreeSet<&Property> = signs.iter().flat_map(BTreeMap::keys).collect();
        let mut found = Vec::new();
        for property in names {
            let known: Vec<&Signed> = signs.iter().filter_map(|of| of.get(property)).collect();
            let count = |sign: i8| known.iter().filter(|of| of.sign == sign).count() as u64;
            let (less, more) = (count(-1), count(1));
            // A pair in which no episode ends in this way, or has this contact, has none of it.
            let shown_by = match property.group {
                Group::Success if property.name.starts_with("failure ") => Some(success()),
                Group::Meaning if property.name.starts_with("contact of ") => Some(duration()),
                _ => None,
            };
            let pairs = shown_by.map_or(known.len(), |other| signs.iter().filter(|of| of.contains_key(&other)).count());
            let n = pairs as f64;
            if less + more == 0 && *property != success() {
                continue;
            }
            let evidence = self.evidence.get(property).copied().unwrap_or(0.0);
            let p_adjusted = ((-evidence).exp() / self.weight(property)).min(1.0);
            let net = more as f64 - less as f64;
            let relevant = property.group == Group::Success || net.abs() >= RELEVANT * n;
            let worse = property.group != Group::Solver || net > 0.0;
            found.push(PropertyChange {
                group: property.group,
                name: property.name.clone(),
                pairs: pairs as u64,
                mean: [
                    known.iter().map(|of| of.before).sum::<f64>() / n,
                    known.iter().map(|of| of.after).sum::<f64>() / n,
                ],
                less,
                more,
                p_adjusted,
                changed: p_adjusted <= self.error && relevant && worse,
            });
        }
        found
    }

    /// The interval of the net share of pairs with more of a property, of those in which it is known.
    fn net(&self, signs: &[Option<i8>], tail: f64) -> [f64; 2] {
        let values: Vec<f64> = signs.iter().flatten().map(|sign| 1.0 + f64::from(*sign)).collect();
        let known = |look: &usize| signs.iter().take(*look).flatten().count();
        let mut looks: Vec<usize> = self.looks.iter().map(known).filter(|n| *n > 0).collect();
        looks.dedup();
        let interval = BoundedMean::new(&values, &looks, 2.0).map(|mean| mean.interval(tail));
        interval.map_or([-1.0, 1.0], |interval| [interval.low - 1.0, interval.high - 1.0])
    }

    fn success(&self, signs: &[BTreeMap<Property, Signed>]) -> SuccessChange {
        let known: Vec<&Signed> = signs.iter().filter_map(|of| of.get(&success())).collect();
        let count = |of: &dyn Fn(&Signed) -> bool| known.iter().filter(|signed| of(signed)).count() as u64;
        let (lost, gained) = (count(&|of| of.sign < 0), count(&|of| of.sign > 0));
        let n = known.len().max(1) as f64;
        SuccessChange {
            pairs: known.len() as u64,
            successes: [count(&|of| of.before > 0.0), count(&|of| of.after > 0.0)],
            only: [lost, gained],
            difference: (gained as f64 - lost as f64) / n,
            interval_95: if known.is_empty() {
                [-1.0, 1.0]
            } else {
                self.net(&signs.iter().map(|of| of.get(&success()).map(|of| of.sign)).collect::<Vec<_>>(), 0.025)
            },
        }
    }

    fn changes(&self, properties: &[PropertyChange], starts: &Starts, success: &SuccessChange) -> Vec<Change> {
        let changed = |group: Group| -> Vec<&PropertyChange> {
            let mut found: Vec<&PropertyChange> =
                properties.iter().filter(|of| of.group == group && of.changed).collect();
            found.sort_by(|a, b| a.p_adjusted.total_cmp(&b.p_adjusted));
            found
        };
        let told = |found: &[&PropertyChange]| found.iter().take(LISTED).map(|of| told(of)).collect::<Vec<String>>();
        let rates = format!(
            "{} of {} succeed, {} before",
            success.successes[1],
            counted(success.pairs, "pair"),
            success.successes[0]
        );
        let mut changes = Vec::new();
        let unpaired = self.unpaired.clone().or_else(|| {
            starts.mixed_up().then(|| {
                format!(
                    "the starts differ as much as those of different scenarios: {} of them are nearest to that of their own pair",
                    percent(starts.recognized.unwrap_or(0.0))
                )
            })
        });
        if let Some(why) = unpaired {
            let details = vec![format!("without pairs: {rates}")];
            changes.push(Change {
                answer: Answer::NotPaired,
                sentence: format!("The pairing is not valid: {why}."),
                details,
            });
        } else {
            let (meaning, endings) = (changed(Group::Meaning), changed(Group::Success));
            if let (Some(first), true) = (meaning.first(), endings.is_empty()) {
                let sentence = format!("Success is equal ({rates}), but its meaning changed: {}.", self::told(first));
                changes.push(Change { answer: Answer::MeaningChanged, sentence, details: told(&meaning) });
            }
            if starts.changed() {
                let sentence = format!(
                    "Initial states changed: {} of {} differ; effectively different ones: {}, {} before.",
                    starts.different,
                    starts.pairs,
                    number((10.0 * starts.effective[1]).round() / 10.0),
                    number((10.0 * starts.effective[0]).round() / 10.0)
                );
                let details = starts.differences.iter().take(LISTED).cloned().collect();
                changes.push(Change { answer: Answer::StartsChanged, sentence, details });
            }
            if !endings.is_empty() {
                let sentence = format!(
                    "Success changed: {rates} ({} points, 95 % interval {}).",
                    points(success.difference),
                    points_range(success.interval_95)
                );
                let details = told(&endings).into_iter().chain(told(&meaning)).collect();
                changes.push(Change { answer: Answer::SuccessChanged, sentence, details });
            }
        }
        let none_runs = self.pairs.iter().any(|[before, _]| before.ending.is_valid())
            && !self.pairs.iter().any(|[_, after]| after.ending.is_valid());
        if none_runs || changed(Group::Runs).first().is_some_and(|of| of.less > of.more) {
            let (n, of) = (self.failed().count(), self.pairs.len());
            let sentence = format!(
                "It cannot run: {n} of {} end with an error that they did not have before.",
                counted(of as u64, "episode")
            );
            changes.push(Change { answer: Answer::CannotRun, sentence, details: self.causes() });
        }
        let solver = changed(Group::Solver);
        if let Some(first) = solver.first() {
            let sentence = format!("The solver does worse: {}.", self::told(first));
            changes.push(Change { answer: Answer::SolverWorse, sentence, details: told(&solver) });
        }
        changes
    }

    /// The errors of episodes that ran before.
    fn failed(&self) -> impl Iterator<Item = &str> {
        self.pairs.iter().filter_map(|[before, after]| match &after.ending {
            Ending::Invalid(fault) if before.ending.is_valid() => Some(&*fault.detail),
            _ => None,
        })
    }

    /// Those errors with their number, the most frequent first.
    fn causes(&self) -> Vec<String> {
        let mut counts: BTreeMap<&str, u64> = BTreeMap::new();
        self.failed().for_each(|why| *counts.entry(why).or_default() += 1);
        let mut found: Vec<(&str, u64)> = counts.into_iter().collect();
        found.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
        found.into_iter().take(LISTED).map(|(why, n)| format!("{}: {why}", counted(n, "episode"))).collect()
    }
}

impl Requalification {
    /// The answer for an upgrade after which the environment does not start.
    pub fn does_not_start(why: String, planned: u64) -> Self {
        let change = Change {
            answer: Answer::CannotRun,
            sentence: "It cannot run: the environment does not start.".to_owned(),
            details: vec![why],
        };
        let headline = change.sentence.clone();
        let unknown = Requalifier::new(Vec::new(), 0, 0.0, 1.0).conclude();
        Self { answer: Answer::CannotRun, headline, changes: vec![change], pairs: [0, planned], ..unknown }
    }

    /// Whether an answer is certain. That initial states changed is known at once, and says nothing about what follows from it.
    pub fn is_certain(&self) -> bool {
        self.within_margin || self.changes.iter().any(|change| change.answer != Answer::StartsChanged)
    }
}

fn success() -> Property {
    Property { group: Group::Success, name: "success".to_owned() }
}

fn duration() -> Property {
    Property { group: Group::Meaning, name: "duration".to_owned() }
}

fn both_valid(one: &Seen, two: &Seen) -> bool {
    one.ending.is_valid() && two.ending.is_valid()
}

fn is_same(one: &Seen, two: &Seen) -> bool {
    one.hash != 0 && one.hash == two.hash && one.ending == two.ending && one.ticks == two.ticks
}

/// The pairs that do not repeat an earlier one bit for bit.
fn distinct(pairs: &[[Seen; 2]]) -> Vec<&[Seen; 2]> {
    let mut known = BTreeSet::new();
    let is_new = |[one, two]: &&[Seen; 2]| one.hash == 0 || two.hash == 0 || known.insert((one.hash, two.hash));
    pairs.iter().filter(is_new).collect()
}

/// A change of a property as a part of a sentence.
fn told(of: &PropertyChange) -> String {
    let PropertyChange { name, pairs, mean, less, more, .. } = of;
    let shares = matches!(of.group, Group::Success | Group::Runs)
        || ["contact of", "motion of"].iter().any(|kind| name.starts_with(kind));
    let shown = |x: f64| {
        if shares {
            percent(x)
        } else if name.starts_with("drift") || name == "penetration" {
            format!("{} mm", robogate_stats::format::significant(1e3 * x, 2))
        } else if name == "duration" {
            format!("{} control periods", number(x.round()))
        } else {
            robogate_stats::format::significant(x, 2)
        }
    };
    let [before, after] = mean.map(shown);
    format!("{name} {after}, {before} before (more in {more} and less in {less} of {})", counted(*pairs, "pair"))
}
