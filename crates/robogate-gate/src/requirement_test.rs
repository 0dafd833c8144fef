//! The two hypothesis tests of one requirement.
//!
//! Each requirement has two tests: one of the hypothesis "not met", and one of the hypothesis "met". The first assumes
//! the worst outcome for every invalid episode, the second the best. Invalid episodes therefore never support either
//! conclusion.
//!
//! Rates are counted as good events (successes, episodes without a collision), so that every requirement on a rate
//! reads "at least". With a fixed number of episodes the tests are exact binomial tests. Each scenario of a suite has
//! its own rate, and so does each case of imported episodes that repeat cases. The binomial distribution at their mean
//! has heavier tails wherever a test at error 0.25 or less rejects (Hoeffding 1956), except for a single event, where the
//! union bound n p is used instead. Sequential tests of a suite are those of [`robogate_stats::budgeted`], because its plan fixes
//! the largest number of rounds; without a plan those of [`robogate_stats::stratified`], in which each scenario is a stratum; and
//! for durations those of [`robogate_stats::bounded_mean`]. Imported episodes that come in groups are tested by group
//! ([`crate::dependence`]).

use std::collections::BTreeMap;

use robogate_stats::bounded_mean::{BoundedMean, OutOfBounds};
use robogate_stats::budgeted::Budget;
use robogate_stats::compare::{at_least, at_most};
use robogate_stats::stratified::{self, Strata, ln_pooled_above, ln_pooled_below};
use robogate_stats::{Confidence, Interval, Trials, clopper_pearson};

use crate::dependence::{ByGroup, by_group};
use crate::figure::{Tally, applies, happened, value};
use crate::production;
use crate::{Bound, GateError, Metric, Requirement, Sampling, Sense, Trial};

/// Both p-values, and the interval at error α on each side.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tested {
    pub(crate) p_met: f64,
    pub(crate) p_violated: f64,
    /// `None` for a quantile.
    pub(crate) interval: Option<[f64; 2]>,
}

/// The settings of a test.
#[derive(Debug, Clone, Copy)]
pub(crate) struct How {
    pub(crate) sampling: Sampling,
    /// Error of "met".
    pub(crate) alpha: f64,
    /// Error of "violated", divided as in the first step of Holm's procedure.
    pub(crate) beta: f64,
    /// Whether the scenarios are those of a suite, each with its own rate.
    pub(crate) suite: bool,
    /// Whether the episodes have different rates: those of a suite, or imported ones that repeat cases.
    pub(crate) mixed: bool,
    /// The largest number of rounds, if it was fixed before the first. The tests then end earlier.
    pub(crate) budget: Option<u64>,
    /// Whether imported episodes are those of groups that depend on each other: each group is then one observation.
    pub(crate) grouped: bool,
}

pub(crate) fn test(
    requirement: &Requirement,
    bound: Bound,
    rounds: &[Vec<&Trial>],
    how: How,
) -> Result<Tested, GateError> {
    let metric = requirement.metric;
    // Without its failures a round of a suite is not complete. A bet of zero on them keeps the argument about complete rounds
    // (`robogate_stats::anytime`), which the pooled e-process and the test of a mean use; the other tests need complete rounds.
    let is_part = matches!(metric, Metric::CycleTime(_));
    let part: Vec<Vec<&Trial>>;
    let (rounds, how) = if is_part {
        part =
            rounds.iter().map(|round| round.iter().copied().filter(|trial| applies(metric, trial)).collect()).collect();
        (part.as_slice(), How { suite: false, ..how })
    } else {
        (rounds, how)
    };
    if let Metric::Production(figure) = metric {
        if how.grouped {
            // The times between events of dependent episodes follow no law that this test knows.
            return Ok(Tested { p_met: 1.0, p_violated: 1.0, interval: None });
        }
        return production::test(figure, requirement, bound, rounds, how);
    }
    if metric.is_mean() {
        return mean(requirement, bound, rounds, how);
    }
    let Some(q) = metric.quantile() else { return Ok(rate(metric, bound, bound, rounds, how)) };
    // The quantile meets its limit exactly if a sufficiently small share of the values lies beyond it.
    let beyond = if bound.sense == Sense::AtMost { 1.0 - q } else { q };
    let tested = rate(metric, bound, Bound { sense: Sense::AtMost, limit: beyond }, rounds, how);
    // This interval is that of the share.
    Ok(Tested { interval: None, ..tested })
}

/// The good events so far, with each invalid episode counted as bad and as good.
#[derive(Debug, Clone, Copy)]
struct Look {
    worst: Trials,
    best: Trials,
}

