//! Pairs the rows of two datasets by scenario.

use std::collections::{BTreeMap, BTreeSet};

use robogate_dictionary::{Column, DictionaryError};
use robogate_stats::compare::Pairs;

use super::keys;
use crate::comparison::dataset::Dataset;
use crate::table::Ending;

/// The rows of one dataset that can be paired: those outside focused stages.
pub(super) struct Design {
    rows: Vec<usize>,
    seeds: Vec<Option<u64>>,
}

impl Design {
    pub(super) fn of(dataset: &Dataset<'_>) -> Result<Self, DictionaryError> {
        let rows: Vec<usize> = (0..dataset.table.len()).filter(|row| !dataset.table.is_focused(*row)).collect();
        let seeds = match dataset.source.dictionary().column("seed")? {
            Column::Counts(seeds) => seeds,
            _ => Vec::new(),
        };
        Ok(Self { rows, seeds })
    }

    /// This design without episodes of an active stage that the other one lacks: each campaign has its own model, and only the
    /// episodes that no model chose can have the same scenario.
    fn shared_with(&self, own: &Dataset<'_>, dataset: &Dataset<'_>, other: &Self) -> Self {
        let there: BTreeSet<u64> = other.rows.iter().map(|row| dataset.table.index[*row]).collect();
        let keep = |row: &usize| !own.table.is_uniform_part(*row) || there.contains(&own.table.index[*row]);
        Self { rows: self.rows.iter().copied().filter(keep).collect(), seeds: self.seeds.clone() }
    }
}

/// Why pairs with equal seeds are not the same scenarios: most of them differ in each parameter that varies in both datasets. Tools
/// number their seeds alike. A case is a name that somebody chose: what differs between its rows was not set.
fn contradiction(first: &Dataset<'_>, second: &Dataset<'_>, pairs: &[(usize, usize)], by: &[String]) -> Option<String> {
    /// Parts of the range up to which read-back values are equal.
    const NOISE: f64 = 0.01;
    if by.iter().any(|name| name == "case") {
        return None;
    }
    let mut differing = Vec::new();
    for one in first.table.parameters.iter().filter(|one| !by.contains(&one.name)) {
        let Some(two) = second.table.parameters.iter().find(|two| two.name == one.name) else { continue };
        let [low, high] = one
            .values
            .iter()
            .chain(&two.values)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(*x), high.max(*x)]);
        if low >= high {
            continue;
        }
        let equal = |(a, b): &(usize, usize)| {
            let (a, b) = (one.values[*a], two.values[*b]);
            // Categories are numbered in each dataset by itself.
            one.exactly(a) == two.exactly(b) || (one.is_numeric() && (a - b).abs() <= NOISE * (high - low))
        };
        if 2 * pairs.iter().filter(|pair| equal(pair)).count() >= pairs.len() {
            return None;
        }
        differing.push(one.name.as_str());
    }
    let name = differing.first()?;
    Some(format!("most rows with the same {} have another {name}", by.join(", ")))
}

/// Two datasets with their rows in pairs.
pub(super) struct PairedRows<'a> {
    pub(super) first: &'a Dataset<'a>,
    pub(super) second: &'a Dataset<'a>,
    pub(super) rows: Vec<(usize, usize)>,
    /// The columns that identify the scenarios of imported rows. Empty for equal designs.
    pub(super) by: Vec<String>,
    /// Rows of either dataset without a partner in the other one.
    pub(super) unpaired: u64,
}

