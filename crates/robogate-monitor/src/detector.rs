//! The mixture Shiryaev-Roberts e-detector: evidence for a change at an unknown time.
//!
//! The input is a stream of symbols (failed or not; the bin of a cycle time; a failure mode). An alternative k maps a
//! symbol x to a factor e_k(x) ≥ 0. Without a change, its expectation given the past is at most 1. The statistic of
//! each alternative is
//!
//! M_k ← (1 + M_k) e_k(x),   M_k = 0 at the start,   M = Σ w_k M_k with Σ w_k = 1,
//!
//! which sums the evidence since every possible start of the change. Without a change, M_t - t is a supermartingale, so
//! the mean number of symbols until M ≥ A is at least A. This bound needs no simulation and no large-sample
//! approximation. It holds for any number of detectors together: see [`crate::Shares`].
//!
//! Numerical range: M stays between the smallest factor and A times the largest, because an alarm restarts it at 0 and
//! 1 + M ≥ 1. It cannot overflow or underflow. One update costs one multiplication and two additions per alternative,
//! and allocates nothing.
//!
//! Limitation: the bound is on the mean, and it assumes that the expectation is at most 1. Each builder states its
//! assumption. Sources: Shiryaev (1963), Theory Probab. Appl. 8; Roberts (1966), Technometrics 8; Shin, Ramdas and
//! Rinaldo (2024), "E-detectors: a nonparametric framework for sequential change detection", New England J. Stat. Data
//! Sci. 2.

use serde::{Deserialize, Serialize};

/// The factors of a detector: the weight of each alternative, and the factor of each symbol.
#[derive(Debug, Clone, PartialEq)]
pub struct Factors {
    weights: Vec<f64>,
    /// The factors of all alternatives, symbol by symbol.
    factors: Vec<f64>,
}

impl Factors {
    /// Builds the table from the weight and the factors of each alternative. Weights are scaled to sum to one.
    ///
    /// `None` without alternatives or symbols, for tables of unequal length, and for a negative or non-finite number.
    pub fn new(alternatives: &[(f64, Vec<f64>)]) -> Option<Self> {
        let symbols = alternatives.first()?.1.len();
        let good = |x: &f64| x.is_finite() && *x >= 0.0;
        let total: f64 = alternatives.iter().map(|(weight, _)| weight).sum();
        let whole = alternatives.iter().all(|(w, f)| good(w) && f.len() == symbols && f.iter().all(good));
        if symbols == 0 || !whole || total <= 0.0 {
            return None;
        }
        let factors = (0..symbols).flat_map(|s| alternatives.iter().filter_map(move |(_, f)| f.get(s).copied()));
        Some(Self { weights: alternatives.iter().map(|(w, _)| w / total).collect(), factors: factors.collect() })
    }

    /// The number of alternatives.
    pub fn alternatives(&self) -> usize {
        self.weights.len()
    }

    /// The number of symbols.
    pub fn symbols(&self) -> usize {
        self.factors.len() / self.weights.len()
    }

    /// The factors of all alternatives for a symbol. Empty for an unknown symbol.
    pub fn of(&self, symbol: u8) -> &[f64] {
        let k = self.weights.len();
        let at = usize::from(symbol) * k;
        self.factors.get(at..at + k).unwrap_or_default()
    }

    /// The factors with their logarithms divided by `inflation`, which is at least 1.
    pub fn tempered(&self, inflation: f64) -> Self {
        let factors = self.factors.iter().map(|e| e.powf(1.0 / inflation.max(1.0))).collect();
        Self { weights: self.weights.clone(), factors }
    }

    /// The largest expectation of any alternative's factor, for these probabilities of the symbols. The bound on false
    /// alarms requires at most 1.
    pub fn largest_expectation(&self, probabilities: &[f64]) -> f64 {
        let mean = |k: usize| -> f64 {
            let factor = |s: usize| self.factors.get(s * self.weights.len() + k).copied().unwrap_or(0.0);
            probabilities.iter().enumerate().map(|(s, p)| p * factor(s)).sum()
        };
        (0..self.weights.len()).map(mean).fold(0.0, f64::max)
    }
}

/// The evidence for a change, for each alternative. This is the whole state of a detector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Evidence(Vec<f64>);

