//! Two dictionaries that ran the same scenarios: what changed, and where.

use robogate_dictionary::{Column, DictionaryError};
use robogate_stats::compare::{Pairs, mcnemar_exact, newcombe_paired};
use robogate_stats::multiplicity::holm;
use robogate_stats::{Confidence, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::comparison::ComparisonError;
use crate::comparison::axis::SharedAxis;
use crate::comparison::entrant::Entrant;
use crate::labels::{parameter_label, value_with_unit};
use crate::rate::ends;
use crate::rate::{Finding, Rate};
use crate::rows::Seen;
use crate::{AnalysisError, Axis};

/// Two dictionaries of the same scenarios. Rows of a focused stage are left out: each campaign chose its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairedComparison {
    /// Name of the first.
    pub first: String,
    /// Name of the second.
    pub second: String,
    /// Scenarios that both ran.
    pub scenarios: u64,
    /// Scenarios with evidence from both: everything below speaks of these.
    pub valid_pairs: u64,
    /// Both succeeded.
    pub both: u64,
    /// Only the first succeeded.
    pub first_only: u64,
    /// Only the second succeeded.
    pub second_only: u64,
    /// Neither succeeded.
    pub neither: u64,
    /// The first's rate.
    pub first_rate: Rate,
    /// The second's rate.
    pub second_rate: Rate,
    /// First rate less second; absent without valid pairs.
    pub gap: Option<f64>,
    /// Newcombe's paired 95 % interval for it.
    pub gap_95: [f64; 2],
    /// ln of McNemar's exact two-sided p-value.
    pub ln_p: f64,
    /// The p-value adjusted by Holm over all pairs of dictionaries.
    pub holm_p: f64,
    /// Scenarios without evidence, and what they could change.
    pub invalid: PairedInvalid,
    /// How the two ended, one against the other.
    pub outcomes: CrossTable,
    /// Where they disagree.
    pub disagreement: Finding<DisagreementMap>,
    /// Scenarios that end in success for one and in failure for the other: the first of each direction.
    pub flips: Vec<Flip>,
}

/// Scenarios without evidence from both.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairedInvalid {
    /// Invalid in the first.
    pub first: u64,
    /// Invalid in the second.
    pub second: u64,
    /// Invalid in at least one: in no rate.
    pub either: u64,
    /// The smallest and largest gap that any outcome of the missing episodes could have given over all scenarios.
    pub gap_bounds: Option<[f64; 2]>,
}

/// Outcomes of the first (rows) against those of the second (columns).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CrossTable {
    /// The outcomes, of rows and columns alike.
    pub outcomes: Vec<String>,
    /// Scenarios, one row for each outcome of the first.
    pub counts: Vec<Vec<u64>>,
}

/// Where two dictionaries disagree, over two parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DisagreementMap {
    /// The parameter across.
    pub x: Axis,
    /// The parameter upwards.
    pub y: Axis,
    /// The cells, row by row from the lowest y, x running fastest.
    pub cells: Vec<DisagreementCell>,
}

/// One cell.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DisagreementCell {
    /// Valid pairs, those that disagree counted as successes: the rate is the share that disagrees.
    pub disagree: Rate,
    /// Only the first succeeded.
    pub first_only: u64,
    /// Only the second succeeded.
    pub second_only: u64,
    /// McNemar's exact p-value, adjusted by Holm over the cells.
    pub holm_p: f64,
}

/// A scenario that one solved and the other did not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Flip {
    /// Its index in both campaigns.
    pub index: u64,
    /// How the first ended.
    pub first: String,
    /// How the second ended.
    pub second: String,
    /// Its parameters, name and value.
    pub parameters: Vec<(String, String)>,
    /// What shows them again, where they can be shown again.
    pub replay: Vec<String>,
}

impl Flip {
    /// The parameters in one line.
    pub fn describe(&self) -> String {
        let all = self
            .parameters
            .iter()
            .map(|(parameter, value)| format!("{} {}", parameter_label(parameter), value_with_unit(value, parameter)));
        all.collect::<Vec<_>>().join(", ")
    }
}

/// The rows of one dictionary that pair: those of no focused stage.
struct Design {
    rows: Vec<usize>,
    seeds: Vec<Option<u64>>,
}

