//! How two sets of answers to the same requests are related, number by number.

use super::Fingerprint;
use crate::chunk::Chunk;

/// The largest difference that a relation leaves, in spreads. It is above the tolerance, because a relation amplifies rounding.
const EXPLAINED: f64 = 2e-3;
/// A difference that is small beside the spread: other arithmetic or slightly other weights.
const SMALL: f64 = 0.05;
/// The largest number of rows by which chunks are compared with an offset.
const MOST_OFFSET: usize = 4;

/// The words for a number without a simple relation.
pub(super) const DIFFERS: &str = "differs";

/// The known factors between units.
const UNITS: [(f64, &str); 4] = [
    (180.0 / std::f64::consts::PI, "degrees in place of radians"),
    (std::f64::consts::PI / 180.0, "radians in place of degrees"),
    (1000.0, "millimetres in place of metres"),
    (0.001, "metres in place of millimetres"),
];

/// Explains the difference between the judged answers and the deployed ones. Empty if no simple relation holds.
pub(super) fn relations(judged: &Fingerprint, deployed: &[Chunk]) -> Vec<String> {
    let pairs: Vec<(&Chunk, &Chunk)> =
        judged.probes.iter().filter_map(|probe| probe.answers.first()).zip(deployed).collect();
    let mut found = Vec::new();
    let lengths = |of: fn(&(&Chunk, &Chunk)) -> usize| pairs.first().map_or(0, of);
    let rows = [lengths(|pair| pair.0.rows().len()), lengths(|pair| pair.1.rows().len())];
    if rows[0] != rows[1] {
        found.push(format!("an answer has {} actions in place of {}", rows[1], rows[0]));
    }
    let sizes = [lengths(|pair| pair.0.rows()[0].len()), lengths(|pair| pair.1.rows()[0].len())];
    if sizes[0] != sizes[1] {
        found.push(format!("an action has {} numbers in place of {}", sizes[1], sizes[0]));
        return found;
    }
    let columns = Columns { pairs, spreads: judged.spreads() };
    found.extend(columns.explained(judged));
    found
}

struct Columns<'a> {
    pairs: Vec<(&'a Chunk, &'a Chunk)>,
    spreads: Vec<f64>,
}

