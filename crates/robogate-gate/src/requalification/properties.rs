//! The properties of a pair of episodes, before and after an upgrade. Each has a sign: more after it, less, or the same.

use std::collections::{BTreeMap, BTreeSet};

use robogate_core::Value;

use super::trace::{ITERATIONS, PENETRATION, RESIDUAL, Trace, WARNINGS};
use super::{Group, Seen};
use crate::Ending;

/// A body that travelled this far has moved, in metres.
const MOVED_M: f64 = 0.005;
/// Drift and depth that differ by less are equal, in metres.
const DRIFT_M: f64 = 0.001;
const DEPTH_M: f64 = 0.0005;
/// Durations and iterations within these factors are equal.
const DURATION: f64 = 1.1;
const SOLVER: f64 = 1.5;
/// Residuals within this factor, or below this size, are equal.
const RESIDUALS: f64 = 10.0;
const NO_RESIDUAL: f64 = 1e-9;

/// A property of an episode.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Property {
    pub(super) group: Group,
    pub(super) name: String,
}

/// A property of a pair.
#[derive(Debug, Clone, Copy)]
pub(super) struct Signed {
    /// 1: more, or true only, after the upgrade. -1: before it.
    pub(super) sign: i8,
    pub(super) before: f64,
    pub(super) after: f64,
}

impl Signed {
    fn of(before: f64, after: f64, is_more: impl Fn(f64, f64) -> bool) -> Self {
        let sign = i8::from(is_more(after, before)) - i8::from(is_more(before, after));
        Self { sign, before, after }
    }

    fn flag(before: bool, after: bool) -> Self {
        Self::of(f64::from(before), f64::from(after), |one, other| one > other)
    }
}

/// Everything that is tested, fixed by the first pair.
#[derive(Debug, Clone)]
pub(super) struct Family {
    /// How many properties there are, with those that no episode shows.
    pub(super) size: usize,
    regions: Vec<Region>,
}

/// A part of the scenarios.
#[derive(Debug, Clone)]
struct Region {
    name: String,
    parameter: String,
    values: Values,
}

#[derive(Debug, Clone)]
enum Values {
    Between(f64, f64),
    Word(String),
}

impl Region {
    fn contains(&self, seen: &Seen) -> bool {
        match (&self.values, seen.requested.get(&self.parameter)) {
            (Values::Between(low, high), Some(value)) => number(value).is_some_and(|x| *low <= x && x <= *high),
            (Values::Word(word), Some(Value::Category(value))) => **value == **word,
            (Values::Word(word), None) => self.parameter.is_empty() && seen.case.as_ref() == Some(word),
            _ => false,
        }
    }
}

fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Number(x) => Some(*x),
        Value::Integer(x) => Some(*x as f64),
        Value::Category(_) => None,
    }
}

/// The thirds of each parameter of the scenarios, its levels, and the cases.
fn regions(scenarios: &[Seen]) -> Vec<Region> {
    /// Values of a parameter that has thirds, and the most levels.
    const FEWEST: usize = 9;
    const MOST_LEVELS: usize = 20;
    let names: BTreeSet<&str> = scenarios.iter().flat_map(|of| of.requested.iter()).map(|(name, _)| name).collect();
    let mut found = Vec::new();
    for name in names {
        let values: Vec<&Value> = scenarios.iter().filter_map(|of| of.requested.get(name)).collect();
        let mut numbers: Vec<f64> = values.iter().filter_map(|value| number(value)).collect();
        numbers.sort_by(f64::total_cmp);
        numbers.dedup();
        if numbers.len() >= FEWEST {
            let at = |third: usize| numbers[(numbers.len() - 1) * third / 3];
            for third in 0..3 {
                let (low, high) = (at(third), at(third + 1));
                let low = if third == 0 { low } else { low.next_up() };
                let shown = robogate_stats::format::range([at(third), high]);
                let region = Region {
                    name: format!("{name} {shown}"),
                    parameter: name.to_owned(),
                    values: Values::Between(low, high),
                };
                found.push(region);
            }
        }
        let words: BTreeSet<String> =
            values.iter().filter(|value| number(value).is_none()).map(ToString::to_string).collect();
        if (2..=MOST_LEVELS).contains(&words.len()) {
            let levels = words.into_iter().map(|word| Region {
                name: format!("{name} = {word}"),
                parameter: name.to_owned(),
                values: Values::Word(word),
            });
            found.extend(levels);
        }
    }
    let cases: BTreeSet<String> = scenarios.iter().filter_map(|of| of.case.clone()).collect();
    if (2..=MOST_LEVELS).contains(&cases.len()) {
        let cases = cases.into_iter().map(|case| Region {
            name: format!("case {case}"),
            parameter: String::new(),
            values: Values::Word(case),
        });
        found.extend(cases);
    }
    found
}

