//! Sequential test of a rate in at most a known number of rounds.
//!
//! A test that is valid forever pays for looks that never come. With a known largest number of rounds, each one-sided test at
//! error α is the union of two: the e-process of [`crate::stratified`] at a share of α, which ends clear cases after few rounds,
//! and a boundary of the family of Wang and Tsiatis on exact binomial tails, whose shape is chosen for the limit (`shape`). Its
//! constant c is the smallest for which both together have an error of at most α at the limit. The probability is exact for equal
//! rates: the distribution of the number of successes is propagated from round to round.
//!
//! Conditions: looks only after complete rounds in which each scenario runs once; results are independent, with fresh
//! randomness in each round; the largest number of rounds is fixed before the first. The e-process is valid for any rates of the
//! scenarios. For the boundary this is checked and not proved: over a grid of unequal rates with the same mean, no error exceeds
//! that of equal rates (`tests/budgeted.rs`), because unequal rates only reduce the variance.
//!
//! Sources: Wang and Tsiatis (1987), Biometrics 43; O'Brien and Fleming (1979), Biometrics 35; Hoeffding (1956), Annals of
//! Mathematical Statistics 27, for unequal rates.

use robogate_maths::beta::ln_binomial_pmf;
use robogate_maths::normal;

use crate::compare::at_least;
use crate::interval::{Interval, Trials};
use crate::stratified::{Strata, bounds, ln_pooled_part_above};

mod shape;

use shape::Shape;

/// The part of the error of the e-process.
const EVIDENCE: f64 = 0.4;
/// The part of the error that is used. The rest covers the stratified part of the e-process, which the recursion leaves out.
const USED: f64 = 0.998;
/// Bisections of an end of the interval: the first bracket is a few points wide.
const STEPS: usize = 11;
/// Probabilities that are left out of the recursion.
const NEGLIGIBLE: f64 = 1e-17;

/// The rounds of a test: their size and their largest number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Trials in a round.
    pub per_round: u64,
    /// Largest number of rounds.
    pub rounds: u64,
}

impl Budget {
    /// The smallest number of successes after each round that shows "the rate is above `p0`" at error `alpha`. A number above
    /// that of the trials means that the round cannot show it.
    pub fn boundary(self, p0: f64, alpha: f64) -> Vec<u64> {
        let evidence = self.evidence_boundary(p0, EVIDENCE * alpha);
        self.calibrated(p0, USED * alpha, Shape::of(self, p0), &Tails::new(self, p0), &evidence, 30)
    }

    /// The union of a boundary of `shape` and of the e-process, with an error of at most `error`.
    fn calibrated(self, p0: f64, error: f64, shape: Shape, tails: &Tails, evidence: &[u64], steps: usize) -> Vec<u64> {
        let union =
            |c: f64| tails.boundary(c, shape).into_iter().zip(evidence).map(|(a, b)| a.min(*b)).collect::<Vec<u64>>();
        let (mut low, mut high) = (0.0, 9.0);
        for _ in 0..steps {
            let c = 0.5 * (low + high);
            if self.course(p0, &union(c)).0 > error { low = c } else { high = c }
        }
        union(high)
    }

    /// ln of the p-value of "the rate is at most `p0`". `looks` are all complete rounds so far, and `evidence` the results of the
    /// scenarios after each of them.
    pub fn ln_p(self, looks: &[Trials], evidence: &[Strata], p0: f64) -> f64 {
        let most = evidence.iter().map(|look| look.ln_evidence_above(p0)).fold(0.0_f64, f64::max);
        let by_evidence = -most - EVIDENCE.ln();
        if !(p0 > 0.0 && p0 < 1.0) {
            return by_evidence.min(0.0);
        }
        let shape = Shape::of(self, p0);
        let boundary = Tails::new(self, p0).boundary(self.score(looks, p0, shape), shape);
        let mut alpha = self.course(p0, &boundary).0 / USED;
        // The smallest error at which both tests together would reject: the e-process has a part of it.
        for _ in 0..40 {
            if alpha >= 1.0 {
                break;
            }
            let next = self.joint(p0, &boundary, alpha) / USED;
            let settled = next <= alpha * (1.0 + 1e-6);
            alpha = alpha.max(next);
            if settled {
                break;
            }
        }
        by_evidence.min(alpha.max(f64::MIN_POSITIVE).ln()).min(0.0)
    }