impl Columns<'_> {
    /// Pairs of a judged and a deployed number: column `from` of the judged answers, `to` of the deployed ones, `offset` rows later.
    fn numbers(&self, from: usize, to: usize, offset: usize) -> Vec<(f64, f64)> {
        let rows = self.pairs.iter().flat_map(|(a, b)| a.rows().iter().skip(offset).zip(b.rows()));
        rows.filter_map(|(a, b)| Some((*a.get(from)?, *b.get(to)?))).collect()
    }

    /// The largest difference that a relation leaves, in spreads of the column.
    fn left(&self, at: usize, pairs: &[(f64, f64)], relation: impl Fn(f64) -> f64) -> f64 {
        let spread = self.spreads.get(at).copied().unwrap_or(1.0);
        pairs
            .iter()
            .map(|(a, b)| (relation(*a) - b).abs() / spread)
            .fold(0.0, |most, x| if x <= most { most } else { x })
    }

    fn explained(&self, judged: &Fingerprint) -> Vec<String> {
        let size = self.spreads.len();
        let tolerance = judged.tolerance();
        let differ: Vec<usize> =
            (0..size).filter(|at| self.left(*at, &self.numbers(*at, *at, 0), |a| a) > tolerance).collect();
        if differ.is_empty() {
            return Vec::new();
        }
        let varies = |at: usize| {
            let numbers = self.numbers(at, at, 0);
            numbers.iter().any(|(_, b)| (b - numbers[0].1).abs() > tolerance * self.spreads[at])
        };
        if !(0..size).any(varies) {
            return vec!["the answers do not depend on the request".to_owned()];
        }
        if differ.iter().all(|at| self.left(*at, &self.numbers(*at, *at, 0), |a| a) < SMALL) {
            let largest = differ.iter().map(|at| self.left(*at, &self.numbers(*at, *at, 0), |a| a)).fold(0.0, f64::max);
            return vec![format!(
                "all numbers agree within {:.2} % of their spread: slightly other weights, or lower precision",
                100.0 * largest
            )];
        }
        if let Some(offset) = (1..=MOST_OFFSET).find(|offset| self.shifted(*offset)) {
            return vec![format!("the actions of an answer begin {offset} later than those of the judged policy")];
        }
        if let Some(factor) = self.common_factor(&differ)
            && !self.is_unit((factor, 0.0))
        {
            return vec![format!(
                "{} numbers of the action are {factor:.4} times those of the judged policy: another scale",
                differ.len()
            )];
        }
        let affine: Vec<Option<(f64, f64)>> = differ.iter().map(|at| self.affine(*at)).collect();
        if differ.len() > 1
            && affine.iter().all(Option::is_some)
            && !affine.iter().flatten().any(|fit| self.is_unit(*fit))
        {
            return vec![format!(
                "{} numbers of the action are scaled and shifted, each in its own way: the normaliser of another data set",
                affine.len()
            )];
        }
        let each: Vec<(usize, Option<String>)> =
            differ.iter().zip(affine).map(|(at, fit)| (*at, self.of_column(*at, fit, judged))).collect();
        if each.iter().all(|(_, words)| words.is_none()) {
            return Vec::new();
        }
        let words = |(at, words): (usize, Option<String>)| {
            words.unwrap_or_else(|| format!("{} {DIFFERS}", self.name(at, judged)))
        };
        each.into_iter().map(words).collect()
    }

    /// Whether the deployed rows are the judged ones from this offset on.
    fn shifted(&self, offset: usize) -> bool {
        (0..self.spreads.len()).all(|at| {
            let numbers = self.numbers(at, at, offset);
            numbers.len() >= self.pairs.len() && self.left(at, &numbers, |a| a) < EXPLAINED
        })
    }

    /// The factor of all of several columns that differ, if one without an offset explains them.
    fn common_factor(&self, differ: &[usize]) -> Option<f64> {
        let in_spreads = |at: &usize| {
            let spread = self.spreads.get(*at).copied().unwrap_or(1.0);
            self.numbers(*at, *at, 0).into_iter().map(move |(a, b)| (a / spread, b / spread))
        };
        let (ab, aa) = differ.iter().flat_map(in_spreads).fold((0.0, 0.0), |(ab, aa), (a, b)| (ab + a * b, aa + a * a));
        let factor = ab / aa;
        let most = EXPLAINED * factor.abs().max(1.0);
        let explains = |at: &usize| self.left(*at, &self.numbers(*at, *at, 0), |a| factor * a) < most;
        (differ.len() > 1 && factor.abs() > 1e-6 && differ.iter().all(explains)).then_some(factor)
    }

    /// Factor and offset of a column, if they explain it and it varies.
    fn affine(&self, at: usize) -> Option<(f64, f64)> {
        let numbers = self.numbers(at, at, 0);
        let n = numbers.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| numbers.iter().map(of).sum::<f64>() / n;
        let (a, b) = (mean(|pair| pair.0), mean(|pair| pair.1));
        let variance = numbers.iter().map(|pair| (pair.0 - a).powi(2)).sum::<f64>();
        if numbers.len() < 3 || variance <= 1e-18 {
            return None;
        }
        let factor = numbers.iter().map(|pair| (pair.0 - a) * (pair.1 - b)).sum::<f64>() / variance;
        let offset = b - factor * a;
        let left = self.left(at, &numbers, |x| factor * x + offset);
        (factor.abs() > 1e-6 && left < EXPLAINED * factor.abs().max(1.0)).then_some((factor, offset))
    }

    /// Whether a factor without an offset is a change of sign or unit, or a factor of its own.
    fn is_unit(&self, (factor, offset): (f64, f64)) -> bool {
        let near = |known: f64| (factor / known - 1.0).abs() < 0.01;
        let plain = offset.abs() < 0.01 * factor.abs().max(1.0);
        near(-1.0) || plain && UNITS.iter().any(|(known, _)| near(*known))
    }

    fn name(&self, at: usize, judged: &Fingerprint) -> String {
        let last = at + 1 == self.spreads.len() && judged.profile.action.gripper_threshold.is_some();
        if last { "the gripper's number".to_owned() } else { format!("number {} of the action", at + 1) }
    }

    /// How a column is related to the judged answers. `None` without a simple relation.
    fn of_column(&self, at: usize, affine: Option<(f64, f64)>, judged: &Fingerprint) -> Option<String> {
        let name = self.name(at, judged);
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.01;
        let small = |offset: f64| offset.abs() < 0.01 * self.spreads[at].max(1e-3);
        let Some((factor, offset)) = affine else {
            let mut others = (0..self.spreads.len()).filter(|from| *from != at);
            let from = others.find(|from| self.left(at, &self.numbers(*from, at, 0), |a| a) < EXPLAINED)?;
            return Some(format!("{name} is number {} of the judged one: another order", from + 1));
        };
        Some(if near(factor, -1.0) && near(offset, 1.0) {
            format!("{name} is one minus the judged one")
        } else if near(factor, -1.0) && small(offset) {
            format!("{name} has the opposite sign")
        } else if let (true, Some((_, words))) = (small(offset), UNITS.iter().find(|(known, _)| near(factor, *known))) {
            format!("{name} is in {words}")
        } else if small(offset) {
            format!("{name} is {factor:.3} times the judged one")
        } else {
            format!("{name} is {factor:.3} times the judged one, plus {offset:.3}")
        })
    }
}
