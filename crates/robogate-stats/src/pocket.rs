//! A box of parameters in which a rare event is frequent.
//!
//! Rows are divided at random into two halves. The first half finds the box: from the whole space, a slab of one parameter (a
//! tenth of the rows in the box, or a level) is removed again and again, so that the rate of the event rises most. Of all boxes on the
//! way, the one with the largest log-likelihood ratio of "different rates inside and outside" is kept. Its sides then grow, and limits
//! are dropped, while the ratio does not fall. The second half, which did not choose the box, gives the rates inside and outside.
//!
//! The search counts rows; the rates count sampling weights, so that they are those of the population even if most rows were sampled
//! where the event is likely.
//!
//! Sources: Friedman and Fisher (1999), Statistics and Computing 9, for peeling and pasting; Kulldorff (1997), Communications
//! in Statistics 26(6), for the ratio.

use rand_chacha::ChaCha8Rng;
use rand_core::SeedableRng;

use crate::interval::{Confidence, Interval};
use crate::resample::shuffle;
use crate::safe_box::{Column, Inside, Limits, contains};
use crate::scan::log_likelihood;
use crate::weighted::hajek;

/// Share of the rows in the box that one step removes.
const PEELED: f64 = 0.1;
/// Fewest rows in a box while it is peeled.
const FEWEST_ROWS: usize = 8;
/// Fewest events in the half that chooses.
const FEWEST_EVENTS: usize = 3;
/// What a limit must add to the ratio.
const OF_A_LIMIT: f64 = 2.0;

/// A rate of the event in one part of the space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EventRate {
    /// Rows.
    pub rows: usize,
    /// Events among them.
    pub events: usize,
    /// The rate by sampling weights.
    pub rate: f64,
    /// Its interval.
    pub interval: Interval,
    /// The number of independent rows that the interval counts.
    pub independent: f64,
}

/// A box with its rates in the rows that did not choose it.
#[derive(Debug, Clone, PartialEq)]
pub struct Pocket {
    /// The box.
    pub limits: Limits,
    /// The rate inside.
    pub inside: EventRate,
    /// The rate outside.
    pub outside: EventRate,
}

impl Pocket {
    /// Whether the rate inside is significantly above that outside.
    pub fn is_significant(&self) -> bool {
        self.inside.interval.low > self.outside.interval.high
    }
}

/// Searches the box. `None` with too few events, for lists of different lengths, and without a box that has rows of both halves.
pub fn pocket(
    columns: &[Column<'_>],
    event: &[bool],
    weights: Option<&[f64]>,
    confidence: Confidence,
    seed: u64,
) -> Option<Pocket> {
    let n = event.len();
    if columns.iter().any(|c| c.values.len() != n) || weights.is_some_and(|weights| weights.len() != n) {
        return None;
    }
    let mut order: Vec<usize> = (0..n).collect();
    shuffle(&mut ChaCha8Rng::seed_from_u64(seed), &mut order);
    // Events are divided evenly, because they are few.
    order.sort_by_key(|row| !event[*row]);
    let half = |parity: usize| order.iter().skip(parity).step_by(2).copied().collect::<Vec<usize>>();
    let (choosing, testing) = (half(0), half(1));
    if choosing.iter().filter(|row| event[**row]).count() < FEWEST_EVENTS {
        return None;
    }
    let weight = |row: usize| weights.map_or(1.0, |weights| weights[row]);
    let search = Search { columns, event, rows: &choosing };
    let limits = search.best()?;
    let rate = |wanted: bool| -> Option<EventRate> {
        let rows: Vec<usize> =
            testing.iter().copied().filter(|row| contains(&limits, columns, *row) == wanted).collect();
        let events: Vec<bool> = rows.iter().map(|row| event[*row]).collect();
        let weights: Vec<f64> = rows.iter().map(|row| weight(*row)).collect();
        let found = hajek(&events, &weights, confidence).ok()?;
        Some(EventRate {
            rows: rows.len(),
            events: events.iter().filter(|event| **event).count(),
            rate: found.rate?,
            interval: found.interval,
            independent: found.independent,
        })
    };
    let (inside, outside) = (rate(true)?, rate(false)?);
    Some(Pocket { limits, inside, outside })
}

struct Search<'a> {
    columns: &'a [Column<'a>],
    event: &'a [bool],
    rows: &'a [usize],
}