    /// The rates that the test does not exclude at error `alpha` on each side. Its lower end is at least `limit` if and only if
    /// the test shows that at this error. `above` and `below` are the scenarios after each look, with successes counted and with
    /// failures counted. Each end is that of the test with the shape of its limit.
    pub fn bounds(self, above: &[Strata], below: &[Strata], alpha: f64, limit: f64) -> Interval {
        let by_evidence = bounds(above, below, EVIDENCE * alpha, limit);
        let low = self.end(above, alpha, limit, by_evidence.low);
        let high = 1.0 - self.end(below, alpha, 1.0 - limit, 1.0 - by_evidence.high);
        Interval { low, high }
    }

    fn end(self, strata: &[Strata], alpha: f64, limit: f64, by_evidence: f64) -> f64 {
        let looks: Vec<Trials> = strata.iter().map(Strata::trials).collect();
        let Some(rate) = looks.last().and_then(|trials| trials.rate()) else { return by_evidence };
        let shape = Shape::of(self, limit);
        let rejected = |p: f64| {
            let boundary = Tails::new(self, p).boundary(self.score(&looks, p, shape), shape);
            self.joint(p, &boundary, alpha) <= USED * alpha
        };
        let (mut low, mut high) = (by_evidence, rate.max(by_evidence));
        if limit > low && limit < high {
            if rejected(limit) { low = limit } else { high = limit }
        }
        for _ in 0..STEPS {
            let middle = 0.5 * (low + high);
            if middle > 0.0 && middle < 1.0 && rejected(middle) { low = middle } else { high = middle }
        }
        low
    }

    /// The probability of crossing a boundary or the e-process at a part of `alpha`.
    fn joint(self, p0: f64, boundary: &[u64], alpha: f64) -> f64 {
        let evidence = self.evidence_boundary(p0, EVIDENCE * alpha);
        let union: Vec<u64> = boundary.iter().zip(&evidence).map(|(a, b)| (*a).min(*b)).collect();
        self.course(p0, &union).0
    }

    /// The largest statistic of the looks: normal score divided by the factor of the round.
    fn score(self, looks: &[Trials], p0: f64, shape: Shape) -> f64 {
        let score = |trials: &Trials| {
            let tail = at_least(*trials, p0).exp().clamp(1e-300, 1.0 - 1e-12);
            -normal::quantile(tail) / shape.factor(trials.n() / self.per_round.max(1), self.rounds)
        };
        looks.iter().map(score).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The boundary of the pooled part of the e-process at error `alpha`.
    fn evidence_boundary(self, p0: f64, alpha: f64) -> Vec<u64> {
        let shown =
            |k: u64, n: u64| Trials::new(k, n).is_ok_and(|trials| ln_pooled_part_above(trials, p0) >= -alpha.ln());
        (1..=self.rounds)
            .map(|round| {
                let n = round * self.per_round;
                let (mut open, mut done) = ((n as f64 * p0) as u64, n + 1);
                while done - open > 1 {
                    let middle = open + (done - open) / 2;
                    if shown(middle, n) { done = middle } else { open = middle }
                }
                done
            })
            .collect()
    }

    /// The probability that the number of successes reaches a boundary after any round, at equal rates `p`, and the expected
    /// number of trials.
    fn course(self, p: f64, boundary: &[u64]) -> (f64, f64) {
        let step = pmf(self.per_round, p);
        let (mut from, mut going) = (0_u64, vec![1.0]);
        let (mut crossed, mut trials) = (0.0, 0.0);
        for limit in boundary {
            trials += (1.0 - crossed) * self.per_round as f64;
            let mut next = vec![0.0; going.len() + step.1.len() - 1];
            for (k, probability) in going.iter().enumerate() {
                for (j, s) in step.1.iter().enumerate() {
                    next[k + j] += probability * s;
                }
            }
            from += step.0;
            let inside = limit.saturating_sub(from).min(next.len() as u64) as usize;
            crossed += next[inside..].iter().sum::<f64>();
            next.truncate(inside);
            let first = next.iter().position(|mass| *mass > NEGLIGIBLE).unwrap_or(next.len());
            next.drain(..first);
            from += first as u64;
            if next.is_empty() {
                break;
            }
            going = next;
        }
        (crossed, trials)
    }
}

/// The first count with a probability that is not negligible, and the probabilities from there.
fn pmf(n: u64, p: f64) -> (u64, Vec<f64>) {
    let masses: Vec<f64> = (0..=n).map(|k| ln_binomial_pmf(k as f64, n as f64, p).exp()).collect();
    let first = masses.iter().position(|mass| *mass > NEGLIGIBLE).unwrap_or(0);
    let last = masses.iter().rposition(|mass| *mass > NEGLIGIBLE).unwrap_or(n as usize);
    (first as u64, masses[first..=last].to_vec())
}

/// The upper tail probabilities of the number of successes after each round.
struct Tails {
    /// The first count, and P(X >= k) from there.
    rounds: Vec<(u64, Vec<f64>)>,
}

impl Tails {
    fn new(budget: Budget, p0: f64) -> Self {
        let tail = |round: u64| {
            let n = round * budget.per_round;
            let (mean, spread) = (n as f64 * p0, (n as f64 * p0 * (1.0 - p0)).sqrt());
            let first = (mean.floor() as u64).min(n);
            // Beyond ten standard deviations and a few counts nothing is left, except for rates near 0.
            let last = ((mean + 10.0 * spread + 30.0) as u64).min(n);
            let mut tails: Vec<f64> = (first..=last).map(|k| ln_binomial_pmf(k as f64, n as f64, p0).exp()).collect();
            for at in (0..tails.len().saturating_sub(1)).rev() {
                tails[at] += tails[at + 1];
            }
            (first, tails)
        };
        Self { rounds: (1..=budget.rounds).map(tail).collect() }
    }