impl Evidence {
    /// Creates zero evidence.
    pub fn none(factors: &Factors) -> Self {
        Self(vec![0.0; factors.alternatives()])
    }

    /// Whether the evidence has the size of these factors.
    pub fn fits(&self, factors: &Factors) -> bool {
        self.0.len() == factors.alternatives() && self.0.iter().all(|m| m.is_finite() && *m >= 0.0)
    }

    /// Updates the evidence with one symbol and returns M. An unknown symbol changes nothing.
    pub fn update(&mut self, factors: &Factors, symbol: u8) -> f64 {
        let mut mixture = 0.0;
        let known = factors.of(symbol);
        if known.is_empty() {
            return self.value(factors);
        }
        for ((m, e), w) in self.0.iter_mut().zip(known).zip(&factors.weights) {
            *m = (1.0 + *m) * e;
            mixture += w * *m;
        }
        mixture
    }

    /// The current M.
    pub fn value(&self, factors: &Factors) -> f64 {
        self.0.iter().zip(&factors.weights).map(|(m, w)| m * w).sum()
    }

    /// Divides the logarithms of the evidence, where there is any, because cycles depend on each other more than before. A smaller
    /// inflation changes nothing.
    pub(crate) fn divide(&mut self, by: f64) {
        self.0.iter_mut().filter(|m| **m > 1.0 && by > 1.0).for_each(|m| *m = m.powf(1.0 / by));
    }

    /// Resets the evidence to zero.
    pub fn restart(&mut self) {
        self.0.fill(0.0);
    }
}

/// The start of a change, counted in symbols back from the newest (0 is the newest).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChangePoint {
    /// The most likely start.
    pub likeliest: usize,
    /// The latest start in the 95 % interval.
    pub latest: usize,
    /// The earliest start in the 95 % interval.
    pub earliest: usize,
    /// Whether the interval reaches the oldest stored symbol. The change may then have started earlier.
    pub or_before: bool,
    /// The alternative that best explains the symbols.
    pub alternative: usize,
}

impl ChangePoint {
    /// Extends the interval over that of another estimate. The most likely start is kept.
    pub fn extended(self, other: Self) -> Self {
        Self {
            latest: self.latest.min(other.latest),
            earliest: self.earliest.max(other.earliest),
            or_before: self.or_before || other.or_before,
            ..self
        }
    }
}

/// Estimates the start of a change from the stored symbols, newest first.
///
/// The factors state the rate before the change. An upper bound of that rate dates the change too late: extend the
/// interval by that of the estimated rate.
///
/// Each start s has the weight Σ_k w_k Π_{i ≥ s} e_k(x_i), its posterior for a uniform prior over the stored symbols.
/// The interval excludes 2.5 % on each side. `None` without symbols. It allocates, but runs only at an alarm.
pub fn change_point(factors: &Factors, newest_first: impl Iterator<Item = u8>) -> Option<ChangePoint> {
    let mut logs = vec![0.0_f64; factors.alternatives()];
    let mut weights = Vec::new();
    let mut best = (f64::NEG_INFINITY, 0);
    for symbol in newest_first {
        for (log, e) in logs.iter_mut().zip(factors.of(symbol)) {
            *log += e.ln();
        }
        let top = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for (k, log) in logs.iter().enumerate() {
            if *log > best.0 {
                best = (*log, k);
            }
        }
        let sum: f64 = logs.iter().zip(&factors.weights).map(|(log, w)| w * (log - top).exp()).sum();
        weights.push(if top.is_finite() { top + sum.ln() } else { f64::NEG_INFINITY });
    }
    let top = weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !top.is_finite() {
        return None;
    }
    let likeliest = weights.iter().position(|w| *w >= top)?;
    let shares: Vec<f64> = weights.iter().map(|w| (w - top).exp()).collect();
    let total: f64 = shares.iter().sum();
    let reached = |share: f64| {
        let mut sum = 0.0;
        shares.iter().position(|x| {
            sum += x / total;
            sum >= share
        })
    };
    let last = shares.len() - 1;
    let (latest, earliest) = (reached(0.025).unwrap_or(0), reached(0.975).unwrap_or(last));
    Some(ChangePoint {
        likeliest,
        latest: latest.min(likeliest),
        earliest: earliest.max(likeliest),
        or_before: earliest >= last,
        alternative: best.1,
    })
}