impl Search<'_> {
    fn best(&self) -> Option<Limits> {
        let mut limits: Limits = Vec::new();
        let mut best: Option<(f64, Limits)> = None;
        while let Some(next) = self.peeled(&limits) {
            limits = next;
            let ratio = self.ratio(&limits);
            if best.as_ref().is_none_or(|(most, _)| ratio > *most) {
                best = Some((ratio, limits.clone()));
            }
        }
        let (mut ratio, mut limits) = best.filter(|(ratio, _)| *ratio > 0.0)?;
        while let Some((larger, grown)) = self.grown(&limits, ratio) {
            (ratio, limits) = (larger, grown);
        }
        while let Some(without) = self.without(&limits, ratio) {
            ratio = self.ratio(&without);
            limits = without;
        }
        (!limits.is_empty()).then_some(limits)
    }

    /// Rows and events among those for which `used` is true.
    fn sums(&self, used: impl Fn(usize) -> bool) -> [f64; 2] {
        let rows = self.rows.iter().filter(|row| used(**row));
        rows.fold([0.0; 2], |[n, k], row| [n + 1.0, k + f64::from(u8::from(self.event[*row]))])
    }

    /// The log-likelihood ratio of different rates inside and outside, 0 if the rate inside is not larger.
    fn ratio(&self, limits: &Limits) -> f64 {
        let [n, k] = self.sums(|row| contains(limits, self.columns, row));
        let [all, events] = self.sums(|_| true);
        let (m, l) = (all - n, events - k);
        if n <= 0.0 || m <= 0.0 || k * m <= l * n {
            return 0.0;
        }
        log_likelihood(k, n) + log_likelihood(l, m) - log_likelihood(events, all)
    }

    /// The box without the slab whose removal raises the rate most. `None` if nothing can be removed.
    fn peeled(&self, limits: &Limits) -> Option<Limits> {
        let inside: Vec<usize> = self.rows.iter().copied().filter(|row| contains(limits, self.columns, *row)).collect();
        if inside.len() < 2 * FEWEST_ROWS || inside.iter().all(|row| self.event[*row]) {
            return None;
        }
        let mut best: Option<(f64, Limits)> = None;
        let mut offer = |candidate: Limits| {
            let kept: Vec<usize> =
                inside.iter().copied().filter(|row| contains(&candidate, self.columns, *row)).collect();
            if kept.len() < FEWEST_ROWS || kept.len() == inside.len() {
                return;
            }
            let events = kept.iter().filter(|row| self.event[**row]).count();
            let rate = events as f64 / kept.len() as f64;
            if best.as_ref().is_none_or(|(most, _)| rate > *most) {
                best = Some((rate, candidate));
            }
        };
        for (at, column) in self.columns.iter().enumerate() {
            if let Some(levels) = column.levels {
                let now = match limits.iter().find(|(c, _)| *c == at) {
                    Some((_, Inside::Levels(kept))) => kept.clone(),
                    _ => vec![true; levels],
                };
                for level in (0..levels).filter(|level| now[*level]) {
                    let mut kept = now.clone();
                    kept[level] = false;
                    offer(with(limits, at, Inside::Levels(kept)));
                }
                continue;
            }
            let mut values: Vec<f64> = inside.iter().map(|row| column.values[*row]).collect();
            values.sort_unstable_by(f64::total_cmp);
            let slab = ((values.len() as f64 * PEELED) as usize).max(1);
            let (low, high) = range_of(limits, at);
            // Halfway between a value that is removed and the next one that stays.
            if let Some(first) = values.iter().position(|v| *v > values[slab - 1]) {
                let from = 0.5 * (values[first - 1] + values[first]);
                offer(with(limits, at, Inside::Range { low: Some(from), high }));
            }
            if let Some(last) = values.iter().rposition(|v| *v < values[values.len() - slab]) {
                let to = 0.5 * (values[last] + values[last + 1]);
                offer(with(limits, at, Inside::Range { low, high: Some(to) }));
            }
        }
        best.map(|(_, limits)| limits)
    }

    /// The box with one side moved outwards over the next rows, if that raises the ratio.
    fn grown(&self, limits: &Limits, ratio: f64) -> Option<(f64, Limits)> {
        let mut best: Option<(f64, Limits)> = None;
        for (at, inside) in limits {
            let Inside::Range { low, high } = inside else { continue };
            let others: Limits = limits.iter().filter(|(c, _)| c != at).cloned().collect();
            let values = self.columns[*at].values;
            let mut beside: Vec<f64> =
                self.rows.iter().filter(|row| contains(&others, self.columns, **row)).map(|row| values[*row]).collect();
            beside.sort_unstable_by(f64::total_cmp);
            let below = beside.partition_point(|v| low.is_some_and(|low| *v < low));
            let above = beside.partition_point(|v| high.is_none_or(|high| *v <= high));
            for step in [1, 2, 4] {
                let mut candidates = Vec::new();
                if let (Some(_), Some(at)) = (low, below.checked_sub(step)) {
                    let from = if at == 0 { None } else { Some(0.5 * (beside[at - 1] + beside[at])) };
                    candidates.push(Inside::Range { low: from, high: *high });
                }
                if high.is_some() && above + step <= beside.len() {
                    let at = above + step;
                    let to = if at == beside.len() { None } else { Some(0.5 * (beside[at - 1] + beside[at])) };
                    candidates.push(Inside::Range { low: *low, high: to });
                }
                for inside in candidates {
                    let grown = with(limits, *at, inside);
                    let larger = self.ratio(&grown);
                    if larger > ratio + 1e-9 && best.as_ref().is_none_or(|(most, _)| larger > *most) {
                        best = Some((larger, grown));
                    }
                }
            }
        }
        best
    }

    /// The box without the limit that adds least to the ratio, if it adds less than [`OF_A_LIMIT`].
    fn without(&self, limits: &Limits, ratio: f64) -> Option<Limits> {
        let mut candidates = Vec::new();
        for (at, inside) in limits {
            let others: Limits = limits.iter().filter(|(c, _)| c != at).cloned().collect();
            if let Inside::Range { low: Some(low), high: Some(high) } = *inside {
                candidates.push(with(limits, *at, Inside::Range { low: None, high: Some(high) }));
                candidates.push(with(limits, *at, Inside::Range { low: Some(low), high: None }));
            }
            if !others.is_empty() {
                candidates.push(others);
            }
        }
        let rated = candidates.into_iter().map(|limits| (self.ratio(&limits), limits));
        let best = rated.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 > ratio - OF_A_LIMIT).then_some(best.1)
    }
}