impl Family {
    /// The family for these scenarios, this number of failure modes and the bodies of these traces.
    pub(super) fn of(scenarios: &[Seen], modes: usize, traces: [Option<&Trace>; 2]) -> Self {
        let regions = regions(scenarios);
        let all: BTreeSet<(&str, bool)> =
            traces.iter().flatten().flat_map(|trace| &trace.bodies).map(|part| (&*part.name, part.robot)).collect();
        let objects = all.iter().filter(|(_, robot)| !robot).count();
        // The robot, the surroundings and the objects, in pairs.
        let contacts = (objects + 2) * (objects + 1) / 2;
        let size = 2 + modes + regions.len() + if all.is_empty() { 1 } else { contacts + all.len() + objects + 5 };
        Self { size, regions }
    }

    /// The signs of a pair.
    pub(super) fn signs(&self, before: &Seen, after: &Seen) -> BTreeMap<Property, Signed> {
        let mut found = BTreeMap::new();
        let mut add = |group: Group, name: &str, signed: Signed| {
            found.insert(Property { group, name: name.to_owned() }, signed);
        };
        let valid = [before.ending.is_valid(), after.ending.is_valid()];
        add(Group::Runs, "episode runs", Signed::flag(valid[0], valid[1]));
        if valid != [true, true] {
            return found;
        }
        let success = [before, after].map(|seen| seen.ending == Ending::Success);
        let succeeds = Signed::flag(success[0], success[1]);
        add(Group::Success, "success", succeeds);
        for region in self.regions.iter().filter(|region| region.contains(before)) {
            add(Group::Success, &format!("success where {}", region.name), succeeds);
        }
        let endings = BTreeSet::from([before.ending.as_str(), after.ending.as_str()]);
        for mode in endings.into_iter().filter(|word| *word != Ending::Success.as_str()) {
            let is = |seen: &Seen| seen.ending.as_str() == mode;
            add(Group::Success, &format!("failure {mode}"), Signed::flag(is(before), is(after)));
        }
        if success == [true, true] {
            let times = [before.ticks, after.ticks].map(f64::from);
            add(Group::Meaning, "duration", Signed::of(times[0], times[1], |one, other| one > DURATION * other + 1.0));
        }
        if let (Some(one), Some(two)) = (&before.trace, &after.trace) {
            if success == [true, true] {
                meaning(one, two, &mut add);
            }
            solver(one, two, &mut add);
        }
        found
    }
}

/// What a success consists of.
fn meaning(before: &Trace, after: &Trace, add: &mut dyn FnMut(Group, &str, Signed)) {
    let pairs: BTreeSet<&String> = before.pairs.iter().chain(&after.pairs).collect();
    for pair in pairs {
        let touches = |trace: &Trace| trace.first_touch(|name| name == pair).is_some();
        add(Group::Meaning, &format!("contact of {pair}"), Signed::flag(touches(before), touches(after)));
    }
    let names: BTreeSet<&String> = before.bodies.iter().chain(&after.bodies).map(|part| &part.name).collect();
    for name in names {
        let travel = |trace: &Trace, before: usize| {
            let at = trace.bodies.iter().position(|part| part.name == *name)?;
            Some((trace.travel(at, before), trace.bodies[at].robot))
        };
        let all = |trace: &Trace| travel(trace, usize::MAX).map_or(0.0, |(metres, _)| metres);
        let moves = Signed::flag(all(before) >= MOVED_M, all(after) >= MOVED_M);
        add(Group::Meaning, &format!("motion of {name}"), moves);
        // Until the robot touches anything, an object moves by itself.
        let alone =
            |trace: &Trace| travel(trace, trace.first_touch(|pair| pair.contains("robot")).unwrap_or(usize::MAX));
        if let (Some((one, false)), Some((two, false))) = (alone(before), alone(after)) {
            let drift = Signed::of(one, two, |one, other| one > other + DRIFT_M);
            add(Group::Meaning, &format!("drift of {name} before the robot touches anything"), drift);
        }
    }
}

/// How hard the solver works, and how well.
fn solver(before: &Trace, after: &Trace, add: &mut dyn FnMut(Group, &str, Signed)) {
    let both = |name: &str, of: &dyn Fn(Vec<f64>) -> f64| Some((of(before.signal(name)?), of(after.signal(name)?)));
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    let largest = |values: Vec<f64>| values.into_iter().fold(0.0, f64::max);
    let grown = |values: Vec<f64>| values.last().copied().unwrap_or(0.0) - values.first().copied().unwrap_or(0.0);
    if let Some((one, two)) = both(ITERATIONS, &mean) {
        add(Group::Solver, "solver iterations", Signed::of(one, two, |one, other| one > SOLVER * other + 0.5));
    }
    if let Some((one, two)) = both(RESIDUAL, &largest) {
        let more = |one: f64, other: f64| one > RESIDUALS * other.max(NO_RESIDUAL);
        add(Group::Solver, "solver residual", Signed::of(one, two, more));
    }
    if let Some((one, two)) = both(PENETRATION, &largest) {
        add(Group::Solver, "penetration", Signed::of(one, two, |one, other| one > other + DEPTH_M));
    }
    if let Some((one, two)) = both(WARNINGS, &grown) {
        add(Group::Solver, "engine warnings", Signed::of(one, two, |one, other| one > other));
    }
}