/// Tests the rate of an event against `bound`. For a quantile, the event is a value beyond `limit`.
pub(crate) fn rate(metric: Metric, limit: Bound, bound: Bound, rounds: &[Vec<&Trial>], how: How) -> Tested {
    if how.grouped {
        return rate_by_group(metric, limit, bound, rounds, how);
    }
    let mut tally = Tally::default();
    let looks: Vec<Look> = rounds
        .iter()
        .map(|round| {
            round.iter().for_each(|trial| tally.add(happened(metric, limit, trial)));
            let good = if bound.sense == Sense::AtLeast { tally.yes } else { tally.no };
            let trials = |k| Trials::new(k, tally.n()).unwrap_or(Trials::NONE);
            Look { worst: trials(good), best: trials(good + tally.unknown) }
        })
        .collect();
    let p0 = if bound.sense == Sense::AtLeast { bound.limit } else { 1.0 - bound.limit };
    let none = Look { worst: Trials::NONE, best: Trials::NONE };
    let last = looks.last().copied().unwrap_or(none);
    let (ln_met, ln_violated, interval) = match how.sampling {
        Sampling::Fixed => {
            let level = Confidence::new(1.0 - 2.0 * how.alpha).unwrap_or(Confidence::P95);
            let low = clopper_pearson(last.worst, level).low;
            let high = clopper_pearson(last.best, level).high;
            (fixed_above(last.worst, p0, how.mixed), fixed_below(last.best, p0, how.mixed), Interval { low, high })
        }
        Sampling::Sequential => {
            if how.suite {
                by_scenario(metric, limit, bound, rounds, p0, how)
            } else {
                at_once(last, p0, how)
            }
        }
    };
    let interval = match bound.sense {
        Sense::AtLeast => [interval.low, interval.high],
        Sense::AtMost => [1.0 - interval.high, 1.0 - interval.low],
    };
    Tested { p_met: ln_met.min(0.0).exp(), p_violated: ln_violated.min(0.0).exp(), interval: Some(interval) }
}

/// The same for imported episodes in groups.
fn rate_by_group(metric: Metric, limit: Bound, bound: Bound, rounds: &[Vec<&Trial>], how: How) -> Tested {
    let trials: Vec<&Trial> = rounds.iter().flatten().copied().collect();
    let share = |unknown: bool| -> Vec<f64> {
        trials.iter().map(|trial| f64::from(u8::from(happened(metric, limit, trial).unwrap_or(unknown)))).collect()
    };
    let tested = by_group(&trials, [&share(false), &share(true)], 1.0, bound.limit, how.alpha);
    let tested = tested.unwrap_or(ByGroup { ln_evidence: [0.0; 2], interval: Interval::UNIT });
    of_groups(tested, bound.sense, 0.0)
}

/// The result of a test by group, whose values were shifted by `floor`.
fn of_groups(tested: ByGroup, sense: Sense, floor: f64) -> Tested {
    let [above, below] = tested.p();
    let (p_met, p_violated) = if sense == Sense::AtLeast { (above, below) } else { (below, above) };
    let interval = Some([tested.interval.low + floor, tested.interval.high + floor]);
    Tested { p_met, p_violated, interval }
}

/// ln of both p-values and the interval of a suite, whose scenarios are strata.
fn by_scenario(
    metric: Metric,
    limit: Bound,
    bound: Bound,
    rounds: &[Vec<&Trial>],
    p0: f64,
    how: How,
) -> (f64, f64, Interval) {
    let mut cases: BTreeMap<&str, usize> = BTreeMap::new();
    let (mut good, mut bad) = (Strata::default(), Strata::default());
    let (mut above, mut below) = (Vec::with_capacity(rounds.len()), Vec::with_capacity(rounds.len()));
    for round in rounds {
        let (mut worst, mut best) = (Vec::with_capacity(round.len()), Vec::with_capacity(round.len()));
        for trial in round {
            let next = cases.len();
            let case = *cases.entry(trial.label.case.as_deref().unwrap_or_default()).or_insert(next);
            let event = happened(metric, limit, trial);
            let is_good = event.map(|event| event == (bound.sense == Sense::AtLeast));
            worst.push((case, is_good.unwrap_or(false)));
            best.push((case, !is_good.unwrap_or(true)));
        }
        good.round(&worst);
        bad.round(&best);
        above.push(good.clone());
        below.push(bad.clone());
    }
    let looks = |of: &[Strata]| of.iter().map(Strata::trials).collect::<Vec<Trials>>();
    let (of_above, of_below) = (looks(&above), looks(&below));
    let per_round = of_above.first().map_or(0, |trials| trials.n());
    let equal = of_above.iter().zip(1..).all(|(trials, round)| trials.n() == round * per_round);
    if let Some(rounds) = how.budget.filter(|rounds| equal && per_round > 0 && *rounds >= of_above.len() as u64) {
        let budget = Budget { per_round, rounds };
        let met = budget.ln_p(&of_above, &above, p0);
        let violated = budget.ln_p(&of_below, &below, 1.0 - p0);
        return (met, violated, budget.bounds(&above, &below, how.alpha, p0));
    }
    let most = |looks: &[Strata], p0: f64| looks.iter().map(|look| look.ln_evidence_above(p0)).fold(0.0_f64, f64::max);
    let interval = stratified::bounds(&above, &below, how.alpha, p0);
    (-most(&above, p0), -most(&below, 1.0 - p0), interval)
}

