//! Scan test: does the success rate depend on a parameter, without an assumption about the shape of the dependence?
//!
//! The statistic is the largest binomial log-likelihood ratio of "inside and outside have different rates" against "one
//! rate", over all ways to divide the cells of one parameter into two groups: every run of neighbouring cells against
//! the rest ([`Order::Ordered`]), or every division of the levels by their rates ([`Order::Unordered`]; for two groups
//! the best division never mixes rates). A one-sided effect, a band, a gap and a single bad level are all such divisions.
//! A run has at least one twentieth of the cells, and so has its rest. Many narrow cells therefore place the ends of a run
//! exactly, without the many candidates of a few rows that would raise the limit of the statistic.
//!
//! The p-value is that of a permutation test: given the rows and the successes of all cells together, the successes per
//! cell are multivariate hypergeometric if success does not depend on the parameter. Counts are sampled directly, at a
//! cost that does not depend on the number of rows, and sampling stops as soon as the p-value is clearly large. The test
//! is exact for any number of rows and any rate. For a very large statistic, a bound replaces the sampling.
//!
//! Sources: Kulldorff (1997), Communications in Statistics 26(6), for scan statistics; Besag and Clifford (1991),
//! Biometrika 78(2), for sequential Monte Carlo p-values; Hoeffding (1963), JASA 58, for the bound.

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::Trials;
use crate::correlation::midranks;
use crate::resample::{hypergeometric, shuffle};

/// Whether neighbouring cells belong together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Bins of a numeric parameter, in order.
    Ordered,
    /// Levels of a categorical parameter.
    Unordered,
}

/// The result of a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// The largest log-likelihood ratio.
    pub log_ratio: f64,
    /// Whether each cell belongs to the group with the lower rate.
    pub low: Vec<bool>,
    /// The p-value of "success does not depend on the parameter", before any adjustment for several parameters.
    pub p: f64,
}

/// Replicates that must reach the observed statistic before sampling stops.
const EXCEEDANCES: usize = 20;
/// The p-value below which the bound replaces sampling.
const BOUND: f64 = 1e-6;
/// The narrowest run, and the narrowest rest, as a part of the number of cells.
pub(crate) const NARROWEST: usize = 20;
/// Numbers whose x ln x is tabulated.
const TABULATED: u64 = 1 << 16;

