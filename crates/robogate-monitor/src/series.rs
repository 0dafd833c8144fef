//! The course of a recipe over its whole life, in a bounded number of points.

use serde::{Deserialize, Serialize};

use crate::cycle::Cycle;
use crate::events::MOST_EVENTS;
use crate::metric::Metric;

/// Maximum number of points. Once they are used up, two neighbours become one.
const MOST_POINTS: usize = 120;
/// Cycles of a point before the first merge.
const FIRST_WIDTH: u64 = 20;

/// Number of detectors that a recipe can have.
const DETECTORS: usize = Metric::FIXED.len() + MOST_EVENTS;

/// Some consecutive cycles of a recipe. Series of earlier versions have no numbers after `evidence`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SeriesPoint {
    /// The last cycle, numbered within the recipe from 1.
    pub cycle: u64,
    /// Its time on the sender's clock, in seconds since 1970-01-01 UTC.
    pub time_s: f64,
    /// Number of cycles.
    pub cycles: u64,
    /// Number of successes among them.
    pub successes: u64,
    /// The largest evidence of any detector for a warning, as a share of its limit.
    pub evidence: f64,
    /// Successful cycles with a cycle time.
    #[serde(default)]
    pub timed: u64,
    /// The sum of these cycle times, in seconds.
    #[serde(default)]
    pub cycle_time_sum_s: f64,
    /// Cycles that report a parameter of the validated region.
    #[serde(default)]
    pub judged: u64,
    /// Cycles outside the validated region.
    #[serde(default)]
    pub outside: u64,
    /// For each event, the cycles that report it, and those in which it happened.
    #[serde(default)]
    pub events: [[u32; 2]; MOST_EVENTS],
    /// The largest evidence of each detector for a warning as a share of its limit, by the index of the metric.
    #[serde(default)]
    pub by_detector: [f32; DETECTORS],
}

/// What a cycle adds to a series, beside the cycle itself.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Observed {
    /// The number of the cycle in its recipe.
    pub(crate) cycle: u64,
    /// Whether the cycle lies outside the validated region. `None` if this is unknown.
    pub(crate) outside: Option<bool>,
    /// The evidence for a warning as a share of its limit, by the index of the metric.
    pub(crate) by_detector: [f32; DETECTORS],
}

impl SeriesPoint {
    /// Adds a cycle.
    fn add<'a>(&mut self, cycle: &Cycle, events: impl Iterator<Item = &'a String>, observed: &Observed) {
        self.cycle = observed.cycle;
        self.time_s = cycle.time_s;
        self.cycles += 1;
        self.successes += u64::from(cycle.success);
        if let Some(time) = cycle.cycle_time_s.filter(|_| cycle.success) {
            self.timed += 1;
            self.cycle_time_sum_s += time;
        }
        self.judged += u64::from(observed.outside.is_some());
        self.outside += u64::from(observed.outside == Some(true));
        for (counts, name) in self.events.iter_mut().zip(events) {
            if let Some(happened) = cycle.events.get(name) {
                counts[0] = counts[0].saturating_add(1);
                counts[1] = counts[1].saturating_add(u32::from(*happened));
            }
        }
        for (most, share) in self.by_detector.iter_mut().zip(observed.by_detector) {
            *most = most.max(share);
            self.evidence = self.evidence.max(f64::from(share));
        }
    }

    /// This point and its successor as one.
    fn with(&self, next: &Self) -> Self {
        let mut both = *next;
        both.cycles += self.cycles;
        both.successes += self.successes;
        both.evidence = both.evidence.max(self.evidence);
        both.timed += self.timed;
        both.cycle_time_sum_s += self.cycle_time_sum_s;
        both.judged += self.judged;
        both.outside += self.outside;
        for (sum, counts) in both.events.iter_mut().zip(self.events) {
            *sum = [sum[0].saturating_add(counts[0]), sum[1].saturating_add(counts[1])];
        }
        for (most, share) in both.by_detector.iter_mut().zip(self.by_detector) {
            *most = most.max(share);
        }
        both
    }
}

/// The points of a recipe, oldest first. All have the same number of cycles, except the last.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Series {
    width: u64,
    points: Vec<SeriesPoint>,
}

impl Default for Series {
    /// No points. All memory is allocated here.
    fn default() -> Self {
        Self { width: FIRST_WIDTH, points: Vec::with_capacity(MOST_POINTS) }
    }
}

impl Series {
    /// Adds one cycle.
    pub(crate) fn push<'a>(&mut self, cycle: &Cycle, events: impl Iterator<Item = &'a String>, observed: &Observed) {
        if self.points.last().is_none_or(|last| last.cycles >= self.width) {
            if self.points.len() >= MOST_POINTS {
                self.halve();
            }
            self.points.push(SeriesPoint::default());
        }
        if let Some(last) = self.points.last_mut() {
            last.add(cycle, events, observed);
        }
    }

    /// Merges each pair of neighbours.
    fn halve(&mut self) {
        let half = self.points.len() / 2;
        for at in 0..half {
            let (Some(first), Some(second)) = (self.points.get(2 * at), self.points.get(2 * at + 1)) else { continue };
            let merged = first.with(second);
            if let Some(place) = self.points.get_mut(at) {
                *place = merged;
            }
        }
        self.points.truncate(half);
        self.width *= 2;
    }

    /// The points, oldest first.
    pub(crate) fn points(&self) -> &[SeriesPoint] {
        &self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_life_fits() {
        let mut series = Series::default();
        let events = ["spill".to_owned()];
        let mut cycle: Cycle = serde_json::from_str(
            r#"{"id": "a", "robot": "a", "recipe": "a", "time_s": 1.0, "success": true, "events": {"spill": false}}"#,
        )
        .unwrap();
        for number in 1..=100_000_u64 {
            cycle.time_s = number as f64;
            cycle.success = !number.is_multiple_of(20);
            cycle.cycle_time_s = Some(4.0);
            cycle.events.insert("spill".to_owned(), number.is_multiple_of(50));
            let mut by_detector = [0.1; DETECTORS];
            by_detector[3] = if number == 777 { 0.9 } else { 0.05 };
            let outside = (number > 50_000).then_some(number.is_multiple_of(2));
            series.push(&cycle, events.iter(), &Observed { cycle: number, outside, by_detector });
        }
        let points = series.points();
        assert!((MOST_POINTS / 2..=MOST_POINTS).contains(&points.len()), "{}", points.len());
        assert_eq!(points.iter().map(|point| point.cycles).sum::<u64>(), 100_000);
        assert_eq!(points.iter().map(|point| point.successes).sum::<u64>(), 95_000);
        assert_eq!(points.last().unwrap().cycle, 100_000);
        assert_eq!(points.iter().filter(|point| point.evidence > 0.5 && point.by_detector[3] > 0.5).count(), 1);
        assert_eq!(points.iter().map(|point| point.events[0][1]).sum::<u32>(), 2_000);
        assert_eq!(
            points.iter().map(|point| (point.outside, point.judged)).fold((0, 0), |(a, b), (c, d)| (a + c, b + d)),
            (25_000, 50_000)
        );
        let [time, timed] =
            [points.iter().map(|p| p.cycle_time_sum_s).sum::<f64>(), points.iter().map(|p| p.timed as f64).sum()];
        assert!((time / timed - 4.0).abs() < 1e-9);
        // A point of an earlier version.
        let old = r#"{"cycle": 20, "time_s": 1.0, "cycles": 20, "successes": 19, "evidence": 0.2}"#;
        assert_eq!(serde_json::from_str::<SeriesPoint>(old).unwrap().timed, 0);
    }
}
