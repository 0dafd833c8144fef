//! Classifies a cell as safe, boundary or danger from its count.
//!
//! As in the paper, a cell is safe above 70 % success, in danger below 30 %, and boundary between. A zone is assigned
//! only if the whole interval of the cell is in it. Otherwise the cell has too few episodes, and the zones that the
//! interval excludes are reported.
//!
//! Guarantee: with Wilson or Clopper-Pearson at 95 %, about one assigned zone in twenty is wrong at most. For a
//! statement about a whole map, share the level over its cells ([`Confidence::shared_by`]). Limit: a cell whose true
//! rate equals a limit stays "too thin" for any number of rows. Source: robogate paper, zones of the failure
//! dictionary; the rule for thin cells is RoboGate's.

use crate::interval::{Confidence, Interval, Trials, wilson};

/// Success rates that separate the zones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZoneLimits {
    danger_below: f64,
    safe_above: f64,
}

impl ZoneLimits {
    /// The paper's 30 % and 70 %.
    pub const PAPER: Self = Self { danger_below: 0.3, safe_above: 0.7 };

    /// Creates limits with 0 ≤ `danger_below` ≤ `safe_above` ≤ 1. `None` otherwise.
    pub fn new(danger_below: f64, safe_above: f64) -> Option<Self> {
        (0.0 <= danger_below && danger_below <= safe_above && safe_above <= 1.0)
            .then_some(Self { danger_below, safe_above })
    }
}

/// The classification of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Zone {
    /// The whole interval is at or above the upper limit.
    Safe,
    /// The whole interval is between the limits.
    Boundary,
    /// The whole interval is at or below the lower limit.
    Danger,
    /// The interval contains a limit.
    TooThin {
        /// Whether the interval allows "safe".
        may_be_safe: bool,
        /// Whether the interval allows "danger".
        may_be_danger: bool,
    },
}

/// Zone of a cell from an interval for its success rate.
pub fn zone(interval: Interval, limits: ZoneLimits) -> Zone {
    if interval.low >= limits.safe_above {
        Zone::Safe
    } else if interval.high <= limits.danger_below {
        Zone::Danger
    } else if interval.low >= limits.danger_below && interval.high <= limits.safe_above {
        Zone::Boundary
    } else {
        Zone::TooThin {
            may_be_safe: interval.high >= limits.safe_above,
            may_be_danger: interval.low <= limits.danger_below,
        }
    }
}

/// The zone of each cell, by Wilson intervals at the given level per cell.
pub fn zones(cells: &[Trials], limits: ZoneLimits, confidence: Confidence) -> Vec<Zone> {
    cells.iter().map(|c| zone(wilson(*c, confidence), limits)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(k: u64, n: u64) -> Zone {
        zones(&[Trials::new(k, n).unwrap()], ZoneLimits::PAPER, Confidence::P95)[0]
    }

    #[test]
    fn thin_cell_has_no_zone() {
        let open = Zone::TooThin { may_be_safe: true, may_be_danger: true };
        assert_eq!((of(0, 0), of(1, 1)), (open, Zone::TooThin { may_be_safe: true, may_be_danger: true }));
        assert_eq!(of(8, 10), Zone::TooThin { may_be_safe: true, may_be_danger: false });
    }

    #[test]
    fn full_cell_has_its_zone() {
        assert_eq!((of(90, 100), of(50, 100), of(10, 100)), (Zone::Safe, Zone::Boundary, Zone::Danger));
    }

    #[test]
    fn rate_on_limit_has_no_zone() {
        assert!(matches!(of(700_000, 1_000_000), Zone::TooThin { may_be_safe: true, may_be_danger: false }));
    }

    #[test]
    fn zones_keep_their_error_level() {
        // Exact sum over Binomial(80, p) for rates just outside "safe" and just outside "danger".
        for p in [0.699, 0.301_f64] {
            let mut mass = (1.0 - p).powi(80);
            let mut wrong = 0.0;
            for k in 0..=80_u64 {
                if matches!(of(k, 80), Zone::Safe | Zone::Danger) {
                    wrong += mass;
                }
                mass *= (80 - k) as f64 / (k + 1) as f64 * p / (1.0 - p);
            }
            assert!(wrong < 0.05, "p {p}: {wrong}");
        }
    }

    #[test]
    fn invalid_limits_are_rejected() {
        assert_eq!(ZoneLimits::new(0.7, 0.3), None);
        assert_eq!(ZoneLimits::new(f64::NAN, 0.3), None);
    }
}