fn range_of(limits: &Limits, column: usize) -> (Option<f64>, Option<f64>) {
    match limits.iter().find(|(c, _)| *c == column) {
        Some((_, Inside::Range { low, high })) => (*low, *high),
        _ => (None, None),
    }
}

/// The box with these values of one column.
fn with(limits: &Limits, column: usize, inside: Inside) -> Limits {
    let mut changed: Limits = limits.iter().filter(|(c, _)| *c != column).cloned().collect();
    if inside != (Inside::Range { low: None, high: None }) {
        changed.push((column, inside));
    }
    changed.sort_by_key(|(column, _)| *column);
    changed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resample::uniform;

    /// Six columns, of which two define a pocket of 0.5 % of the volume. A third of the rows were sampled in a larger box around it,
    /// with the weights of the mixture.
    fn rows(seed: u64, n: usize) -> (Vec<Vec<f64>>, Vec<bool>, Vec<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut columns = vec![Vec::new(); 6];
        let (mut event, mut weights) = (Vec::new(), Vec::new());
        let around = [[0.25, 0.45], [0.55, 0.75]];
        for row in 0..n {
            let mut x: Vec<f64> = (0..6).map(|_| uniform(&mut rng)).collect();
            if row % 3 == 0 {
                (0..2).for_each(|i| x[i] = around[i][0] + (around[i][1] - around[i][0]) * x[i]);
            }
            let is_around = (0..2).all(|i| (around[i][0]..around[i][1]).contains(&x[i]));
            // The mixture has 2/3 of the uniform density, and a third spread over 4 % of the volume.
            weights.push(1.0 / (2.0 / 3.0 + if is_around { 1.0 / 3.0 / 0.04 } else { 0.0 }));
            let within = (0.3..0.37).contains(&x[0]) && (0.6..0.67).contains(&x[1]);
            event.push(uniform(&mut rng) < if within { 0.9 } else { 0.002 });
            columns.iter_mut().zip(x).for_each(|(column, x)| column.push(x));
        }
        (columns, event, weights)
    }

    #[test]
    fn small_pocket_is_boxed() {
        let mut covered = 0;
        for seed in 0..10 {
            let (columns, event, weights) = rows(seed, 1_500);
            let views: Vec<Column<'_>> = columns.iter().map(|values| Column { values, levels: None }).collect();
            let found = pocket(&views, &event, Some(&weights), Confidence::P95, seed).unwrap();
            assert!(found.is_significant(), "{found:?}");
            assert_eq!(
                found.limits.iter().map(|(column, _)| *column).collect::<Vec<_>>(),
                [0, 1],
                "seed {seed}: {found:?}"
            );
            let mut filled = 1.0;
            for ((_, inside), [from, to]) in found.limits.iter().zip([[0.3_f64, 0.37_f64], [0.6, 0.67]]) {
                let Inside::Range { low: Some(low), high: Some(high) } = inside else { panic!("{inside:?}") };
                assert!((low - from).abs() < 0.03 && (high - to).abs() < 0.03, "seed {seed}: {inside:?}");
                filled *= (high.min(to) - low.max(from)) / (high - low);
            }
            covered += u32::from(found.inside.interval.contains(0.9 * filled + 0.002 * (1.0 - filled)));
            assert!(found.outside.rate < 0.01);
        }
        assert!(covered >= 8, "{covered} of 10 intervals contain the rate inside");
    }

    #[test]
    fn noise_has_no_significant_pocket() {
        let mut significant = 0;
        for seed in 0..100 {
            let (columns, _, weights) = rows(seed, 600);
            let mut rng = ChaCha8Rng::seed_from_u64(1_000 + seed);
            let event: Vec<bool> = (0..600).map(|_| uniform(&mut rng) < 0.05).collect();
            let views: Vec<Column<'_>> = columns.iter().map(|values| Column { values, levels: None }).collect();
            let found = pocket(&views, &event, Some(&weights), Confidence::P95, seed);
            significant += u32::from(found.is_some_and(|found| found.is_significant()));
        }
        assert!(significant <= 5, "{significant} of 100");
    }

    #[test]
    fn few_events_have_no_pocket() {
        let values = vec![0.5; 50];
        let columns = [Column { values: &values, levels: None }];
        assert!(pocket(&columns, &[false; 50], None, Confidence::P95, 1).is_none());
        assert!(pocket(&columns, &[true; 40], None, Confidence::P95, 1).is_none());
    }
}