/// The same for episodes without scenarios, which are tested once.
fn at_once(look: Look, p0: f64, how: How) -> (f64, f64, Interval) {
    let wanted = -how.alpha.ln();
    let end = |rejected: &dyn Fn(f64) -> bool, limit: f64, rate: f64| {
        let (mut low, mut high) = if rejected(limit) { (limit, rate.max(limit)) } else { (0.0, limit.min(rate)) };
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if rejected(middle) { low = middle } else { high = middle }
        }
        low
    };
    let low = end(&|p| ln_pooled_above(look.worst, p) >= wanted, p0, look.worst.rate().unwrap_or(0.0));
    let bad = 1.0 - look.best.rate().unwrap_or(1.0);
    let high = 1.0 - end(&|q| ln_pooled_below(look.best, 1.0 - q) >= wanted, 1.0 - p0, bad);
    let above = ln_pooled_above(look.worst, p0).max(0.0);
    let below = ln_pooled_below(look.best, p0).max(0.0);
    (-above, -below, Interval { low, high })
}

/// 95 % interval of the success rate by the method of the requirements: exact for a fixed number of episodes, and that of the
/// sequential test for others. It holds for any outcome of the invalid episodes.
pub(crate) fn success_interval(rounds: &[Vec<&Trial>], how: How) -> [f64; 2] {
    let alpha = Confidence::P95.tail();
    let bound = Bound { sense: Sense::AtLeast, limit: 0.5 };
    rate(Metric::Success, bound, bound, rounds, How { alpha, beta: alpha, ..how }).interval.unwrap_or([0.0, 1.0])
}

/// ln P(X >= k | p0), for episodes with different rates if `mixed`.
fn fixed_above(trials: Trials, p0: f64, mixed: bool) -> f64 {
    let binomial = at_least(trials, p0);
    if mixed && trials.successes() == 1 { binomial.max((trials.n() as f64 * p0).ln()).min(0.0) } else { binomial }
}

/// ln P(X <= k | p0), for episodes with different rates if `mixed`.
fn fixed_below(trials: Trials, p0: f64, mixed: bool) -> f64 {
    let binomial = at_most(trials, p0);
    if mixed && trials.failures() == 1 {
        binomial.max((trials.n() as f64 * (1.0 - p0)).ln()).min(0.0)
    } else {
        binomial
    }
}

fn mean(requirement: &Requirement, bound: Bound, rounds: &[Vec<&Trial>], how: How) -> Result<Tested, GateError> {
    // Values are shifted so that their range starts at 0.
    let [floor, ceiling] = requirement.range();
    let floor = floor.unwrap_or(0.0);
    let ceiling = ceiling.unwrap_or(f64::INFINITY) - floor;
    let bound = Bound { limit: bound.limit - floor, ..bound };
    let mut looks = Vec::with_capacity(rounds.len());
    let (mut short, mut long) = (Vec::new(), Vec::new());
    for round in rounds {
        for trial in round {
            let value = value(requirement.metric, trial).map(|value| value - floor);
            // The duration of an episode is a sum of many time steps, so it can exceed the limit by a rounding error.
            if let Some(shifted) = value
                && !(-1e-9 * ceiling..=ceiling * (1.0 + 1e-9)).contains(&shifted)
            {
                let (id, index) = (requirement.id(), trial.index);
                let (low, high) = (floor, ceiling + floor);
                return Err(GateError::OutOfRange { id, index, value: shifted + floor, low, high });
            }
            short.push(value.unwrap_or(0.0).clamp(0.0, ceiling));
            long.push(value.unwrap_or(ceiling).clamp(0.0, ceiling));
        }
        looks.push(short.len());
    }
    if how.sampling == Sampling::Fixed {
        looks = vec![short.len()];
    }
    let out_of_bounds = |error: OutOfBounds| GateError::Requirement { id: requirement.id(), reason: error.to_string() };
    if how.grouped {
        let trials: Vec<&Trial> = rounds.iter().flatten().copied().collect();
        let tested = by_group(&trials, [&short, &long], ceiling, bound.limit, how.alpha).map_err(out_of_bounds)?;
        return Ok(of_groups(tested, bound.sense, floor));
    }
    let account = |values: &[f64], limit_is_above: bool| -> Result<(f64, Interval), GateError> {
        let mean = BoundedMean::new(values, &looks, ceiling).map_err(out_of_bounds)?;
        let ln = if limit_is_above { mean.ln_evidence_below(bound.limit) } else { mean.ln_evidence_above(bound.limit) };
        Ok((ln, mean.interval(how.alpha)))
    };
    // Short durations are shown with the longest possible unknown values, long ones with the shortest.
    let (above, of_short) = account(&short, false)?;
    let (below, of_long) = account(&long, true)?;
    let (met, violated) = match bound.sense {
        Sense::AtMost => (below, above),
        Sense::AtLeast => (above, below),
    };
    Ok(Tested {
        p_met: (-met).exp(),
        p_violated: (-violated).exp(),
        interval: Some([of_short.low + floor, of_long.high + floor]),
    })
}
