//! Figures of production: units per hour, cycles between failures, time between assists, the longest clean run, and cycle times.
//!
//! **Requirements.** "At least r units per hour" states that the mean of success - r x duration is at least 0, and "at least r seconds
//! between assists" that the mean of duration - r x assist is. Both are means of bounded values, which [`BoundedMean`] tests without an assumption
//! about durations. "At least r cycles between failures" is a success rate of 1 - 1/r, and a longest clean run of r among n planned episodes
//! is the success rate at which the longest run reaches r with 50 %.
//!
//! **Figures.** The 95 % intervals of [`ProductionFigures`] are those of renewal theory ([`robogate_stats::renewal`]); they assume
//! independent episodes. Cycle times of episodes that ran into their time limit, or failed otherwise, are censored there.

use robogate_stats::bounded_mean::BoundedMean;
use robogate_stats::renewal::{event_rate, median_run, rate_of_run, reward_rate};
use robogate_stats::survival::{kaplan_meier, quantile_time, tolerance_interval};
use robogate_stats::{Confidence, Trials, clopper_pearson};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::requirement_test::{How, Tested, rate};
use crate::{Bound, Ending, Extremes, GateError, Metric, Production, Requirement, Sampling, Sense, Trial};

/// Stands for "without a limit": no failure or no assist was seen.
pub const UNLIMITED: f64 = 1e9;
/// The measure that counts assists.
const ASSISTS: &str = "assists";
/// Smallest share of cycle times in a tolerance interval.
const CONTENT: f64 = 0.9;
const SECONDS: f64 = 3600.0;

/// Duration, success and assist of a valid episode with a duration.
fn cycle(trial: &Trial) -> Option<(f64, bool, bool)> {
    let success = trial.ending == Ending::Success;
    let assisted = trial.measures.get(ASSISTS).is_some_and(|assists| assists > 0.0);
    trial.time_s.filter(|_| trial.ending.is_valid()).map(|time| (time, success, !success || assisted))
}

fn longest_run<'a>(trials: impl Iterator<Item = &'a Trial>, invalid: Option<bool>) -> f64 {
    let (mut run, mut longest) = (0_u64, 0_u64);
    for trial in trials {
        let success = if trial.ending.is_valid() { Some(trial.ending == Ending::Success) } else { invalid };
        match success {
            Some(true) => run += 1,
            Some(false) => run = 0,
            None => {}
        }
        longest = longest.max(run);
    }
    longest as f64
}

/// The figure of a requirement, and the numbers of episodes with and without a value.
pub(crate) fn figure(figure: Production, trials: &[&Trial], ceiling: Option<f64>) -> (u64, u64, Extremes) {
    let ratio = |a: f64, b: f64| if b > 0.0 { (a / b).min(UNLIMITED) } else { UNLIMITED };
    let valid = trials.iter().filter(|trial| trial.ending.is_valid());
    let cycles: Vec<(f64, bool, bool)> = trials.iter().filter_map(|trial| cycle(trial)).collect();
    let time: f64 = cycles.iter().map(|cycle| cycle.0).sum();
    let count = |of: fn(&(f64, bool, bool)) -> bool| cycles.iter().filter(|cycle| of(cycle)).count() as f64;
    let known = match figure.is_per_time() {
        true => cycles.len(),
        false => valid.clone().count(),
    };
    let unknown = (trials.len() - known) as f64;
    let failures = valid.filter(|trial| trial.ending != Ending::Success).count() as f64;
    let longest = ceiling.map(|ceiling| unknown * ceiling).or((unknown == 0.0).then_some(0.0));
    let (observed, least, most) = match figure {
        Production::UnitsPerHour => {
            let of = |units: f64, time: f64| if time > 0.0 { SECONDS * units / time } else { 0.0 };
            let units = count(|cycle| cycle.1);
            (of(units, time), longest.map(|more| of(units, time + more)), Some(of(units + unknown, time)))
        }
        Production::TimeBetweenAssists => {
            let assists = count(|cycle| cycle.2);
            (
                ratio(time, assists),
                Some(ratio(time, assists + unknown)),
                longest.map(|more| ratio(time + more, assists)),
            )
        }
        Production::CyclesBetweenFailures => {
            let n = known as f64;
            (ratio(n, failures), Some(ratio(n + unknown, failures + unknown)), Some(ratio(n + unknown, failures)))
        }
        Production::LongestCleanRun => {
            let of = |invalid| longest_run(trials.iter().copied(), invalid);
            (of(None), Some(of(Some(false))), Some(of(Some(true))))
        }
    };
    (known as u64, unknown as u64, Extremes { observed: (known > 0).then_some(observed), least, most })
}

