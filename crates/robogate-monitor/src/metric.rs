//! The metrics of a recipe.

use std::borrow::Cow;

use crate::settings::Settings;

/// A metric that the monitor watches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Metric {
    /// The rate of failures.
    Success,
    /// The rate of an event: its index among the events of the settings.
    Event(u8),
    /// The location of the cycle time of successful cycles.
    CycleTime,
    /// The spread of the cycle time of successful cycles.
    CycleTimeSpread,
    /// The shares of the failure modes among failures.
    FailureModes,
    /// The rate of cycles outside the validated region.
    Outside,
    /// The failure rate that the risk model predicts.
    Risk,
    /// The failure rate of one robot among several.
    Robot,
}

impl Metric {
    /// The metrics that every recipe has, in the order of their indices.
    pub(crate) const FIXED: [Self; 7] = [
        Self::Success,
        Self::CycleTime,
        Self::CycleTimeSpread,
        Self::FailureModes,
        Self::Outside,
        Self::Risk,
        Self::Robot,
    ];

    /// All metrics, in the order of reports.
    pub fn all(settings: &Settings) -> impl Iterator<Item = Self> + use<> {
        let events = (0..settings.events.len() as u8).map(Self::Event);
        let [success, others @ ..] = Self::FIXED;
        std::iter::once(success).chain(events).chain(others)
    }

    /// The index of the metric's detector: events follow the others.
    pub(crate) fn index(self) -> usize {
        match self {
            Self::Success => 0,
            Self::CycleTime => 1,
            Self::CycleTimeSpread => 2,
            Self::FailureModes => 3,
            Self::Outside => 4,
            Self::Risk => 5,
            Self::Robot => 6,
            Self::Event(event) => Self::FIXED.len() + usize::from(event),
        }
    }

    /// The name of the metric in data: `success`, or `event:` and the name of the event.
    pub fn name(self, settings: &Settings) -> Cow<'static, str> {
        Cow::Borrowed(match self {
            Self::Success => "success",
            Self::Event(_) => return format!("event:{}", settings.event(self).unwrap_or_default()).into(),
            Self::CycleTime => "cycle_time",
            Self::CycleTimeSpread => "cycle_time_spread",
            Self::FailureModes => "failure_modes",
            Self::Outside => "outside",
            Self::Risk => "risk",
            Self::Robot => "robot",
        })
    }

    /// The label of the metric.
    pub fn label(self, settings: &Settings) -> Cow<'static, str> {
        Cow::Borrowed(match self {
            Self::Success => "failure rate",
            Self::Event(_) => return format!("{} rate", settings.event(self).unwrap_or_default()).into(),
            Self::CycleTime => "cycle time",
            Self::CycleTimeSpread => "spread of the cycle time",
            Self::FailureModes => "mix of failure modes",
            Self::Outside => "cycles outside the validated region",
            Self::Risk => "expected failure rate",
            Self::Robot => "failure rate of one robot",
        })
    }
}