    /// The smallest counts whose scores reach c times the factor of their round.
    fn boundary(&self, c: f64, shape: Shape) -> Vec<u64> {
        let rounds = self.rounds.len() as u64;
        (1..=rounds).map(|round| self.least(round, normal::sf(c * shape.factor(round, rounds)))).collect()
    }

    /// The smallest count after a round whose tail probability is at most `level`.
    fn least(&self, round: u64, level: f64) -> u64 {
        let Some((first, tails)) = self.rounds.get(round as usize - 1) else { return u64::MAX };
        first + tails.partition_point(|tail| *tail > level * (1.0 + 1e-9)) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GATE: Budget = Budget { per_round: 68, rounds: 20 };

    #[test]
    fn errors_use_the_level() {
        for p0 in [0.05, 0.5, 0.8, 0.92, 0.95, 0.98, 0.99] {
            let error = GATE.course(p0, &GATE.boundary(p0, 0.05)).0;
            assert!(error <= 0.05 && error > 0.03, "{p0}: {error}");
        }
    }

    #[test]
    fn p_value_and_bounds_agree_with_the_boundary() {
        let boundary = GATE.boundary(0.92, 0.05);
        for (round, less) in [(6, 0), (6, 1), (12, 0), (12, 1), (20, 0), (20, 1)] {
            // As few successes as possible before, then the boundary or one less.
            let mut strata = Strata::default();
            let mut looks = Vec::new();
            let mut evidence = Vec::new();
            let mut done = 0;
            for at in 1..=round {
                let wanted = if at == round { boundary[at - 1] - less } else { (0.9 * 68.0 * at as f64) as u64 };
                let good = (wanted - done).min(68);
                done += good;
                let results: Vec<(usize, bool)> = (0..68).map(|s| ((s + 7 * at) % 68, (s as u64) < good)).collect();
                strata.round(&results);
                looks.push(strata.trials());
                evidence.push(strata.clone());
            }
            if done != boundary[round - 1] - less {
                continue;
            }
            let p = GATE.ln_p(&looks, &evidence, 0.92).exp();
            assert_eq!(p <= 0.05, less == 0, "round {round}, {less} less: p {p}");
            let bad: Vec<Strata> = (0..1).map(|_| Strata::default()).collect();
            let low = GATE.end(&evidence, 0.05, 0.92, bounds(&evidence, &bad, 0.02, 0.92).low);
            assert_eq!(low >= 0.92, less == 0, "round {round}: {low}");
        }
    }

    #[test]
    fn later_looks_do_not_raise_the_p_value() {
        let mut strata = Strata::default();
        let (mut looks, mut evidence, mut last) = (Vec::new(), Vec::new(), 0.0_f64);
        for round in 0..8 {
            let results: Vec<(usize, bool)> = (0..68).map(|s| (s, (s * 7 + round) % 68 != 0)).collect();
            strata.round(&results);
            looks.push(strata.trials());
            evidence.push(strata.clone());
            let now = GATE.ln_p(&looks, &evidence, 0.92);
            assert!(now <= last + 1e-9, "{now} {last}");
            last = now;
        }
        assert!(last < 0.01_f64.ln());
    }
}
