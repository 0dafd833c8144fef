//! The course of a recipe over its whole life, in a bounded number of points.

use serde::{Deserialize, Serialize};

/// Maximum number of points. Once they are used up, two neighbours become one.
const MOST_POINTS: usize = 120;
/// Cycles of a point before the first merge.
const FIRST_WIDTH: u64 = 20;

/// Some consecutive cycles of a recipe.
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
    pub(crate) fn push(&mut self, cycle: u64, time_s: f64, success: bool, evidence: f64) {
        if self.points.last().is_none_or(|last| last.cycles >= self.width) {
            if self.points.len() >= MOST_POINTS {
                self.halve();
            }
            self.points.push(SeriesPoint::default());
        }
        if let Some(last) = self.points.last_mut() {
            last.cycle = cycle;
            last.time_s = time_s;
            last.cycles += 1;
            last.successes += u64::from(success);
            last.evidence = last.evidence.max(evidence);
        }
    }

    /// Merges each pair of neighbours.
    fn halve(&mut self) {
        let half = self.points.len() / 2;
        for at in 0..half {
            let (Some(first), Some(second)) = (self.points.get(2 * at), self.points.get(2 * at + 1)) else { continue };
            let merged = SeriesPoint {
                cycle: second.cycle,
                time_s: second.time_s,
                cycles: first.cycles + second.cycles,
                successes: first.successes + second.successes,
                evidence: first.evidence.max(second.evidence),
            };
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
        for cycle in 1..=100_000_u64 {
            series.push(cycle, cycle as f64, cycle % 20 != 0, if cycle == 777 { 0.9 } else { 0.1 });
        }
        let points = series.points();
        assert!((MOST_POINTS / 2..=MOST_POINTS).contains(&points.len()), "{}", points.len());
        assert_eq!(points.iter().map(|point| point.cycles).sum::<u64>(), 100_000);
        assert_eq!(points.iter().map(|point| point.successes).sum::<u64>(), 95_000);
        assert_eq!(points.last().unwrap().cycle, 100_000);
        assert_eq!(points.iter().filter(|point| point.evidence > 0.5).count(), 1);
    }
}