/// Tests whether the success rate depends on the parameter with these cells.
///
/// `replicates` bounds the number of sampled tables; the smallest sampled p-value is 1 / (`replicates` + 1). `None` if
/// fewer than two cells have trials, or if all outcomes are equal.
pub fn scan(cells: &[Trials], order: Order, replicates: usize, seed: u64) -> Option<Scan> {
    let n: Vec<u64> = cells.iter().map(|c| c.n()).collect();
    let k: Vec<u64> = cells.iter().map(|c| c.successes()).collect();
    let mut divisions = Divisions::of(&n, &k, order)?;
    let (log_ratio, low) = divisions.observed(&n, &k)?;
    // Each division has a statistic of at least t only if one side has a deviation of at least t/2.
    let number = cells.len() as f64 * (cells.len() as f64 + 1.0) / 2.0;
    let bound = 4.0 * number * (-0.5 * log_ratio).exp();
    if order == Order::Ordered && bound < BOUND {
        return Some(Scan { log_ratio, low, p: bound });
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut drawn = vec![0; cells.len()];
    let (rows, successes) = (divisions.rows, divisions.successes);
    let p = sequential(log_ratio, replicates, || {
        let (mut left, mut left_successes) = (rows, successes);
        for (of, drawn) in n.iter().zip(&mut drawn) {
            *drawn = hypergeometric(&mut rng, left, left_successes, *of);
            left -= of;
            left_successes -= *drawn;
        }
        divisions.largest(&n, &drawn)
    });
    Some(Scan { log_ratio, low, p })
}

/// The p-value of "the rates of units do not depend on a number", for few units: the absolute rank correlation of rates and
/// values, with permuted units. It has more power than a scan against a monotone effect.
///
/// `None` for lists of different lengths, for fewer than two units with trials, and if all rates or values are equal.
pub fn rank_units(units: &[Trials], values: &[f64], replicates: usize, seed: u64) -> Option<f64> {
    if units.len() != values.len() {
        return None;
    }
    let used = units.iter().zip(values).filter_map(|(unit, value)| Some((unit.rate()?, *value)));
    let (rates, values): (Vec<f64>, Vec<f64>) = used.unzip();
    let centred = |values: &[f64]| {
        let middle = 0.5 * (values.len() as f64 + 1.0);
        midranks(values).into_iter().map(|rank| rank - middle).collect::<Vec<f64>>()
    };
    let (mut rates, values) = (centred(&rates), centred(&values));
    let varies = |ranks: &[f64]| ranks.iter().any(|rank| rank.abs() > 0.0);
    if !varies(&rates) || !varies(&values) {
        return None;
    }
    let product = |rates: &[f64]| rates.iter().zip(&values).map(|(a, b)| a * b).sum::<f64>().abs();
    let observed = product(&rates);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Some(sequential(observed, replicates, || {
        shuffle(&mut rng, &mut rates);
        product(&rates)
    }))
}

/// The p-value by sampling until enough replicates reach the observed statistic.
pub(crate) fn sequential(statistic: f64, replicates: usize, mut replicate: impl FnMut() -> f64) -> f64 {
    let mut reached = 0;
    for drawn in 1..=replicates {
        // Equal tables have equal statistics except for rounding.
        if replicate() >= statistic - 1e-7 * (1.0 + statistic.abs()) {
            reached += 1;
            if reached == EXCEEDANCES {
                return EXCEEDANCES as f64 / drawn as f64;
            }
        }
    }
    (reached + 1) as f64 / (replicates + 1) as f64
}

/// k ln(k/n) + (n - k) ln((n - k)/n): the largest log-likelihood of one rate.
pub(crate) fn log_likelihood(k: f64, n: f64) -> f64 {
    let term = |x: f64| if x > 0.0 { x * (x / n).ln() } else { 0.0 };
    term(k) + term(n - k)
}

/// x ln x of an integer.
fn x_ln_x(x: u64) -> f64 {
    if x == 0 { 0.0 } else { x as f64 * (x as f64).ln() }
}

/// All ways to divide the cells, with the total counts, which all tables share.
struct Divisions {
    order: Order,
    rows: u64,
    successes: u64,
    /// x ln x of small integers.
    table: Vec<f64>,
    /// Sums of the cells before each cell: rows and successes.
    before: Vec<[u64; 2]>,
    /// Levels by rate.
    levels: Vec<usize>,
}

impl Divisions {
    /// `None` if fewer than two cells have rows, or if all outcomes are equal.
    fn of(n: &[u64], k: &[u64], order: Order) -> Option<Self> {
        let (rows, successes) = (n.iter().sum::<u64>(), k.iter().sum::<u64>());
        if n.iter().filter(|n| **n > 0).count() < 2 || successes == 0 || successes == rows {
            return None;
        }
        let table = (0..=rows.min(TABULATED)).map(x_ln_x).collect();
        Some(Self { order, rows, successes, table, before: Vec::new(), levels: Vec::new() })
    }

    /// The largest log-likelihood ratio and whether each cell is in the group with the lower rate.
    fn observed(&mut self, n: &[u64], k: &[u64]) -> Option<(f64, Vec<bool>)> {
        let mut best = (f64::NEG_INFINITY, [0; 2]);
        self.visit(n, k, |ratio, run| {
            if ratio > best.0 {
                best = (ratio, run);
            }
        });
        let (log_ratio, [from, to]) = best;
        let mut low = vec![false; n.len()];
        match self.order {
            Order::Ordered => low.get_mut(from..to)?.fill(true),
            Order::Unordered => self.levels.get(from..to)?.iter().for_each(|level| low[*level] = true),
        }
        let rate_of = |wanted: bool| {
            let cells = (0..n.len()).filter(|cell| low[*cell] == wanted);
            let (n, k) = cells.fold((0, 0), |(a, b), cell| (a + n[cell], b + k[cell]));
            k as f64 / n.max(1) as f64
        };
        if rate_of(true) > rate_of(false) {
            low.iter_mut().for_each(|low| *low = !*low);
        }
        log_ratio.is_finite().then_some((log_ratio, low))
    }

    fn largest(&mut self, n: &[u64], k: &[u64]) -> f64 {
        let mut best = f64::NEG_INFINITY;
        self.visit(n, k, |ratio, _| best = best.max(ratio));
        best
    }

    /// Calls `visit` with the log-likelihood ratio of each division and the group of one side: a range of cells, or of the
    /// levels by rate.
    fn visit(&mut self, n: &[u64], k: &[u64], mut visit: impl FnMut(f64, [usize; 2])) {
        let mut sum = [0, 0];
        let cells = match self.order {
            Order::Ordered => {
                self.before.clear();
                self.before.push(sum);
                for (n, k) in n.iter().zip(k) {
                    sum = [sum[0] + n, sum[1] + k];
                    self.before.push(sum);
                }
                n.len()
            }
            Order::Unordered => {
                self.levels.clear();
                self.levels.extend((0..n.len()).filter(|cell| n[*cell] > 0));
                let rate = |cell: usize| k[cell] as f64 / n[cell] as f64;
                self.levels.sort_by(|a, b| rate(*a).total_cmp(&rate(*b)));
                self.before.clear();
                self.before.push(sum);
                for level in &self.levels {
                    sum = [sum[0] + n[*level], sum[1] + k[*level]];
                    self.before.push(sum);
                }
                self.levels.len()
            }
        };
        let term = |x: u64| self.table.get(x as usize).copied().unwrap_or_else(|| x_ln_x(x));
        let likelihood = |n: u64, k: u64| term(k) + term(n - k) - term(n);
        let one_rate = likelihood(self.rows, self.successes);
        let (narrowest, starts) = match self.order {
            Order::Ordered => ((cells / NARROWEST).max(1), cells),
            Order::Unordered => (1, 1),
        };
        for (from, [n_before, k_before]) in self.before.iter().enumerate().take(starts) {
            for (to, [n_to, k_to]) in self.before.iter().enumerate().skip(from + narrowest) {
                let (inside, successes) = (n_to - n_before, k_to - k_before);
                // A run up to the last cell is the complement of one from the first.
                if to - from + narrowest <= cells && inside > 0 && inside < self.rows {
                    let outside = likelihood(self.rows - inside, self.successes - successes);
                    visit(likelihood(inside, successes) + outside - one_rate, [from, to]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::binomial;

    fn trials(cells: &[(u64, u64)]) -> Vec<Trials> {
        cells.iter().map(|(k, n)| Trials::new(*k, *n).unwrap()).collect()
    }

    #[test]
    fn false_positives_stay_below_level() {
        // Rates from almost never to almost always, few and many rows per cell.
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for (p, n) in [(0.01, 30), (0.1, 15), (0.5, 15), (0.99, 500)] {
            let mut rejected = 0;
            for set in 0..400 {
                let cells: Vec<(u64, u64)> = (0..20).map(|_| (binomial(&mut rng, n, p), n)).collect();
                let found = scan(&trials(&cells), Order::Ordered, 199, set);
                rejected += u32::from(found.is_some_and(|found| found.p <= 0.05));
            }
            // 5 % of 400 is 20, with a standard deviation of 4.4.
            assert!(rejected <= 33, "{rejected} of 400 at p = {p}, n = {n}");
        }
    }

    #[test]
    fn band_is_found_with_both_ends() {
        let cells: Vec<(u64, u64)> = (0..20).map(|i| (if (6..14).contains(&i) { 90 } else { 40 }, 100)).collect();
        let found = scan(&trials(&cells), Order::Ordered, 999, 1).unwrap();
        assert!(found.p < 1e-6);
        let high: Vec<usize> = (0..20).filter(|i| !found.low[*i]).collect();
        assert_eq!(high, (6..14).collect::<Vec<_>>());
    }

    #[test]
    fn one_bad_level_is_found() {
        let found = scan(&trials(&[(90, 100), (40, 100), (88, 100), (0, 0)]), Order::Unordered, 999, 1).unwrap();
        assert!((found.p - 0.001).abs() < 1e-12, "{}", found.p);
        assert_eq!(found.low, [false, true, false, false]);
    }

    #[test]
    fn sampled_p_matches_exact_enumeration() {
        // Three levels of 4, 4 and 4 rows with 6 successes: all tables can be enumerated.
        let n = [4, 4, 4];
        let mut divisions = Divisions::of(&n, &[4, 1, 1], Order::Unordered).unwrap();
        let seen = divisions.largest(&n, &[4, 1, 1]);
        let choose = [1.0, 4.0, 6.0, 4.0, 1.0];
        let (mut reached, mut all) = (0.0, 0.0);
        for a in 0..=4_u64 {
            for b in 0..=4_u64 {
                for c in (0..=4_u64).filter(|c| a + b + c == 6) {
                    let ways = choose[a as usize] * choose[b as usize] * choose[c as usize];
                    all += ways;
                    reached += if divisions.largest(&n, &[a, b, c]) >= seen - 1e-9 { ways } else { 0.0 };
                }
            }
        }
        let cells = trials(&[(4, 4), (1, 4), (1, 4)]);
        let mean = (0..200).map(|seed| scan(&cells, Order::Unordered, 999, seed).unwrap().p).sum::<f64>() / 200.0;
        assert!((mean - reached / all).abs() < 0.02, "{mean} for {}", reached / all);
    }

    #[test]
    fn ranks_of_few_units_find_a_trend() {
        let units: Vec<Trials> = (0..10).map(|i| Trials::new(10 + 3 * i, 60).unwrap()).collect();
        let rising: Vec<f64> = (0..10).map(f64::from).collect();
        assert!(rank_units(&units, &rising, 999, 1).unwrap() < 0.01);
        let mixed: Vec<f64> = [5, 2, 8, 1, 9, 0, 7, 3, 6, 4].map(f64::from).to_vec();
        assert!(rank_units(&units, &mixed, 999, 1).unwrap() > 0.1);
        assert_eq!(rank_units(&units, &[1.0; 10], 999, 1), None);
    }

    #[test]
    fn one_outcome_gives_no_test() {
        assert!(scan(&trials(&[(5, 5), (9, 9)]), Order::Ordered, 99, 1).is_none());
        assert!(scan(&trials(&[(5, 9), (0, 0)]), Order::Unordered, 99, 1).is_none());
    }
}