impl<'a> PairedRows<'a> {
    /// Pairs the rows of two designs.
    ///
    /// # Errors
    /// The first difference of the designs, as text.
    pub(super) fn of(
        first: &'a Dataset<'a>,
        one: &Design,
        second: &'a Dataset<'a>,
        two: &Design,
    ) -> Result<Self, String> {
        let (one, two) = (one.shared_with(first, second, two), two.shared_with(second, first, one));
        let Some(difference) = difference(first, &one, second, &two) else {
            let rows = one.rows.into_iter().zip(two.rows).collect();
            return Ok(Self { first, second, rows, by: Vec::new(), unpaired: 0 });
        };
        // Tools number their episodes in their own order.
        let imported = |dataset: &Dataset<'_>| {
            dataset.provenance().source.as_ref().is_some_and(|source| source.format != "published_json")
        };
        let keys =
            if imported(first) && imported(second) { keys::common(first, &one.rows, second, &two.rows) } else { None };
        let Some(keys::Keys { by, of }) = keys else { return Err(difference) };
        let there: BTreeMap<&[String], usize> = of[1].iter().map(Vec::as_slice).zip(two.rows.iter().copied()).collect();
        let pair = |(key, row): (&Vec<String>, &usize)| Some((*row, *there.get(key.as_slice())?));
        let rows: Vec<(usize, usize)> = of[0].iter().zip(&one.rows).filter_map(pair).collect();
        let fewest = one.rows.len().min(two.rows.len());
        if rows.is_empty() || 2 * rows.len() < fewest {
            // Two rounded numbers can be equal by chance, and all other rows would be left out.
            return Err(format!("only {} of {fewest} rows have the same {} in both", rows.len(), by.join(", ")));
        }
        if let Some(why) = contradiction(first, second, &rows, &by) {
            return Err(why);
        }
        let unpaired = (one.rows.len() + two.rows.len() - 2 * rows.len()) as u64;
        Ok(Self { first, second, rows, by, unpaired })
    }

    /// How the scenario ended in both datasets.
    pub(super) fn endings(&self, (first, second): (usize, usize)) -> (Ending, Ending) {
        (self.first.table.outcome[first], self.second.table.outcome[second])
    }

    /// Counts of valid pairs by the success of both.
    pub(super) fn counts(&self) -> Pairs {
        let mut pairs = Pairs::default();
        for at in &self.rows {
            count(&mut pairs, self.endings(*at));
        }
        pairs
    }
}

/// Adds one scenario to the counts, unless it is invalid in one of the datasets.
pub(super) fn count(pairs: &mut Pairs, endings: (Ending, Ending)) {
    match endings {
        (Ending::Invalid, _) | (_, Ending::Invalid) => {}
        (Ending::Success, Ending::Success) => pairs.both += 1,
        (Ending::Success, Ending::Failure(_)) => pairs.first_only += 1,
        (Ending::Failure(_), Ending::Success) => pairs.second_only += 1,
        (Ending::Failure(_), Ending::Failure(_)) => pairs.neither += 1,
    }
}

/// The first difference of two designs. `None` if they are equal.
fn difference(first: &Dataset<'_>, one: &Design, second: &Dataset<'_>, two: &Design) -> Option<String> {
    let missing = |from: &Dataset<'_>, other: &Dataset<'_>| {
        from.table
            .parameters
            .iter()
            .find(|p| !other.table.parameters.iter().any(|q| q.name == p.name))
            .map(|p| format!("`{}` has the parameter {} but `{}` does not", from.name, p.name, other.name))
    };
    if let Some(parameter) = missing(first, second).or_else(|| missing(second, first)) {
        return Some(parameter);
    }
    for (dataset, design) in [(first, one), (second, two)] {
        if design.rows.is_empty() {
            return Some(format!("`{}` has no row outside focused stages", dataset.name));
        }
    }
    for (at, (a, b)) in one.rows.iter().zip(&two.rows).enumerate() {
        let (i, j) = (first.table.index[*a], second.table.index[*b]);
        if i != j {
            return Some(format!("row {at} is episode {i} in one but episode {j} in the other"));
        }
        let (s, t) = (one.seeds.get(*a).copied().flatten(), two.seeds.get(*b).copied().flatten());
        if let (Some(s), Some(t)) = (s, t)
            && s != t
        {
            return Some(format!("row {at} (episode {i}) has the seed {s} in one but {t} in the other"));
        }
        for p in &first.table.parameters {
            let Some(q) = second.table.parameters.iter().find(|q| q.name == p.name) else { continue };
            let (x, y) = (p.values[*a], q.values[*b]);
            let (x_text, y_text) = (p.exactly(x), q.exactly(y));
            let same = if p.is_numeric() && q.is_numeric() { x.to_bits() == y.to_bits() } else { x_text == y_text };
            if !same {
                return Some(format!(
                    "row {at} (episode {i}) has {} {x_text} in one but {y_text} in the other",
                    p.name
                ));
            }
        }
    }
    (one.rows.len() != two.rows.len()).then(|| {
        let (n, m) = (one.rows.len(), two.rows.len());
        format!("`{}` has {n} scenarios but `{}` has {m}", first.name, second.name)
    })
}