impl Design {
    fn of(entrant: &Entrant<'_>) -> Result<Self, DictionaryError> {
        let rows: Vec<usize> = (0..entrant.rows.len()).filter(|row| !entrant.rows.is_focused(*row)).collect();
        let seeds = match entrant.source.dictionary().column("seed")? {
            Column::Counts(seeds) => seeds,
            _ => Vec::new(),
        };
        Ok(Self { rows, seeds })
    }
}

/// The first way in which two designs differ, if they do.
fn difference(first: &Entrant<'_>, one: &Design, second: &Entrant<'_>, two: &Design) -> Option<String> {
    let missing = |from: &Entrant<'_>, in_: &Entrant<'_>| {
        from.rows
            .parameters
            .iter()
            .find(|p| !in_.rows.parameters.iter().any(|q| q.name == p.name))
            .map(|p| format!("`{}` has the parameter {}, `{}` has not", from.name, p.name, in_.name))
    };
    if let Some(parameter) = missing(first, second).or_else(|| missing(second, first)) {
        return Some(parameter);
    }
    for (entrant, design) in [(first, one), (second, two)] {
        if design.rows.is_empty() {
            return Some(format!("`{}` has no row outside a focused stage", entrant.name));
        }
    }
    for (at, (a, b)) in one.rows.iter().zip(&two.rows).enumerate() {
        let (i, j) = (first.rows.index[*a], second.rows.index[*b]);
        if i != j {
            return Some(format!("row {at} is episode {i} in one and episode {j} in the other"));
        }
        let (s, t) = (one.seeds.get(*a).copied().flatten(), two.seeds.get(*b).copied().flatten());
        if let (Some(s), Some(t)) = (s, t)
            && s != t
        {
            return Some(format!("row {at} (episode {i}) has the seed {s} in one and {t} in the other"));
        }
        for p in &first.rows.parameters {
            let Some(q) = second.rows.parameters.iter().find(|q| q.name == p.name) else { continue };
            let (x, y) = (p.values[*a], q.values[*b]);
            let (said_x, said_y) = (p.exactly(x), q.exactly(y));
            let same = if p.is_numeric() && q.is_numeric() { x.to_bits() == y.to_bits() } else { said_x == said_y };
            if !same {
                return Some(format!(
                    "row {at} (episode {i}) has {} {said_x} in one and {said_y} in the other",
                    p.name
                ));
            }
        }
    }
    (one.rows.len() != two.rows.len())
        .then(|| format!("`{}` holds {} of them, `{}` {}", first.name, one.rows.len(), second.name, two.rows.len()))
}

/// How two dictionaries went on the scenarios that both ran; `None` where they did not run the same ones.
pub(crate) fn same_scenarios(first: &Entrant<'_>, second: &Entrant<'_>) -> Result<Option<Pairs>, AnalysisError> {
    let (one, two) = (Design::of(first)?, Design::of(second)?);
    if difference(first, &one, second, &two).is_some() {
        return Ok(None);
    }
    let rows: Vec<(usize, usize)> = one.rows.into_iter().zip(two.rows).collect();
    Ok(Some(pairs(first, second, &rows)))
}

/// Scenarios with evidence from both, by who succeeded.
fn pairs(first: &Entrant<'_>, second: &Entrant<'_>, rows: &[(usize, usize)]) -> Pairs {
    let mut pairs = Pairs::default();
    for (a, b) in rows {
        match (first.rows.outcome[*a], second.rows.outcome[*b]) {
            (Seen::Invalid, _) | (_, Seen::Invalid) => {}
            (Seen::Success, Seen::Success) => pairs.both += 1,
            (Seen::Success, Seen::Failure(_)) => pairs.first_only += 1,
            (Seen::Failure(_), Seen::Success) => pairs.second_only += 1,
            (Seen::Failure(_), Seen::Failure(_)) => pairs.neither += 1,
        }
    }
    pairs
}

