//! Safe, boundary and danger zones.

use robogate_stats::zone::{self, ZoneLimits, zones};
use robogate_stats::{Confidence, Interval, Trials};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The zone of a cell by its confidence interval: safe from 70 % success, danger up to 30 %.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Zone {
    /// The whole interval is at or above 70 %.
    Safe,
    /// The whole interval is between 30 % and 70 %.
    Boundary,
    /// The whole interval is at or below 30 %.
    Danger,
    /// There are enough episodes, but the interval includes a limit: the rate is near it.
    Undecided,
    /// There are too few episodes: even a rate of 50 % would not be classified.
    TooFewEpisodes,
}

impl Zone {
    /// The name of the zone in reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Safe => "mostly succeeds",
            Self::Boundary => "boundary",
            Self::Danger => "mostly fails",
            Self::Undecided => "undecided",
            Self::TooFewEpisodes => "too few episodes",
        }
    }

    /// Whether the cell is classified as safe, boundary or danger.
    pub fn is_classified(self) -> bool {
        matches!(self, Self::Safe | Self::Boundary | Self::Danger)
    }

    /// The zone of an interval.
    pub(crate) fn of_interval([low, high]: [f64; 2]) -> Self {
        match zone::zone(Interval { low, high }, ZoneLimits::PAPER) {
            zone::Zone::Safe => Self::Safe,
            zone::Zone::Boundary => Self::Boundary,
            zone::Zone::Danger => Self::Danger,
            zone::Zone::TooThin { .. } => Self::Undecided,
        }
    }

    /// The zone of each cell, at a simultaneous confidence of 95 %.
    pub(crate) fn of(cells: &[Trials]) -> Vec<Self> {
        let level = Confidence::P95.shared_by(cells.len());
        // The same number of episodes with a success rate of 50 %.
        let halves: Vec<Trials> = cells.iter().map(|c| Trials::new(c.n() / 2, c.n()).unwrap_or(Trials::NONE)).collect();
        let zone = |(found, half)| match found {
            zone::Zone::Safe => Self::Safe,
            zone::Zone::Boundary => Self::Boundary,
            zone::Zone::Danger => Self::Danger,
            zone::Zone::TooThin { .. } if half == zone::Zone::Boundary => Self::Undecided,
            zone::Zone::TooThin { .. } => Self::TooFewEpisodes,
        };
        let at_level = |cells: &[Trials]| zones(cells, ZoneLimits::PAPER, level);
        at_level(cells).into_iter().zip(at_level(&halves)).map(zone).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn undecided_is_not_too_few_episodes() {
        let of = |k, n| Trials::new(k, n).unwrap();
        let cells = [of(700, 1_000), of(7, 10), of(0, 0), of(950, 1_000), of(500, 1_000), of(50, 1_000)];
        let names: Vec<&str> = Zone::of(&cells).into_iter().map(Zone::as_str).collect();
        assert_eq!(
            names,
            ["undecided", "too few episodes", "too few episodes", "mostly succeeds", "boundary", "mostly fails"]
        );
    }
}
