//! The course of a recipe for the page: one chart for each metric, and the evidence of each detector.

use std::borrow::Cow;

use robogate_stats::Trials;
use serde::Serialize;

use super::status::RateStatus;
use crate::metric::Metric;
use crate::{Recipe, SeriesPoint, Settings};

/// The course of a recipe. All lists of values have one item for each point.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Charts {
    /// The last cycle of each point, numbered within the recipe.
    pub cycles: Vec<u64>,
    /// Its time on the sender's clock, in seconds since 1970-01-01 UTC.
    pub times_s: Vec<f64>,
    /// The metrics that can be drawn.
    pub metrics: Vec<MetricChart>,
    /// The evidence of the detectors that run.
    pub evidence: Vec<EvidenceChart>,
}

/// The course of one metric.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MetricChart {
    /// The metric, as in alarms.
    pub metric: Cow<'static, str>,
    /// Its label.
    pub label: Cow<'static, str>,
    /// Whether the values are shares from 0 to 1. Otherwise they are seconds.
    pub share: bool,
    /// The value of the baseline. `None` while it is being learnt.
    pub baseline: Option<f64>,
    /// The bounds of the baseline: a 95 % confidence interval of a rate, or the 5th and 95th percentile of cycle times.
    pub bounds: Option<[f64; 2]>,
    /// The values. `None` where nothing was reported.
    pub values: Vec<Option<f64>>,
    /// 95 % Wilson intervals of shares. Empty for other metrics.
    pub intervals_95: Vec<Option<[f64; 2]>>,
}

/// The course of one detector's evidence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EvidenceChart {
    /// The metric, as in alarms.
    pub metric: Cow<'static, str>,
    /// Its label.
    pub label: Cow<'static, str>,
    /// The largest evidence of each point as a share of the limit of a warning. 1 while an alarm is active.
    pub shares: Vec<f64>,
}

impl Charts {
    pub(super) fn of(recipe: &Recipe, settings: &Settings) -> Self {
        let points = recipe.series();
        let baseline = recipe.baseline();
        let mut metrics = Vec::new();
        for metric in Metric::all(settings) {
            let chart = |of: fn(&SeriesPoint, usize) -> (u64, u64), at: usize, known: Option<(u64, u64)>| {
                rates(metric, settings, points.iter().map(|point| of(point, at)), known)
            };
            match metric {
                Metric::Success => {
                    let known = baseline.success.map(|count| (count.of.saturating_sub(count.count), count.of));
                    metrics.push(chart(|point, _| (point.cycles - point.successes, point.cycles), 0, known));
                }
                Metric::Event(event) => {
                    let count = settings.event(metric).and_then(|name| baseline.events.get(name));
                    let of = |point: &SeriesPoint, at: usize| {
                        let [reported, happened] = point.events.get(at).copied().unwrap_or_default();
                        (u64::from(happened), u64::from(reported))
                    };
                    metrics.push(chart(of, usize::from(event), count.map(|count| (count.count, count.of))));
                }
                Metric::Outside => metrics.push(chart(|point, _| (point.outside, point.judged), 0, None)),
                Metric::CycleTime => metrics.push(times(metric, settings, points, baseline.cycle_times_s.as_deref())),
                Metric::CycleTimeSpread | Metric::FailureModes | Metric::Risk | Metric::Robot => {}
            }
        }
        metrics.retain(|chart| chart.values.iter().any(Option::is_some));
        let running = recipe.detectors(settings).into_iter().filter(|view| view.levels.is_ok());
        let evidence = running.map(|view| EvidenceChart {
            metric: view.name,
            label: view.label,
            shares: points.iter().map(|point| rounded(share(point, view.metric))).collect(),
        });
        Self {
            cycles: points.iter().map(|point| point.cycle).collect(),
            times_s: points.iter().map(|point| point.time_s.round()).collect(),
            metrics,
            evidence: evidence.collect(),
        }
    }
}

fn share(point: &SeriesPoint, metric: Metric) -> f64 {
    f64::from(point.by_detector.get(metric.index()).copied().unwrap_or_default())
}

/// A number with four decimals, because the page draws it on a few hundred pixels.
fn rounded(x: f64) -> f64 {
    (x * 1e4).round() / 1e4
}

/// A metric that counts cycles. Each item is a count with its number of cycles.
fn rates(
    metric: Metric,
    settings: &Settings,
    counts: impl Iterator<Item = (u64, u64)>,
    known: Option<(u64, u64)>,
) -> MetricChart {
    let rate = |(count, of): (u64, u64)| {
        let status = RateStatus::of(Trials::new(count, of).unwrap_or(Trials::NONE));
        (status.rate.map(rounded), status.rate.map(|_| status.interval_95.map(rounded)))
    };
    let (values, intervals_95) = counts.map(rate).unzip();
    let (baseline, bounds) = known.map_or((None, None), rate);
    MetricChart {
        metric: metric.name(settings),
        label: metric.label(settings),
        share: true,
        baseline,
        bounds,
        values,
        intervals_95,
    }
}

/// The mean cycle time of successful cycles.
fn times(metric: Metric, settings: &Settings, points: &[SeriesPoint], known: Option<&[f64]>) -> MetricChart {
    let mean = |point: &SeriesPoint| (point.timed > 0).then(|| rounded(point.cycle_time_sum_s / point.timed as f64));
    let mut sorted = known.unwrap_or_default().to_vec();
    sorted.sort_by(f64::total_cmp);
    let quantile = |share: f64| sorted.get((share * sorted.len() as f64) as usize).copied().map(rounded);
    let baseline = (!sorted.is_empty()).then(|| rounded(sorted.iter().sum::<f64>() / sorted.len() as f64));
    MetricChart {
        metric: metric.name(settings),
        label: "mean cycle time of successful cycles".into(),
        share: false,
        baseline,
        bounds: quantile(0.05).zip(quantile(0.95)).map(|(low, high)| [low, high]),
        values: points.iter().map(mean).collect(),
        intervals_95: Vec::new(),
    }
}