/// Compares every two of them, scenario by scenario.
pub(crate) fn paired(
    entrants: &[&Entrant<'_>],
    pair: Option<(&str, &str)>,
    most_flips: usize,
) -> Result<Vec<PairedComparison>, ComparisonError> {
    let designs: Vec<Design> = entrants
        .iter()
        .map(|entrant| Design::of(entrant))
        .collect::<Result<_, _>>()
        .map_err(crate::AnalysisError::from)?;
    let mut found = Vec::new();
    for (i, first) in entrants.iter().enumerate() {
        for (j, second) in entrants.iter().enumerate().skip(i + 1) {
            if let Some(difference) = difference(first, &designs[i], second, &designs[j]) {
                return Err(ComparisonError::NotTheSameDesign {
                    first: first.name.clone(),
                    second: second.name.clone(),
                    difference,
                });
            }
            let rows: Vec<(usize, usize)> =
                designs[i].rows.iter().copied().zip(designs[j].rows.iter().copied()).collect();
            found.push(one(first, second, &rows, pair, most_flips));
        }
    }
    let p: Vec<f64> = found.iter().map(|of| of.ln_p.exp()).collect();
    let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
    found.iter_mut().zip(adjusted).for_each(|(of, p)| of.holm_p = p);
    Ok(found)
}

fn one(
    first: &Entrant<'_>,
    second: &Entrant<'_>,
    rows: &[(usize, usize)],
    pair: Option<(&str, &str)>,
    most_flips: usize,
) -> PairedComparison {
    let seen = |(a, b): &(usize, usize)| (first.rows.outcome[*a], second.rows.outcome[*b]);
    let pairs = pairs(first, second, rows);
    let mut invalid = (0, 0, 0);
    let mut bounds = [0_i64; 2];
    let names = outcome_names(first, second);
    let place = |entrant: &Entrant<'_>, seen: Seen| {
        let name = entrant.rows.outcome_name(seen);
        names.iter().position(|known| *known == name).unwrap_or_default()
    };
    let mut counts = vec![vec![0; names.len()]; names.len()];
    for at in rows {
        let (one, two) = seen(at);
        counts[place(first, one)][place(second, two)] += 1;
        invalid.0 += u64::from(one == Seen::Invalid);
        invalid.1 += u64::from(two == Seen::Invalid);
        invalid.2 += u64::from(one == Seen::Invalid || two == Seen::Invalid);
        let [low_one, high_one] = possible(one);
        let [low_two, high_two] = possible(two);
        bounds[0] += low_one - high_two;
        bounds[1] += high_one - low_two;
    }
    let gap = newcombe_paired(pairs, Confidence::P95);
    let rate = |successes| Rate::of(Trials::new(successes, pairs.n()).unwrap_or(Trials::NONE));
    let (outcomes, counts) = without_empty(&names, counts);
    PairedComparison {
        first: first.name.clone(),
        second: second.name.clone(),
        scenarios: rows.len() as u64,
        valid_pairs: pairs.n(),
        both: pairs.both,
        first_only: pairs.first_only,
        second_only: pairs.second_only,
        neither: pairs.neither,
        first_rate: rate(pairs.both + pairs.first_only),
        second_rate: rate(pairs.both + pairs.second_only),
        gap: gap.estimate,
        gap_95: ends(gap.interval),
        ln_p: mcnemar_exact(pairs).max(f64::MIN),
        holm_p: 1.0,
        invalid: PairedInvalid {
            first: invalid.0,
            second: invalid.1,
            either: invalid.2,
            gap_bounds: (invalid.2 > 0).then(|| bounds.map(|bound| bound as f64 / rows.len() as f64)),
        },
        outcomes: CrossTable { outcomes, counts },
        disagreement: disagreement(first, second, rows, pair),
        flips: flips(first, second, rows, most_flips),
    }
}

/// Success as 0 or 1: what it was, or what it could have been.
fn possible(seen: Seen) -> [i64; 2] {
    match seen {
        Seen::Success => [1, 1],
        Seen::Failure(_) => [0, 0],
        Seen::Invalid => [0, 1],
    }
}

/// Every outcome that either can have: success, the failure modes of both, invalid.
fn outcome_names(first: &Entrant<'_>, second: &Entrant<'_>) -> Vec<&'static str> {
    let mut names = vec!["success"];
    for mode in first.rows.modes.iter().chain(&second.rows.modes) {
        if !names.contains(&mode.as_str()) {
            names.push(mode.as_str());
        }
    }
    names.push("invalid");
    names
}