/// The quantile of the time until success, with an unsuccessful episode later than all others.
pub(crate) fn time_to_success(q: f64, trials: &[&Trial]) -> (u64, u64, Extremes) {
    let cycles: Vec<(f64, bool, bool)> = trials.iter().filter_map(|trial| cycle(trial)).collect();
    let unknown = trials.len() - cycles.len();
    let mut times: Vec<f64> = cycles.iter().filter(|cycle| cycle.1).map(|cycle| cycle.0).collect();
    times.sort_by(f64::total_cmp);
    let place = |n: usize| ((q * n as f64 - 1e-9).ceil() as usize).clamp(1, n.max(1)) - 1;
    let at = |place: usize| Some(times.get(place).copied().unwrap_or(UNLIMITED));
    let least = place(trials.len()).checked_sub(unknown).map_or(Some(0.0), at);
    let observed = at(place(cycles.len())).filter(|_| !cycles.is_empty());
    (cycles.len() as u64, unknown as u64, Extremes { observed, least, most: at(place(trials.len())) })
}

/// The test of a requirement.
pub(crate) fn test(
    figure: Production,
    requirement: &Requirement,
    bound: Bound,
    rounds: &[Vec<&Trial>],
    how: How,
) -> Result<Tested, GateError> {
    if figure.is_per_time() {
        return per_time(figure, requirement, bound.limit, rounds, how);
    }
    let episodes: usize = rounds.iter().map(Vec::len).sum();
    let planned = match (how.budget, rounds.first()) {
        (Some(budget), Some(round)) => usize::try_from(budget).unwrap_or(episodes) * round.len(),
        _ => episodes,
    };
    let clean = figure == Production::LongestCleanRun;
    if clean && bound.limit > planned as f64 {
        return Err(GateError::Requirement {
            id: requirement.id(),
            reason: format!(
                "{planned} episodes have no run of {}\nHint: plan more rounds, or lower `at_least`",
                bound.limit
            ),
        });
    }
    let limit = if clean { rate_of_run(planned, bound.limit as usize) } else { 1.0 - 1.0 / bound.limit };
    let bound = Bound { sense: Sense::AtLeast, limit };
    let tested = rate(Metric::Success, bound, bound, rounds, how);
    let of = |rate: f64| match figure {
        Production::LongestCleanRun => median_run(planned, rate) as f64,
        _ => (1.0 / (1.0 - rate)).min(UNLIMITED),
    };
    Ok(Tested { interval: tested.interval.map(|ends| ends.map(of)), ..tested })
}

/// The test of a reward per time, as that of a mean.
fn per_time(
    figure: Production,
    requirement: &Requirement,
    limit: f64,
    rounds: &[Vec<&Trial>],
    how: How,
) -> Result<Tested, GateError> {
    let ceiling = requirement.ceiling.unwrap_or(f64::INFINITY);
    let mut looks = Vec::with_capacity(rounds.len());
    // Duration, and unit or assist, with the worst and with the best value of an unknown one.
    let (mut worst, mut best) = (Vec::new(), Vec::new());
    let units = figure == Production::UnitsPerHour;
    for round in rounds {
        for trial in round {
            let known = cycle(trial)
                .map(|(time, success, assist)| (time, f64::from(u8::from(if units { success } else { assist }))));
            if let Some((time, _)) = known
                && time > ceiling * (1.0 + 1e-9)
            {
                let (id, index) = (requirement.id(), trial.index);
                return Err(GateError::OutOfRange { id, index, value: time, low: 0.0, high: ceiling });
            }
            let known = known.map(|(time, event)| (time.min(ceiling), event));
            worst.push(known.unwrap_or(if units { (ceiling, 0.0) } else { (0.0, 1.0) }));
            best.push(known.unwrap_or(if units { (0.0, 1.0) } else { (ceiling, 0.0) }));
        }
        looks.push(worst.len());
    }
    if how.sampling == Sampling::Fixed {
        looks = vec![worst.len()];
    }
    // ln of the evidence that the figure is above r, or below it.
    let evidence = |cycles: &[(f64, f64)], r: f64, above: bool| {
        let (lowest, range) =
            if units { (r / SECONDS * ceiling, 1.0 + r / SECONDS * ceiling) } else { (r, r + ceiling) };
        let value = |(time, event): &(f64, f64)| if units { event - r / SECONDS * time } else { time - r * event };
        let values: Vec<f64> = cycles.iter().map(|cycle| (value(cycle) + lowest).clamp(0.0, range)).collect();
        BoundedMean::new(&values, &looks, range)
            .map(|mean| if above { mean.ln_evidence_above(lowest) } else { mean.ln_evidence_below(lowest) })
            .map_err(|error| GateError::Requirement { id: requirement.id(), reason: error.to_string() })
    };
    let wanted = -how.alpha.ln();
    // The evidence for "above r" falls with r, and that for "below r" rises.
    let end = |above: bool| -> Result<f64, GateError> {
        let cycles = if above { &worst } else { &best };
        let inside = |r: f64| evidence(cycles, r, above).map(|ln| (ln >= wanted) == above);
        let (mut low, mut high) = (0.0, limit);
        while high < UNLIMITED && inside(high)? {
            (low, high) = (high, 2.0 * high);
        }
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if inside(middle)? { low = middle } else { high = middle }
        }
        Ok(if above { low } else { high }.min(UNLIMITED))
    };
    let (met, violated) = (evidence(&worst, limit, true)?, evidence(&best, limit, false)?);
    Ok(Tested { p_met: (-met).exp(), p_violated: (-violated).exp(), interval: Some([end(true)?, end(false)?]) })
}