/// Without outcomes that neither had.
fn without_empty(names: &[&str], counts: Vec<Vec<u64>>) -> (Vec<String>, Vec<Vec<u64>>) {
    let keep: Vec<bool> =
        (0..counts.len()).map(|i| counts[i].iter().any(|n| *n > 0) || counts.iter().any(|row| row[i] > 0)).collect();
    let kept = |i: &usize| keep[*i];
    let words = (0..names.len()).filter(kept).map(|i| names[i].to_owned()).collect();
    let counts = (0..counts.len()).filter(kept).map(|i| (0..counts.len()).filter(kept).map(|j| counts[i][j]).collect());
    (words, counts.collect())
}

fn disagreement(
    first: &Entrant<'_>,
    second: &Entrant<'_>,
    rows: &[(usize, usize)],
    pair: Option<(&str, &str)>,
) -> Finding<DisagreementMap> {
    let Some((up, across)) = pair else {
        return Finding::not("there are no two numeric parameters to draw a map over");
    };
    let bins = ((rows.len() / 25) as f64).sqrt() as usize;
    let axis = |parameter: &str| SharedAxis::of(&[first, second], parameter, bins.clamp(3, 10));
    let (y, x) = match (axis(up), axis(across)) {
        (Ok(y), Ok(x)) => (y, x),
        (Err(because), _) | (_, Err(because)) => return Finding::CannotBeEstimated { because },
    };
    let all = |name: &str| first.rows.parameters.iter().find(|p| p.name == name);
    let (Some(up), Some(across)) = (all(up), all(across)) else {
        return Finding::not("one of the two parameters is missing");
    };
    let (y_places, x_places) = (y.places(up), x.places(across));
    let mut cells = vec![Pairs::default(); y.cells() * x.cells()];
    for (a, b) in rows {
        let (Some(row), Some(column)) = (y_places[*a], x_places[*a]) else { continue };
        let cell = &mut cells[row * x.cells() + column];
        match (first.rows.outcome[*a], second.rows.outcome[*b]) {
            (Seen::Invalid, _) | (_, Seen::Invalid) => {}
            (Seen::Success, Seen::Success) => cell.both += 1,
            (Seen::Success, Seen::Failure(_)) => cell.first_only += 1,
            (Seen::Failure(_), Seen::Success) => cell.second_only += 1,
            (Seen::Failure(_), Seen::Failure(_)) => cell.neither += 1,
        }
    }
    let p: Vec<f64> = cells.iter().map(|cell| mcnemar_exact(*cell).exp()).collect();
    let adjusted = holm(&p).unwrap_or_else(|_| vec![1.0; p.len()]);
    let cells = cells.iter().zip(adjusted).map(|(cell, holm_p)| DisagreementCell {
        disagree: Rate::of(Trials::new(cell.first_only + cell.second_only, cell.n()).unwrap_or(Trials::NONE)),
        first_only: cell.first_only,
        second_only: cell.second_only,
        holm_p,
    });
    Finding::Estimated(DisagreementMap { cells: cells.collect(), x: x.axis, y: y.axis })
}

fn flips(first: &Entrant<'_>, second: &Entrant<'_>, rows: &[(usize, usize)], most: usize) -> Vec<Flip> {
    let mut left = [most; 2];
    let mut found = Vec::new();
    for (a, b) in rows {
        let (one, two) = (first.rows.outcome[*a], second.rows.outcome[*b]);
        let direction = match (one, two) {
            (Seen::Success, Seen::Failure(_)) => 0,
            (Seen::Failure(_), Seen::Success) => 1,
            _ => continue,
        };
        if left[direction] == 0 {
            continue;
        }
        left[direction] -= 1;
        let index = first.rows.index[*a];
        found.push(Flip {
            index,
            first: first.rows.outcome_name(one).to_owned(),
            second: second.rows.outcome_name(two).to_owned(),
            parameters: first.rows.parameters.iter().map(|p| (p.name.clone(), p.show(p.values[*a]))).collect(),
            replay: [first, second].into_iter().filter_map(|entrant| entrant.replay(index)).collect(),
        });
    }
    found
}