/// A figure with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProductionFigure {
    /// The figure. `None` if the events that it divides by did not happen.
    pub at: Option<f64>,
    /// Lower end.
    pub low: Option<f64>,
    /// Upper end. `None` without a limit.
    pub high: Option<f64>,
}

/// Figures of production. They do not affect the verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProductionFigures {
    /// Successful episodes per hour of all episodes.
    pub units_per_hour: ProductionFigure,
    /// Episodes per failure.
    pub mean_cycles_between_failures: ProductionFigure,
    /// Seconds of all episodes per failure, or per episode with a measure `assists` above 0.
    pub time_between_assists_s: ProductionFigure,
    /// The longest run of successes, in the order of the episodes. The interval contains the medians of the longest run among as many episodes.
    pub longest_clean_run: ProductionFigure,
    /// Median of the cycle time. Episodes without success are censored at their end.
    pub median_cycle_time_s: ProductionFigure,
    /// 90 % quantile of the cycle time, likewise.
    pub p90_cycle_time_s: ProductionFigure,
    /// At least 90 % of the cycle times of successful episodes lie in this range, with a confidence of 95 %. `None` with too few.
    pub tolerance_cycle_time_s: Option<[f64; 2]>,
}

impl ProductionFigures {
    /// The figures of these episodes, in their order. `None` without two valid episodes that have a duration.
    pub(crate) fn of(trials: &[&Trial]) -> Option<Self> {
        let cycles: Vec<(f64, bool, bool)> = trials.iter().filter_map(|trial| cycle(trial)).collect();
        let times: Vec<f64> = cycles.iter().map(|cycle| cycle.0).collect();
        let units: Vec<f64> = cycles.iter().map(|cycle| f64::from(u8::from(cycle.1))).collect();
        let assists: Vec<bool> = cycles.iter().map(|cycle| cycle.2).collect();
        let limited = |x: f64| Some(x).filter(|x| *x < UNLIMITED && x.is_finite());
        let units = reward_rate(&units, &times, Confidence::P95)?;
        let assists = event_rate(&assists, &times, Confidence::P95)?;
        let inverse = |rate: f64| limited(1.0 / rate);
        let rate = clopper_pearson(Trials::count(cycles.iter().map(|cycle| cycle.1)), Confidence::P95);
        let n = cycles.len();
        let failures = cycles.iter().filter(|cycle| !cycle.1).count();
        let steps = kaplan_meier(&times, &cycles.iter().map(|cycle| cycle.1).collect::<Vec<bool>>(), Confidence::P95);
        let quantile = |q: f64| {
            let found = quantile_time(&steps, q);
            ProductionFigure { at: found.at, low: found.low, high: found.high }
        };
        let mut successes: Vec<f64> = cycles.iter().filter(|cycle| cycle.1).map(|cycle| cycle.0).collect();
        successes.sort_by(f64::total_cmp);
        let tolerance = tolerance_interval(successes.len() as u64, CONTENT, 0.95);
        Some(Self {
            units_per_hour: ProductionFigure {
                at: limited(SECONDS * units.rate),
                low: limited(SECONDS * units.interval.low),
                high: limited(SECONDS * units.interval.high),
            },
            mean_cycles_between_failures: ProductionFigure {
                at: inverse(failures as f64 / n as f64),
                low: inverse(1.0 - rate.low),
                high: inverse(1.0 - rate.high),
            },
            time_between_assists_s: ProductionFigure {
                at: inverse(assists.rate),
                low: inverse(assists.interval.high),
                high: inverse(assists.interval.low),
            },
            longest_clean_run: ProductionFigure {
                at: Some(median_run(n, (n - failures) as f64 / n as f64) as f64),
                low: Some(median_run(n, rate.low) as f64),
                high: Some(median_run(n, rate.high) as f64),
            },
            median_cycle_time_s: quantile(0.5),
            p90_cycle_time_s: quantile(0.9),
            tolerance_cycle_time_s: tolerance
                .and_then(|[low, high]| Some([*successes.get(low as usize - 1)?, *successes.get(high as usize - 1)?])),
        })
    }

    /// Names, units and figures, in the order of a table.
    pub fn rows(&self) -> [(&'static str, &'static str, ProductionFigure); 6] {
        [
            ("units per hour", "", self.units_per_hour),
            ("mean cycles between failures", "", self.mean_cycles_between_failures),
            ("time between assists", "s", self.time_between_assists_s),
            ("longest clean run, median", "episodes", self.longest_clean_run),
            ("median cycle time", "s", self.median_cycle_time_s),
            ("90 % quantile of cycle time", "s", self.p90_cycle_time_s),
        ]
    }
}
